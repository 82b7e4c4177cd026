"""The regression behind `details.belief`: what it finds, what the command says, and that the package goes by it."""

import json
import os

import numpy as np
import pytest

from adagmm_bench.belief.pairs import KINDS, BeliefPair
from adagmm_bench.belief.regression import (
    RECORDED,
    Outcomes,
    fit_belief,
    outcomes_seen,
    read_outcomes,
    signs_seen,
)
from adagmm_bench.belief.trial import is_right, run_belief_trial
from adagmm_bench.cli import main
from adagmm_bench.trial import TrialJob
from adagmm_o3d.errors import InputError
from adagmm_o3d.trust.verdict import CONSTANT, WEIGHTS


def outcomes(rng, n, weights, constant):
    signs = rng.normal(size=(n, len(weights)))
    return Outcomes(signs, rng.random(n) < 1.0 / (1.0 + np.exp(-(signs @ weights + constant))))


def test_the_weights_of_a_known_regression_are_found():
    rng = np.random.default_rng(0)
    made = outcomes(rng, 20_000, np.array([2.0, -1.0, 0.5]), 0.0)
    fitted = fit_belief(Outcomes(made.signs * [1.0, 10.0, 1.0] + [0.0, 0.0, 3.0], made.right))
    np.testing.assert_allclose(fitted.weights, [2.0, -0.1, 0.5], rtol=0.1, atol=0)
    assert fitted.constant == pytest.approx(-1.5, abs=0.15)
    # Where right outcomes are rare, they weigh as much together: a sign of nothing is in doubt.
    rare = ~made.right | (rng.random(len(made)) < 0.1)
    fewer = fit_belief(Outcomes(made.signs[rare], made.right[rare]))
    np.testing.assert_allclose(fewer.weights, [2.0, -1.0, 0.5], rtol=0.2, atol=0)
    assert fewer.constant == pytest.approx(0.0, abs=0.2)
    with pytest.raises(InputError, match="some right and some wrong"):
        fit_belief(Outcomes(made.signs[made.right], made.right[made.right]))


def test_the_package_goes_by_what_the_command_prints():
    assert fit_belief(outcomes_seen(read_outcomes())).rounded() == (WEIGHTS, CONSTANT)


@pytest.mark.slow
def test_the_recorded_outcomes_are_those_of_the_generated_pairs():
    recorded = {outcome["pair"]: outcome for outcome in read_outcomes()}
    assert {key.split(" #")[0] for key in recorded} == set(KINDS)
    for kind in ("pieces", "half a turn", "mirrored, in the plane", "strangers, in the plane"):
        pair = BeliefPair(kind, 0, 1)
        record = run_belief_trial(TrialJob(pair, "adagmm", "as-given"))
        kept = recorded[pair.key]
        assert record["status"] == "ok" and record["right"] == kept["right"]
        assert (record["seen"] is None) == (kept["seen"] is None)
        if kept["seen"] is not None:
            # the last digits of a pose move the margins of rivals a little
            np.testing.assert_allclose(signs_seen(record["seen"]), signs_seen(kept["seen"]), rtol=0, atol=0.05)


def test_pairs_of_every_kind_are_made_and_right_at_their_truth():
    for kind in KINDS:
        pair, again = (BeliefPair(kind, 3, 5).load() for _ in range(2))
        np.testing.assert_array_equal(pair.source, again.source)
        dimension = 2 if kind.endswith("in the plane") else 3
        for cloud in (pair.source, pair.target):
            assert cloud.shape[1] == dimension and len(cloud) > 20 and np.isfinite(cloud).all()
        if pair.covariances is not None:
            assert [c.shape[:1] for c in pair.covariances] == [pair.source.shape[:1], pair.target.shape[:1]]
        if pair.T_target_source is not None:
            assert is_right(pair, pair.T_target_source)
            turned = pair.T_target_source.copy()
            turned[:dimension, :dimension] = np.diag([-1.0, -1.0, 1.0][:dimension]) @ turned[:dimension, :dimension]
            assert not is_right(pair, turned)
    assert BeliefPair("halves", 0, 1).load().T_target_source is None


def record(group, signs, right):
    return {
        "status": "ok",
        "problem": {"section": "trust", "group": group, "pair": "p"},
        "signs": list(signs),
        "rotation_error_deg": 1.0 if right else 90.0,
        "translation_error": 0.0,
        "limits": [5.0, 0.1],
    }


@pytest.mark.slow
def test_the_command_fits_what_it_makes_and_checks_it_on_reports(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("adagmm_bench.commands.belief.KINDS", ("noisy, in the plane", "strangers, in the plane"))
    trials = [record("room, as given", 4 * [9.0], right) for right in (True, True, False)]
    trials += [record("room, as given", 3 * [9.0], False)]  # of a version with other signs
    trials += [record("scale 1.05", 4 * [9.0], False)]
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps({"trials": trials}))
    before = RECORDED.read_bytes()
    told = ["--trials", "3", "--seed", "7", "--workers", "1", "--output", str(tmp_path / "out")]
    assert main(["belief", str(path), *told]) == 0
    printed = capsys.readouterr().out
    lines = [line for line in printed.splitlines() if "held out" in line]
    assert [[int(word) for word in line.split() if word.isdigit()] for line in lines] == 2 * [[3, 2, 1, 0]]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    weights = " ".join(map(str, report["weights"]))
    assert f"fitted: {weights} constant {report['constant']}" in printed
    assert [outcome["pair"] for outcome in report["outcomes"]][:2] == [
        "noisy, in the plane #0 seed 7",
        "noisy, in the plane #1 seed 7",
    ]
    assert RECORDED.read_bytes() == before


def test_what_is_no_report_is_named(tmp_path, capsys):
    path = tmp_path / "report.json"
    for text in ("{", "{}", '{"trials": [{"key": "a"}]}'):
        path.write_text(text)
        assert main(["belief", str(path), "--output", str(tmp_path)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "expected" in line
        with pytest.raises(InputError, match="as --record writes them"):
            read_outcomes(path)
    assert main(["belief", str(tmp_path / "absent.json"), "--output", str(tmp_path)]) == 1
    assert "absent.json" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
def test_a_pipe_for_a_report_is_not_waited_for(tmp_path, capsys):
    os.mkfifo(tmp_path / "report.json")
    assert main(["belief", str(tmp_path / "report.json"), "--output", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "report.json: cannot be read: it is a pipe" in line
