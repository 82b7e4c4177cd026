"""`search_globally`: any rotation is found, in 2D and 3D, and objects with symmetries are recognised as ambiguous."""

import numpy as np
import pytest
from shapes import body_with_head, bumpy, move, turn
from shared_data import shared_data

from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, so_exp
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.search.find import AMBIGUOUS_LIKELIHOOD
from adagmm_o3d.search.find import is_ambiguous as clearly_ambiguous
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.search.rotations import rotation_grid, search_globally
from adagmm_o3d.search.schedule import SCHEDULE

FLAG = 1e6


def is_ambiguous(ends):
    return clearly_ambiguous([(end, end.log_likelihood) for end in ends], AMBIGUOUS_LIKELIHOOD)


def search(source, target, source_covariances=None, target_covariances=None):
    """The ends, likeliest first, and the pose of the first in input units, (D+1, D+1)."""
    dimension = np.shape(source)[1]
    moving, fixed, normalisation = normalise(
        make_mixture("source", source, source_covariances), make_mixture("target", target, target_covariances)
    )
    ends = search_globally(Levels(moving, fixed, SCHEDULE))
    keep = [*range(dimension), 3]
    return ends, normalisation.pose_out(ends[0].pose)[np.ix_(keep, keep)]


def any_pose(rng, dimension):
    """A rigid motion with a rotation drawn evenly from all there are."""
    if dimension == 2:
        turned = rng.uniform(-np.pi, np.pi, 1)
    else:
        axis = rng.normal(size=3)
        turned = axis / np.linalg.norm(axis) * rng.uniform(0.0, np.pi)
    return se_exp(np.concatenate([turned, 3.0 * rng.normal(size=dimension)]))


def degraded(rng, points, *, outliers=0.3, occlusion=0.1, noise=0.01):
    """The points without those nearest to one of them, noisy, and flagged outliers among them: points, covariances."""
    dimension = points.shape[1]
    distance = np.linalg.norm(points - points[rng.integers(len(points))], axis=1)
    seen = points[distance >= np.quantile(distance, occlusion)]
    stray = rng.uniform(-2.0, 2.0, (int(outliers * len(seen)), dimension))
    cloud = np.concatenate([seen + noise * rng.normal(size=seen.shape), stray])
    variances = np.concatenate([np.ones(len(seen)), np.full(len(stray), FLAG)])
    return cloud, variances[:, None, None] * np.eye(dimension)


@pytest.mark.parametrize(("dimension", "n"), [(2, 150), (3, 600), (3, 3000)])
def test_any_rotation_is_found(dimension, n):
    for seed in range(8):
        rng = np.random.default_rng([seed, dimension, n])
        truth = any_pose(rng, dimension)
        source, source_covariances = degraded(rng, body_with_head(rng, n, dimension))
        target, target_covariances = degraded(rng, body_with_head(rng, n, dimension))
        ends, pose = search(source, move(target, truth), source_covariances, turn(target_covariances, truth))
        errors = pose_errors(truth, pose)
        assert errors.rotation_deg < 6.0 and errors.translation < 0.05, (seed, errors)
        assert not is_ambiguous(ends)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_half_turn_about_each_axis_is_found(dimension):
    rng = np.random.default_rng(3)
    source, target = bumpy(rng, 400, dimension), bumpy(rng, 400, dimension)
    for axis in np.eye(3) if dimension == 3 else np.ones((1, 1)):
        truth = np.eye(dimension + 1)
        truth[:-1, :-1] = so_exp(np.pi * axis)
        _, pose = search(source, move(target, truth))
        assert pose_errors(truth, pose).rotation_deg < 6.0


def test_the_way_to_an_end_begins_at_its_start():
    rng = np.random.default_rng(5)
    ends, _ = search(bumpy(rng, 300, 3), bumpy(rng, 300, 3))
    likelihoods = [end.log_likelihood for end in ends]
    assert likelihoods == sorted(likelihoods, reverse=True)
    for end in ends:
        np.testing.assert_array_equal(end.start[:3, 3], 0.0)
        np.testing.assert_allclose(end.iterations[-1].pose, end.pose, rtol=0, atol=1e-12)
        assert [i.level for i in end.iterations] == sorted(i.level for i in end.iterations)


def cube(rng, n):
    points = rng.uniform(-1.0, 1.0, (n, 3))
    points[np.arange(n), rng.integers(0, 3, n)] = rng.choice([-1.0, 1.0], n)
    return points


def cylinder(rng, n):
    """Radius 1, height 2.4, with both caps."""
    angle, height, radius = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-1.2, 1.2, n), np.ones(n)
    caps = rng.random(n) < 1.0 / 3.4
    radius[caps], height[caps] = np.sqrt(rng.random(caps.sum())), rng.choice([-1.2, 1.2], caps.sum())
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def polygon(rng, n, corners=5):
    """The outline of a regular polygon."""
    corner, along = np.divmod(rng.uniform(0.0, corners, n), 1.0)
    a, b = 2.0 * np.pi / corners * corner, 2.0 * np.pi / corners * (corner + 1.0)
    return np.stack([(1 - along) * f(a) + along * f(b) for f in (np.cos, np.sin)], axis=1)


@pytest.mark.parametrize("shape", [cube, cylinder, polygon])
def test_symmetric_objects_are_ambiguous(shape):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        source, target = (shape(rng, 1000) for _ in range(2))
        truth = any_pose(rng, source.shape[1])
        target = move(target + 0.01 * rng.normal(size=target.shape), truth)
        ends, pose = search(source, target)
        assert is_ambiguous(ends), seed
        # whichever turn of the object it is, the centres have to meet
        np.testing.assert_allclose(move(np.zeros((1, source.shape[1])), pose)[0], truth[:-1, -1], rtol=0, atol=0.1)


def test_the_rotations_of_the_grid_are_spread_evenly():
    grid = rotation_grid(128)
    np.testing.assert_allclose(grid @ grid.transpose(0, 2, 1), np.tile(np.eye(3), (128, 1, 1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(grid), 1.0, rtol=0, atol=1e-12)
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(2000, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    w, v = quaternions[:, 0], quaternions[:, 1:]
    skew = np.cross(v[:, None], np.eye(3)[None])
    rotations = (w**2 - (v**2).sum(axis=1))[:, None, None] * np.eye(3) + 2 * v[:, :, None] * v[:, None]
    rotations -= 2 * w[:, None, None] * skew
    traces = np.einsum("aij,bij->ab", rotations, grid).max(axis=1)
    angle_deg = np.degrees(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))
    # a perfect covering of SO(3) by 128 balls of equal size would need a radius of about 31°
    assert angle_deg.max() < 50.0 and np.median(angle_deg) < 32.0


@pytest.mark.parametrize("scene", ["01", "08", "14", "17"])
def test_kinect_scenes_are_found_from_any_rotation(scene):
    file = np.load(sorted(shared_data("kinect_pairs").glob(f"*{scene}.npz"))[0])
    rng = np.random.default_rng(int(scene))
    moved = any_pose(rng, 3)
    truth = file["T_target_source"] @ np.linalg.inv(moved)
    _, pose = search(
        move(file["source"], moved),
        file["target"],
        turn(file["source_covariances"], moved),
        file["target_covariances"],
    )
    errors = pose_errors(truth, pose)
    # the ground truth itself is known to about 3°
    assert errors.rotation_deg < 10.0
    # metres; the scenes are 1 to 4 m away, and `truth` is taken about the moved origin
    centre = move(file["source"], moved).mean(axis=0)
    np.testing.assert_allclose(move(centre[None], pose), move(centre[None], truth), rtol=0, atol=0.2)
