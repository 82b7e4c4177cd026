"""Arrays, legacy clouds and tensor clouds of one pair: the same pose, by whichever door they come."""

import numpy as np
import open3d as o3d
import pytest
from shared_data import shared_data

from adagmm_o3d import estimate_surface_covariances, register_points, registration_adaptive_gmm

core = o3d.core


def assert_same(transformation, expected):
    np.testing.assert_allclose(transformation, expected, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "3dm_7-scenes-redki_0_5",
        "3dm_sun3d-hotel_um_8_15",
        "goicp_bunny",
        "kitti_small_gicp",
        "lpm_cloud_1_0",
        "mac_demo",
        "o3d_frag_0_4",
        "opengr_hippo",
        "pcl_bun4_bun0",
        "stanford_bunny_bun045_bun000",
        "stanford_bunny_bun090_bun045",
        "stanford_dragon_Right_24_dRight_0",
        "stanford_dragon_Right_72_Right_24",
    ],
)
@pytest.mark.parametrize("dtype", [core.float32, core.float64])
def test_every_door_leads_to_the_same_pose(name, dtype):
    data = np.load(shared_data("cloud_pairs", f"{name}.npz"))
    points = [data[which][:: max(1, len(data[which]) // 2000)] for which in ("source", "target")]
    covariances = [estimate_surface_covariances(p) for p in points]
    expected = register_points(*points, *covariances).transformation
    legacy = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p.astype(float))) for p in points]
    tensor = [o3d.t.geometry.PointCloud(core.Tensor(np.ascontiguousarray(p)).to(dtype)) for p in points]
    assert_same(registration_adaptive_gmm(*legacy, 0.1).transformation, expected)
    assert_same(registration_adaptive_gmm(*tensor, 0.1).transformation.numpy(), expected)
    for k in range(2):
        legacy[k].covariances = o3d.utility.Matrix3dVector(covariances[k])
        tensor[k].point.covariances = core.Tensor(covariances[k])
    assert_same(registration_adaptive_gmm(*legacy, 0.1).transformation, expected)
    assert_same(registration_adaptive_gmm(*tensor, 0.1).transformation.numpy(), expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kitti_small_gicp", "stanford_bunny_bun045_bun000"])
def test_dense_clouds_are_the_same_by_every_door(name):
    data = np.load(shared_data("cloud_pairs", f"{name}.npz"))
    points = [data[which] for which in ("source", "target")]
    expected = register_points(*points, *map(estimate_surface_covariances, points)).transformation
    legacy = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p.astype(float))) for p in points]
    tensor = [o3d.t.geometry.PointCloud(core.Tensor(np.ascontiguousarray(p))) for p in points]
    assert_same(registration_adaptive_gmm(*legacy, 0.1).transformation, expected)
    assert_same(registration_adaptive_gmm(*tensor, 0.1).transformation.numpy(), expected)
