"""What both loops of EM do between two passes, against NumPy and the definitions."""

import math

import numpy as np
import pytest

from adagmm_o3d.kernels.cpu.acceleration import LOG_SIGMA, STATE, UNMATCHED_SHARE
from adagmm_o3d.kernels.layout import (
    GRADIENT,
    HESSIAN,
    TOTAL_ENERGY,
    TOTAL_MATCHED,
    TOTAL_SUMS,
    TOTAL_WEIGHT,
)
from adagmm_o3d.kernels.update import (
    SIGMA_TOLERANCE,
    Rule,
    call_follow_pairs,
    call_m_step,
    call_move,
    density_without_partner,
    fresh_memory,
)
from adagmm_o3d.lie import so_exp

FREE = {2: [2, 3, 4], 3: [0, 1, 2, 3, 4, 5]}
RULE = Rule(
    dimension=3, floor=1e-4, fastest=0.5, follow=1.0, least_unmatched=0.05, most_unmatched=0.7, accelerated=False
)
dimensions = pytest.mark.parametrize("dimension", [2, 3])


def sums(hessian=None, gradient=None, weight=1.0, energy=1.0, matched=0.5):
    total = np.full(TOTAL_SUMS, np.nan)
    if hessian is not None:
        total[HESSIAN:GRADIENT] = hessian[np.triu_indices(6)]
        total[GRADIENT:TOTAL_WEIGHT] = gradient
    total[TOTAL_WEIGHT], total[TOTAL_ENERGY], total[TOTAL_MATCHED] = weight, energy, matched
    return total


def step_of(hessian, gradient, dimension=3, relaxation=1.0, relative_rmse=1e-3, sigma=0.1):
    delta = np.full(6, np.nan)
    total, axis = sums(hessian, gradient), np.zeros(3)
    determined, short = call_m_step(total, dimension == 2, axis, relaxation, relative_rmse, sigma, delta)
    return delta, determined, short


def follow(total, sigma=0.2, unmatched=0.3, delta=None, memory=None, **changes):
    step = np.full(STATE, np.nan)
    delta = np.array([0.01, -0.02, 0.03, 0.01, 0.02, -0.01]) if delta is None else delta
    memory = fresh_memory(1)[0] if memory is None else memory
    return *call_follow_pairs(total, delta, sigma, unmatched, RULE._replace(**changes), memory, step), step


@dimensions
@pytest.mark.parametrize("seed", range(4))
def test_the_step_solves_the_normal_equations_on_the_free_directions(dimension, seed):
    rng = np.random.default_rng([seed, dimension])
    factor = rng.normal(size=(6, 6))
    hessian, gradient = factor @ factor.T + 0.1 * np.eye(6), rng.normal(size=6)
    free = FREE[dimension]
    delta, determined, _ = step_of(hessian, gradient, dimension, relaxation=1.3)
    assert determined
    expected = -1.3 * np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
    np.testing.assert_allclose(delta[free], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(np.delete(delta, free), 0.0)


def test_stiffness_of_any_order_is_solved_for_to_the_last_digits():
    # The stiffest direction first: what is left of the softer ones is not lost in rounding.
    rng = np.random.default_rng(0)
    for _ in range(10):
        scales = rng.permutation(10.0 ** -np.arange(0.0, 4.5, 0.9))[:6]
        scales = np.resize(scales, 6)
        factor = rng.normal(size=(6, 6))
        hessian = scales[:, None] * (factor @ factor.T + np.eye(6)) * scales
        expected = rng.normal(size=6) / scales
        delta, determined, _ = step_of(hessian, -hessian @ expected)
        assert determined
        np.testing.assert_allclose(delta * scales, expected * scales, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("soft", range(6))
@pytest.mark.parametrize(("stiffness", "determined"), [(0.0, False), (0.9e-9, False), (1.1e-9, True), (-1.0, False)])
def test_a_direction_that_the_pairs_leave_free_gets_no_step(soft, stiffness, determined):
    diagonal = np.array([0.1, 0.4, 1.0, 0.3, 0.2, 0.5])
    diagonal[soft] = 1.0
    diagonal[(soft + 3) % 6], diagonal[soft] = 1.0, stiffness
    delta, found, _ = step_of(np.diag(diagonal), diagonal)
    assert found == determined
    np.testing.assert_allclose(delta[np.arange(6) != soft], -1.0, rtol=1e-12, atol=0)
    assert delta[soft] == pytest.approx(-1.0, rel=1e-12) if determined else delta[soft] == 0.0


def test_of_directions_that_are_free_together_some_are_held():
    rng = np.random.default_rng(1)
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        hessian = axes @ np.diag([5.0, 4.0, 3.0, 2.0, 1e-13, 1e-13]) @ axes.T
        gradient = axes[:, :4] @ rng.normal(size=4)
        delta, determined, _ = step_of(hessian, gradient)
        assert not determined and np.count_nonzero(delta) == 4
        np.testing.assert_allclose(hessian @ delta, -gradient, rtol=0, atol=1e-9)
        assert np.linalg.norm(delta) < 20.0 * np.linalg.norm(np.linalg.pinv(hessian, 1e-9) @ gradient)


def test_no_pair_is_no_step():
    delta, determined, short = step_of(np.zeros((6, 6)), np.zeros(6))
    np.testing.assert_array_equal(delta, 0.0)
    assert not determined and short


@dimensions
def test_a_step_is_short_in_standard_deviations_of_the_mixtures(dimension):
    gradient = np.array([0.01, -0.02, 0.03, 0.01, 0.02, -0.01])
    size = 1.5 * np.linalg.norm(gradient[FREE[dimension]])
    for share, short in ((1.001, True), (0.999, False)):
        _, _, found = step_of(np.eye(6), gradient, dimension, 1.5, share * size**2 / 0.04, 0.04)
        assert found == short


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 1e-3, 0.4, 3.0])
def test_a_pose_is_turned_about_the_origin_and_then_shifted(angle):
    rng = np.random.default_rng(2)
    rotation, translation = so_exp(rng.normal(size=3)), rng.normal(size=3)
    axis = rng.normal(size=3)
    turn, shift = angle * axis / np.linalg.norm(axis), rng.normal(size=3)
    pose = np.column_stack([rotation, translation]).ravel()
    call_move(np.concatenate([turn, shift]), pose)
    expected = np.column_stack([so_exp(turn) @ rotation, so_exp(turn) @ translation + shift])
    np.testing.assert_allclose(pose.reshape(3, 4), expected, rtol=0, atol=1e-14)


@dimensions
@pytest.mark.parametrize("follow_share", [0.0, 0.5, 1.0])
def test_sigma_is_what_the_residuals_say_within_its_bounds(dimension, follow_share):
    for energy, floor, fastest in ((6.0, 1e-4, 0.5), (3.0, 0.3, 0.5), (0.1, 1e-4, 0.7), (30.0, 1e-4, 0.5)):
        total = sums(weight=4.0, energy=energy)
        sigma, _, settled, step = follow(total, dimension=dimension, follow=follow_share, floor=floor, fastest=fastest)
        observed = follow_share * 0.2 * energy / 4.0 / dimension
        assert sigma == pytest.approx(max(observed, floor, fastest * 0.2), rel=1e-12)
        assert not settled
        assert step[LOG_SIGMA] == pytest.approx(math.log(sigma / 0.2), rel=1e-12)


def test_sigma_has_settled_when_it_changes_by_less_than_a_hundredth():
    for ratio, still in ((1.0, True), (1.0098, True), (0.9902, True), (1.0102, False), (0.9898, False)):
        _, _, settled, _ = follow(sums(energy=3.0 * ratio))
        assert settled == still
    assert SIGMA_TOLERANCE == 0.01


@pytest.mark.parametrize("matched", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_the_share_without_a_partner_is_that_of_the_pairs_within_its_bounds(matched):
    _, unmatched, _, step = follow(sums(matched=matched), unmatched=0.4)
    expected = min(max(1.0 - matched, 0.05), 0.7)
    assert unmatched == pytest.approx(expected, rel=1e-12)
    assert step[UNMATCHED_SHARE] == pytest.approx(expected - 0.4, rel=1e-12)


def run(accelerated, count=8, floor=1e-4, held=1.0):
    """Steps of a linear contraction of the pose, σ and share, and the states that they lead to."""
    pose, sigma, unmatched, memory, states = np.full(6, 0.01), 0.11, 0.6, fresh_memory(1)[0], []
    for _ in range(count):
        total = sums(energy=3.0 * (0.1 / sigma) ** 0.5 * held, matched=0.8 + 0.1 * (1.0 - unmatched))
        sigma, unmatched, _, step = follow(
            total, sigma, unmatched, -0.2 * pose, memory, accelerated=accelerated, floor=floor
        )
        pose = pose + step[:6]
        states.append((np.linalg.norm(pose), sigma, unmatched))
    return np.array(states)


def test_accelerated_steps_lead_there_sooner_and_memory_is_what_does_it():
    plain, fast = run(False), run(True)
    np.testing.assert_allclose(plain[:, 0], 0.01 * math.sqrt(6.0) * 0.8 ** np.arange(1, 9), rtol=1e-12)
    np.testing.assert_array_equal(plain[0], fast[0])
    assert fast[-1, 0] < 0.01 * plain[-1, 0]
    assert abs(fast[-1, 1] - 0.1) < 0.1 * abs(plain[-1, 1] - 0.1)


@pytest.mark.parametrize("floor", [1e-4, 0.2 * math.exp(-0.17)])
@pytest.mark.parametrize("most", [0.7, 1.0])
def test_an_extrapolated_sigma_and_share_stay_within_their_bounds(floor, most):
    # All of the state comes half as far each time: the second step is twice its residual, and goes all the way.
    memory, sigma, unmatched = fresh_memory(1)[0], 0.2, 0.63
    for part in (1.0, 0.5):
        total = sums(energy=3.0 * math.exp(-0.1 * part), matched=1.0 - unmatched - 0.04 * part)
        sigma, unmatched, _, step = follow(
            total, sigma, unmatched, np.full(6, 0.01 * part), memory, accelerated=True, floor=floor, most_unmatched=most
        )
    np.testing.assert_allclose(step, [0.01] * 6 + [-0.1, 0.04], rtol=1e-8, atol=0)
    assert sigma == pytest.approx(max(0.2 * math.exp(-0.2), floor), rel=1e-9)
    assert unmatched == pytest.approx(min(0.71, most), rel=1e-9)


def test_while_sigma_falls_as_fast_as_it_may_nothing_is_extrapolated():
    memory = fresh_memory(1)[0]
    delta = np.full(6, 0.01)
    follow(sums(energy=2.9), delta=delta, memory=memory, accelerated=True)
    *_, step = follow(sums(energy=0.1), delta=0.9 * delta, memory=memory, accelerated=True)
    np.testing.assert_array_equal(step[:6], 0.9 * delta)
    assert step[LOG_SIGMA] == pytest.approx(math.log(0.5), rel=1e-12)
    # And what came before is forgotten.
    *_, step = follow(sums(energy=2.9), delta=0.5 * delta, memory=memory, accelerated=True)
    np.testing.assert_array_equal(step[:6], 0.5 * delta)


def test_a_step_is_extrapolated_in_units_of_the_mixtures_deviation():
    # The longest step is a share of √σ: at a σ a hundred times smaller ten times shorter.
    lengths = []
    for sigma in (0.25, 0.0025):
        *_, step = follow(sums(energy=3.0), sigma, delta=np.full(6, 10.0), accelerated=True)
        lengths.append(np.linalg.norm(step[:6]))
    np.testing.assert_allclose(lengths, [0.3 * 0.5, 0.3 * 0.05], rtol=1e-12)


def test_points_without_a_partner_are_as_dense_as_the_mixtures_are_thick():
    assert density_without_partner(3.0, 0.04, 0.2) == pytest.approx(3.0 / 0.2 * 0.25, rel=1e-12)
