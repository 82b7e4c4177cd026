"""Arrays, legacy clouds and tensor clouds of one pair: the same pose, by whichever door they come."""

import numpy as np
import open3d as o3d
import pytest
from shapes import bumpy, move
from shared_data import shared_data

from adagmm_o3d import estimate_surface_covariances, prepare, register_points, registration_adaptive_gmm
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp

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


@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize("which", ["source", "target"])
def test_covariances_of_one_cloud_alone_count_as_those_of_both(unit, which):
    """They were taken beside surfaces without a unit: in millimetres nothing overlapped."""
    rng = np.random.default_rng(5)
    T = se_exp(np.array([0.05, -0.04, 0.1, 0.1 * unit, 0.05 * unit, 0.0]))
    points = unit * bumpy(rng, 3000, 3)
    clouds = {"source": points[:1500], "target": move(points[1500:], T)}
    legacy = {
        name: o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.copy())) for name, points in clouds.items()
    }
    legacy[which].estimate_covariances()
    covariances = np.asarray(legacy[which].covariances).copy()
    tensor = {name: o3d.t.geometry.PointCloud.from_legacy(cloud) for name, cloud in legacy.items()}
    tensor[which].point.covariances = o3d.core.Tensor(covariances)
    results = [registration_adaptive_gmm(*pair.values(), 0.1 * unit, np.eye(4)) for pair in (legacy, tensor)]
    prepared = [prepare(cloud) for cloud in legacy.values()]
    results.append(registration_adaptive_gmm(*prepared, 0.1 * unit, np.eye(4)))
    found = [results[0].transformation, results[1].transformation.numpy(), results[2].transformation]
    for pose in found:
        errors = pose_errors(T, pose)
        assert errors.rotation_deg < 1.0 and errors.translation < 0.01 * unit
    for result in results:
        assert result.details.overlap > 0.9 and not result.details.unobservable
    np.testing.assert_array_equal(found[0], found[2])


@pytest.mark.parametrize("swapped", [False, True])
def test_flags_of_most_points_of_one_cloud_do_not_make_the_other_vague(swapped):
    """What is as large as the other's covariances goes by the good points, of which there may be few."""
    rng = np.random.default_rng(6)
    T = se_exp(np.array([0.05, -0.04, 0.1, 0.1, 0.05, 0.0]))
    points = bumpy(rng, 3000, 3)
    strangers = rng.uniform(-1.5, 1.5, (2500, 3))
    covariances = np.concatenate([estimate_surface_covariances(points[:1500]), np.tile(1e4 * np.eye(3), (2500, 1, 1))])
    flagged = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate([points[:1500], strangers])))
    flagged.covariances = o3d.utility.Matrix3dVector(1e-3 * covariances)
    plain = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(move(points[1500:], T)))
    pair = (plain, flagged) if swapped else (flagged, plain)
    pose = registration_adaptive_gmm(*pair, 0.1, np.eye(4)).transformation
    errors = pose_errors(np.linalg.inv(T) if swapped else T, pose)
    assert errors.rotation_deg < 1.0 and errors.translation < 0.01
