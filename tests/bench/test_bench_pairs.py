"""`adagmm-bench pairs`: what counts as found, silent and alarmed, the consensus, and the command on made pairs."""

import json
from pathlib import Path

import numpy as np
import pytest
from pair_files import pose, write_pair
from shared_data import shared_data

from adagmm_bench.cli import main
from adagmm_bench.commands.pairs import choose_pair_methods
from adagmm_bench.methods import METHODS
from adagmm_bench.methods.ours import TAKES_VIEWPOINTS, _viewpoints
from adagmm_bench.methods.variant import Variant
from adagmm_bench.pairs import overlap
from adagmm_bench.pairs.consensus import consensus_pose, judged_by_consensus
from adagmm_bench.pairs.made import CASES, DIFFERENT_ROOMS, MadePair
from adagmm_bench.pairs.overlap import ANYWHERE, MODELS, NEAR, ROOMS, OverlapPair
from adagmm_bench.pairs.problem import plain_pair
from adagmm_bench.pairs.public import PublicPair
from adagmm_bench.pairs.recorded import RecordedPair
from adagmm_bench.pairs.sections import methods_for
from adagmm_bench.pairs.tables import (
    ALL,
    by_group,
    curve_table,
    each_pair_table,
    found_table,
    summarise_pairs,
    trust_table,
)
from adagmm_bench.pairs.trial import pose_difference, run_pair_trial
from adagmm_bench.pairs.trust import RANDOM_START, WRONG_START, Restarted
from adagmm_bench.trial import TrialJob
from adagmm_o3d.errors import InputError

PEERS = "open3d-ransac-gicp,open3d-gicp"


def record(method, degrees, translation, *, warnings=None, pair="p", group="g", T=None, status="ok", cpu=1.0):
    made = {
        "method": method,
        "status": status,
        "problem": {"section": "clouds", "group": group, "pair": pair},
        "rotation_error_deg": degrees,
        "translation_error": translation,
        "overlap_truth": None if degrees is None else 0.5,
        "cpu_seconds": cpu,
        "unit": 2.0,
        "centre": [1.0, 0.0, 0.0],
        "limits": [5.0, 0.1],
        "T_target_source": (np.eye(4) if T is None else T).tolist(),
    }
    return made if warnings is None else made | {"warnings": warnings, "overlap": 0.4}


def test_wrong_without_a_warning_and_right_with_one_are_counted():
    records = [
        record("adagmm", 1.0, 0.05, warnings=[]),
        record("adagmm", 2.0, 0.05, warnings=["doubtful"], cpu=3.0),
        record("adagmm", 9.0, 0.05, warnings=[]),
        record("adagmm", 1.0, 0.15, warnings=[]),
        record("adagmm", 50.0, 0.05, warnings=["doubtful"]),
        # It raised, so that its user knows.
        record("adagmm", 1.0, 0.05, status="failed"),
    ]
    s = summarise_pairs("adagmm", records)
    assert (s.trials, s.found, s.failed, s.silently_wrong, s.false_alarms) == (6, 2, 1, 2, 1)
    assert s.cell == "2 (2)"
    np.testing.assert_allclose(
        [s.rotation_deg, s.translation, s.rotation_deg_found, s.overlap_off, s.cpu_seconds_median],
        [1.5, 0.05, 1.5, 0.1, 1.0],
        rtol=1e-12,
        atol=0,
    )
    peer = summarise_pairs("open3d-gicp", [record("open3d-gicp", 9.0, 0.0)])
    # All that a peer does is for the pose.
    assert peer.pose_cpu_seconds_median == peer.cpu_seconds_median == 1.0
    told = summarise_pairs("adagmm", [record("adagmm", 1.0, 0.0, warnings=[]) | {"pose_cpu_seconds": 0.75}])
    assert (told.pose_cpu_seconds_median, told.cpu_seconds_median) == (0.75, 1.0)
    assert (peer.silently_wrong, peer.false_alarms, peer.rotation_deg_found, peer.cell) == (None, None, None, "0")


def test_groups_are_summed_up_and_all_come_last():
    records = [record("adagmm", 1.0, 0.0, warnings=[], group=g) for g in ("b", "a", "b")]
    records.append(record("open3d-gicp", 8.0, 0.0, group="b"))
    groups = by_group(records)
    assert list(groups) == ["b", "a", ALL]
    columns, rows = found_table(groups, ["adagmm", "open3d-gicp-dense", "open3d-gicp"])
    assert columns == ["found (silently wrong)", "adagmm", "open3d-gicp", "open3d-gicp"]
    assert rows == [["b, 2", "2 (0)", "", "0"], ["a, 1", "1 (0)", "", ""], ["all, 3", "3 (0)", "", "0"]]


def test_each_pair_shows_what_was_found_and_warned_of():
    records = [record("adagmm", 1.0, 0.05, warnings=["doubtful"]), record("adagmm", 9.0, 0.05, warnings=[], pair="q")]
    records += [
        record("open3d-gicp-dense", 1.0, 0.05),
        record("open3d-gicp-dense", 1.0, 0.0, pair="q", status="failed"),
    ]
    columns, rows = each_pair_table(records, ["adagmm", "open3d-gicp-dense"], 100.0)
    assert columns == ["pair", "adagmm", "open3d-gicp"]
    assert rows == [["p", "1.00 / 5.0!", "1.00 / 5.0"], ["q", "(9.00 / 5.0)", "-"]]


def test_viewpoints_are_told_where_they_are_known_and_wanted():
    told, here, there = Variant("It is told.", viewpoints=True), np.zeros(3), np.ones(3)
    keywords = _viewpoints(told, here, there)
    assert keywords["source_viewpoint"] is here and keywords["target_viewpoint"] is there and len(keywords) == 2
    assert _viewpoints(told, None, here) == _viewpoints(told, here, None) == {}
    assert _viewpoints(Variant("It is not."), here, here) == {}
    assert ("adagmm-viewpoints" in METHODS) == TAKES_VIEWPOINTS


def test_displacement_is_that_of_the_centre_in_units():
    T = pose(90.0, 3.0)
    degrees, displacement = pose_difference(np.eye(4), T, np.array([1.0, 0.0, 0.0]), 2.0)
    np.testing.assert_allclose((degrees, displacement), (90.0, np.hypot(2.0, 1.0) / 2.0), rtol=1e-9, atol=0)


def test_a_consensus_needs_a_method_without_a_start_and_ours_has_no_say():
    def found(method, angle):
        return record(method, None, None, T=pose(angle))

    local = [found("open3d-gicp-dense", 70.0), found("small-gicp-dense", 70.0)]
    ours = [found("adagmm", 0.0), found("adagmm-global", 0.0)]
    assert consensus_pose([*local, *ours, found("open3d-ransac-gicp-dense", 0.0)]) is None
    three = [found("open3d-ransac-gicp-dense", a) for a in (10.0, 12.0, 13.0)]
    np.testing.assert_allclose(consensus_pose([*local, *ours, *three]), pose(12.0), rtol=0, atol=1e-12)
    failed = [one | {"status": "failed"} for one in three[1:]]
    assert consensus_pose([*local, *ours, three[0], *failed]) is None


def test_pairs_without_a_truth_are_judged_by_the_consensus_or_left_out():
    peers = [record(name, None, None, T=pose(10.0)) for name in ("kiss-matcher-gicp-dense", "open3d-gicp-dense")]
    wrong = record("adagmm", None, None, T=pose(40.0), warnings=[])
    alone = record("adagmm", None, None, pair="q", warnings=[])
    known = record("adagmm", 1.0, 0.0, pair="r", warnings=[])
    # The others' records may come from an earlier run.
    judged, left_out = judged_by_consensus([wrong, alone, known], [*peers, wrong, alone, known], "agreed")
    assert left_out == ["q"] and [one["problem"]["group"] for one in judged] == ["agreed", "g"]
    np.testing.assert_allclose(judged[0]["rotation_error_deg"], 30.0, rtol=1e-9, atol=0)
    assert judged[1] is known


def test_methods_not_installed_are_left_out_with_a_reason(monkeypatch):
    monkeypatch.setattr(type(METHODS["small-gicp"]), "missing", lambda self: "is away" if "kiss" in self.name else None)
    chosen, skipped = choose_pair_methods(None)
    assert "small-gicp" in chosen and "kiss-matcher-gicp: is away" in skipped
    with pytest.raises(InputError, match="methods: kiss-matcher-gicp is away"):
        choose_pair_methods(["kiss-matcher-gicp"])
    with pytest.raises(InputError, match="methods: unknown gicpp"):
        choose_pair_methods(["gicpp"])


def test_dense_settings_and_viewpoints_only_where_they_belong():
    names = ["adagmm", "adagmm-viewpoints", "open3d-gicp", "open3d-ndt"]
    dense = ["adagmm", "open3d-gicp-dense", "open3d-ndt"]
    assert methods_for(PublicPair(Path("x.npz")), names) == dense
    assert methods_for(RecordedPair(Path("r"), 0, "a"), names) == [dense[0], "adagmm-viewpoints", *dense[1:]]


def test_public_pairs_are_checked(tmp_path):
    path = tmp_path / "one.npz"
    write_pair(path, pose(20.0, 5.0))
    clouds = PublicPair(path).load()
    np.testing.assert_allclose(clouds.T_target_source, pose(20.0, 5.0), rtol=0, atol=1e-12)
    source, _ = clouds.for_peers()
    np.testing.assert_allclose(source.rms_radius(), 1.0, rtol=0.05, atol=0)
    np.savez(tmp_path / "two.npz", source=np.zeros((20, 2)), target=np.zeros((20, 3)), T=np.eye(4))
    np.savez(tmp_path / "three.npz", source=np.zeros((20, 3)), target=np.zeros((20, 3)))
    np.savez(tmp_path / "four.npz", source=np.zeros((20, 3)), target=np.zeros((20, 3)), T=np.diag([1, 1, 1, np.nan]))
    np.savez(tmp_path / "five.npz", source=np.full((20, 3), "a"), target=np.zeros((20, 3)), T=np.eye(4))
    (tmp_path / "six.npz").write_bytes(path.read_bytes()[:1000])
    (tmp_path / "seven.npz").write_bytes(b"")
    for name, message in (
        ("two", r"source: expected at least 10 finite points"),
        ("three", "expected a pair of source, target, T, got"),
        ("four", r"T: expected a finite \(4, 4\) pose, or NaN throughout, got \(4, 4\), 1 not finite"),
        ("five", "source: expected numbers, got <U1"),
        ("six", "expected a pair of source, target, T, got"),
        ("seven", "expected a pair of source, target, T, got"),
    ):
        with pytest.raises(InputError, match=message):
            PublicPair(tmp_path / f"{name}.npz").load()


def test_a_record_says_what_ours_says_of_itself(tmp_path):
    path = tmp_path / "one.npz"
    write_pair(path, pose(12.0, 3.0))
    ours = run_pair_trial(TrialJob(PublicPair(path), "adagmm", "as-given"))
    assert ours["status"] == "ok" and ours["warnings"] == [] and ours["overlap"] > 0.8
    assert ours["rotation_error_deg"] < 1.0 and ours["translation_error"] < 0.02 and ours["overlap_truth"] > 0.9
    peer = run_pair_trial(TrialJob(PublicPair(path), "open3d-gicp-dense", "as-given"))
    assert peer["rotation_error_deg"] < 1.0 and peer["translation_error"] < 0.02 and "warnings" not in peer
    assert peer["translation_error"] * peer["unit"] < 1.0


@pytest.mark.slow
def test_the_command_prints_both_tables_and_goes_on_where_it_was(tmp_path, capsys):
    data = tmp_path / "data"
    (data / "cloud_pairs").mkdir(parents=True)
    write_pair(data / "cloud_pairs" / "known.npz", pose(12.0, 3.0))
    write_pair(data / "cloud_pairs" / "open.npz", pose(12.0, 3.0), known=False)
    arguments = ["pairs", "--only", "recordings,clouds", "--workers", "1", "--data", str(data)]
    arguments += ["--output", str(tmp_path / "out"), "--methods"]
    assert main([*arguments, PEERS]) == 0
    assert main([*arguments, "adagmm"]) == 0
    captured = capsys.readouterr()
    assert "left out recordings: data: expected recordings with ground truth, found none" in captured.err
    assert "clouds, by consensus, 1" in captured.out and "silently wrong" in captured.out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    groups = report["sections"]["clouds"]
    assert {group: members["adagmm"]["found"] for group, members in groups.items()} == {
        "clouds": 1,
        "clouds, by consensus": 1,
        ALL: 2,
    }
    assert len((tmp_path / "out" / "results.jsonl").read_text().splitlines()) == 6
    assert "## Left out" in (tmp_path / "out" / "report.md").read_text()


def test_pairs_are_listed(tmp_path, capsys):
    (tmp_path / "cloud_pairs").mkdir()
    write_pair(tmp_path / "cloud_pairs" / "one.npz", np.eye(4))
    assert main(["pairs", "--only", "clouds", "--list", "--data", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "cloud pair one\n"


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--only", "weather"], "only: unknown weather; known are recordings, clouds, overlap, lidar, trust"),
        (["--only", ""], "only: expected at least one of recordings, clouds"),
        (
            ["--only", "clouds"],
            "only: no section has a pair: clouds: data: expected cloud_pairs/*.npz files, found none",
        ),
        (["--only", "recordings,clouds"], "only: no section has a pair: recordings: data: expected"),
        (["--trials", "0"], "trials: expected 1 or more, got 0"),
        (["--seed", "-1"], "seed: expected 0 or more, got -1"),
        (["--only", "trust", "--methods", "open3d-gicp"], "methods: none of open3d-gicp takes part in trust"),
    ],
)
def test_errors_are_one_line(arguments, line, tmp_path, capsys):
    assert main(["pairs", *arguments, "--data", str(tmp_path), "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err.splitlines()
    assert error[-1].startswith(f"adagmm-bench: {line}")
    assert all(before.startswith("left out ") for before in error[:-1])
    assert not (tmp_path / "out").exists()


def test_recorded_pairs_have_the_camera_at_the_origin_and_metres():
    pair = RecordedPair(shared_data("recordings", "redwood_open3d_5frames"), 0, "first")
    clouds = pair.load()
    source, target = clouds.for_peers()
    np.testing.assert_array_equal(source.points, np.asarray(clouds.peers_source.points))
    np.testing.assert_array_equal(target.viewpoint, np.zeros(3))
    assert len(clouds.source.covariances) == len(clouds.source.points) < 4000 < len(source)


def test_nothing_is_right_among_clouds_that_share_nothing():
    records = [record("adagmm", None, None, warnings=w) for w in ([], ["doubtful"], ["doubtful"])]
    records.append(record("adagmm", 1.0, 0.0, warnings=["doubtful"], group="h"))
    s = summarise_pairs("adagmm", records[:3])
    assert (s.found, s.silently_wrong, s.false_alarms, s.rotation_deg, s.translation) == (0, 1, 0, None, None)
    columns, rows = trust_table(by_group(records), "adagmm")
    assert columns == ["adagmm", "pairs", "right", "silently wrong", "false alarms"]
    assert rows == [["g", 3, 0, 1, 0], ["h", 1, 1, 0, 1], ["all", 4, 1, "1 (25.0%)", "1 (25.0%)"]]
    assert trust_table(by_group(records), "adagmm-global")[1] == []


def test_curves_have_a_column_for_each_share():
    records = [record("adagmm", degrees, 0.0, warnings=[]) for degrees in (1.0, 9.0, 1.0)]
    for one, share in zip(records, (0.2, 0.6, 0.6), strict=True):
        one["problem"] = one["problem"] | {"share": share}
    assert curve_table(records) == (["found (silently wrong)", "60%", "20%"], [["g, 2: adagmm", "1 (1)", "1 (0)"]])


def test_methods_run_from_the_starts_they_are_made_for():
    names = ["adagmm", "adagmm-global", "open3d-ransac-gicp", "open3d-gicp"]
    assert methods_for(OverlapPair(MODELS, 0.4, NEAR, 0, 0), names) == ["adagmm", "open3d-gicp"]
    assert methods_for(OverlapPair(MODELS, 0.4, ANYWHERE, 0, 0), names) == names[:3]
    rooms = methods_for(OverlapPair(ROOMS, 0.4, ANYWHERE, 0, 0), names)
    assert rooms == ["adagmm", "adagmm-global", "open3d-ransac-gicp-dense"]
    recorded = RecordedPair(Path("r"), 0, "a")
    assert methods_for(Restarted(recorded, WRONG_START, 0, 0), names) == ["adagmm"]
    assert methods_for(Restarted(recorded, RANDOM_START, 0, 0), names) == names[:2]
    assert methods_for(MadePair("halves of a model", 0, 0, None), names) == names[:2]


def test_a_digest_tells_what_a_pair_is_made_of(tmp_path):
    """A file of the same name that holds another pair is registered anew; what is made from a seed alone never is."""
    path = tmp_path / "one.npz"
    public, made = PublicPair(path), MadePair("half a turn off", 0, 0, None)
    pairs = (public, Restarted(public, WRONG_START, 0, 0), OverlapPair(ROOMS, 0.5, NEAR, 0, 0, rooms=(path,)), made)
    digests = []
    for angle_deg in (10.0, 10.0, 150.0):
        write_pair(path, pose(angle_deg, 3.0))
        digests.append([pair.content() for pair in pairs])
    first, again, other = digests
    assert first == again
    assert [a == b for a, b in zip(first, other, strict=True)] == [False, False, False, True]


def test_a_start_reaches_ours(tmp_path):
    path = tmp_path / "one.npz"
    write_pair(path, pose(150.0, 3.0))
    found = run_pair_trial(TrialJob(_FromTruth(PublicPair(path)), "adagmm", "as-given"))
    assert found["rotation_error_deg"] < 1.0


class _FromTruth:
    """A pair that is started where it ends."""

    def __init__(self, pair):
        self.pair, self.key, self.facts = pair, pair.key, pair.facts

    def load(self):
        clouds = self.pair.load()
        return plain_pair(
            np.asarray(clouds.source.points),
            np.asarray(clouds.target.points),
            clouds.T_target_source,
            init=clouds.T_target_source,
        )


@pytest.mark.slow
def test_the_command_prints_curves_and_trust(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(overlap, "SHARES", (0.6,))
    (tmp_path / "data").mkdir()
    arguments = ["pairs", "--only", "overlap,trust", "--trials", "1", "--workers", "1", "--methods"]
    arguments += ["adagmm,open3d-gicp", "--data", str(tmp_path / "data"), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    captured = capsys.readouterr()
    assert "left out overlap of rooms: data: expected cloud_pairs" in captured.err
    assert f"left out trust of {DIFFERENT_ROOMS}" in captured.err
    assert "models, start within 20°, 1: open3d-gicp" in captured.out
    assert "what adagmm knows" in captured.out and "all sections of this run" in captured.out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["sections"]["overlap"]["models, start within 20°"]["open3d-gicp"]["trials"] == 1
    assert {t["method"] for t in report["trials"] if t["problem"]["section"] == "trust"} == {"adagmm"}
    assert len(report["trials"]) == 2 + 1 + len(CASES) - 1
