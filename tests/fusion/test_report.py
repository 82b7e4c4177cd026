"""Reports and results of a run: numbers as found, failures in plain sight, files that other programs can read."""

import json
from dataclasses import fields, replace
from io import StringIO

import numpy as np
import open3d as o3d
import pytest
from rich.console import Console
from shared_data import ROOT

from adagmm_fusion.errors import OutputError
from adagmm_fusion.meshes.orientation import upright
from adagmm_fusion.pairs.fusion import RigEstimate, fused_cloud, mean_pose, save_cloud
from adagmm_fusion.pairs.moved_sensors import moved_sensors_notes
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.record import PairRecord, pair_record
from adagmm_fusion.pairs.report import Report, as_json, markdown, terminal_table, write_report
from adagmm_fusion.pairs.scaled_ways import scaled_ways_notes
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import Stage
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import load_rig, save_rig
from adagmm_o3d.lie import so_exp

SHIPPED = ROOT / "recordings" / "two_kinects"
SETTINGS = Settings(target_points=1200, device="cpu")
GOOD = PairRecord(
    pair="a_to_b",
    index=0,
    status="ok",
    judged_by="ground truth",
    reason="",
    T_target_source=np.eye(4).tolist(),
    rotation_error_frobenius=0.0123,
    rotation_error_deg=0.5,
    translation_error_mm=12.25,
    rotation_deviation_deg=0.151,
    translation_deviation_mm=20.6,
    overlap=0.81,
    overlap_truth=0.80,
    sigma=2.5e-4,
    spread_mm=15.75,
    contradicted=0.02,
    iterations=42,
    seconds_registration=0.25,
)
BAD = replace(
    GOOD, pair="b_to_c", index=1, status="failed", reason="rotation error 9.50° is above 3°", rotation_error_deg=9.5
)
BROKEN = PairRecord("c_to_d", 2, "failed", "error", "d.png: the image is missing")
UNKNOWN = PairRecord("d_to_e", 3, "ok", "estimate", "", overlap=0.7, iterations=10, warnings=("near a symmetry",))


def report(*records: PairRecord, **more) -> Report:
    values = {
        "recording": "room",
        "path": "recordings/room",
        "format": "adagmm",
        "sensors": ("left", "right"),
        "calibration": None,
        "settings": SETTINGS,
        "pairs_asked": len(records),
        "records": records,
    }
    return Report(**(values | more))


@pytest.fixture(scope="module")
def outcome():
    return register_pair(open_recording(SHIPPED)[0], SETTINGS)


def test_the_headline_counts_failures_and_takes_medians_over_all():
    text = report(GOOD, BAD, BROKEN, UNKNOWN).headline()
    assert text == "2 of 4 pairs registered; median error 5.00° and 12 mm"
    assert report(BROKEN).headline() == "0 of 1 pairs registered"
    partial = report(GOOD, pairs_asked=5, interrupted=True)
    assert partial.headline().endswith("interrupted, 4 of 5 not tried")


def test_markdown_shows_every_pair_and_every_failure():
    text = markdown(report(GOOD, BAD, BROKEN, UNKNOWN, results={"Rerun recording": "room.rrd"}))
    lines = text.splitlines()
    rows = [line for line in lines if line.startswith("| ") and "_to_" in line]
    assert [row.split(" | ")[0] for row in rows] == ["| a_to_b", "| b_to_c", "| c_to_d", "| d_to_e"]
    assert rows[0] == "| a_to_b | 0.0123 | 0.50 | 12.2 | 0.15° 21 mm | 0.810 | 0.800 | 0.020 | 15.8 | 42 | 0.25 | ok |"
    assert rows[2].count("–") == 10 and rows[2].endswith("| failed |")
    assert rows[3].endswith("| ok (no ground truth) |")
    assert "- b_to_c: rotation error 9.50° is above 3°" in lines
    assert "- c_to_d: d.png: the image is missing" in lines
    assert "- d_to_e: near a symmetry" in lines
    assert "- Rerun recording: [room.rrd](room.rrd)" in lines
    assert "- voxel_size_m: automatic" in lines and "- target_points: 1200" in lines


def test_json_has_schema_settings_versions_and_all_numbers():
    content = json.loads(as_json(report(GOOD, BAD, BROKEN, interrupted=True, pairs_asked=4)))
    assert (content["schema"], content["version"]) == ("adagmm-fusion-report", 1)
    assert content["interrupted"] is True
    assert content["summary"]["pairs_asked"] == 4 and content["summary"]["pairs_done"] == 3
    assert content["summary"]["ok"] == 1 and content["summary"]["failed"] == 2
    assert content["summary"]["median"]["rotation_error_deg"] == 5.0
    assert content["settings"]["target_points"] == 1200
    assert {"python", "adagmm-o3d", "open3d", "numpy", "numba", "rerun-sdk"} == set(content["versions"])
    assert set(content["pairs"][0]) == {field.name for field in fields(PairRecord)}
    assert content["pairs"][0]["rotation_error_frobenius"] == 0.0123
    assert content["pairs"][2]["T_target_source"] is None


def test_the_terminal_table_keeps_units_and_names_as_they_are():
    output = StringIO()
    odd = replace(GOOD, pair="x[red]y")
    Console(file=output, width=200).print(terminal_table(report(odd, BAD)))
    text = output.getvalue()
    for expected in ("translation [mm]", "time [s]", "rotation [°]", "x[red]y", "failed", "12.2"):
        assert expected in text


@pytest.mark.parametrize("name", ["a_to_b", "000000_right_to_left", "1311868164.363181_to_1311868164.399026"])
def test_the_terminal_table_is_readable_at_80_columns(name):
    """A pair has its errors, overlap, time and verdict on one line; only long names are folded, and nothing is cut."""
    errors = {"identity": (41.26, 1629.0), "start": (11.81, 332.0), "end": (0.5, 12.25)}
    stages = tuple(Stage(stage, "", np.eye(4).tolist(), *error) for stage, error in errors.items())
    output = StringIO()
    Console(file=output, width=80).print(terminal_table(report(replace(GOOD, pair=name, stages=stages), BAD), 80))
    lines = output.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    (heading,) = [line.split() for line in lines if "verdict" in line]
    assert heading == ["pair", "start", "end", "overlap", "time", "[s]", "verdict"]
    (first,) = [i for i, line in enumerate(lines) if "332 mm" in line]
    assert lines[first].split()[1:] == ["11.81°", "332", "mm", "0.50°", "12", "mm", "0.81", "0.25", "ok"]
    (last,) = [i for i, line in enumerate(lines) if "b_to_c" in line]
    shown = [lines[first].split()[0], *(line.strip() for line in lines[first + 1 : last])]
    assert "".join(shown) == name and len(shown) == (1 if len(name) <= 20 else 2)


def test_a_record_has_the_numbers_of_its_outcome(outcome):
    record = pair_record(outcome, SETTINGS)
    np.testing.assert_array_equal(record.T_target_source, outcome.T_estimate)
    np.testing.assert_array_equal(record.T_target_source_truth, outcome.pair.T_target_source)
    assert record.target == "left/000000" and record.source == "right/000000"
    assert record.source_points == len(outcome.source_cloud.points)
    np.testing.assert_allclose(record.translation_error_mm, 1000.0 * outcome.evaluation.errors.translation, rtol=1e-12)
    assert record.iterations == outcome.estimate.iterations
    turned = np.degrees(np.sqrt(np.trace(outcome.estimate.pose_covariance[:3, :3])))
    assert record.rotation_deviation_deg == pytest.approx(turned, rel=1e-12)
    # The depths of both cameras may be 1 % off, which at two metres and 40 degrees apart are some centimetres.
    assert 5.0 < record.translation_deviation_mm < 60.0
    assert json.loads(as_json(report(record)))["pairs"][0]["trustworthy"] == outcome.estimate.trustworthy


def test_numbers_that_are_not_finite_become_null(outcome):
    spoilt = replace(outcome, evaluation=replace(outcome.evaluation, inlier_rmse_m=float("nan")))
    content = json.loads(as_json(report(pair_record(spoilt, SETTINGS))))
    assert content["pairs"][0]["inlier_rmse_mm"] is None


def test_reports_are_written_and_replaced(tmp_path):
    first = write_report(tmp_path / "new", report(GOOD))
    assert [path.name for path in first] == ["report.md", "report.json"]
    write_report(tmp_path / "new", report(GOOD, BAD))
    assert len(json.loads(first[1].read_text(encoding="utf-8"))["pairs"]) == 2
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["report.json", "report.md"]


def test_a_report_that_cannot_be_written_is_an_error_of_ours(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"report\.json"):
        write_report(tmp_path / "file", report(GOOD))


def test_the_fused_cloud_holds_both_frames_in_the_targets_frame(outcome, tmp_path):
    pair = outcome.pair
    cloud = fused_cloud(pair, pair.T_target_source, max_depth_m=5.0, voxel_size_m=0.03)
    alone = fused_cloud(pair, pair.T_target_source, max_depth_m=5.0, voxel_size_m=0.01)
    assert 10_000 < len(cloud.points) < len(alone.points)
    points = np.asarray(cloud.points)
    # What only the source saw lies outside the target's image.
    u = 525.0 * points[:, 0] / points[:, 2] + 319.5
    v = 525.0 * points[:, 1] / points[:, 2] + 239.5
    inside = (points[:, 2] > 0) & (u > 0) & (u < 639) & (v > 0) & (v < 479)
    assert 0.5 < inside.mean() < 0.95
    save_cloud(tmp_path / "cloud.ply", cloud)
    again = o3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    np.testing.assert_allclose(np.asarray(again.points), upright(points), rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.asarray(again.colors), np.asarray(cloud.colors), rtol=0, atol=0.5 / 255 + 1e-6)


def test_the_estimated_rig_is_a_rig_file(outcome, tmp_path):
    estimate = RigEstimate()
    estimate.add(outcome)
    rig = estimate.rig("mine")
    save_rig(tmp_path / "rig.yaml", rig)
    loaded = load_rig(tmp_path / "rig.yaml")
    np.testing.assert_allclose(loaded.T_target_source("left", "right"), outcome.T_estimate, rtol=0, atol=1e-9)
    assert loaded.sensors["right"].intrinsics == outcome.pair.source.intrinsics
    assert "right from 1 pair(s)" in loaded.description


def test_failed_pairs_say_nothing_about_the_rig(outcome):
    estimate = RigEstimate()
    estimate.add(replace(outcome, status="failed"))
    assert estimate.rig("mine") is None
    estimate.add(outcome)
    assert estimate.rig("mine") is not None


def test_frames_of_one_moving_sensor_are_no_rig(outcome):
    estimate = RigEstimate()
    same = replace(outcome.pair, source=replace(outcome.pair.source, sensor="left"))
    estimate.add(outcome)
    estimate.add(replace(outcome, pair=same))
    assert estimate.rig("mine") is None


def test_the_mean_of_poses_lies_in_the_middle():
    rng = np.random.default_rng(4)
    center, offset = np.eye(4), np.eye(4)
    center[:3, :3], center[:3, 3] = so_exp(np.array([0.3, -0.8, 0.2])), (1.0, 2.0, 3.0)
    poses = []
    for twist in rng.normal(scale=0.05, size=(5, 3)):
        for sign in (1.0, -1.0):
            offset[:3, :3], offset[:3, 3] = so_exp(sign * twist), sign * twist
            poses.append(center @ offset)
    np.testing.assert_allclose(mean_pose(poses), center, rtol=0, atol=1e-12)
    assert mean_pose([]) is None
    assert mean_pose([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])]) is None  # half a turn apart: no rotation is nearest


def moved(way: float, times: float, turn_deg: float = 0.1, **more) -> PairRecord:
    """Registered `way` metres off, and by its ground truth so many times as far."""
    found, true = np.eye(4), np.eye(4)
    found[2, 3], true[2, 3] = way, times * way
    true[:3, :3] = so_exp((0.0, np.radians(turn_deg), 0.0))
    values = {"T_target_source": found.tolist(), "T_target_source_truth": true.tolist(), "trustworthy": True}
    return replace(GOOD, **(values | more))


def test_poses_in_another_unit_than_the_depth_are_said_to_be():
    scaled = [moved(way, 0.4) for way in (0.1, 0.2, 0.3)]
    (note,) = scaled_ways_notes(scaled)
    assert note.startswith("the ways between the known poses look 2.5 times too short: of 3 pairs the rotations are as")
    assert scaled_ways_notes(scaled, [note]) == []


@pytest.mark.parametrize(
    "records",
    [
        [moved(way, 0.95) for way in (0.1, 0.2, 0.3)],
        [moved(0.1, times) for times in (0.3, 1.0, 2.0)],
        [moved(way, 0.4, turn_deg=5.0) for way in (0.1, 0.2, 0.3)],
        [moved(way, 0.4, trustworthy=False) for way in (0.1, 0.2, 0.3)],
        [moved(0.01, 0.4)] * 3,
        [moved(0.1, 0.4)] * 2,
        [BROKEN, UNKNOWN, GOOD] * 3,
    ],
)
def test_poses_that_may_be_in_the_depths_unit_are_not(records):
    assert scaled_ways_notes(records) == []


def turned(index: int, turn_deg: float, way_m: float = 0.0, **more) -> PairRecord:
    """Registered so far from where the shipped rig has the sensor."""
    true, off = open_recording(SHIPPED).pairs[index].T_target_source, np.eye(4)
    off[:3, :3], off[:3, 3] = so_exp((0.0, np.radians(turn_deg), 0.0)), (way_m, 0.0, 0.0)
    values = {"index": index, "T_target_source": (true @ off).tolist(), "T_target_source_truth": true.tolist()}
    return replace(GOOD, **(values | {"trustworthy": True} | more))


def test_pairs_that_differ_alike_from_the_rig_are_said_to():
    recording = open_recording(SHIPPED)
    records = [turned(i, turn, 0.06) for i, turn in enumerate((2.6, 2.7, 2.8))]
    (note,) = moved_sensors_notes(records, recording)
    assert note == (
        "all 3 pairs of right and left differ from their given pose by the same 2.7° and 60 mm, 18 times the "
        "deviation: has a sensor moved since? see verify"
    )
    assert moved_sensors_notes(records, recording, ["the pose of right to left looks like its inverse"]) == []
    records[2] = replace(records[2], trustworthy=False)
    assert moved_sensors_notes(records, recording)[0].startswith("2 of 3 pairs of right and left differ")
    (note,) = moved_sensors_notes([turned(i, 0.0, 0.15) for i in range(2)], recording)
    assert "by the same 0.0° and 150 mm, 7 times" in note


@pytest.mark.parametrize(
    "changes",
    [
        [(2.7,)],
        [(2.7,), (-2.7,), (2.7,)],
        [(2.7,), (1.5,), (2.7,)],
        [(0.4,)] * 3,
        [(0.6,)] * 3,
        [(0.0, 0.06)] * 3,
        [(0.0, 0.0)] * 3,
    ],
)
def test_pairs_that_differ_little_or_otherwise_each_are_not(changes):
    records = [turned(i, *change) for i, change in enumerate(changes)]
    assert moved_sensors_notes(records, open_recording(SHIPPED)) == []
    unknown = [turned(i, 2.7, rotation_deviation_deg=None) for i in range(3)]
    assert moved_sensors_notes([*unknown, BROKEN], open_recording(SHIPPED)) == []
