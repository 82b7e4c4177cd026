"""The speed command's arithmetic: taking turns, recorded ratios, and what counts as a regression."""

import json

import numpy as np
import pytest

from adagmm_bench.cli import main
from adagmm_bench.commands import speed
from adagmm_bench.methods import METHODS
from adagmm_bench.problem import Cloud, Problem
from adagmm_bench.speed import kernel, large, measurement
from adagmm_bench.speed.measurement import Measurement
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import pose_errors

RATIO = Measurement("kinect", "adagmm / peer", 1.3, "×", cost=True)


def test_a_ratio_a_fifth_above_the_recorded_one_is_a_regression():
    assert speed.find_regressions([RATIO], {RATIO.key: 1.0}) == [
        "kinect: adagmm / peer is 1.3, recorded 1, allowed 1.2"
    ]
    assert speed.find_regressions([RATIO], {RATIO.key: 1.1}) == []
    assert speed.find_regressions([RATIO], {}) == [], "a ratio that was never recorded cannot have regressed"
    seconds = Measurement("kinect", "adagmm / peer", 9.0, "s")
    assert speed.find_regressions([seconds], {seconds.key: 1.0}) == [], "seconds are another machine's business"


def test_recording_keeps_what_was_not_measured(tmp_path):
    path = tmp_path / "ratios.json"
    speed.record(path, [RATIO])
    speed.record(path, [Measurement("sim2d", "a / b", 2.0, "×", cost=True), Measurement("sim2d", "a", 2.0, "s")])
    assert speed.read_recorded(path) == {"kinect: adagmm / peer": 1.3, "sim2d: a / b": 2.0}
    assert "machine" in json.loads(path.read_text())


@pytest.mark.parametrize("content", ["", "[]", '{"ratios": [1]}', '{"ratios": {"a": "x"}}'])
def test_a_file_without_ratios_is_named(tmp_path, content):
    path = tmp_path / "ratios.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"ratios\.json: expected recorded ratios"):
        speed.read_recorded(path)


def test_the_shipped_ratios_can_be_read():
    assert all(value > 0 for value in speed.read_recorded(speed.RECORDED).values())


def measured_before(function, tasks, workers):
    """In place of `run_tasks`: what a section hands back."""
    lines = [RATIO, Measurement("kinect", "adagmm, median of a pair", 5.0, "ms", goal=6.0)]
    return [(section, lines) for section in tasks]


def test_the_command_exits_1_on_a_regression_and_0_without(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(speed, "run_tasks", measured_before)
    recorded = tmp_path / "ratios.json"
    recorded.write_text('{"ratios": {"kinect: adagmm / peer": 1.0}}')
    arguments = ["speed", "--sections", "kinect", "--recorded", str(recorded), "--output", str(tmp_path / "out")]
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert "regression: kinect: adagmm / peer is 1.3, recorded 1, allowed 1.2" in captured.err
    assert "≤ 6 met" in captured.out
    assert "Regression: " in (tmp_path / "out" / "report.md").read_text()
    assert main([*arguments, "--record"]) == 0 and main(arguments) == 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--sections", "speedy"], "sections: unknown speedy; known are kinect, "),
        (["--repeats", "0"], "repeats: expected 1 or more, got 0"),
        (["--recorded", "/nowhere/ratios.json"], "/nowhere/ratios.json: expected recorded ratios"),
    ],
)
def test_errors_are_one_line(arguments, line, tmp_path, capsys):
    assert main(["speed", "--output", str(tmp_path / "out"), *arguments]) == 1
    (error,) = capsys.readouterr().err.splitlines()
    assert error.startswith(f"adagmm-bench: {line}")


def test_methods_take_turns_on_each_pair(monkeypatch):
    order = []

    def fake(name):
        entry = METHODS["open3d-gicp"]
        return type(entry)(**{**vars(entry), "function": lambda s, t: order.append((name, len(s))) or np.eye(3)})

    for name in ("a", "b"):
        monkeypatch.setitem(METHODS, name, fake(name))
    clouds = [Cloud(np.random.default_rng(n).normal(size=(n, 2)), np.tile(np.eye(2), (n, 1, 1))) for n in (5, 6)]
    problems = [Problem(str(len(c)), c, c) for c in clouds]
    seconds = measurement.interleaved_seconds(["a", "b"], problems, "centroids", repeats=2)
    assert order == [("a", 5), ("b", 5)] + 2 * [("a", 5), ("b", 5), ("a", 6), ("b", 6)]
    assert {name: values.shape for name, values in seconds.items()} == {"a": (2, 2), "b": (2, 2)}
    assert all((values > 0).all() for values in seconds.values())


@pytest.mark.slow
def test_the_kernels_are_measured_with_every_pair_evaluated(monkeypatch):
    monkeypatch.setattr(kernel, "POINTS", 500)
    monkeypatch.setattr(kernel, "MATRIX", 128)
    lines = {m.name: m for m in kernel.kernel(1)}
    for name, count in kernel.OPERATIONS.items():
        rate, operations = lines[f"{name}, pairs"], lines[f"{name}, {count} operations a pair"]
        np.testing.assert_allclose(operations.value, rate.value * count / 1000, rtol=1e-12, atol=0)
        assert lines[f"matrix product / {name}"].cost


def test_the_surface_pair_s_truth_is_its_truth():
    problem = large.surface_pair(2000)
    prepared = large.prepare(problem, "centroids")
    errors = pose_errors(problem.T_target_source, prepared.restore(METHODS["adagmm"](prepared.source, prepared.target)))
    assert errors.rotation_deg < 1.0 and errors.translation < 0.05


def test_growth_is_an_exponent(monkeypatch):
    monkeypatch.setattr(large, "SIZES", (200, 400, 800, 1600))
    monkeypatch.setattr(large, "_seconds", lambda name, prepared: 1e-6 * len(prepared.source) ** 1.25)
    *_, exponent = large.scaling()
    assert exponent.name == "exponent from 800 points on"
    np.testing.assert_allclose(exponent.value, 1.25, rtol=1e-9, atol=0)
