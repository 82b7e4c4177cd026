"""Rendered pairs of depth cameras that err in a known way, and what the app says of its pose: the truth is exact."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from adagmm_bench.covariance_trial import normalised_error
from adagmm_bench.methods import METHODS
from adagmm_bench.trial import TrialJob, record_of
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.simulation.kinect import KinectModel, render_color, render_depth
from adagmm_fusion.simulation.raycast import Scene
from adagmm_fusion.simulation.recording import DEPTH_SCALE, SOURCE, T_WORLD_CAMERA, TARGET, simulated_rig
from adagmm_fusion.simulation.room import furnish
from adagmm_o3d.evaluation import pose_errors


@dataclass(frozen=True)
class Cameras:
    """How two cameras err: the steps of their disparity [px], and the scale and shift [m] of each one's depth."""

    disparity_step_px: float = 0.125
    source: tuple[float, float] = (1.0, 0.0)
    target: tuple[float, float] = (1.0, 0.0)


CAMERAS = {
    "true depth": Cameras(),
    "true depth in fine steps": Cameras(disparity_step_px=0.01),
    "depths 1 % apart": Cameras(source=(0.995, 0.0), target=(1.005, 0.0)),
    "both depths 1 % long": Cameras(source=(1.01, 0.0), target=(1.01, 0.0)),
    "depths 10 mm apart": Cameras(source=(1.0, -0.005), target=(1.0, 0.005)),
    "both depths 5 mm long": Cameras(source=(1.0, 0.005), target=(1.0, 0.005)),
}


@dataclass(frozen=True)
class RenderedPair:
    """A furnished room seen by two cameras."""

    cameras: str
    room: int

    @property
    def key(self) -> str:
        return f"room {self.room}, {self.cameras}"

    def content(self) -> str:
        return hashlib.sha256(repr(CAMERAS[self.cameras]).encode()).hexdigest()

    def facts(self) -> dict:
        return {"cameras": self.cameras, "room": self.room}

    def load(self) -> RGBDPair:
        cameras, rig = CAMERAS[self.cameras], simulated_rig("rendered")
        scene, frames = Scene(furnish(self.room, 0)), {}
        for number, (sensor, (scale, shift)) in enumerate(((TARGET, cameras.target), (SOURCE, cameras.source))):
            depth_noise, color_noise = (np.random.default_rng([self.room, number, kind]) for kind in (0, 1))
            model = KinectModel(disparity_step_px=cameras.disparity_step_px)
            depth = render_depth(scene, T_WORLD_CAMERA[sensor], depth_noise, model).astype(float)
            wrong = np.where(depth > 0.0, scale * depth + DEPTH_SCALE * shift, 0.0)
            frames[sensor] = RGBDFrame(
                name=str(self.room),
                sensor=sensor,
                color=render_color(scene, T_WORLD_CAMERA[sensor], color_noise),
                depth=np.rint(wrong).astype(np.uint16),
                depth_scale=DEPTH_SCALE,
                intrinsics=rig.sensors[sensor].intrinsics,
            )
        return RGBDPair(self.key, frames[SOURCE], frames[TARGET], rig.T_target_source(TARGET, SOURCE), 0)


def run_rendered_trial(job: TrialJob[RenderedPair]) -> dict:
    """Register through the app, which judges; the record has `nees`, see `normalised_error`, and the pose's errors."""
    pair = job.problem.load()
    outcome = register_pair(pair, Settings())
    found: dict = {"status": outcome.status, "reason": outcome.reason, "nees": None, "free": 0}
    if (estimate := outcome.estimate) is not None:
        errors = pose_errors(pair.T_target_source, estimate.transformation)
        found |= {"rotation_error_deg": errors.rotation_deg, "translation_error": errors.translation}
        found["nees"] = normalised_error(pair.T_target_source, estimate.transformation, estimate.pose_covariance)
        found["free"] = len(estimate.unobservable)
    return record_of(job, METHODS[job.method].version(), **found)


def is_found(record: dict) -> bool:
    """Whether the app calls it a success: within 3° and 100 mm."""
    return record["status"] == "ok"
