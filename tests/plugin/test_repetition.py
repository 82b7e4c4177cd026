"""Shapes that repeat themselves, of which no pose is the only one that fits."""

import numpy as np
import pytest
from shapes import DOOR, corner_room, corridor, move

from adagmm_o3d import estimate_surface_covariances, register_points
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.search.schedule import SCHEDULE
from adagmm_o3d.trust.agreement import surfaces_of
from adagmm_o3d.trust.judge import JUDGED, Judge
from adagmm_o3d.trust.repetition import repeats_itself

REPEATS = "slid from here the clouds fit as well: a shape that repeats itself"


class Views:
    """Two samples of a room, the first up to x = `left`, the second, turned, from `right` on."""

    def __init__(self, seed, room, left, right):
        rng = np.random.default_rng(seed)
        source, target = (points + rng.normal(0.0, 0.005, points.shape) for points in (room(rng), room(rng)))
        self.T = se_exp(rng.normal(0.0, 0.5, 6))
        self.source, self.target = source[source[:, 0] < left], move(target[target[:, 0] > right], self.T)
        self.covariances = [estimate_surface_covariances(points) for points in (self.source, self.target)]

    def repeats(self, slid=0.0):
        """At the true pose, slid along the room."""
        source, target, normalisation = normalise(
            make_mixture("source", self.source, self.covariances[0]),
            make_mixture("target", self.target, self.covariances[1]),
        )
        judge = Judge(source, target, Levels(source, target, SCHEDULE).sampled(JUDGED))
        slide = np.eye(4)
        slide[0, 3] = slid
        return repeats_itself(judge, *surfaces_of(*judge.sides), normalisation.pose_in(self.T @ slide))

    def register(self):
        return register_points(self.source, self.target, *self.covariances)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("doors", [0, 1, 2])
def test_a_corridor_of_equal_doors_repeats_itself_wherever_a_door_lies_on_a_door(seed, doors):
    assert Views(seed, corridor, 5.4, 2.4).repeats(doors * DOOR)


@pytest.mark.parametrize("seed", range(3))
def test_registered_it_is_said_or_right(seed):
    views = Views(seed, corridor, 5.4, 2.4)
    result = views.register()
    errors = pose_errors(views.T, result.transformation)
    assert result.warnings or (errors.rotation_deg < 2.0 and errors.translation < 0.1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("left", "right"), [(5.0, 0.0), (4.0, 1.0)])
def test_what_does_not_repeat_itself_is_not_said_to(seed, left, right):
    views = Views(seed, corner_room, left, right)
    assert not views.repeats()
    assert REPEATS not in views.register().warnings
