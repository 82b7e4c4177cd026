"""What a registered pair is good for: a coloured cloud and a textured mesh of both sensors, and the estimated rig."""

from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_fusion.clouds.building import dense_cloud
from adagmm_fusion.files.atomic_file import replacing
from adagmm_fusion.files.ply_file import ply_bytes
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDPair
from adagmm_fusion.meshes.joined_grids import SAME_SURFACE_M, textured_moment
from adagmm_fusion.meshes.orientation import upright
from adagmm_fusion.meshes.texture_colors import texture_colors
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.pairs.pipeline import PairOutcome
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import project_to_rotation

FUSED_VOXEL_SIZE_M = 0.01


def fused_cloud(
    pair: RGBDPair,
    T_target_source: np.ndarray,
    *,
    max_depth_m: float,
    voxel_size_m: float = FUSED_VOXEL_SIZE_M,
    mesh: TexturedMesh | None = None,
) -> o3d.geometry.PointCloud:
    """Every measured point of both frames in the target's camera frame [m], averaged with its colour over a voxel grid.

    mesh : of the same frames; what lies on it has the colours that were blended for it.

    Raises
    ------
    InputError  if a frame has no depth up to max_depth_m.
    """
    target = dense_cloud(pair.target, max_depth=max_depth_m)
    source = dense_cloud(pair.source, max_depth=max_depth_m).transform(T_target_source)
    cloud = (target + source).voxel_down_sample(voxel_size_m)
    if mesh is not None:
        blended, near = texture_colors(mesh, np.asarray(cloud.points), within_m=SAME_SURFACE_M)
        colors = np.where(near[:, None], blended, np.asarray(cloud.colors))
        cloud.colors = o3d.utility.Vector3dVector(colors)
    return cloud


def fused_mesh(pair: RGBDPair, T_target_source: np.ndarray, *, max_depth_m: float) -> TexturedMesh | None:
    """The surface of both frames in the target's camera frame, textured; None where one of them shows no surface."""
    placed = [(pair.target, np.eye(4)), (pair.source, T_target_source)]
    try:
        return textured_moment(placed, max_depth_m=max_depth_m)
    except InputError:
        return None


def save_cloud(path: Path, cloud: o3d.geometry.PointCloud) -> None:
    """Write a binary .ply, y up, float32 positions and 8-bit colours. Raises OutputError if it cannot be written."""
    with replacing(path) as temporary:
        temporary.write_bytes(ply_bytes(upright(cloud.points), np.asarray(cloud.colors)))


class RigEstimate:
    """Collects outcomes of a rig's pairs and averages them into one rig, whose frame is the target's camera frame.

    Only pairs of two sensors at one moment say something about a rig, all with the same target sensor; if another pair
    comes, there is no rig to estimate.
    """

    def __init__(self) -> None:
        self._target: str | None = None
        self._sensors: dict[str, tuple[PinholeIntrinsics, float]] = {}
        self._poses: dict[str, list[np.ndarray]] = {}
        self._is_rig = True

    def add(self, outcome: PairOutcome) -> None:
        """Take an outcome into account; the pose only if it was registered."""
        if outcome.pair is None or not self._is_rig:
            return
        target, source = outcome.pair.target, outcome.pair.source
        self._target = self._target or target.sensor
        if target.sensor != self._target or source.sensor == target.sensor or source.name != target.name:
            self._is_rig = False
            return
        for frame in (target, source):
            self._sensors.setdefault(frame.sensor, (frame.intrinsics, frame.depth_scale))
        self._poses.setdefault(source.sensor, [])
        if outcome.status == "ok":
            self._poses[source.sensor].append(np.asarray(outcome.T_estimate))

    def rig(self, name: str) -> Rig | None:
        """The rig, with sensors `unknown` that were never registered; None if no sensor was, or there is no rig."""
        if not self._is_rig or not any(self._poses.values()):
            return None
        calibrations, counts = {}, []
        for sensor, (intrinsics, depth_scale) in self._sensors.items():
            T_rig_sensor = np.eye(4) if sensor == self._target else mean_pose(self._poses[sensor])
            calibrations[sensor] = SensorCalibration(sensor, intrinsics, depth_scale, T_rig_sensor)
            if sensor != self._target:
                counts.append(f"{sensor} from {len(self._poses[sensor])} pair(s)")
        return Rig(name, calibrations, f"estimated by registration: {', '.join(counts)}")


def mean_pose(poses: list[np.ndarray]) -> np.ndarray | None:
    """The rotation nearest to all in the chordal sense, and the mean translation; (4, 4).

    None of none, and where no rotation is nearest to all, as of two half a turn apart.
    """
    if not poses:
        return None
    mean = np.mean(poses, axis=0)
    try:
        mean[:3, :3] = project_to_rotation(mean[:3, :3])
    except InputError:
        return None
    return mean
