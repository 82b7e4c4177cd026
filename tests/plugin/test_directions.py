"""Rooms, whose walls and floor propose where one part lies on another: by what they face, and by votes for shifts."""

import numpy as np
import pytest
from shapes import corner_room, move, rectangle

from adagmm_o3d import estimate_surface_covariances
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.search.directions import direction_poses
from adagmm_o3d.search.features import thinned_alike


def mixtures(source, target):
    clouds = (("source", source), ("target", target))
    return normalise(*(make_mixture(name, p, estimate_surface_covariances(p)) for name, p in clouds))


@pytest.mark.parametrize("seed", range(6))
def test_parts_of_a_room_are_laid_on_each_other(seed):
    """The left part and the right one, which share the middle."""
    rng = np.random.default_rng(seed)
    source, target = (points + rng.normal(0.0, 0.005, points.shape) for points in (corner_room(rng), corner_room(rng)))
    axis = rng.normal(size=3)
    T = se_exp(np.concatenate([rng.uniform(0.5, 3.0) * axis / np.linalg.norm(axis), rng.normal(size=3)]))
    source, target, normalisation = mixtures(source[source[:, 0] < 3.0], move(target[target[:, 0] > 1.0], T))
    truth = normalisation.pose_in(T)
    errors = [pose_errors(truth, pose) for pose in direction_poses(thinned_alike(source, target))[:6]]
    assert any(e.rotation_deg < 10.0 and e.translation < 0.2 for e in errors)


def test_one_plane_proposes_nothing():
    rng = np.random.default_rng(0)
    floor = rectangle(rng, (0, 0, 0), (4, 0, 0), (0, 3, 0))
    source, target, _ = mixtures(floor, floor + np.array([0.5, 0.0, 0.0]))
    assert direction_poses(thinned_alike(source, target)) == []


def test_too_few_points_propose_nothing():
    points = np.random.default_rng(0).normal(size=(30, 3))
    source, target, _ = mixtures(points, points)
    assert direction_poses(thinned_alike(source, target)) == []
