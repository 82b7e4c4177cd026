"""A small room seen twice, and a registration of it that is known in advance: what the Rerun tests log."""

from functools import lru_cache

import numpy as np
from depth_scene import camera_pose, render
from scipy.spatial.transform import Rotation

from adagmm_fusion.clouds.building import cloud_from_frame
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.pairs.fusion import fused_mesh
from adagmm_o3d.result import Deferred, Partners, PointRegistrationResult, PoseUncertainty, StopReason, Verdict

ITERATIONS = 12
INTRINSICS = PinholeIntrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)


@lru_cache
def room_pair(index: int = 0) -> RGBDPair:
    """Two views 15 degrees and more apart, in millimetres, with the exact pose between them."""
    T_world_target, T_world_source = camera_pose(0.0), camera_pose(15.0 + 5.0 * index, position=(0.1, 0.15, 1.3))
    frames = []
    for name, T in (("left", T_world_source), ("right", T_world_target)):
        color, depth = render(INTRINSICS, T)
        frames.append(RGBDFrame(name, color, np.rint(1000.0 * depth).astype(np.uint16), INTRINSICS, 1000.0, name))
    T_target_source = np.linalg.inv(T_world_target) @ T_world_source
    return RGBDPair(f"pair_{index}", *frames, T_target_source, index)


@lru_cache
def room_clouds(index: int = 0):
    """Source and target clouds of about 1500 points, with colours, normals and Kinect covariances."""
    pair = room_pair(index)
    return tuple(cloud_from_frame(frame, target_points=1500) for frame in (pair.source, pair.target))


def known_estimate(
    index: int = 0, *, off=(0.0, 0.0, 0.0), unobservable=(), iterations: int = ITERATIONS
) -> PointRegistrationResult:
    """A registration that goes from the identity straight to the truth, or as far off [m] as asked."""
    T_end = room_pair(index).T_target_source.copy()
    T_end[:3, 3] += off
    source, _ = room_clouds(index)
    shares = np.linspace(0.0, 1.0, iterations + 1)
    transformations = np.tile(np.eye(4), (len(shares), 1, 1))
    rotation_vector = Rotation.from_matrix(T_end[:3, :3]).as_rotvec()
    transformations[:, :3, :3] = Rotation.from_rotvec(shares[:, None] * rotation_vector).as_matrix()
    transformations[:, :3, 3] = shares[:, None] * T_end[:3, 3]
    steps = np.arange(iterations)
    return PointRegistrationResult(
        transformation=transformations[-1],
        stop_reason=StopReason.CONVERGED,
        iterations=iterations,
        sigmas=0.04 * 0.7**steps,
        energies=2.0 + 0.5**steps,
        transformations=transformations,
        dropped_source=0,
        dropped_target=0,
        regularised_source=0,
        regularised_target=0,
        ambiguous=False,
        doubts=(),
        find_partners=Deferred(lambda: Partners(0.7, np.linspace(0.0, 1.0, len(source.points)))),
        assess=Deferred(lambda: PoseUncertainty(None, unobservable)),
        weigh=Deferred(lambda: Verdict(2.0)),
    )


@lru_cache
def room_mesh(index: int = 0, off=(0.0, 0.0, 0.0)) -> TexturedMesh:
    """Both views joined at the end of `known_estimate`."""
    T_target_source = known_estimate(index, off=off).transformation
    return fused_mesh(room_pair(index), T_target_source, max_depth_m=6.0)
