"""The sums of each point's scores against pairs written out in NumPy, derivatives as finite differences."""

import numpy as np
import pytest
import reference
from mixtures import random_colours, random_points_and_covariances

from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.kernels.cpu.scores import Hues, Reach, ScoredPoints, score_sums
from adagmm_o3d.kernels.layout import CURVATURE, POINT_SUMS, SCORE, SENSITIVITY
from adagmm_o3d.lie import se_exp

EVERYTHING = 1e12
STEP = 1e-5


class Side:
    def __init__(self, rng, n, dimension):
        self.points, self.covariances = np.zeros((n, 3)), np.zeros((n, 3, 3))
        points, covariances = random_points_and_covariances(rng, n, dimension, isotropic=False)
        self.points[:, :dimension], self.covariances[:, :dimension, :dimension] = points, covariances
        self.variances = np.linalg.eigvalsh(covariances)[:, -1].copy()
        self.weights = rng.uniform(0.5, 2.0, n)
        self.shares = rng.uniform(0.5, 2.0, n)

    def as_argument(self):
        packed = self.covariances.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].copy(order="C")
        return ScoredPoints(self.points, packed, self.variances, self.weights)


class Pairs:
    """What every pair adds, in plain NumPy; source points are turned and shifted by exp(δ)."""

    def __init__(self, dimension):
        rng = np.random.default_rng(dimension)
        self.dimension, self.free = dimension, FREE[dimension]
        self.source, self.target = Side(rng, 5, dimension), Side(rng, 7, dimension)

    def at(self, delta):
        """(M, N) densities, (M, N) squared distances and (M, N, 6) gradients of half of these."""
        pose = se_exp(delta)
        R = pose[:3, :3]
        y = self.source.points @ R.T + pose[:3, 3]
        S = (R @ self.source.covariances @ R.T)[:, None] + self.target.covariances[None]
        if self.dimension == 2:
            S[..., 2, 2] = 1.0
        d = y[:, None] - self.target.points[None]
        v = np.linalg.solve(S, d[..., None])[..., 0]
        distance_sq = (d * v).sum(axis=-1)
        density = np.exp(-0.5 * distance_sq) / np.sqrt(np.linalg.det(S))
        return density, distance_sq, np.concatenate([np.cross(y[:, None], v), v], axis=-1)

    def change(self, function):
        """∂function/∂δ, the direction last."""
        return np.stack([(function(STEP * e) - function(-STEP * e)) / (2.0 * STEP) for e in np.eye(6)], axis=-1)

    def expected(self, own_is_source, counts):
        """The sums over the pairs that `counts` (M, N), of each point of one side."""
        density, _, j = self.at(np.zeros(6))
        weights = self.source.weights[:, None] * self.target.weights * counts
        shares = (self.target.shares[None] if own_is_source else self.source.shares[:, None]) * counts
        axis = 1 if own_is_source else 0
        of_density = self.change(lambda delta: self.at(delta)[0])
        of_score = self.change(lambda delta: self.at(delta)[0][..., None] * self.at(delta)[2])
        w = weights * density
        # left out: at an optimum the pulls v sum to nothing
        of_lever_arms = np.zeros_like(of_score)
        of_lever_arms[..., :3, 3:] = density[..., None, None] * np.cross(np.eye(3), j[..., None, 3:]).swapaxes(-1, -2)
        return (
            (w[..., None] * j).sum(axis=axis),
            -(shares[..., None] * of_density).sum(axis=axis),
            (weights[..., None, None] * (of_score - of_lever_arms)).sum(axis=axis),
        )

    def sums(self, own_is_source, windows=None, cut=EVERYTHING, hues=None):
        own, other = (self.source, self.target) if own_is_source else (self.target, self.source)
        sums = np.full((len(own.points), POINT_SUMS), np.nan)
        if windows is None:
            windows = np.repeat([[0], [len(other.points)]], len(own.points), axis=1)
        args = (own.as_argument(), other.as_argument(), other.shares, Reach(windows, cut))
        score_sums(*args, own_is_source, self.dimension == 2, sums, hues)
        return sums

    def check(self, sums, own_is_source, counts):
        score, sensitivity, curvature = self.expected(own_is_source, counts)
        free, f = np.ix_(range(len(sums)), self.free), np.ix_(range(len(sums)), self.free, self.free)

        def close(got, expected, rtol):
            np.testing.assert_allclose(got, expected, rtol=rtol, atol=rtol * np.abs(expected).max())

        close(sums[:, SCORE:SENSITIVITY][free], score[free], 1e-12)
        close(sums[:, SENSITIVITY:CURVATURE][free], sensitivity[free], 1e-8)
        if own_is_source:
            close(sums[:, CURVATURE:].reshape(-1, 6, 6)[f], curvature[f], 1e-8)
        else:
            np.testing.assert_array_equal(sums[:, CURVATURE:], 0.0)


sides = pytest.mark.parametrize("own_is_source", [True, False], ids=["source", "target"])
dimensions = pytest.mark.parametrize("dimension", [2, 3])


@dimensions
@sides
def test_sums_are_those_of_the_pairs(dimension, own_is_source):
    p = Pairs(dimension)
    p.check(p.sums(own_is_source), own_is_source, np.ones((5, 7)))


@dimensions
@sides
def test_a_pair_counts_as_far_as_its_colours_agree(dimension, own_is_source):
    p = Pairs(dimension)
    colours, model = random_colours(5, 7)
    moved, still = model.scaled(colours[0], of_source=True), model.scaled(colours[1], of_source=False)
    hues = Hues(*((moved, still) if own_is_source else (still, moved)), model.floor, model.expected)
    p.check(p.sums(own_is_source, hues=hues), own_is_source, reference.colour_ratios(*colours, model))


@dimensions
@sides
def test_only_pairs_in_the_window_and_nearer_than_the_cut_count(dimension, own_is_source):
    p = Pairs(dimension)
    _, distance_sq, _ = p.at(np.zeros(6))
    cut = float(np.sort(distance_sq, axis=None)[16:18].mean())
    p.check(p.sums(own_is_source, cut=cut), own_is_source, distance_sq <= cut)
    own, other = (5, 7) if own_is_source else (7, 5)
    windows = np.stack([np.arange(own) % 3, 3 + np.arange(own) % (other - 2)])
    inside = (np.arange(other) >= windows[0][:, None]) & (np.arange(other) < windows[1][:, None])
    p.check(p.sums(own_is_source, windows=windows), own_is_source, inside if own_is_source else inside.T)
