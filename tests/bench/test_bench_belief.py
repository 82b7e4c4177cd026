"""The regression behind `details.belief`: what it finds, and what the command says of it."""

import json

import numpy as np
import pytest

from adagmm_bench.cli import main
from adagmm_bench.pairs.belief import fit_belief


def outcomes(rng, n, weights, constant):
    signs = rng.normal(size=(n, len(weights)))
    return signs, rng.random(n) < 1.0 / (1.0 + np.exp(-(signs @ weights + constant)))


def test_the_weights_of_a_known_regression_are_found():
    rng = np.random.default_rng(0)
    signs, right = outcomes(rng, 20_000, np.array([2.0, -1.0, 0.5]), 0.0)
    fitted = fit_belief(signs * [1.0, 10.0, 1.0] + [0.0, 0.0, 3.0], right)
    np.testing.assert_allclose(fitted.weights, [2.0, -0.1, 0.5], rtol=0.1, atol=0)
    assert fitted.constant == pytest.approx(-1.5, abs=0.15)
    # Where right outcomes are rare, they weigh as much together: a sign of nothing is in doubt.
    rare = ~right | (rng.random(len(right)) < 0.1)
    fewer = fit_belief(signs[rare], right[rare])
    np.testing.assert_allclose(fewer.weights, [2.0, -1.0, 0.5], rtol=0.2, atol=0)
    assert fewer.constant == pytest.approx(0.0, abs=0.2)


def record(section, group, signs, right):
    return {
        "status": "ok",
        "problem": {"section": section, "group": group, "pair": "p"},
        "signs": list(signs),
        "rotation_error_deg": 1.0 if right else 90.0,
        "translation_error": 0.0,
        "limits": [5.0, 0.1],
    }


def test_the_command_fits_generated_pairs_and_checks_the_rest(tmp_path, capsys):
    rng = np.random.default_rng(1)
    made = zip(*outcomes(rng, 400, np.array([3.0, 1.0, 1.0, 1.0]), 0.0), strict=True)
    trials = [record("overlap", "models", *outcome) for outcome in made]
    trials += [record("trust", "halves of a model", 4 * [-9.0], False)]
    trials += [record("trust", "room, as given", 4 * [9.0], right) for right in (True, True, False)]
    trials += [record("trust", "room, as given", 3 * [9.0], False)]  # of a version with other signs
    trials += [record("trust", "scale 1.05", 4 * [9.0], False)]
    path = tmp_path / "report.json"
    path.write_text(json.dumps({"trials": trials}))
    assert main(["belief", str(path)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "held out" in line]
    counts = [[int(word) for word in line.split() if word.isdigit()] for line in lines]
    assert counts == 2 * [[3, 2, 1, 0]]


def test_what_is_no_report_is_named(tmp_path, capsys):
    path = tmp_path / "report.json"
    for text in ("{", "{}", '{"trials": [{"key": "a"}]}', '{"trials": []}'):
        path.write_text(text)
        assert main(["belief", str(path)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "expected" in line
    assert main(["belief", str(tmp_path / "absent.json")]) == 1
    assert "absent.json" in capsys.readouterr().err
