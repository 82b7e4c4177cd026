"""The command as a user meets it: reports, figures, and errors in one line."""

import json

import numpy as np
import pytest
from shared_data import shared_data

from adagmm_bench import plots
from adagmm_bench.cli import main
from adagmm_bench.color_trial import STARTS, VARIANTS
from adagmm_bench.commands import ablation, covariance
from adagmm_bench.commands.kinect import AUTHORS
from adagmm_bench.commands.options import starts_of
from adagmm_bench.methods import METHODS
from adagmm_bench.plots import plot_pair_errors, plot_sweep
from adagmm_bench.problem import prepare
from adagmm_bench.simulation import TrialId
from adagmm_bench.summary import best_start, by_setting, summarise
from adagmm_bench.trial import SimulatedProblem

PNG = b"\x89PNG\r\n"


def record(method, start, error, *, setting=0.1, status="ok", seconds=1.0):
    return {
        "method": method,
        "start": start,
        "status": status,
        "rotation_error": error,
        "rotation_error_deg": 20 * error,
        "translation_error": 2 * error,
        "overlap": 0.5,
        "seconds": seconds,
        "cpu_seconds": 2 * seconds,
        "problem": {"sweep": "noise", "setting": setting},
    }


def test_summaries_are_the_statistics_they_are_called():
    records = [record("a", "x", e) for e in (0.1, 0.2, 0.6)] + [record("b", "x", 0.05, status="failed", seconds=3.0)]
    best, worst = summarise(records)
    assert (best.method, best.failed, best.found, best.seconds_total) == ("b", 1, 1, 3.0)
    assert (worst.method, worst.trials, worst.found) == ("a", 3, 1)
    np.testing.assert_allclose(
        [worst.mean, worst.std, worst.median, worst.translation_mean, worst.cpu_seconds_total],
        [0.3, np.std([0.1, 0.2, 0.6]), 0.2, 0.6, 6.0],
        rtol=1e-12,
        atol=0,
    )


def test_settings_are_kept_apart():
    records = [record("a", "x", e, setting=s) for s, e in ((0.1, 0.2), (0.1, 0.4), (0.3, 0.5))]
    lines = by_setting(records, "noise")
    np.testing.assert_allclose(lines["a", "x"][0.1], (0.3, 0.1), rtol=1e-12, atol=0)
    np.testing.assert_allclose(lines["a", "x"][0.3], (0.5, 0.0), rtol=1e-12, atol=0)
    assert by_setting(records, "rotation") == {}


def test_the_best_start_of_each_method_is_shown():
    summaries = summarise([record("a", "x", 0.3), record("a", "y", 0.2), record("b", "x", 0.25)])
    assert [(s.method, s.start) for s in best_start(summaries)] == [("a", "y"), ("b", "x")]


def test_methods_that_work_from_anywhere_run_once_for_two_starts():
    starts = ("as-given", "centroids", "unflagged")
    assert starts_of(METHODS["open3d-fgr"], starts) == ("centroids", "unflagged")
    assert starts_of(METHODS["open3d-fgr"], ("as-given",)) == ("as-given",)
    assert starts_of(METHODS["open3d-gicp"], starts) == starts


def test_plots_are_written_whole(tmp_path):
    plot_sweep(tmp_path / "a.png", "t", "noise", {"one": {0.01: (0.1, 0.05)}, "two": {0.01: (0.2, 0.3)}})
    plot_pair_errors(tmp_path / "b.png", "t", ["x", "y"], [0.2, 0.01], ours=["x"], published=0.12)
    assert all((tmp_path / name).read_bytes().startswith(PNG) for name in ("a.png", "b.png"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "a.svg", "b.png", "b.svg"]
    assert all("<svg" in (tmp_path / name).read_text(encoding="utf-8") for name in ("a.svg", "b.svg"))


@pytest.mark.parametrize(("ours", "scale"), [(0.001, "log"), (0.0, "log"), (0.3, "linear")])
def test_the_axis_is_logarithmic_where_ours_would_lie_on_zero(tmp_path, monkeypatch, ours, scale):
    shown = []
    monkeypatch.setattr(plots, "_save", lambda figure, path: shown.append(figure.axes[0].get_yscale()))
    lines = {"ours": {0.01: (ours, 0.5 * ours), 0.02: (ours, ours)}, "theirs": {0.01: (1.0, 0.2), 0.02: (1.2, 1.5)}}
    plot_sweep(tmp_path / "a.png", "t", "noise", lines)
    assert shown == [scale]


@pytest.mark.slow
def test_sim2d_writes_report_figures_and_every_trial(tmp_path, capsys):
    output, empty = tmp_path / "out", tmp_path / "empty"
    empty.mkdir()
    methods = "adagmm,open3d-point-to-point"
    arguments = ["sim2d", "--trials", "1", "--sweeps", "noise", "--methods", methods, "--starts", "centroids"]
    arguments += ["--workers", "1", "--output", str(output), "--data", str(empty)]
    assert main(arguments) == 0
    assert sorted(path.name for path in output.iterdir()) == [
        "figure_07_noise.png",
        "figure_07_noise.svg",
        "report.json",
        "report.md",
        "results.jsonl",
    ]
    printed = capsys.readouterr().out
    assert "2D, 10 trials a row, shapes made by the bench" in printed and "adagmm (centroids)" in printed
    report = json.loads((output / "report.json").read_text())
    assert len(report["trials"]) == 20 and {s["method"] for s in report["summaries"]} == set(methods.split(","))
    text = (output / "report.md").read_text()
    assert "![noise](figure_07_noise.png)" in text and "Open3D ICP, point to point" in text
    ours = [t for t in report["trials"] if t["method"] == "adagmm" and t["problem"]["setting"] <= 0.19]
    assert max(t["rotation_error"] for t in ours) < 0.1


@pytest.mark.slow
def test_sim3d_from_any_rotation_is_another_experiment(tmp_path):
    arguments = ["sim3d", "--trials", "1", "--sweeps", "occlusion", "--methods", "small-gicp", "--starts", "centroids"]
    arguments += ["--workers", "1", "--output", str(tmp_path), "--data", str(tmp_path)]
    if METHODS["small-gicp"].missing():
        pytest.skip("small_gicp is not installed")
    assert main(arguments) == 0 and main([*arguments, "--rotation-range", "180"]) == 0
    lines = (tmp_path / "results.jsonl").read_text().splitlines()
    assert len(lines) == 22 and sum("within 180 deg" in json.loads(line)["key"] for line in lines) == 11


@pytest.mark.slow
def test_kinect_has_the_authors_beside_the_others(tmp_path, capsys):
    data = shared_data("kinect_pairs").parent
    arguments = ["kinect", "--methods", "open3d-point-to-plane", "--starts", "centroids", "--workers", "1"]
    assert main([*arguments, "--output", str(tmp_path), "--data", str(data)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    authors = next(s for s in report["summaries"] if s["method"] == AUTHORS)
    scenes = len(list((data / "kinect_pairs").glob("scene_*.npz")))
    assert authors["trials"] == scenes
    # The paper: 24 to 632 seconds a scene, 159 in the mean over its thirty.
    assert 24 * scenes < authors["seconds_total"] < 632 * scenes
    assert authors["median"] < 0.06
    assert (tmp_path / "figure_18.png").read_bytes().startswith(PNG)
    assert "the authors' rotation and the ground truth agree" in (tmp_path / "report.md").read_text()
    assert "authors (published)" in capsys.readouterr().out


def test_replay_gives_the_record_of_the_sweep_and_a_rerun_file(tmp_path, capsys):
    file = tmp_path / "trial.rrd"
    arguments = ["replay", "2", "rotation", "-44", "2", "--data", str(tmp_path), "--save", str(file)]
    assert main(arguments) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["problem"] == {
        "dimension": 2,
        "sweep": "rotation",
        "setting": -44.0,
        "trial": 2,
        "seed": 0,
        "rotation_range_deg": None,
    }
    assert file.read_bytes().startswith(b"RRF2")
    assert main([*arguments[:-2], "--method", "adagmm"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["T_target_source"] == first["T_target_source"]


@pytest.mark.slow
def test_methods_are_listed_with_their_settings(capsys):
    assert main(["methods"]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in METHODS)
    assert "Correspondences within 1.0, 0.5, 0.25, 0.12, then 0.06 radii" in printed


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["sim2d", "--methods", "gicpp"], "methods: unknown gicpp; known are "),
        (["sim2d", "--methods", "open3d-ndt"], "methods: open3d-ndt is not made for 2D"),
        (["sim2d", "--starts", "nowhere"], "starts: unknown nowhere; known are as-given, centroids, unflagged"),
        (["sim3d", "--trials", "0"], "trials: expected 1 or more, got 0"),
        (["sim3d", "--seed", "-1", "--methods", "open3d-gicp"], "seed: expected 0 or more, got -1"),
        (["sim3d", "--data", "/nowhere/at/all"], "/nowhere/at/all: --data names no folder"),
        (["replay", "3", "rotation", "21", "0"], "setting: expected one of -60, -52, "),
        (["replay", "3", "rotation", "20", "0", "--method", "x"], "method: unknown 'x'; known are "),
        (["kinect", "--data", "EMPTY"], "data: expected kinect_pairs/scene_XX.npz files, found none"),
        (["recordings", "--data", "EMPTY"], "data: expected recordings with ground truth, found none"),
    ],
)
def test_errors_are_one_line_and_exit_code_1(arguments, line, tmp_path, capsys):
    arguments = [str(tmp_path) if word == "EMPTY" else word for word in arguments]
    if arguments[0] != "replay":
        arguments += ["--output", str(tmp_path / "out")]
    assert main(arguments) == 1
    error = capsys.readouterr().err.splitlines()
    assert error[-1].startswith(f"adagmm-bench: {line}")
    assert all(before.startswith("left out ") for before in error[:-1])
    assert not (tmp_path / "out").exists()


def test_wrong_usage_is_exit_code_2(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["sim2d", "--sweeps", "weather"])
    assert stop.value.code == 2
    assert "expected some of rotation,noise,outliers,occlusion, got 'weather'" in capsys.readouterr().err


@pytest.mark.slow
def test_recordings_go_through_the_app_and_others_get_its_clouds(tmp_path, capsys):
    data = tmp_path / "data"
    (data / "recordings" / "not_one").mkdir(parents=True)
    (data / "recordings" / "room").symlink_to(shared_data("recordings", "redwood_open3d_5frames"))
    arguments = ["recordings", "--methods", "adagmm", "--starts", "as-given", "--workers", "1", "--data", str(data)]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 0
    captured = capsys.readouterr()
    assert "room, 4 pairs" in captured.out and "not_one: not a recording of a known format" in captured.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert {(s["method"], s["trials"], s["found"]) for s in report["summaries"]} == {
        ("adagmm-fusion", 4, 4),
        ("adagmm", 4, 4),
    }


@pytest.mark.slow
def test_ablation_undoes_one_choice_at_a_time(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        ablation, "trial_ids", lambda dimension, **_: [TrialId(dimension, "occlusion", 0.03, i) for i in range(2)]
    )
    monkeypatch.setattr(ablation, "SIDES", 1)
    monkeypatch.setattr(ablation, "DENSE_POINTS", (1000, 1500))
    arguments = ["ablation", "--workers", "1", "--data", str(tmp_path), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    captured = capsys.readouterr()
    assert "left out the Kinect scenes: data: expected kinect_pairs" in captured.err
    assert "left out the coloured pairs: data: expected recordings with ground truth" in captured.err
    assert all(f"one choice undone at a time: {group}" in captured.out for group in ("2D", "3D", "sides", "dense"))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert set(report["summaries"]) == {"2D", "3D", "sides", "dense"}
    assert all({s["method"] for s in group} == set(ablation.NAMES) for group in report["summaries"].values())
    assert all(s["trials"] == 2 for group in report["summaries"].values() for s in group)


@pytest.mark.slow
def test_ablation_undoes_what_is_about_colours_on_recorded_pairs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ablation, "NAMES", ("adagmm",))
    monkeypatch.setattr(ablation, "trial_ids", lambda dimension, **_: [TrialId(dimension, "occlusion", 0.03, 0)])
    monkeypatch.setattr(ablation, "SIDES", 1)
    monkeypatch.setattr(ablation, "DENSE_POINTS", (1000,))
    data = tmp_path / "data"
    (data / "recordings").mkdir(parents=True)
    (data / "recordings" / "room").symlink_to(shared_data("recordings", "redwood_open3d_5frames"))
    arguments = ["ablation", "--workers", "1", "--data", str(data), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "one choice about colours undone at a time" in capsys.readouterr().out
    text = (tmp_path / "out" / "report.md").read_text()
    assert all(f"{start}, {name} | 4/4" in text for start in STARTS for name in VARIANTS)
    errors: dict[str, set] = {name: set() for name in VARIANTS}
    for trial in json.loads((tmp_path / "out" / "report.json").read_text())["trials"]:
        if trial["problem"].get("recording") == "room":
            errors[trial["method"]].add((trial["start"], trial["problem"]["pair"], trial["rotation_error_deg"]))
    # each of them changes what comes out
    assert all(len(found) == 8 for found in errors.values())
    assert len({frozenset(found) for found in errors.values()}) == len(VARIANTS)


@pytest.mark.slow
def test_covariance_compares_true_errors_with_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        covariance,
        "trial_ids",
        lambda dimension, *, seed, **_: [TrialId(dimension, "outliers", 0.3, i, seed) for i in range(6)],
    )
    monkeypatch.setattr(covariance, "CAMERAS", ("depths 1 % apart",))
    arguments = [
        "covariance",
        "--workers",
        "1",
        "--rooms",
        "1",
        "--data",
        str(tmp_path),
        "--output",
        str(tmp_path / "out"),
    ]
    assert main(arguments) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert len(report["trials"]) == 2 * 2 * 6 + 1
    rows = {row[0]: dict(zip(report["columns"], row, strict=True)) for row in report["rows"]}
    for dimension, directions in covariance.DIRECTIONS.items():
        squares = [t["nees"] for t in report["trials"] if t["problem"].get("dimension") == dimension]
        assert rows[f"{dimension}D"] == rows[f"{dimension}D, outliers"] | {report["columns"][0]: f"{dimension}D"}
        assert rows[f"{dimension}D"]["mean"] == f"{np.mean(squares):.2f}" and rows[f"{dimension}D"]["found"] == "12/12"
        assert 0.3 * directions < np.mean(squares) < 3.0 * directions
        assert rows[f"{dimension}D, noise"]["mean"] == "-"
    rendered = rows["rendered rooms by the app, depths 1 % apart"]
    assert rendered["found"] == "1/1" and 0.3 < float(rendered["mean"]) < 20.0
    assert report["trials"][-1]["translation_error"] > 0.01, "far more than without"
    captured = capsys.readouterr()
    assert "left out the Kinect scenes" in captured.err and "3D, outliers" in captured.out


def test_poses_enter_the_prepared_clouds_and_leave_them():
    problem = SimulatedProblem(TrialId(3, "noise", 0.13, 0), None).load()
    prepared = prepare(problem, "centroids")
    T = prepared.prepared_pose(problem.T_target_source)
    np.testing.assert_allclose(prepared.restore(T), problem.T_target_source, rtol=0, atol=1e-12)
    moved = prepared.source.points @ T[:3, :3].T + T[:3, 3]
    expected = problem.source.points @ problem.T_target_source[:3, :3].T + problem.T_target_source[:3, 3]
    expected = (expected - prepared.target_offset) / prepared.scale
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)
