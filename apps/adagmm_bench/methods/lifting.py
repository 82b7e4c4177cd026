"""2D clouds for libraries that know 3D only, and the Open3D clouds made from ours.

A 2D cloud becomes two parallel layers. As both clouds have the same layers, the nearest neighbour
of a point is the one it has in 2D, and the second layer holds the tilt and the height that the plane alone would
leave free.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d

from adagmm_bench.problem import Cloud
from adagmm_o3d.errors import InputError

HEIGHT = 0.5  # radii
THIN_HEIGHT = 0.1  # so low that neighbourhoods span both layers and surface normals found in 3D lie in the plane
NORMAL_NEIGHBOURS = {2: 8, 3: 20}


def lift(cloud: Cloud, height: float = HEIGHT) -> Cloud:
    """A 2D cloud as two layers at z = ±height, with unit variance across; a 3D cloud as it is."""
    if cloud.points.shape[1] == 3:
        return cloud
    n = len(cloud)
    points = np.concatenate([np.column_stack([cloud.points, np.full(n, z)]) for z in (-height, height)])
    covariances = np.zeros((2 * n, 3, 3))
    covariances[:, :2, :2] = np.tile(cloud.covariances, (2, 1, 1))
    covariances[:, 2, 2] = 1.0
    return Cloud(points, covariances)


def lower(T: np.ndarray, dimension: int) -> np.ndarray:
    """The SE(2) part of a 4x4 pose between lifted clouds (the nearest rotation); a 3D pose as it is.

    Raises
    ------
    InputError  if the pose turns the plane over.
    """
    if dimension == 3:
        return np.asarray(T, dtype=float)
    if T[2, 2] <= 0.0:
        raise InputError("the pose found turns the plane over")
    angle = np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1])
    planar = np.eye(3)
    planar[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    planar[:2, 2] = T[:2, 3]
    return planar


def open3d_cloud(cloud: Cloud, *, normals: bool = False, covariances: bool = False) -> o3d.geometry.PointCloud:
    """An Open3D cloud of the lifted points. Normals come from a plane (in 2D a line) through the nearest neighbours."""
    lifted = lift(cloud)
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(lifted.points))
    if normals:
        if cloud.points.shape[1] == 3:
            made.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS[3]))
        else:
            planar = line_normals(cloud.points)
            made.normals = o3d.utility.Vector3dVector(np.tile(np.column_stack([planar, np.zeros(len(planar))]), (2, 1)))
    if covariances:
        made.covariances = o3d.utility.Matrix3dVector(lifted.covariances)
    return made


def line_normals(points: np.ndarray) -> np.ndarray:
    """(n, 2) unit normals of the line through each point's nearest neighbours."""
    flat = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.column_stack([points, np.zeros(len(points))])))
    tree = o3d.geometry.KDTreeFlann(flat)
    normals = np.empty_like(points)
    for i, point in enumerate(flat.points):
        neighbours = points[np.asarray(tree.search_knn_vector_3d(point, NORMAL_NEIGHBOURS[2])[1])]
        normals[i] = np.linalg.eigh(np.cov(neighbours.T))[1][:, 0]
    return normals
