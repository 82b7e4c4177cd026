"""Local features and the consistency of correspondences against NumPy, one formula at a time."""

import numpy as np
import pytest

from adagmm_o3d.kernels.cpu.consistency import shared_support
from adagmm_o3d.kernels.cpu.features import BINS, FEATURE, binned, describe, nearest_features, scatter_around


def cloud(n, seed=0):
    """Points in ascending x, as the kernels take them, and normals."""
    rng = np.random.default_rng(seed)
    points, normals = rng.uniform(-1.0, 1.0, (n, 3)), rng.normal(size=(n, 3))
    return points[np.argsort(points[:, 0])], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def angles(p, n, q, m):
    """The three numbers of a pair in [0, 1]: the turn, and how the normals stand to the frame and to the line."""
    if n @ m < 0.0:
        m = -m
    line = (q - p) / np.linalg.norm(q - p)
    if abs(n @ line) < abs(m @ line):
        n, m, line = m, n, -line
    v = np.cross(line, n)
    v /= np.linalg.norm(v)
    w = np.cross(n, v)
    return np.arctan2(w @ m, n @ m) / (2.0 * np.pi) + 0.5, 0.5 * (v @ m + 1.0), 0.5 * (n @ line + 1.0)


def naive_features(points, normals, radius):
    n = len(points)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = (distance <= radius) & (distance > 0.0)
    simple = np.zeros((n, 3, BINS))
    for i in range(n):
        for j in np.flatnonzero(near[i]):
            for k, value in enumerate(angles(points[i], normals[i], points[j], normals[j])):
                simple[i, k, min(int(BINS * value), BINS - 1)] += 100.0 / near[i].sum()
    features = simple.copy()
    for i in range(n):
        around = np.zeros((3, BINS))
        for j in np.flatnonzero(near[i]):
            other = simple[j].copy()
            if normals[i] @ normals[j] < 0.0:
                other[[0, 2]] = other[[0, 2], ::-1]
            around += other / distance[i, j] ** 2
        total = around.sum(axis=1, keepdims=True)
        features[i] += 100.0 * around / np.where(total > 0.0, total, 1.0)
    return features.reshape(n, FEATURE)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_features_match_the_formula_written_out(n):
    points, normals = cloud(n)
    features = np.empty((n, FEATURE))
    describe(points, normals, 0.7, features)
    np.testing.assert_allclose(features, naive_features(points, normals, 0.7), rtol=1e-9, atol=1e-9)


def test_features_are_the_same_in_any_unit():
    points, normals = cloud(30)
    features, magnified = np.empty((2, 30, FEATURE))
    describe(points, normals, 0.7, features)
    describe(64.0 * points, normals, 64.0 * 0.7, magnified)
    np.testing.assert_allclose(magnified, features, rtol=1e-9, atol=1e-9)


def test_the_ends_of_the_range_are_in_the_outer_bins():
    assert [binned(value) for value in (-0.1, 0.0, 0.999, 1.0, 1.1)] == [0, 0, BINS - 1, BINS - 1, BINS - 1]


def test_a_feature_whose_normal_is_turned_is_the_same_reversed():
    points, normals = cloud(40)
    signs = np.where(np.arange(40) % 3 == 0, -1.0, 1.0)
    given, turned = np.empty((2, 40, FEATURE))
    describe(points, normals, 0.8, given)
    describe(points, signs[:, None] * normals, 0.8, turned)
    reversed_ = given.reshape(-1, 3, BINS).copy()
    reversed_[:, [0, 2]] = reversed_[:, [0, 2], ::-1]
    expected = np.where(signs[:, None] < 0.0, reversed_.reshape(-1, FEATURE), given)
    # A value on the border of two bins falls to either side.
    assert np.mean(np.abs(turned - expected) < 1e-9) > 0.99


def test_the_two_nearest_features_both_ways_of_either_sign():
    rng = np.random.default_rng(1)
    own, others, turned = (rng.normal(size=(n, FEATURE)).astype(np.float32) for n in (7, 12, 12))
    best, best_other = np.empty(7, np.intp), np.empty(12, np.intp)
    least, least_other = np.empty((7, 2), np.float32), np.empty((12, 2), np.float32)
    tables = np.ascontiguousarray(others.T), np.ascontiguousarray(turned.T)
    nearest_features(own, *tables, best, least, best_other, least_other)
    straight, reverse = (((own[:, None].astype(np.float64) - x[None]) ** 2).sum(axis=2) for x in (others, turned))
    squares = np.minimum(straight, reverse)
    for found, distances, expected in ((best, least, squares), (best_other, least_other, squares.T)):
        np.testing.assert_array_equal(found, expected.argmin(axis=1))
        np.testing.assert_allclose(distances, np.sort(expected, axis=1)[:, :2], rtol=1e-5, atol=0)


def test_scatter_around_a_point():
    points, _ = cloud(50)
    scatter = np.empty((3, 3, 3))
    scatter_around(points, points[20:23], 0.9, scatter)
    for query, found in zip(points[20:23], scatter, strict=True):
        near = points[np.linalg.norm(points - query, axis=1) <= 0.9]
        np.testing.assert_allclose(found, np.cov(near.T, bias=True), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("n", [3, 64, 65, 70])
def test_support_counts_the_correspondences_that_agree_with_both(n):
    rng = np.random.default_rng(n)
    p, normals = cloud(n, n)
    q, other_normals = p + 0.2 * rng.normal(size=(n, 3)), cloud(n, n + 1)[1]
    support = np.empty((n, n), np.int32)
    with np.errstate(
        over="ignore"
    ):  # counting bits multiplies modulo 2**64, of which NumPy warns where nothing is compiled
        shared_support(p, q, normals, other_normals, 0.3, 0.4, support)
    lengths = [np.linalg.norm(x[:, None] - x[None], axis=2) for x in (p, q)]
    cosines = [np.abs(x @ x.T) for x in (normals, other_normals)]
    agree = (np.abs(lengths[0] - lengths[1]) < 0.3) & (np.abs(cosines[0] - cosines[1]) < 0.4)
    np.fill_diagonal(agree, False)
    expected = np.where(agree, agree.astype(int) @ agree.astype(int), 0)
    np.testing.assert_array_equal(support, expected)
