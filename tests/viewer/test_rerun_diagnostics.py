"""What the layers say of each point, on scenes whose answer is known."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
import rerun as rr
from registered_scene import INTRINSICS, known_estimate, room_clouds, room_pair

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.pairs.partners import partner_distance
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.point_diagnostics import CONTRADICTED, HIDDEN, PARTNER, diagnose, weight_shares
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.rerun_log.clouds import log_points, point_radius, shaded_colors
from adagmm_fusion.rerun_log.ellipsoids import chosen_points
from adagmm_fusion.rerun_log.iterations import pose_errors
from adagmm_fusion.rerun_log.legends import NO_PARTNER_COLOR, RESIDUAL_RAMP, ramp_colors
from adagmm_fusion.rerun_log.overlay import project_colors
from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.errors import InputError
from adagmm_o3d.result import Deferred, Partners


def wall(depth_m: float, *, name="wall", color=(200, 60, 20)) -> RGBDFrame:
    shape = (INTRINSICS.height, INTRINSICS.width)
    return RGBDFrame(
        name,
        np.full((*shape, 3), color, np.uint8),
        np.full(shape, 1000.0 * depth_m).astype(np.uint16),
        INTRINSICS,
        1000.0,
        name,
    )


def points_at(depth_m: float, n: int = 400) -> o3d.geometry.PointCloud:
    """A plane patch in front of the camera, with normals towards it."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, int(np.sqrt(n))), np.linspace(-0.2, 0.2, int(np.sqrt(n))))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, depth_m)], axis=1)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(np.tile((0.0, 0.0, -1.0), (len(points), 1)))
    return cloud


def still(cloud: o3d.geometry.PointCloud):
    """An estimate that leaves the source where it is."""
    n = len(cloud.points)
    return replace(
        known_estimate(), transformation=np.eye(4), find_partners=Deferred(lambda: Partners(1.0, np.ones(n)))
    )


def test_residual_is_the_distance_along_the_normal_in_millimetres():
    source, target = points_at(2.007), points_at(2.0)
    source.translate((0.004, 0.0, 0.0))  # along the surface: no residual
    found = diagnose(source, target, still(source), target_frame=wall(2.0), partner_distance=0.05)
    np.testing.assert_allclose(found.residual_mm, 7.0, rtol=1e-9, atol=1e-6)
    assert (found.overlap == PARTNER).all()


@pytest.mark.parametrize(("depth_m", "state"), [(1.5, CONTRADICTED), (2.0, PARTNER), (2.5, HIDDEN)])
def test_in_front_of_at_and_behind_what_the_target_sees(depth_m, state):
    source = points_at(depth_m)
    found = diagnose(source, points_at(2.0), still(source), target_frame=wall(2.0), partner_distance=0.1)
    assert (found.overlap == state).all()
    assert np.isnan(found.residual_mm).all() == (state != PARTNER)


def test_outside_the_image_or_behind_the_camera_is_hidden():
    for shift in ((30.0, 0.0, 0.0), (0.0, 0.0, -4.0)):
        source = points_at(2.0).translate(shift)
        found = diagnose(source, points_at(2.0), still(source), target_frame=wall(2.0), partner_distance=0.1)
        assert (found.overlap == HIDDEN).all(), shift


def test_the_room_at_the_truth_and_off_it():
    source, target = room_clouds()
    at, off = (
        diagnose(
            source,
            target,
            known_estimate(off=(0.0, x, -x)),
            target_frame=room_pair().target,
            partner_distance=0.144,
        )
        for x in (0.0, 0.2)
    )
    assert np.nanmedian(at.residual_mm) < 2.0 < 20.0 < np.nanmedian(off.residual_mm)
    assert np.mean(at.overlap == CONTRADICTED) < 0.02 < 0.1 < np.mean(off.overlap == CONTRADICTED)


def test_weight_shares_average_to_one_and_dropped_points_have_none():
    shares = weight_shares(np.array([0.0, 1.0, 3.0, np.nan]))
    np.testing.assert_allclose(shares, [0.0, 1.0, 3.0, 0.0], rtol=1e-12, atol=0.0)
    assert np.array_equal(weight_shares(np.zeros(3)), np.zeros(3))


def test_ramp_ends_and_points_without_a_partner():
    colors = ramp_colors(np.array([0.0, 10.0, 99.0, np.nan]), 10.0, RESIDUAL_RAMP)
    np.testing.assert_array_equal(colors, [RESIDUAL_RAMP[0], RESIDUAL_RAMP[-1], RESIDUAL_RAMP[-1], NO_PARTNER_COLOR])


def test_source_colors_land_where_the_target_sees_them():
    pair = room_pair()
    colors, seen = project_colors(pair.source, pair.target, pair.T_target_source)
    error = np.abs(colors[seen].astype(int) - pair.target.color[seen].astype(int)).max(axis=1)
    assert seen.mean() > 0.3 and np.mean(error < 40) > 0.9
    wrong = pair.T_target_source.copy()
    wrong[0, 3] += 0.3
    colors, seen = project_colors(pair.source, pair.target, wrong)
    error = np.abs(colors[seen].astype(int) - pair.target.color[seen].astype(int)).max(axis=1)
    assert np.mean(error < 40) < 0.5


def test_the_target_hides_what_is_behind_it():
    near, far = wall(1.0, name="near"), wall(2.0, name="far", color=(0, 90, 200))
    assert not project_colors(far, near, np.eye(4))[1].any()
    colors, seen = project_colors(near, far, np.eye(4))
    assert seen.all() and (colors == near.color).all()


def test_pose_errors_of_known_poses():
    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T[:3, 3] = (0.003, 0.004, 0.0)
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    angles_deg, distances_mm = pose_errors(np.stack([np.eye(4), T, half]), np.eye(4))
    np.testing.assert_allclose(angles_deg, [0.0, 90.0, 180.0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(distances_mm, [0.0, 5.0, 0.0], rtol=1e-12, atol=1e-12)


def test_ellipsoids_leave_out_flagged_and_broken_points():
    cloud = points_at(1.0)
    covariances = np.tile(np.eye(3), (len(cloud.points), 1, 1))
    covariances[::10] *= 1e6
    covariances[1] = np.nan
    cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    chosen = chosen_points(cloud, count=50)
    assert len(chosen) == 50 and (chosen % 10 != 0).all() and 1 not in chosen


def test_colors_must_match_the_points():
    rec, points = rr.RecordingStream("test"), np.zeros((4, 3))
    with pytest.raises(InputError, match=r"^cloud: expected \(4, 3\) uint8 colors to match the points, got \(3, 3\)"):
        log_points(rec, "cloud", points, np.zeros((3, 3), np.uint8), When())
    with pytest.raises(InputError, match=r"^cloud:Shape: expected \(4, 3\) uint8"):
        log_points(rec, "cloud", points, np.zeros((4, 3), np.uint8), When(), {"Shape": np.zeros((4, 3))})


def test_radius_follows_the_spacing_and_shading_needs_normals():
    cloud = points_at(1.0)
    spacing = 0.4 / 19
    assert point_radius(np.asarray(cloud.points)) == pytest.approx(0.6 * spacing, rel=1e-9, abs=0.0)
    assert point_radius(np.zeros((1, 3))) == 0.005
    assert len(np.unique(shaded_colors(cloud, (200, 100, 50)), axis=0)) == 1
    cloud.normals = o3d.utility.Vector3dVector()
    assert (shaded_colors(cloud, (200, 100, 50)) == (200, 100, 50)).all()


def test_what_is_shown_has_the_partners_that_the_registration_is_judged_by():
    source, target = points_at(2.0), points_at(2.0)
    spacing = 0.4 / 19
    assert partner_distance(target) == pytest.approx(2.0 * spacing, rel=1e-9, abs=0.0)
    assert partner_distance(target, 0.3) == 0.3
    assert diagnose(source, target, still(source)).partner_distance == partner_distance(target)
    estimate = register_pair(room_pair(), Settings(device="cpu", start="geometry", target_points=1500))
    shown = diagnose(estimate.source_cloud, estimate.target_cloud, estimate.estimate)
    assert shown.partner_distance == estimate.evaluation.partner_distance_m
    assert np.mean(shown.overlap == PARTNER) == pytest.approx(estimate.evaluation.overlap, rel=0.0, abs=1e-9)
