"""One method on one coloured pair of frames, from the truth disturbed by a known amount."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import open3d as o3d

from adagmm_bench.methods import METHODS
from adagmm_bench.methods.variant import Replacement, Variant, replaced
from adagmm_bench.scenes import FramePair
from adagmm_bench.trial import TrialJob, record_of
from adagmm_fusion.clouds.building import clouds_from_pair, dense_cloud
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.settings import Settings
from adagmm_o3d import TransformationEstimationForAdaptiveGMM, registration_adaptive_gmm
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import hat, se_exp

# How far the truth is turned, about a random axis through the target's centroid, and shifted [degrees, m].
STARTS = {"5° and 0.1 m": (5.0, 0.1), "10° and 0.2 m": (10.0, 0.2)}
SEED = 7
# Open3D's tutorial on coloured ICP: voxels, which are the distances as well, and iterations; and with distances that
# reach as far as the starts are off.
TUTORIAL = (((0.04, 0.04), 50), ((0.02, 0.02), 30), ((0.01, 0.01), 14))
REACHING = (((0.08, 0.4), 50), ((0.04, 0.2), 50), ((0.02, 0.1), 30), ((0.02, 0.04), 30))


def _as_before(self: Any, *_: Any) -> Any:
    return self.prior()


def _one_sensor(*_: Any) -> tuple[np.ndarray, np.ndarray]:
    return np.ones(3), np.zeros(3)


VARIANTS = {
    "adagmm": Variant("This package on the app's clouds, geometry alone."),
    "adagmm-color": Variant("The same with colours.", {"color": True}),
    "adagmm-color-fixed": Variant(
        "With colours whose variance and share that lies are what they are before any pair is known.",
        {"color": True},
        replacements=(
            Replacement("em.colour", "ColourEstimate.first", _as_before),
            Replacement("em.colour", "ColourEstimate.next", _as_before),
        ),
    ),
    "adagmm-color-believed": Variant(
        "With colours of which next to none is taken to lie.",
        {"color": True},
        replacements=(Replacement("em.colour", "MOST_LYING", 0.02), Replacement("em.colour", "LYING", 0.02)),
    ),
    "adagmm-color-as-seen": Variant(
        "With colours as they are, whatever two sensors make of one.",
        {"color": True},
        replacements=(Replacement("em.colour", "correction", _one_sensor),),
    ),
}


def colored_icp(pair: RGBDPair, init: np.ndarray, steps: Any) -> np.ndarray:
    """Open3D's `registration_colored_icp` on all points of both frames, coarse to fine."""
    reg, T = o3d.pipelines.registration, init
    dense = [dense_cloud(frame, max_depth=Settings().max_depth_m) for frame in (pair.source, pair.target)]
    for (voxel, distance), iterations in steps:
        clouds = [cloud.voxel_down_sample(voxel) for cloud in dense]
        for cloud in clouds:
            cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2.0 * voxel, max_nn=30))
        result = reg.registration_colored_icp(
            *clouds,
            distance,
            T,
            reg.TransformationEstimationForColoredICP(),
            reg.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=iterations),
        )
        T = result.transformation
    return np.asarray(T)


def ours(pair: RGBDPair, init: np.ndarray, variant: Variant) -> tuple[np.ndarray, dict[str, float]]:
    """A variant of this package, as the app calls it: its pose, and the standard deviations that it says of it."""
    settings = Settings()
    source, target = clouds_from_pair(pair, target_points=settings.target_points, max_depth=settings.max_depth_m)
    with replaced(variant.replacements):
        found = registration_adaptive_gmm(
            source,
            target,
            0.05,
            init,
            TransformationEstimationForAdaptiveGMM(**variant.options),
            device="cpu",
            source_viewpoint=np.zeros(3),
            target_viewpoint=np.zeros(3),
        ).details
        return found.transformation, deviations(found.transformation, found.pose_covariance)


def deviations(T_target_source: np.ndarray, covariance: np.ndarray | None) -> dict[str, float]:
    """Standard deviations of a pose (4, 4), as its errors are measured: of the turn and of the translation, which a
    turn on the left moves too; none without a covariance (6, 6)."""
    if covariance is None:
        return {}
    moved = np.hstack([-hat(T_target_source[:3, 3]), np.eye(3)])
    return {
        "rotation_deviation_deg": float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        "translation_deviation": float(np.sqrt(np.trace(moved @ covariance @ moved.T))),
    }


PEERS: dict[str, tuple[str, Callable[[RGBDPair, np.ndarray], np.ndarray]]] = {
    "open3d-colored-icp": (
        "Open3D's coloured ICP as its tutorial has it.",
        lambda pair, init: colored_icp(pair, init, TUTORIAL),
    ),
    "open3d-colored-icp-reaching": (
        "The same with distances of 0.4 m down to 0.04 m, that reach as far as the starts are off.",
        lambda pair, init: colored_icp(pair, init, REACHING),
    ),
}
NAMES = (*VARIANTS, *PEERS)


def meaning(name: str) -> str:
    return VARIANTS[name].meaning if name in VARIANTS else PEERS[name][0]


def version_of(name: str) -> str:
    return METHODS["adagmm" if name in VARIANTS else "open3d-gicp"].version()


def disturbed(T_target_source: np.ndarray, start: str, index: int, centre: np.ndarray) -> np.ndarray:
    """(4, 4) the truth turned about the centre (3,) and shifted, as a start says; the same for every method."""
    rng = np.random.default_rng([SEED, index, list(STARTS).index(start)])
    angle_deg, distance = STARTS[start]
    axis, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = se_exp(np.concatenate([np.radians(angle_deg) * axis, np.zeros(3)]))
    T = turn @ T_target_source
    T[:3, 3] += centre - turn[:3, :3] @ centre + distance * shift
    return T


def run_color_trial(job: TrialJob[FramePair]) -> dict:
    """The errors of a method's pose on a pair of frames; of one that raises, those of its start."""
    pair = job.problem.frames()
    assert pair.T_target_source is not None
    centre = np.asarray(dense_cloud(pair.target, max_depth=Settings().max_depth_m).points).mean(axis=0)
    init = disturbed(pair.T_target_source, job.start, job.problem.index, centre)
    started, reason, T = time.process_time(), "", init
    own: dict[str, float] = {}
    try:
        if job.method in VARIANTS:
            T, own = ours(pair, init, VARIANTS[job.method])
        else:
            T = PEERS[job.method][1](pair, init)
    except Exception as error:  # a peer may raise anything, and that is its result
        reason = " ".join(f"{type(error).__name__}: {error}".split())
    seconds = time.process_time() - started
    errors = pose_errors(pair.T_target_source, T)
    return record_of(
        job,
        version_of(job.method),
        reason=reason,
        cpu_seconds=seconds,
        rotation_error_deg=errors.rotation_deg,
        translation_error=errors.translation,
        **own,
    )
