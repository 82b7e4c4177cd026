"""Extrinsics from what sensors see: poses from edges with exact truth, and the shipped rig without a board."""

import json

import numpy as np
import pytest
from shared_data import ROOT, shared_data

from adagmm_fusion.cli import main
from adagmm_fusion.rigs.rig import load_rig
from adagmm_fusion.rigs.scene_calibration import SceneEdge, solve_poses
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, se_inverse, se_log

SENSORS = ("a", "b", "c")


def noisy_edges(rng: np.random.Generator, moments: int, deviation: float) -> tuple[dict, list[SceneEdge]]:
    """True poses of three sensors, and edges whose errors are as their information says."""
    poses = {"a": np.eye(4)} | {s: se_exp(rng.normal(0.0, 0.6, 6)) for s in SENSORS[1:]}
    scales = deviation * np.array([0.3, 0.3, 0.3, 1.0, 1.0, 3.0])
    edges = []
    for moment in range(moments):
        for target, source in (("a", "b"), ("b", "c"), ("a", "c")):
            T = se_exp(scales * rng.normal(size=6)) @ se_inverse(poses[target]) @ poses[source]
            edges.append(SceneEdge(str(moment), target, source, T, np.diag(scales**-2.0), np.zeros((6, 4))))
    return poses, edges


def test_exact_edges_give_exact_poses():
    truth, edges = noisy_edges(np.random.default_rng(0), 2, 1e-9)
    poses, _, disagreeing = solve_poses(edges, SENSORS)
    assert disagreeing == []
    for sensor in SENSORS:
        np.testing.assert_allclose(poses[sensor], truth[sensor], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_the_covariances_are_those_of_the_errors():
    squares = []
    for seed in range(60):
        truth, edges = noisy_edges(np.random.default_rng(seed), 8, 0.01)
        poses, covariances, _ = solve_poses(edges, SENSORS)
        for sensor in ("b", "c"):
            off = se_log(se_inverse(truth[sensor]) @ poses[sensor])
            squares.append(off @ np.linalg.solve(covariances[sensor], off))
    assert 4.0 < np.mean(squares) < 8.0
    assert not covariances["a"].any()


def test_what_depths_share_does_not_average_out():
    squares = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        truth, edges = noisy_edges(rng, 8, 1e-4)
        errors = {sensor: rng.normal(size=2) for sensor in SENSORS}
        effects = 0.01 * np.random.default_rng(0).normal(size=(6, 4))
        wrong = []
        for edge in edges:
            off = effects @ np.concatenate([errors[edge.source], errors[edge.target]])
            T = se_exp(off) @ edge.T_target_source
            wrong.append(SceneEdge(edge.moment, edge.target, edge.source, T, edge.information, effects))
        poses, covariances, _ = solve_poses(wrong, SENSORS)
        for sensor in ("b", "c"):
            off = se_log(se_inverse(truth[sensor]) @ poses[sensor])
            squares.append(off @ np.linalg.solve(covariances[sensor], off))
    assert 4.0 < np.mean(squares) < 8.0


@pytest.mark.parametrize("wrong", [0, 4])
def test_an_edge_that_contradicts_the_rest_is_named_and_let_go(wrong):
    truth, edges = noisy_edges(np.random.default_rng(3), 4, 0.002)
    bad = edges[wrong]
    T = se_exp((0.0, 0.5, 0.0, 0.3, 0.0, 0.0)) @ bad.T_target_source
    edges[wrong] = SceneEdge(bad.moment, bad.target, bad.source, T, bad.information, bad.depth_effects)
    poses, _, disagreeing = solve_poses(edges, SENSORS)
    assert disagreeing == [bad.name]
    for sensor in SENSORS:
        errors = pose_errors(truth[sensor], poses[sensor])
        assert errors.rotation_deg < 0.3 and errors.translation < 0.02


def test_a_sensor_that_no_edge_leads_to_has_no_pose():
    _, edges = noisy_edges(np.random.default_rng(1), 1, 0.01)
    poses, covariances, _ = solve_poses([e for e in edges if "c" not in (e.target, e.source)], SENSORS)
    assert set(poses) == set(covariances) == {"a", "b"}


@pytest.mark.slow
def test_the_shipped_rig_is_found_without_a_board(tmp_path, capsys):
    output = tmp_path / "rig.yaml"
    recording = ROOT / "recordings" / "two_kinects"
    assert main(["calibrate", "--from-scene", str(recording), "--output", str(output)]) == 0
    assert "3 of 3 pairs registered" in capsys.readouterr().out
    found, true = load_rig(output), load_rig(ROOT / "calibration" / "two_kinects.yaml")
    first, second = found.sensors
    errors = pose_errors(true.T_target_source(first, second), found.T_target_source(first, second))
    assert errors.rotation_deg < 0.04 and errors.translation < 2e-3
    written = json.loads((tmp_path / "rig_covariances.json").read_text())
    covariance = np.array(written["covariances"][second])
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert written["disagreeing"] == []


@pytest.mark.slow
def test_two_xtions_are_placed_without_a_board(tmp_path, capsys):
    folder = shared_data("recordings/two_xtion_rig")
    assert main(["calibrate", "--from-scene", str(folder), "--output", str(tmp_path / "rig.yaml")]) == 0
    assert "2 of 2 pairs registered" in capsys.readouterr().out
    reference = np.loadtxt(folder / "recording" / "T_cam1_to_cam2_reference.txt")
    errors = pose_errors(reference, load_rig(tmp_path / "rig.yaml").T_target_source("camera2", "camera1"))
    # The reference, from image features, is good to 1 degree and 60 mm.
    assert errors.rotation_deg < 1.0 and errors.translation < 0.06


def test_one_that_does_not_say_from_what_or_both_is_wrong_usage(capsys):
    recording = str(ROOT / "recordings" / "two_kinects")
    for arguments in (["calibrate"], ["calibrate", recording, "--from-scene", recording]):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 2
    assert "--from-scene" in capsys.readouterr().err
