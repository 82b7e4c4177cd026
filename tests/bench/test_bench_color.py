"""The starts and the table of `adagmm-bench color`, and that each of its rows changes something."""

import numpy as np
import pytest

from adagmm_bench.color_table import color_rows
from adagmm_bench.color_trial import NAMES, STARTS, VARIANTS, deviations, disturbed
from adagmm_bench.commands.color import worse_rows
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp


@pytest.mark.parametrize("start", STARTS)
def test_a_start_is_as_far_from_the_truth_as_it_says(start):
    T, centre = se_exp(np.array([0.2, -0.4, 0.1, 1.0, 0.5, -2.0])), np.array([0.3, -0.2, 2.5])
    off = disturbed(T, start, 3, centre) @ np.linalg.inv(T)
    angle_deg, distance = STARTS[start]
    turned = np.degrees(np.arccos((np.trace(off[:3, :3]) - 1.0) / 2.0))
    np.testing.assert_allclose(turned, angle_deg, rtol=1e-9, atol=0)
    np.testing.assert_allclose(np.linalg.norm(off[:3, :3] @ centre + off[:3, 3] - centre), distance, rtol=1e-9, atol=0)


def test_the_same_start_for_every_method_and_another_for_every_pair():
    T, centre, start = np.eye(4), np.zeros(3), next(iter(STARTS))
    np.testing.assert_array_equal(disturbed(T, start, 1, centre), disturbed(T, start, 1, centre))
    assert not np.allclose(disturbed(T, start, 1, centre), disturbed(T, start, 2, centre))


@pytest.mark.slow
def test_deviations_are_those_of_the_errors():
    """Of poses drawn with a covariance, as far as 4000 of them tell."""
    rng = np.random.default_rng(2)
    T = se_exp(np.array([0.2, -0.4, 0.1, 1.0, 0.5, -2.0]))
    root = 1e-3 * rng.normal(size=(6, 6))
    own = deviations(T, root @ root.T)
    errors = [pose_errors(T, se_exp(root @ rng.normal(size=6)) @ T) for _ in range(4000)]
    for name, values in (
        ("rotation_deviation_deg", [error.rotation_deg for error in errors]),
        ("translation_deviation", [error.translation for error in errors]),
    ):
        np.testing.assert_allclose(np.sqrt(np.mean(np.square(values))), own[name], rtol=0.05, atol=0)
    assert deviations(T, None) == {}


def test_worse_is_further_off_by_more_than_the_end_says_of_itself():
    start, pairs = next(iter(STARTS)), {"same": 0.5, "within": 0.9, "beyond": 1.1, "better": 0.1}
    records = [
        {
            "start": start,
            "method": method,
            "problem": {"recording": "room", "pair": pair},
            "rotation_error_deg": 0.5 if method == "adagmm" else degrees,
            "translation_error": 0.01,
            "rotation_deviation_deg": 0.5,
            "translation_deviation": 0.002,
        }
        for pair, degrees in pairs.items()
        for method in ("adagmm", "adagmm-color")
    ]
    assert worse_rows(records) == [[f"{start}, room, beyond", "0.50°, 10.0", "1.10°, 10.0", "0.50°, 2.0"]]


def test_what_a_row_replaces_is_there():
    for variant in VARIANTS.values():
        for replacement in variant.replacements:
            place, name = replacement.place()
            assert getattr(place, name) is not replacement.value


def test_found_is_within_both_limits():
    start, name = next(iter(STARTS)), NAMES[0]
    errors = [(0.5, 0.01), (2.9, 0.2), (40.0, 0.01)]
    records = [
        {"start": s, "method": name, "rotation_error_deg": r, "translation_error": t, "cpu_seconds": 1.0}
        for s in STARTS
        for r, t in errors
    ]
    rows = color_rows(records, [name])
    assert rows[0] == [f"{start}, {name}", "1/3", "2.90", "10.0", "1.00"]
