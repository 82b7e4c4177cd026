"""The pose covariance against plain double sums and finite differences, against true errors, and against Open3D."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_points_and_covariances, random_pose
from shapes import bumpy, move, turn

from adagmm_o3d.em.expectation import PosteriorExpectation, posterior_rule
from adagmm_o3d.em.loop import expectation_maximisation
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.em.unmatched import uniform_density
from adagmm_o3d.lie import se_exp, se_log
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.options import Criteria
from adagmm_o3d.pairs.cpu_pairs import PairLoop
from adagmm_o3d.trust import pose_covariance
from adagmm_o3d.trust.pose_covariance import BLOCK, Fit, covariance_out, pose_uncertainty, score_moments

dimensions = pytest.mark.parametrize("dimension", [2, 3])


def lifted(transformation):
    """A (D+1, D+1) transformation as (4, 4)."""
    pose = np.eye(4)
    keep = [*range(len(transformation) - 1), 3]
    pose[np.ix_(keep, keep)] = transformation
    return pose


class Registered:
    """Two clouds brought together by EM from the truth, so that only what noise does to the pose is left."""

    def __init__(self, source, target, truth, *, covariances=(None, None), mutuality=0.5):
        self.source, self.target, self.normalisation = normalise(
            make_mixture("source", source, covariances[0]), make_mixture("target", target, covariances[1])
        )
        dimension = self.source.dimension
        self.free = FREE[dimension]
        self.truth = self.normalisation.pose_in(lifted(truth))
        self.pairs = PairLoop(self.source, self.target)
        em = PosteriorExpectation(self.pairs, posterior_rule(dimension), 0.01, unmatched=0.1, mutuality=mutuality)
        outcome = expectation_maximisation(em, self.truth, Criteria(1e-6, 300), dimension)
        self.fit = Fit(outcome.pose, em.scale.target, em.unmatched, mutuality)

    def moments(self):
        return score_moments(self.pairs, self.source, self.target, self.fit)

    def uncertainty(self):
        return pose_uncertainty(self.pairs, self.source, self.target, self.fit)

    def error(self):
        """δ of exp(δ) · found = truth, between normalised clouds."""
        return se_log(self.truth @ np.linalg.inv(self.fit.pose))[self.free]


def sampled_twice(rng, n, dimension, *, noise, share=0.9):
    """Two noisy samples of the same points, and a motion between them: source, target, truth."""
    points = bumpy(rng, n, dimension)
    source, target = (points[rng.random(n) < share] for _ in range(2))
    truth = random_pose(rng, dimension)
    source = source + noise * rng.normal(size=source.shape)
    target = move(target + noise * rng.normal(size=target.shape), truth)
    return source, target, truth


def naive_scores(source, target, fit, delta):
    """(M, N, 6) the score of every pair after a perturbation δ, in plain NumPy."""
    pose = se_exp(delta) @ fit.pose
    y = source.points @ pose[:3, :3].T + pose[:3, 3]
    s = fit.sigma * (target.covariances[None] + (pose[:3, :3] @ source.covariances @ pose[:3, :3].T)[:, None])
    if source.dimension == 2:
        s[..., 2, 2] = 1.0
    v = np.linalg.solve(s, (y[:, None] - target.points[None])[..., None])[..., 0]
    distance_sq = ((y[:, None] - target.points[None]) * v).sum(axis=-1)
    c = np.exp(-0.5 * distance_sq) / np.sqrt(np.linalg.det(s))
    wx, wy = target.weights / target.weights.sum(), source.weights / source.weights.sum()
    uniform = uniform_density(fit.unmatched, fit.sigma, source.dimension)
    rows, columns = (c @ wx + uniform) ** (1.0 - fit.mutuality), (wy @ c + uniform) ** fit.mutuality
    weights = c * wy[:, None] * wx[None] / rows[:, None] / columns[None]
    return weights[..., None] * np.concatenate([np.cross(y[:, None], v), v], axis=-1)


@dimensions
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "anisotropic"])
@pytest.mark.parametrize("mutuality", [0.0, 0.3, 0.5])
def test_moments_match_double_sums_and_finite_differences(dimension, isotropic, mutuality):
    rng = np.random.default_rng(dimension)
    source, target, truth = sampled_twice(rng, 150, dimension, noise=0.03)
    covariances = [
        0.3 * random_points_and_covariances(rng, len(p), dimension, isotropic=isotropic)[1] for p in (source, target)
    ]
    covariances[1] = turn(covariances[1], truth)
    registered = Registered(source, target, truth, covariances=covariances, mutuality=mutuality)
    moments, free = registered.moments(), registered.free

    def scores(delta):
        return naive_scores(registered.source, registered.target, registered.fit, delta)

    at = scores(np.zeros(6))
    step = 1e-5
    change = np.stack(
        [(scores(step * e) - scores(-step * e)).sum(axis=(0, 1)) / (2.0 * step) for e in np.eye(6)], axis=1
    )
    curvature = 0.5 * (change + change.T)
    by_points, by_blocks = np.zeros((2, 6, 6))
    moved = registered.source.points @ registered.fit.pose[:3, :3].T + registered.fit.pose[:3, 3]
    for points, scores_of in ((moved, at.sum(axis=1)), (registered.target.points, at.sum(axis=0))):
        blocks = defaultdict(lambda: np.zeros(6))
        for point, score in zip(points, scores_of, strict=True):
            blocks[tuple(int(c // BLOCK) for c in point)] += score
            by_points += 0.5 * np.outer(score, score)
        assert 4 < len(blocks) < 0.9 * len(points)
        by_blocks += sum(0.5 * np.outer(score, score) for score in blocks.values())
    # pairs beyond CUT are left out, and the densities come from the float32 kernel
    compared = ((moments.curvature, curvature), (moments.by_points, by_points), (moments.by_blocks, by_blocks))
    for got, expected in compared:
        expected = expected[np.ix_(free, free)]
        np.testing.assert_allclose(got, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


def test_a_part_of_the_points_stands_for_all(monkeypatch):
    rng = np.random.default_rng(9)
    registered = Registered(*sampled_twice(rng, 1500, 3, noise=0.02))
    monkeypatch.setattr(pose_covariance, "SCORED", 2000)
    whole = np.sqrt(np.diag(registered.uncertainty().covariance))
    monkeypatch.setattr(pose_covariance, "SCORED", 500)
    part = np.sqrt(np.diag(registered.uncertainty().covariance))
    np.testing.assert_allclose(part, whole, rtol=0.3, atol=0)


@pytest.mark.parametrize(("dimension", "mutuality"), [(2, 0.0), (3, 0.0), (3, 0.5)])
def test_true_errors_are_as_large_as_the_covariance_says(dimension, mutuality):
    squares, size = [], dimension * (dimension + 1) // 2
    for seed in range(100):
        rng = np.random.default_rng([seed, dimension])
        trial = sampled_twice(rng, 250, dimension, noise=rng.uniform(0.005, 0.03))
        registered = Registered(*trial, mutuality=mutuality)
        error, covariance = registered.error(), registered.uncertainty().covariance
        squares.append(error @ np.linalg.solve(covariance, error))
    assert 0.6 * size < np.mean(squares) < 1.4 * size


@pytest.mark.slow
def test_errors_that_neighbours_share_count():
    """A sensor whose errors are those of whole patches: their pull on the pose does not average out point by point."""
    squares, by_points = [], []
    for seed in range(40):
        rng = np.random.default_rng([seed, 7])
        source, target, truth = sampled_twice(rng, 1000, 3, noise=0.003)
        patches, noisy = source[:200], []
        for cloud, centres in ((source, patches), (target, move(patches, truth))):
            patch = np.argmin(np.linalg.norm(cloud[:, None] - centres[None], axis=-1), axis=1)
            noisy.append(cloud + 0.02 * rng.normal(size=patches.shape)[patch])
        registered = Registered(*noisy, truth)
        error, covariance = registered.error(), registered.uncertainty().covariance
        squares.append(error @ np.linalg.solve(covariance, error))
        moments = registered.moments()
        step = np.linalg.inv(moments.curvature)
        by_points.append(error @ np.linalg.solve(step @ moments.by_points @ step, error))
    assert np.mean(squares) < 0.6 * np.mean(by_points)
    assert np.mean(squares) < 3.0 * 6


@dimensions
@pytest.mark.parametrize("mutuality", [0.0, 0.5])
def test_a_pose_short_of_the_end_says_so(dimension, mutuality):
    rng = np.random.default_rng(dimension)
    registered = Registered(*sampled_twice(rng, 600, dimension, noise=0.01), mutuality=mutuality)
    settled = registered.uncertainty().covariance
    delta = np.zeros(6)
    delta[registered.free] = 0.002 * rng.choice([-1.0, 1.0], len(registered.free))
    registered.fit = replace(registered.fit, pose=se_exp(delta) @ registered.fit.pose)
    delta = delta[registered.free]
    assert delta @ np.linalg.solve(settled, delta) > 10.0
    change = registered.uncertainty().covariance - settled
    np.testing.assert_allclose(change, np.outer(delta, delta), rtol=0, atol=0.5 * 0.002**2)


@dimensions
def test_covariances_leave_the_normalised_frame(dimension):
    """The pose itself, perturbed on both sides of the normalisation, must move the same."""
    rng = np.random.default_rng(dimension)
    source = 50.0 + 7.0 * bumpy(rng, 100, dimension)
    registered = Registered(source, move(source, random_pose(rng, dimension)), random_pose(rng, dimension))
    normalisation, free = registered.normalisation, registered.free
    pose = registered.truth
    step, columns = 1e-6, []
    for e in np.eye(6)[free]:
        moved = normalisation.pose_out(se_exp(step * e) @ pose) @ np.linalg.inv(normalisation.pose_out(pose))
        columns.append(se_log(moved)[free] / step)
    change = np.stack(columns, axis=1)
    factor = rng.normal(size=(len(free), len(free)))
    covariance = factor @ factor.T
    np.testing.assert_allclose(
        covariance_out(covariance, normalisation), change @ covariance @ change.T, rtol=1e-3, atol=1e-3
    )


def test_its_inverse_is_the_information_matrix_of_open3d():
    """Same tangent, same order: where partners are clear its information is Open3D's over a residual's variance."""
    rng = np.random.default_rng(2)
    noise = 0.01
    # far from the origin, where turns and shifts are strongly coupled
    source = bumpy(rng, 800, 3) + np.array([3.0, -2.0, 5.0])
    truth = random_pose(rng, 3)
    target = move(source, truth) + noise * rng.normal(size=source.shape)
    registered = Registered(source, target, truth)
    covariance = covariance_out(registered.uncertainty().covariance, registered.normalisation)
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    information = o3d.pipelines.registration.get_information_matrix_from_point_clouds(*clouds, 0.05, truth)
    ratio = covariance @ information / noise**2
    # eigenvalues of the ratio: 1 where the covariances agree in a direction; EM also knows that partners may be others
    eigenvalues = np.sort(np.linalg.eigvals(ratio).real)
    assert eigenvalues[0] > 0.5 and eigenvalues[-1] < 4.0
    # a wrong order or frame shows at once
    swapped = covariance[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])] @ information / noise**2
    assert np.abs(np.linalg.eigvals(swapped)).max() > 20.0


def test_a_plane_is_held_in_three_directions_only():
    rng = np.random.default_rng(3)
    source, target = (np.concatenate([rng.uniform(-1.0, 1.0, (700, 2)), np.zeros((700, 1))], axis=1) for _ in range(2))
    source, target = (p + 0.01 * rng.normal(size=p.shape) for p in (source, target))
    uncertainty = Registered(source, target, np.eye(4)).uncertainty()
    assert len(uncertainty.unobservable) == 3
    deviations = np.sqrt(np.linalg.eigvalsh(uncertainty.covariance))
    np.testing.assert_allclose(deviations[3:], 1.0, rtol=1e-6, atol=0)
    assert deviations[2] < 0.01
    for direction in uncertainty.unobservable:
        np.testing.assert_allclose(np.linalg.norm(direction), 1.0, rtol=1e-12, atol=0)
        # the turn about the normal and the shifts across it
        assert np.linalg.norm(direction[2:5]) > 0.99


@dimensions
def test_an_irregular_shape_is_held_in_all_directions(dimension):
    rng = np.random.default_rng(4)
    uncertainty = Registered(*sampled_twice(rng, 500, dimension, noise=0.01)).uncertainty()
    assert uncertainty.unobservable == ()
    assert np.sqrt(np.linalg.eigvalsh(uncertainty.covariance)[-1]) < 0.02


def test_clouds_that_do_not_meet_have_no_covariance():
    rng = np.random.default_rng(5)
    registered = Registered(*sampled_twice(rng, 200, 3, noise=0.01))
    away = registered.fit.pose.copy()
    away[:3, 3] += 100.0
    fit = Fit(away, 1e-3, 0.5, 0.5)
    uncertainty = pose_uncertainty(registered.pairs, registered.source, registered.target, fit)
    assert uncertainty.covariance is None and len(uncertainty.unobservable) == 6
