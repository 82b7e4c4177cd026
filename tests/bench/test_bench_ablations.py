"""The ablation's rows: each undoes one choice, does change what runs, and leaves the package as it was."""

from functools import cache
from inspect import signature

import numpy as np
import pytest
from shapes import body_with_head, move

from adagmm_bench.color_trial import VARIANTS
from adagmm_bench.commands.ablation import ablation_table
from adagmm_bench.extra_pairs import LOST, DenseSurface, OppositeSides, found_part, without_side
from adagmm_bench.methods.ablations import ABLATIONS
from adagmm_bench.methods.ours import register
from adagmm_bench.methods.variant import Replacement, replaced
from adagmm_bench.problem import Cloud, Problem, prepare
from adagmm_bench.simulation import TrialId
from adagmm_bench.trial import SimulatedProblem
from adagmm_o3d import TransformationEstimationForAdaptiveGMM
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures import spacing
from adagmm_o3d.search.levels import Levels


class Turned:
    """Two parts of a body, a quarter missing on either, turned against each other by a third of a full turn."""

    def __init__(self, dimension, noise):
        self.dimension, self.noise = dimension, noise

    def load(self):
        rng = np.random.default_rng([8, self.dimension])
        points = body_with_head(rng, 700 if self.dimension == 3 else 150, self.dimension)
        direction = rng.normal(size=self.dimension)
        parts = [without_side(points, side) for side in (direction, -direction)]
        parts = [part + self.noise * rng.normal(size=part.shape) for part in parts]
        turn = np.array([1.2, -1.2, 1.2]) if self.dimension == 3 else np.array([2.1])
        target = move(parts[1], se_exp(np.concatenate([turn, rng.normal(size=self.dimension)])))
        unit = np.eye(self.dimension)
        return Problem("turned", *(Cloud(p, np.tile(unit, (len(p), 1, 1))) for p in (parts[0], target)))


SIDES, DENSE = OppositeSides(3, 0, 0, None), DenseSurface(40_000)
PLANE, TURNED = OppositeSides(2, 0, 0, None), Turned(3, 0.0)
# What a row acts on; on SIDES where nothing else is said.
CASES = {
    "adagmm-without-mutuality": DenseSurface(3000),
    "adagmm-without-condensing": DENSE,
    "adagmm-without-acceleration": DENSE,
    "adagmm-without-centroids": PLANE,
    "adagmm-without-shifted-starts": PLANE,
    "adagmm-without-sketch": PLANE,
    "adagmm-decided-on-all-points": SimulatedProblem(TrialId(3, "noise", 0.31, 0), None),
    "adagmm-without-features": TURNED,
}


@cache
def way(name, problem):
    """Every pose on the way to the result."""
    prepared = prepare(problem.load(), "as-given")
    return register(name, prepared.source, prepared.target).transformations


@pytest.mark.slow
@pytest.mark.parametrize("name", ABLATIONS)
def test_a_row_changes_what_runs_and_only_while_it_runs(name):
    problem = CASES.get(name, SIDES)
    before = way("adagmm", problem)
    assert not np.array_equal(way(name, problem), before)
    prepared = prepare(problem.load(), "as-given")
    np.testing.assert_array_equal(register("adagmm", prepared.source, prepared.target).transformations, before)


def test_a_row_differs_from_the_default_in_one_option_or_in_what_it_replaces():
    default = TransformationEstimationForAdaptiveGMM()
    for name, variant in ABLATIONS.items():
        assert variant.init is None and len(variant.options) + bool(variant.replacements) == 1, name
        assert all(getattr(default, option) != value for option, value in variant.options.items()), name
        for replacement in variant.replacements:
            place, last = replacement.place()
            assert vars(place)[last] != replacement.value, (name, last)


def test_a_function_that_stands_in_for_another_takes_what_that_takes():
    compared = 0
    for variant in (ABLATIONS | VARIANTS).values():
        for replacement in variant.replacements:
            place, last = replacement.place()
            if callable(vars(place)[last]):
                signature(replacement.value).bind(*signature(getattr(place, last)).parameters)
                compared += 1
    assert compared == 5


def test_replacements_end_with_their_block_whatever_happens_in_it():
    probed, run = spacing.PROBED, Levels.run
    replacements = Replacement("mixtures.spacing", "PROBED", 0.0), Replacement("search.levels", "Levels.run", None)
    with pytest.raises(ZeroDivisionError), replaced(replacements):
        assert (spacing.PROBED, Levels.run) == (0.0, None)
        raise ZeroDivisionError
    assert (spacing.PROBED, Levels.run) == (probed, run)


@pytest.mark.parametrize("name", ["NO_LONGER_THERE", "PROBES.no_longer_there", "Gone.search", "PROBED.there"])
def test_a_name_that_is_gone_is_an_error_and_nothing_is_replaced(name):
    probed = spacing.PROBED
    replacements = Replacement("mixtures.spacing", "PROBED", 0.0), Replacement("mixtures.spacing", name, 1)
    message = rf"^adagmm_o3d\.mixtures\.spacing: expected a name {name} to replace"
    with pytest.raises(InputError, match=message), replaced(replacements):
        pass
    assert probed == spacing.PROBED


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_truth_of_opposite_sides_is_their_truth(dimension):
    problem = OppositeSides(dimension, 3, 1, None).load()
    assert len(problem.source) == pytest.approx(0.9 * (1.0 - LOST) * {2: 100, 3: 1000}[dimension], abs=2)
    moved = move(problem.source.points, problem.T_target_source)
    nearest = np.linalg.norm(moved[:, None] - problem.target.points, axis=2).min(axis=1)
    # Four sevenths have a partner, but for those that were not sampled.
    assert 0.45 < np.mean(nearest < {2: 0.08, 3: 0.1}[dimension]) < 0.8


def test_a_part_is_found_where_its_translation_is_right_too():
    right = {"rotation_error": 0.05, "translation_error": 0.05}
    assert found_part(right)
    assert not found_part(right | {"translation_error": 0.2}) and not found_part(right | {"rotation_error": 0.2})


def test_the_table_has_a_row_for_every_choice_with_its_seconds():
    class Row:
        mean, found, trials, translation_mean, cpu_seconds_total = 0.01234, 5, 6, 1.5e-5, 7.0

    columns, rows = ablation_table({"2D": dict.fromkeys(("adagmm", *ABLATIONS), Row)})
    assert columns == ["method", "2D mean", "found", "translation", "CPU s"]
    assert [row[0] for row in rows] == ["adagmm", *ABLATIONS]
    assert all(row[1:] == ["0.0123", "5/6", "1.5e-05", "7.00"] for row in rows)
