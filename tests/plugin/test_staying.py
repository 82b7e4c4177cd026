"""A start that fits is not left because more would overlap elsewhere."""

import numpy as np
import open3d as o3d
import pytest

from adagmm_o3d import registration_adaptive_gmm
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, se_inverse
from adagmm_o3d.search.staying import surface_fit
from adagmm_o3d.trust.agreement import Surface
from adagmm_o3d.trust.fit_loss import SIGNIFICANT, FitLoss


def yawed(angle_deg, at=(0.0, 0.0, 0.0)):
    pose = se_exp((0.0, np.radians(angle_deg), 0.0, 0.0, 0.0, 0.0))
    pose[:3, 3] = at
    return pose


def view(pose, size=(3.2, 1.3, 2.4), columns=80, rows=60, field_deg=62.0):
    """What a depth camera at a pose (4, 4) sees of a bare room, a box of half that size; x right, y down, z forward."""
    focal = 0.5 * columns / np.tan(np.radians(0.5 * field_deg))
    x, y = np.meshgrid(np.arange(columns) - 0.5 * (columns - 1), np.arange(rows) - 0.5 * (rows - 1))
    rays = np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1).reshape(-1, 3)
    directions = rays @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        to_walls = (np.sign(directions) * size - pose[:3, 3]) / directions
    return rays * to_walls.min(axis=1)[:, None]


def turned_views(seed, turn_deg):
    """Two views from one place, the second turned; points of both and the pose between them."""
    rng = np.random.default_rng(seed)
    place, yaw = rng.uniform(-0.4, 0.4, 3) * (1.0, 0.3, 1.0), rng.uniform(0.0, 360.0)
    source, target = yawed(yaw, place), yawed(yaw + turn_deg, place)
    return view(source), view(target), se_inverse(target) @ source


@pytest.mark.slow
@pytest.mark.parametrize("door", ["cloud", "turned about"])
def test_a_camera_that_is_turned_in_place_stays_there(door):
    """Clouds that are aligned already, with the pose as `init` or moved by it."""
    for seed in range(4):
        source, target, T = turned_views(seed, 30.0)
        init = T if door == "cloud" else np.eye(4)
        moved = source if door == "cloud" else source @ T[:3, :3].T + T[:3, 3]
        clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (moved, target)]
        result = registration_adaptive_gmm(*clouds, 0.05, init)
        errors = pose_errors(init, result.transformation)
        assert errors.rotation_deg < 0.5 and errors.translation < 0.03, (seed, errors)
        np.testing.assert_array_equal(result.details.transformations[-1], result.transformation)


def corner(rng, count=1500):
    """Points on three walls and the floor's surface of them."""
    u, v = rng.uniform(0.0, 1.0, (2, count))
    zero = np.zeros(count)
    walls = [np.stack(axes, axis=1) for axes in ((u, v, zero), (u, zero, v), (zero, u, v))]
    return Surface(np.concatenate(walls)[:: 3 * count // 1000], 3)


def test_a_fit_goes_where_surfaces_hold_it_and_nowhere_else():
    rng = np.random.default_rng(0)
    off = se_exp((0.02, -0.01, 0.03, 0.03, -0.02, 0.04))
    fit = surface_fit(corner(rng), corner(rng), off, np.inf)
    assert np.abs(fit - np.eye(4)).max() < 0.01
    flat = [Surface(np.column_stack([rng.uniform(0.0, 1.0, (1000, 2)), np.zeros(1000)]), 3) for _ in range(2)]
    slid = np.eye(4)
    slid[:3, 3] = 0.1, 0.05, 0.02
    fit = surface_fit(*flat, slid, np.inf)
    np.testing.assert_allclose(fit[:3, 3], (0.1, 0.05, 0.0), atol=1e-6)
    assert surface_fit(*flat, slid, 0.01) is None, "it goes farther than it may"
    slid[:3, 3] = 0.0, 0.0, 5.0
    assert surface_fit(*flat, slid, np.inf) is None, "nothing meets"


def test_what_is_met_less_is_no_loss_and_what_is_off_is():
    rng = np.random.default_rng(1)
    own, other = corner(rng), corner(rng)
    fit = FitLoss(own, other, np.eye(4))
    assert fit.known.any() and abs(fit.of(np.eye(4))) < 1e-9
    lifted = np.eye(4)
    lifted[2, 3] = 0.05
    assert fit.of(lifted) > SIGNIFICANT
    flat = [
        Surface(np.column_stack([rng.uniform(0.0, 1.0, (1000, 2)), 1e-4 * rng.normal(size=1000)]), 3) for _ in (0, 1)
    ]
    aside = np.eye(4)
    aside[0, 3] = 0.4
    assert FitLoss(*flat, np.eye(4)).of(aside) < SIGNIFICANT
    far = np.eye(4)
    far[:3, 3] = 10.0
    assert FitLoss(own, other, far).of(np.eye(4)) == 0.0
