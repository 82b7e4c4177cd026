"""Tell the registration how a sensor errs, compared with telling it nothing: a stereo camera, whose noise grows with
the square of the distance, and some of whose pixels are known to be wrong."""

import numpy as np
import open3d as o3d

from adagmm_o3d import estimate_surface_covariances, mark_outliers, registration_adaptive_gmm

NOISE_AT_A_METRE, WRONG = 0.004, 0.35
rng = np.random.default_rng(0)
o3d.utility.random.seed(0)


def seen(surface, T_world_camera):
    """The surface as a camera measures it, in its own frame; standard deviations [m]; which points are wrong."""
    cloud = surface.sample_points_uniformly(2500).transform(np.linalg.inv(T_world_camera))
    points = np.asarray(cloud.points)
    sigma = NOISE_AT_A_METRE * np.sum(points**2, axis=1)
    points += sigma[:, None] * rng.normal(size=points.shape)
    wrong = rng.random(len(points)) < WRONG * (points[:, 0] > 0)
    points[wrong] *= rng.uniform(0.3, 0.9, size=(wrong.sum(), 1))
    return cloud, sigma, wrong


def box(size, corner):
    return o3d.geometry.TriangleMesh.create_box(*size).translate(corner)


# Two boxes on a table at a metre, and a far corner of the room.
room = box((1.2, 0.05, 0.8), (-0.6, 0.3, 0.8)) + box((0.3, 0.3, 0.2), (-0.4, 0.0, 1.0))
room += box((0.2, 0.2, 0.3), (0.1, 0.1, 0.9)) + box((4.0, 2.5, 0.05), (-2.0, -1.5, 4.0))
room += box((0.05, 2.5, 2.0), (-2.0, -1.5, 2.0))
T_world_second = np.eye(4)
T_world_second[:3, :3] = o3d.geometry.get_rotation_matrix_from_xyz(np.radians((2.0, 12.0, 3.0)))
T_world_second[:3, 3] = (-0.3, 0.05, 0.1)

views = seen(room, T_world_second), seen(room, np.eye(4))
for told in ("nothing", "the noise", "the wrong points", "both"):
    for cloud, sigma, wrong in views:
        covariances = estimate_surface_covariances(np.asarray(cloud.points))
        if told in ("the noise", "both"):
            covariances *= sigma[:, None, None] ** 2
        if told in ("the wrong points", "both"):
            covariances = mark_outliers(covariances, wrong)
        cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    (source, *_), (target, *_) = views
    result = registration_adaptive_gmm(source, target, 0.05)
    millimetres = 1000.0 * np.linalg.norm(result.transformation[:3, 3] - T_world_second[:3, 3])
    turned = result.transformation[:3, :3].T @ T_world_second[:3, :3]
    degrees = np.degrees(np.arccos(np.clip((np.trace(turned) - 1.0) / 2.0, -1.0, 1.0)))
    print(f"told {told}: {degrees:.2f} degrees and {millimetres:.0f} mm off")
