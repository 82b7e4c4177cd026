"""Which way round a pose is meant: only under the right reading two depth images see the same surfaces."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.frames.depth_geometry import back_project, depth_in_range
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_o3d.lie import se_inverse

MIN_DEPTH, MAX_DEPTH = 0.1, 8.0
# So many points of a frame are looked at.
SAMPLES = 4000
# Depths agree up to this share of them, and at least this much [m].
AGREEMENT, AGREEMENT_M = 0.03, 0.02
# Another reading is believed if it explains this many times as much, and this much more of all points.
CLEARLY, CLEARLY_MORE = 1.5, 0.1
# With a smaller share of agreeing points a reading may be a coincidence.
LEAST_SHARE = 0.4
# A shorter way [m] between two frames is almost none, which near frames agree with whatever was given: numbers that
# small were metres.
LEAST_WAY = {"millimetres": 0.005, "centimetres": 0.05}

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward


def _transposed(T: np.ndarray) -> np.ndarray:
    turned = T.copy()
    turned[:3, :3] = T[:3, :3].T
    return turned


def _divided(T: np.ndarray, by: float) -> np.ndarray:
    """With its translation divided."""
    scaled = T.copy()
    scaled[:3, 3] /= by
    return scaled


def _w_first(T: np.ndarray) -> np.ndarray:
    """Of a pose that was made of (w, x, y, z) as if it were (x, y, z, w)."""
    turned = T.copy()
    turned[:3, :3] = Rotation.from_quat(np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), -1)).as_matrix()
    return turned


def _same(T: np.ndarray) -> np.ndarray:
    return T


AS_GIVEN = "as given"
# What a given T_world_camera becomes when it is read as something else.
READINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    AS_GIVEN: _same,
    "the inverse": se_inverse,
    "with its rotation transposed": _transposed,
    "in millimetres": lambda T: _divided(T, 1000.0),
    "the inverse, in millimetres": lambda T: se_inverse(_divided(T, 1000.0)),
    "in centimetres": lambda T: _divided(T, 100.0),
    "with its translation the other way": lambda T: _divided(T, -1.0),
    "with w first in its quaternion": _w_first,
    "the inverse, with w first in its quaternion": lambda T: se_inverse(_w_first(T)),
    "of a camera with y up and z backward": lambda T: T @ OPENGL,
    "the inverse, of a camera with y up and z backward": lambda T: se_inverse(OPENGL @ T),
}


@dataclass(frozen=True)
class BestReading:
    """The reading to believe, and the shares of points that agree under it and as given.

    share_at_one_place : where that is clearly better than what is believed, of both frames at almost one place; else 0.
    """

    name: str
    share: float
    share_as_given: float
    share_at_one_place: float = 0.0


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two frames and their poses as a file gives them, T_world_camera (4, 4)."""

    source: RGBDFrame
    target: RGBDFrame
    source_pose: np.ndarray
    target_pose: np.ndarray


def best_reading(pairs: Iterable[PosedPair]) -> BestReading:
    """The reading under which the depth images of the pairs agree; as given, unless another is clearly better."""
    shares: dict[str, list[float]] = {name: [] for name in READINGS}
    ways = dict.fromkeys(READINGS, 0.0)
    for pair in pairs:
        points = sampled_points(pair.source)
        for name, read in READINGS.items():
            T = se_inverse(read(pair.target_pose)) @ read(pair.source_pose)
            shares[name].append(agreeing_share(points, pair.target, T))
            ways[name] = max(ways[name], float(np.linalg.norm(T[:3, 3])))
    means = {name: float(np.mean(values)) if values else 0.0 for name, values in shares.items()}
    given = means[AS_GIVEN]
    too_near = {name for name in READINGS for unit, least in LEAST_WAY.items() if unit in name and ways[name] < least}
    best = max(means.keys() - too_near, key=lambda name: (means[name], -list(READINGS).index(name)))
    if not clearly_better(means[best], given):
        best = AS_GIVEN
    at_one_place = max((means[name] for name in too_near), default=0.0)
    at_one_place = at_one_place if clearly_better(at_one_place, means[best]) else 0.0
    return BestReading(best, means[best], given, at_one_place)


def clearly_better(share: float, than: float) -> bool:
    """Whether a share of agreeing points is no coincidence beside another one."""
    return share >= max(CLEARLY * than, than + CLEARLY_MORE, LEAST_SHARE)


def sampled_points(frame: RGBDFrame) -> np.ndarray:
    """(N, 3) [m], camera frame: some thousand measured points, evenly over the image."""
    points = back_project(depth_in_range(frame, MIN_DEPTH, MAX_DEPTH), frame.intrinsics)
    every = max(int(np.sqrt(points.shape[0] * points.shape[1] / SAMPLES)), 1)
    points = points[::every, ::every].reshape(-1, 3)
    return points[np.isfinite(points).all(axis=1)]


def agreeing_share(
    points: np.ndarray, target: RGBDFrame, T_target_source: np.ndarray, at_least_m: float = AGREEMENT_M
) -> float:
    """The share of the source's points (N, 3) [m] that the target sees where its own depth is, up to AGREEMENT of it
    or `at_least_m`."""
    if not len(points):
        return 0.0
    k = target.intrinsics
    x, y, z = (points @ T_target_source[:3, :3].T + T_target_source[:3, 3]).T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        column, row = np.floor(k.fx * x / z + k.cx + 0.5), np.floor(k.fy * y / z + k.cy + 0.5)
        seen = (z > MIN_DEPTH) & (column >= 0) & (column < k.width) & (row >= 0) & (row < k.height)
    depth = depth_in_range(target, MIN_DEPTH, MAX_DEPTH)[row[seen].astype(int), column[seen].astype(int)]
    with np.errstate(invalid="ignore"):
        agree = np.abs(depth - z[seen]) < np.maximum(AGREEMENT * z[seen], at_least_m)
    return float(agree.sum() / len(points))
