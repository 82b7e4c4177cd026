"""`adagmm-fusion verify`: rigs that are still true, rigs whose sensor has been knocked, and what cannot be said."""

import dataclasses

import numpy as np
import pytest
from rerun.chunk import RrdReader
from shared_data import ROOT

from adagmm_fusion.cli import main
from adagmm_fusion.pairs.pose_deviations import pose_deviations
from adagmm_fusion.rigs.checking import FrameCheck, judged, spread_over
from adagmm_fusion.rigs.rig import Rig, load_rig, save_rig
from adagmm_o3d import lie

SHIPPED = str(ROOT / "recordings" / "two_kinects")
RIG = ROOT / "calibration" / "two_kinects.yaml"


def knocked(tmp_path, tangent):
    """The shipped rig, with its right sensor moved."""
    rig = load_rig(RIG)
    right = rig.sensors["right"]
    moved = dataclasses.replace(right, T_rig_sensor=lie.se_exp(tangent) @ right.T_rig_sensor)
    save_rig(tmp_path / "rig.yaml", Rig(rig.name, rig.sensors | {"right": moved}))
    return str(tmp_path / "rig.yaml")


@pytest.mark.slow
def test_the_rig_of_the_shipped_recording_is_unchanged(capsys):
    assert main(["verify", str(RIG), SHIPPED, "--device", "cpu"]) == 0
    out, err = capsys.readouterr()
    assert err == "" and "right against left: unchanged, " in out
    assert [f"00000{i}" in out for i in range(3)] == [True] * 3
    assert "rotation [°]" in out and "translation [mm]" in out and out.count(" ± ") == 8  # two a frame, two in all


@pytest.mark.slow
def test_a_knocked_sensor_has_moved_by_as_much(tmp_path, capsys):
    rig = knocked(tmp_path, (0.0, np.radians(4.0), 0.0, 0.05, 0.0, 0.1))
    log = tmp_path / "moved.rrd"
    assert main(["verify", rig, SHIPPED, "--frames", "2", "--device", "cpu", "--save", str(log)]) == 3
    sentence = capsys.readouterr().out.splitlines()[-1]
    assert sentence.startswith("right against left: moved, ")
    rotation_deg = float(sentence.split("moved, ")[1].split("°")[0])
    assert rotation_deg == pytest.approx(4.0, abs=1.0)
    logged = {str(column) for column in RrdReader(log).store().schema().component_columns()}
    for entity in ("rig/image", "found/image", "frames", "moved", "moved/label"):
        assert any(f"/world/rig/left/right/{entity}:" in column for column in logged), entity


@pytest.mark.slow
def test_tolerances_are_the_users(capsys):
    arguments = ["verify", str(RIG), SHIPPED, "--device", "cpu", "--max-rotation", "0.01", "--max-translation", "0.1"]
    assert main(arguments) == 3  # registration is not as good as that
    assert "right against left: moved" in capsys.readouterr().out


def rigid(rotation, translation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def frames_off(rotations_deg, translations_mm):
    T_rig = lie.se_exp((0.1, 0.5, 0.0, 1.0, 0.0, 0.2))
    frames = []
    for i, (angle, length) in enumerate(zip(rotations_deg, translations_mm, strict=True)):
        T = T_rig.copy()
        T[:3, :3] = lie.so_exp((0.0, 0.0, np.radians(angle))) @ T[:3, :3]
        T[0, 3] += length / 1000.0
        frames.append(FrameCheck(str(i), angle, length, T))
    return frames, T_rig


@pytest.mark.parametrize(
    ("rotations_deg", "translations_mm", "verdict"),
    [
        ((0.2, 0.3, 0.25), (5.0, 6.0, 7.0), "unchanged"),
        ((3.0, 3.1, 2.9), (5.0, 6.0, 7.0), "moved"),
        ((0.2, 0.3, 0.25), (80.0, 82.0, 81.0), "moved"),
        ((0.1, 2.2, -1.9, 2.8), (5.0, 6.0, 7.0, 5.0), "undecided"),
        ((0.9, 1.1), (5.0, 5.0), "undecided"),
        ((0.2,), (5.0,), "undecided"),
        ((), (), "undecided"),
    ],
)
def test_the_verdict_needs_frames_that_agree(rotations_deg, translations_mm, verdict):
    frames, T_rig = frames_off(rotations_deg, translations_mm)
    assert judged("right", "left", frames, T_rig, 1.0, 50.0).verdict == verdict


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        (lie.se_inverse, "the inverse"),
        (lambda T: rigid(T[:3, :3].T, T[:3, 3]), "with its rotation transposed"),
        (lambda T: rigid(T[:3, :3], 1000.0 * T[:3, 3]), "in millimetres"),
        (lambda T: T @ lie.se_exp((0.0, 0.1, 0.0, 0.0, 0.0, 0.3)), ""),
    ],
)
def test_what_a_wrong_rig_looks_like_is_said(wrong, name):
    frames, T_rig = frames_off((0.2, 0.3, 0.25), (5.0, 6.0, 7.0))
    check = judged("right", "left", frames, wrong(T_rig), 1.0, 50.0)
    assert (check.verdict, check.looks_like) == ("moved", name)


def test_mean_and_spread_are_over_frames():
    frames, T_rig = frames_off((1.0, 3.0), (10.0, 30.0))
    check = judged("right", "left", frames, T_rig, 1.0, 50.0)
    assert check.rotation_deg == pytest.approx(2.0, rel=1e-6)
    assert check.translation_mm == pytest.approx(20.0, rel=1e-9)
    assert check.rotation_spread_deg == pytest.approx(1.0, rel=1e-6)
    assert check.translation_spread_mm == pytest.approx(10.0, rel=1e-9)


def test_moments_are_spread_over_the_recording():
    assert spread_over(list(range(100)), 4) == [0, 33, 66, 99]
    assert spread_over([3, 5], 10) == [3, 5]


def test_errors_are_one_line(tmp_path, capsys):
    rig = load_rig(RIG)
    lost = dataclasses.replace(rig.sensors["right"], T_rig_sensor=None)
    save_rig(tmp_path / "lost.yaml", Rig("lost", rig.sensors | {"right": lost}))
    for arguments, message in (
        (["nowhere.yaml", SHIPPED], "nowhere.yaml: cannot be read"),
        ([str(tmp_path / "lost.yaml"), SHIPPED], "T_rig_sensor of sensor 'right' is unknown"),
        ([str(RIG), SHIPPED, "--frames", "1"], "--frames: expected at least 2"),
        ([str(RIG), SHIPPED, "--max-rotation", "0"], "--max-rotation: expected a positive number"),
    ):
        assert main(["verify", *arguments]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and message in err


def test_deviations_are_those_of_the_sensors_own_place():
    rng = np.random.default_rng(0)
    T = lie.se_exp((0.1, 0.5, 0.0, 1.0, 0.0, 2.0))
    root = 0.002 * rng.normal(size=(6, 6))
    draws = [lie.se_exp(root @ rng.normal(size=6)) @ T for _ in range(4000)]
    turned = [np.linalg.norm(lie.so_log(draw[:3, :3] @ T[:3, :3].T)) for draw in draws]
    shifted = [np.linalg.norm(draw[:3, 3] - T[:3, 3]) for draw in draws]
    rotation_deg, translation_mm = pose_deviations(root @ root.T, T)
    assert rotation_deg == pytest.approx(np.degrees(np.sqrt(np.mean(np.square(turned)))), rel=0.05)
    assert translation_mm == pytest.approx(1000 * np.sqrt(np.mean(np.square(shifted))), rel=0.05)
    assert pose_deviations(None, T) == (None, None)
