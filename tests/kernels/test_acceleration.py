"""Anderson acceleration against its definition by least squares, against GMRES, and what bounds it."""

import numpy as np
import pytest

from adagmm_o3d.kernels.cpu.acceleration import (
    LARGEST_CHANGE,
    LOG_SIGMA,
    LONGEST_STEP,
    MEMORY,
    STATE,
    TURN_AND_SHIFT,
    accelerated_step,
    empty_memory,
    forget,
)

# What `product` divides a state by: the pose by the deviation, the rest by nothing.
DEVIATION = 0.3
UNITS = np.array([DEVIATION] * TURN_AND_SHIFT + [1.0] * (STATE - TURN_AND_SHIFT))


def fresh():
    memory = empty_memory()
    forget(memory)
    return memory


def next_step(memory, residual, deviation=DEVIATION):
    step = np.full(STATE, np.nan)
    accelerated_step(residual, deviation, memory, step)
    return step


def bounded(step, deviation=DEVIATION):
    excess = max(
        np.linalg.norm(step[:TURN_AND_SHIFT]) / (LONGEST_STEP * deviation), abs(step[LOG_SIGMA]) / LARGEST_CHANGE
    )
    return step / max(excess, 1.0)


def expected_steps(residuals):
    """Anderson's steps by NumPy's least squares; begun anew where a residual has grown."""
    steps, differences = [], []
    for k, residual in enumerate(residuals):
        if k and np.linalg.norm(residual / UNITS) > np.linalg.norm(residuals[k - 1] / UNITS):
            differences = []
        elif k:
            differences = [(residual - residuals[k - 1], steps[-1]), *differences][:MEMORY]
        step = residual.copy()
        if differences:
            of_residuals, of_states = (np.stack(d, axis=1) for d in zip(*differences, strict=True))
            share = np.linalg.lstsq(of_residuals / UNITS[:, None], residual / UNITS, rcond=None)[0]
            step -= (of_residuals + of_states) @ share
        steps.append(bounded(step))
    return steps


def contraction(rng, eigenvalues):
    """A linear map with these eigenvalues, in turn, and a fixed point; not symmetric."""
    basis = np.linalg.qr(rng.normal(size=(STATE, STATE)))[0] + 0.2 * rng.normal(size=(STATE, STATE))
    return basis @ np.diag(np.resize(eigenvalues, STATE)) @ np.linalg.inv(basis), 0.05 * rng.normal(size=STATE)


def test_steps_are_those_of_least_squares_over_the_last_differences():
    rng = np.random.default_rng(0)
    # Small steps, of which none is cut short; each of another direction, the third and the tenth twice forgotten.
    sizes = 1e-4 * np.array([1.0, 0.9, 2.5, 2.0, 1.2, 1.5, 0.8, 0.7, 0.6, 2.0, 5.0, 4.0, 3.0, 3.0])
    residuals = [size * UNITS * direction for size, direction in zip(sizes, rng.normal(size=(14, STATE)), strict=True)]
    memory = fresh()
    for k, (residual, expected) in enumerate(zip(residuals, expected_steps(residuals), strict=True)):
        given = residual.copy()
        np.testing.assert_allclose(next_step(memory, given), expected, rtol=1e-6, atol=1e-10, err_msg=f"step {k}")
        np.testing.assert_array_equal(given, residual)


# Maps on whose way the residual never grows.
@pytest.mark.parametrize("seed", [0, 1, 4])
def test_on_a_linear_map_its_residuals_are_those_of_gmres(seed):
    # Walker and Ni, Theorem 2.2: the state after k + 1 steps is the map of GMRES' iterate k.
    A, fixed = contraction(np.random.default_rng(seed), [0.9, 0.6, 0.3, 0.1, -0.2])
    M, memory = np.eye(STATE) - A, fresh()
    x = np.zeros(STATE)
    first = M @ fixed
    for k in range(MEMORY + 2):
        residual = M @ (fixed - x)
        if k > 0:
            krylov = np.stack([np.linalg.matrix_power(M, i) @ first for i in range(k - 1)], axis=1) if k > 1 else None
            best = first
            if krylov is not None:
                y = np.linalg.lstsq((M @ krylov) / UNITS[:, None], first / UNITS, rcond=None)[0]
                best = first - M @ krylov @ y
            np.testing.assert_allclose(residual, A @ best, rtol=1e-5, atol=1e-8)
        x += next_step(memory, residual)


@pytest.mark.parametrize("seed", range(3))
def test_three_rates_of_convergence_take_five_steps(seed):
    A, fixed = contraction(np.random.default_rng(seed), [0.97, 0.8, 0.4])
    memory, x, plain = fresh(), np.zeros(STATE), np.zeros(STATE)
    for _ in range(MEMORY + 2):
        x += next_step(memory, (A - np.eye(STATE)) @ (x - fixed))
        plain += (A - np.eye(STATE)) @ (plain - fixed)
    assert np.linalg.norm(x - fixed) < 1e-6 * np.linalg.norm(fixed)
    assert np.linalg.norm(plain - fixed) > 0.1 * np.linalg.norm(fixed)


def test_the_fixed_point_of_a_curved_map_is_that_of_plain_iteration():
    rng = np.random.default_rng(4)
    A, centre = contraction(rng, [0.9, 0.85, 0.7, 0.5])

    def residual(x):
        return A @ (x - centre) - 0.1 * np.sin(x) ** 3 + centre - x

    plain = np.zeros(STATE)
    count = 0
    while np.linalg.norm(residual(plain)) > 1e-10:
        plain += residual(plain)
        count += 1
    memory, x = fresh(), np.zeros(STATE)
    steps = 0
    while np.linalg.norm(residual(x)) > 1e-10:
        x += next_step(memory, residual(x))
        steps += 1
        assert steps < count / 3
    np.testing.assert_allclose(x, plain, rtol=0, atol=1e-8)


def test_a_grown_residual_is_taken_as_it_is_and_the_past_forgotten():
    rng = np.random.default_rng(5)
    memory = fresh()
    first, second = 1e-3 * UNITS * rng.normal(size=(2, STATE))
    np.testing.assert_array_equal(next_step(memory, first), first)
    second *= np.linalg.norm(first / UNITS) / np.linalg.norm(second / UNITS)
    assert not np.allclose(next_step(memory, second), second, rtol=1e-3, atol=0)
    grown = 1.01 * first
    np.testing.assert_array_equal(next_step(memory, grown), grown)
    again = fresh()
    next_step(again, grown)
    np.testing.assert_array_equal(next_step(memory, first), next_step(again, first))
    # As the state's size counts: the pose in deviations.
    memory = fresh()
    small, large = np.full(STATE, 1e-3), np.full(STATE, 1e-3)
    large[:TURN_AND_SHIFT] = 2.2e-3
    next_step(memory, small)
    np.testing.assert_array_equal(next_step(memory, large), large)
    memory = fresh()
    next_step(memory, small, deviation=100.0)
    assert not np.array_equal(next_step(memory, 0.99 * large, deviation=100.0), 0.99 * large)


def test_forgetting_begins_anew():
    rng = np.random.default_rng(6)
    memory = fresh()
    for residual in 1e-3 * rng.normal(size=(3, STATE)):
        next_step(memory, residual)
    forget(memory)
    residual = 1e-3 * rng.normal(size=STATE)
    np.testing.assert_array_equal(next_step(memory, residual), residual)


@pytest.mark.parametrize("longest", ["pose", "sigma"])
def test_no_step_is_longer_than_allowed_and_its_direction_is_kept(longest):
    residual = np.full(STATE, 1e-3)
    residual[2 if longest == "pose" else LOG_SIGMA] = -3.0
    step = next_step(fresh(), residual)
    if longest == "pose":
        np.testing.assert_allclose(np.linalg.norm(step[:TURN_AND_SHIFT]), LONGEST_STEP * DEVIATION, rtol=1e-12)
    else:
        np.testing.assert_allclose(step[LOG_SIGMA], -LARGEST_CHANGE, rtol=1e-12)
    np.testing.assert_allclose(step / step[0], residual / residual[0], rtol=1e-12)


def test_a_step_cut_short_is_remembered_as_it_was_taken():
    A, fixed = 0.5 * np.eye(STATE), np.zeros(STATE)
    fixed[3] = 2.0 * DEVIATION
    memory, x = fresh(), np.zeros(STATE)
    x += next_step(memory, fixed - A @ fixed)
    np.testing.assert_allclose(x[3], LONGEST_STEP * DEVIATION, rtol=1e-12)
    # The second knows where the map leads, and is cut short again; so are all but the last.
    for _ in range(9):
        x += next_step(memory, (np.eye(STATE) - A) @ (fixed - x))
    np.testing.assert_allclose(x, fixed, rtol=0, atol=1e-8)


def test_differences_that_say_the_same_do_no_harm():
    # Along one line all differences are multiples of each other; where nothing moves they are zero.
    direction = 1e-3 * np.random.default_rng(7).normal(size=STATE)
    memory, x = fresh(), 0.0
    for _ in range(6):
        step = next_step(memory, 0.5 * (1.0 - x) * direction)
        x += (step @ direction) / (direction @ direction)
        assert abs(x - 1.0) <= 0.5 + 1e-6
    np.testing.assert_allclose(x, 1.0, rtol=0, atol=1e-6)
    memory = fresh()
    for _ in range(5):
        np.testing.assert_array_equal(next_step(memory, np.zeros(STATE)), 0.0)
    memory = fresh()
    for _ in range(5):
        step = next_step(memory, direction)
        np.testing.assert_allclose(step, direction, rtol=1e-12)
