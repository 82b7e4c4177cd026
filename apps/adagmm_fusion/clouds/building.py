"""From a depth camera's frame to the cloud that is registered: some thousand averaged points with normals and
covariances."""

import numpy as np
import open3d as o3d

from adagmm_fusion.clouds.sensor_models import NONE, sensor_models
from adagmm_fusion.clouds.surface_grid import surface_grid
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_o3d.errors import InputError
from adagmm_o3d.uncertainty.sensor_models import DEFAULT, estimate_sensor_covariances

# The paper registered clouds of 3000 to 4000 points.
TARGET_POINTS = 3500
MIN_DEPTH, MAX_DEPTH = 0.1, 6.0
# No voxels are finer than this [m], nor than this share of the cloud's extent: their numbers would not fit.
FINEST_VOXEL, FINEST_SHARE = 1e-4, 1e-6


def cloud_from_frame(
    frame: RGBDFrame,
    *,
    voxel_size: float | None = None,
    target_points: int = TARGET_POINTS,
    sensor_model: str = DEFAULT,
    min_depth: float = MIN_DEPTH,
    max_depth: float = MAX_DEPTH,
) -> o3d.geometry.PointCloud:
    """A frame's cloud: depth edges removed, averaged over a voxel grid, with normals towards the camera and
    covariances.

    Parameters
    ----------
    voxel_size : [m]; None takes the size that leaves about `target_points`.
    sensor_model : where covariances come from: "kinect-surface" (the sensor's noise and the spacing along the surface,
        m²), "kinect" (Pu et al. Eq. 6, relative), "nguyen" (noise alone, Nguyen et al. 2012, m²), "surface" (the
        surface alone, relative), another package's (see `uncertainty.sensor_models`), or "none".
    min_depth, max_depth : [m], along the optical axis; what lies outside is left out.

    Returns
    -------
    PointCloud with points [m, camera frame], colors 0..1, normals (unit), covariances (unless "none").

    Raises
    ------
    InputError  if an argument is out of its range, or no point is left.
    """
    dense = dense_cloud(frame, min_depth=min_depth, max_depth=max_depth)
    if voxel_size is None:
        voxel_size = find_voxel_size([dense], target_points)
    return _sparse_cloud(dense, voxel_size, sensor_model, frame)


def clouds_from_pair(
    pair: RGBDPair,
    *,
    voxel_size: float | None = None,
    target_points: int = TARGET_POINTS,
    sensor_model: str = DEFAULT,
    min_depth: float = MIN_DEPTH,
    max_depth: float = MAX_DEPTH,
) -> tuple[o3d.geometry.PointCloud, o3d.geometry.PointCloud]:
    """The source's and the target's cloud, as cloud_from_frame makes them, on voxels of one size: about
    `target_points` each
    on average, and equally dense where they overlap."""
    frames = (pair.source, pair.target)
    dense = [dense_cloud(frame, min_depth=min_depth, max_depth=max_depth) for frame in frames]
    if voxel_size is None:
        voxel_size = find_voxel_size(dense, target_points)
    source, target = (_sparse_cloud(d, voxel_size, sensor_model, f) for d, f in zip(dense, frames, strict=True))
    return source, target


def dense_cloud(
    frame: RGBDFrame, *, min_depth: float = MIN_DEPTH, max_depth: float = MAX_DEPTH
) -> o3d.geometry.PointCloud:
    """One point, with color and normal, for each pixel with depth not at a depth edge. Raises InputError if none is."""
    if not 0 <= min_depth < max_depth:
        raise InputError(f"min_depth, max_depth: expected 0 <= min < max [m], got {min_depth:g} and {max_depth:g}")
    grid = surface_grid(frame, min_depth, max_depth)
    kept = grid.known
    if not kept.any():
        measured = frame.depth_m()
        measured = measured[np.isfinite(measured)]
        seen = f"depth from {measured.min():.3g} to {measured.max():.3g} m" if measured.size else "no depth at all"
        raise InputError(
            f"{frame.name}: {frame.sensor}: the cloud is empty: no surface between {min_depth:g} and {max_depth:g} m, "
            f"the image has {seen}; check depth_scale ({frame.depth_scale:g} units per metre) and the limits"
        )
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(grid.points[kept]))
    cloud.colors = o3d.utility.Vector3dVector(frame.color[kept] / 255.0)
    cloud.normals = o3d.utility.Vector3dVector(grid.normals[kept])
    return cloud


def find_voxel_size(clouds: list[o3d.geometry.PointCloud], target_points: int) -> float:
    """The voxel size [m] that leaves about `target_points` a cloud, on average; smaller clouds stay whole."""
    if target_points < 1:
        raise InputError(f"target_points: expected a positive number, got {target_points}")
    points = [np.asarray(cloud.points) for cloud in clouds]
    extent = max(np.ptp(p, axis=0).max() for p in points)
    size = max(extent / np.sqrt(target_points), 1e-3)
    for _ in range(8):
        count = np.mean([_occupied_voxels(p, size) for p in points])
        if abs(count / target_points - 1) < 0.02:
            break
        # A surface fills voxels by its area. Where there are fewer points, no grid is fine enough.
        size = max(size * np.sqrt(count / target_points), FINEST_VOXEL, extent * FINEST_SHARE)
    return float(size)


def _occupied_voxels(points: np.ndarray, size: float) -> int:
    # Open3D's own grid starts half a voxel before the lowest coordinates.
    cells = np.floor((points - points.min(axis=0)) / size + 0.5).astype(np.int64)
    extent = cells.max(axis=0) + 1
    return np.unique((cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]).size


def _sparse_cloud(
    dense: o3d.geometry.PointCloud, voxel_size: float, sensor_model: str, frame: RGBDFrame
) -> o3d.geometry.PointCloud:
    if not (np.isfinite(voxel_size) and voxel_size > 0):
        raise InputError(f"voxel_size: expected a positive length [m], got {voxel_size}")
    cloud = dense.voxel_down_sample(voxel_size)
    cloud.normalize_normals()
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    if sensor_model not in sensor_models():
        raise InputError(f"sensor_model: expected one of {', '.join(sensor_models())}, got {sensor_model!r}")
    if sensor_model == NONE:
        return cloud
    focal_lengths = (frame.intrinsics.fx, frame.intrinsics.fy)
    covariances = estimate_sensor_covariances(sensor_model, points, normals, focal_lengths)
    cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    return cloud
