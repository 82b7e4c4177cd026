"""The search after a doubtful first result: parts of a shape and large turns are found, ends compared by likelihood."""

import math

import numpy as np
import pytest
from mixtures import random_points_and_covariances
from shapes import body_with_head, move

from adagmm_o3d import register_points
from adagmm_o3d.em.runs import Limits, Start, run_starts
from adagmm_o3d.em.unmatched import AREA
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, so_exp
from adagmm_o3d.mixtures.merging import sample
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise

dimensions = pytest.mark.parametrize("dimension", [2, 3])


def without_a_side(points, direction, share):
    """The points but for the share of them that lies furthest along a direction."""
    along = points @ direction
    return points[along <= np.quantile(along, 1.0 - share)]


@dimensions
def test_clouds_that_lost_opposite_sides_are_found(dimension):
    """Each lost 30 % of its points: four sevenths have a partner, and the centroids lie a radius apart."""
    for seed in range(6):
        rng = np.random.default_rng([seed, dimension])
        points = body_with_head(rng, {2: 150, 3: 700}[dimension], dimension)
        direction = rng.normal(size=dimension)
        direction /= np.linalg.norm(direction)
        source, target = without_a_side(points, direction, 0.3), without_a_side(points, -direction, 0.3)
        truth = se_exp(np.concatenate([0.2 * rng.normal(size=1 if dimension == 2 else 3), rng.normal(size=dimension)]))
        target = move(target + 0.005 * rng.normal(size=target.shape), truth)
        errors = pose_errors(truth, register_points(source, target).transformation)
        assert errors.rotation_deg < 3.0 and errors.translation < 0.05, (seed, errors)


def test_turns_by_sixty_degrees_about_every_axis_are_found():
    for seed, signs in enumerate(np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T):
        rng = np.random.default_rng(seed)
        truth = np.eye(4)
        for axis, sign in zip(np.eye(3), signs, strict=True):
            truth[:3, :3] = so_exp(np.radians(60.0) * sign * axis) @ truth[:3, :3]
        source, target = (body_with_head(rng, 600, 3) for _ in range(2))
        errors = pose_errors(truth, register_points(source, move(target, truth)).transformation)
        assert errors.rotation_deg < 6.0, (signs, errors)


@dimensions
@pytest.mark.parametrize("unmatched", [0.05, 0.4])
def test_ends_are_compared_by_the_likelihood_of_both_clouds(dimension, unmatched):
    """The mean log density of each cloud under the other's mixture and a uniform one, each by its own σ and share;
    those without a partner as dense as at the σ at which all are compared."""
    rng = np.random.default_rng(dimension)
    source, target, _ = normalise(
        *(
            make_mixture(name, *random_points_and_covariances(rng, n, dimension, isotropic=False))
            for name, n in (("source", 60), ("target", 80))
        )
    )
    sigma, compared_at, pose = 0.03, 0.01, np.eye(4)
    start = Start(pose, sigma, unmatched, fastest=1.0, iterations=0, follow=0.0)
    limits = Limits(floor=1e-3, least_unmatched=0.05, relative_rmse=1e-3)
    (end,) = run_starts(
        sample(source, 99), sample(target, 99), [start], limits=limits, level=0, compared_at=compared_at
    )
    assert (end.sigma, end.unmatched, end.iterations) == (sigma, unmatched, ())
    free = slice(0, dimension)
    offsets = (source.points[:, None] - target.points[None])[..., free]
    both = sigma * (source.covariances[:, None] + target.covariances[None])[..., free, free]
    distances_sq = np.einsum("mni,mnij,mnj->mn", offsets, np.linalg.inv(both), offsets)
    densities = np.exp(-0.5 * distances_sq) / np.sqrt((2.0 * math.pi) ** dimension * np.linalg.det(both))
    nowhere = 1.0 / (AREA[dimension] * math.sqrt(4.0 * math.pi * compared_at))
    expected = sum(
        np.log((1.0 - unmatched) * densities.mean(axis=axis) + unmatched * nowhere).mean() for axis in (0, 1)
    )
    np.testing.assert_allclose(end.log_likelihood + 2.0 * math.log(nowhere), expected, rtol=1e-4, atol=1e-4)
