"""Covariances of a spinning LiDAR: the beam's part by hand, the surface between rings, and what they do for a pose."""

import math

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adagmm_bench.pairs.lidar_scene import HEIGHT, Lidar, Street, drive, scan_pair
from adagmm_o3d import (
    estimate_lidar_covariances,
    estimate_surface_covariances,
    register_points,
    registration_adaptive_gmm,
)
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_inverse
from adagmm_o3d.uncertainty.surface import scan_covariances, stand_in_covariances

seeds = st.integers(0, 2**32 - 1)


def scattered(seed, count=30):
    """Points so far apart that none has a neighbour, on a grid of float64's own."""
    rng = np.random.default_rng(seed)
    cells = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    chosen = rng.choice(cells[np.abs(cells).max(axis=1) > 0], count, replace=False)
    return 16.0 * chosen + np.round(rng.uniform(-2.0, 2.0, (count, 3)) * 2**20) / 2**20


def wall(distance, angle, n=400):
    """Points of a plane at that distance along x, seen under that angle of incidence, and its normal."""
    rng = np.random.default_rng(0)
    normal = np.array([-math.cos(angle), math.sin(angle), 0.0])
    along = np.array([math.sin(angle), math.cos(angle), 0.0])
    u, v = rng.uniform(-0.5, 0.5, (2, n, 1))
    return np.array([distance, 0.0, 0.0]) + u * along + v * np.array([0.0, 0.0, 1.0]), normal


@given(seed=seeds, range_noise=st.floats(0.0, 1.0), beam_noise=st.floats(0.0, 0.01), extent=st.floats(0.1, 3.0))
def test_where_there_is_no_surface_the_beam_alone_speaks(seed, range_noise, beam_noise, extent):
    points = scattered(seed)
    covariances = estimate_lidar_covariances(points, range_noise=range_noise, beam_noise=beam_noise, extent=extent)
    ranges = np.linalg.norm(points, axis=1)
    beams = points / ranges[:, None]
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", covariances, beams), (extent**2 + range_noise**2) * beams, rtol=1e-9, atol=1e-9
    )
    total = 3.0 * extent**2 + range_noise**2 + 2.0 * (ranges * beam_noise) ** 2
    np.testing.assert_allclose(np.trace(covariances, axis1=1, axis2=2), total, rtol=1e-9, atol=0)
    np.testing.assert_allclose(covariances, covariances.transpose(0, 2, 1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("distance", [3.0, 10.0, 40.0])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 80.0])
def test_a_plane_is_as_thick_as_range_and_beam_make_it_at_the_angle_of_incidence(distance, angle_deg):
    points, normal = wall(distance, math.radians(angle_deg))
    covariances = estimate_lidar_covariances(points, range_noise=0.03, beam_noise=2e-3)
    ranges = np.linalg.norm(points, axis=1)
    cosine = np.abs(points @ normal) / ranges
    expected = (0.03 * cosine) ** 2 + (ranges * 2e-3) ** 2 * (1.0 - cosine**2)
    across = np.einsum("i,nij,j->n", normal, covariances, normal)
    np.testing.assert_allclose(across, expected, rtol=1e-6, atol=1e-9)
    along = np.linalg.eigvalsh(covariances)[:, 1:]
    assert (along > 0.99).all() and (along < 1.02).all()


def test_a_rough_surface_is_as_thick_as_it_is_rough():
    points, normal = wall(10.0, 0.0, n=4000)
    rng = np.random.default_rng(1)
    thickness = []
    for roughness in (0.0, 0.03, 0.1):
        rough = points + roughness * rng.normal(size=(len(points), 1)) * normal
        covariances = estimate_lidar_covariances(rough, range_noise=0.0, beam_noise=0.0)
        thickness.append(np.sqrt(np.median(np.einsum("i,nij,j->n", normal, covariances, normal))))
    assert thickness[0] < 1e-6
    assert 0.015 < thickness[1] < 0.06 and 0.05 < thickness[2] < 0.15


@given(seed=seeds)
def test_the_sensor_need_not_be_at_the_origin(seed):
    points = np.concatenate([scattered(seed), wall(10.0, 0.3)[0]])
    points = np.round(points * 2**20) / 2**20
    shift = np.array([64.0, -32.0, 8.0])
    expected = estimate_lidar_covariances(points)
    np.testing.assert_allclose(estimate_lidar_covariances(points + shift, origin=shift), expected, rtol=0, atol=1e-9)


def test_a_beam_without_a_return_has_no_say():
    points = np.concatenate([wall(10.0, 0.3)[0], np.zeros((30, 3))])
    covariances = estimate_lidar_covariances(points)
    np.testing.assert_array_equal(covariances[-30:], np.broadcast_to(1e6 * np.eye(3), (30, 3, 3)))
    np.testing.assert_array_equal(covariances[:-30], estimate_lidar_covariances(points[:-30]))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_few_points_are_enough(count):
    covariances = estimate_lidar_covariances(scattered(0)[:count])
    assert covariances.shape == (count, 3, 3) and np.isfinite(covariances).all()
    assert estimate_lidar_covariances(np.zeros((2, 3))).shape == (2, 3, 3)


def normal_errors_deg(covariances, normals):
    thin = np.linalg.eigh(covariances)[1][:, :, 0]
    return np.degrees(np.arccos(np.minimum(np.abs(np.einsum("ni,ni->n", thin, normals)), 1.0)))


@pytest.mark.parametrize("n_rings", [16, 32, 64])
def test_normals_are_found_between_rings(n_rings):
    pose = np.eye(4)
    pose[2, 3] = HEIGHT
    scan = Street(1).scan(pose, Lidar(n_rings=n_rings))
    road = (scan.normals[:, 2] > 0.99) & (np.linalg.norm(scan.points, axis=1) < 12.0)
    ours = normal_errors_deg(estimate_lidar_covariances(scan.points), scan.normals)
    assert road.sum() > 5000 and np.median(ours[road]) < 1.0 and np.median(ours) < 2.0
    # the nearest points are those of one ring; the nearest cells are not
    surface = normal_errors_deg(estimate_surface_covariances(scan.points), scan.normals)
    assert np.median(surface[road]) < 1.0 and np.median(surface) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "angle_deg"), [(0.1, 1.0), (0.5, 2.0), (1.0, 5.0), (2.0, 10.0)])
def test_rings_are_not_registered_to_each_other(distance, angle_deg):
    for seed in range(2):
        source, target, T = scan_pair(seed, distance, angle_deg)
        covariances = estimate_lidar_covariances(source), estimate_lidar_covariances(target)
        errors = pose_errors(T, register_points(source, target, *covariances).transformation)
        assert errors.rotation_deg < 0.03 and errors.translation < 0.015


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "angle_deg"), [(0.1, 1.0), (0.5, 2.0), (2.0, 10.0)])
def test_clouds_without_covariances_need_no_sensor_model(distance, angle_deg):
    for seed in range(2):
        source, target, T = scan_pair(seed, distance, angle_deg)
        clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
        result = registration_adaptive_gmm(*clouds, 0.5)
        errors = pose_errors(T, result.transformation)
        assert errors.rotation_deg < 0.03 and errors.translation < 0.02
        assert not result.details.warnings


@pytest.mark.parametrize("far", [-1e6, -1e5, 1e5])
def test_a_point_far_out_leaves_the_planes_of_the_others(far):
    scan = Street(1).scan(drive(2)[0])
    alone = normal_errors_deg(estimate_surface_covariances(scan.points), scan.normals)
    with_it = estimate_surface_covariances(np.vstack([scan.points, np.full((1, 3), far)]))[:-1]
    assert np.median(normal_errors_deg(with_it, scan.normals)) < 1.75 * np.median(alone)


@pytest.mark.slow
def test_the_steps_of_a_drive_do_not_add_up_to_a_drift():
    poses, street = drive(25), Street(0)
    errors = []
    for k in range(4, 25, 4):
        source, target = (street.scan(poses[i], seed=i).points for i in (k, k - 1))
        T = se_inverse(poses[k - 1]) @ poses[k]
        covariances = estimate_surface_covariances(source), estimate_surface_covariances(target)
        found = register_points(source, target, *covariances).transformation
        errors.append((se_inverse(T) @ found)[:3, 3])
    # along the street what faces the sensor changes as it passes
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, rtol=0, atol=4e-3)


def test_scans_are_of_one_street_and_poses_exact():
    street, lidar = Street(2), Lidar(range_noise=0.0)
    here, there = drive(8, step=1.5)[[2, 4]]
    a, b = street.scan(here, lidar), street.scan(there, lidar)
    T = se_inverse(there) @ here
    moved = a.points @ T[:3, :3].T + T[:3, 3]
    # the road below the one scan is the road below the other
    level = [s.normals[:, 2] > 0.999 for s in (a, b)]
    near = [np.linalg.norm(p, axis=1) < 6.0 for p in (moved, b.points)]
    heights = [np.median(p[k & n, 2]) for p, k, n in zip((moved, b.points), level, near, strict=True)]
    assert abs(heights[0] - heights[1]) < 0.02
    assert set(np.unique(a.rings)) <= set(range(32)) and len(a.points) == len(a.normals) == len(a.rings)
    elevations = np.degrees(np.arcsin(a.points[:, 2] / np.linalg.norm(a.points, axis=1)))
    np.testing.assert_allclose(elevations, np.linspace(-24.0, 4.0, 32)[a.rings], rtol=0, atol=1e-9)


def hilly_scans(seed, distance, *, shots=1200):
    """Two scans of 16 beams over hills, so far apart and turned by 20 degrees; points (n, 3) of each, and the pose."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.normal(0.0, 0.6, (6, 2)), rng.uniform(0.0, 2.0 * np.pi, 6)

    def height(x, y):
        return sum(0.35 * np.sin(u * x + v * y + phase) for (u, v), phase in zip(waves, phases, strict=True))

    def scan(x, y, yaw):
        directions = Lidar(n_rings=16, azimuth_step_deg=360.0 / shots, elevation_deg=(-15.0, 15.0)).directions()
        directions = directions.reshape(-1, 3)
        ranges = np.linspace(1.0, 25.0, 120)
        pose = np.eye(4)
        pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        pose[:3, 3] = x, y, height(x, y) + HEIGHT
        along = (directions @ pose[:3, :3].T)[:, None, :] * ranges[:, None] + pose[:3, 3]
        above = along[..., 2] - height(along[..., 0], along[..., 1])
        first = np.argmax(above < 0.0, axis=1)
        hit = np.flatnonzero(first > 0)
        before, after = above[hit, first[hit] - 1], above[hit, first[hit]]
        met = ranges[first[hit] - 1] + (ranges[1] - ranges[0]) * before / (before - after)
        return (met + rng.normal(0.0, 0.02, len(hit)))[:, None] * directions[hit], pose

    way = rng.uniform(0.0, 2.0 * np.pi)
    source, source_pose = scan(0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi))
    turn = math.atan2(source_pose[1, 0], source_pose[0, 0]) + math.radians(20.0)
    target, target_pose = scan(distance * math.cos(way), distance * math.sin(way), turn)
    return source, target, se_inverse(target_pose) @ source_pose


@pytest.mark.slow
@pytest.mark.parametrize("distance", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("door", ["arrays", "cloud", "normals", "voxels"])
def test_few_beams_over_hills_are_no_lines_to_be_laid_on_each_other(distance, door):
    for seed in range(2):
        source, target, T = hilly_scans(seed, distance)
        if door == "arrays":
            pose = register_points(source, target).transformation
        else:
            clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
            if door == "normals":
                for cloud in clouds:
                    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
            pose = registration_adaptive_gmm(*clouds, 0.5, voxel_size=0.25 if door == "voxels" else -1.0).transformation
        errors = pose_errors(T, pose)
        assert errors.rotation_deg < 0.3 and errors.translation < 0.1


@pytest.mark.slow
def test_wide_beams_are_averaged():
    """Where the surface is dense much is known of it, however noisy a beam is."""
    errors = []
    for seed in range(4):
        source, target, T = scan_pair(seed, 1.0, 5.0, Lidar(n_rings=64, angular_noise=1e-3))
        errors.append(pose_errors(T, register_points(source, target).transformation))
    assert np.mean([error.rotation_deg for error in errors]) < 0.018
    assert np.mean([error.translation for error in errors]) < 0.003


def test_only_scan_lines_and_dense_clouds_get_covariances_that_an_array_does_not_have():
    rng = np.random.default_rng(0)
    body = rng.normal(size=(3000, 3))
    assert scan_covariances(body) is None and scan_covariances(body[:, :2]) is None
    source, _, _ = hilly_scans(0, 1.0)
    np.testing.assert_array_equal(scan_covariances(source), estimate_surface_covariances(source))
    assert scan_covariances(source[::20]) is None, "a few points are no lines any more"
    with_holes = np.insert(source, 5, np.nan, axis=0)
    covariances = scan_covariances(with_holes)
    np.testing.assert_array_equal(np.delete(covariances, 5, axis=0), estimate_surface_covariances(source))


def test_normals_made_of_a_line_are_not_believed():
    source, _, _ = hilly_scans(0, 1.0)
    sideways = np.tile([1.0, 0.0, 0.0], (len(source), 1))
    np.testing.assert_array_equal(stand_in_covariances(source, sideways), estimate_surface_covariances(source))
    body = np.random.default_rng(0).normal(size=(3000, 3))
    assert (stand_in_covariances(body, sideways[:3000])[:, 0, 0] < 0.01).all(), "those of other clouds are"
