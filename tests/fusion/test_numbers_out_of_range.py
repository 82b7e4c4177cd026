"""Numbers on the command line beyond what can be meant: one line that names the option, before any work is done."""

import numpy as np
import open3d as o3d
import pytest
from shared_data import ROOT

import adagmm_bench.cli
from adagmm_fusion.board_calibration.boards import parse_board_size
from adagmm_fusion.cli import main
from adagmm_fusion.clouds.building import find_voxel_size
from adagmm_fusion.commands.run import selected_pairs
from adagmm_fusion.errors import MAX_LENGTH, one_line
from adagmm_fusion.pairs.settings import LIMITS, Settings
from adagmm_o3d.errors import InputError

SHIPPED = str(ROOT / "recordings" / "two_kinects")
RIG = str(ROOT / "calibration" / "two_kinects.yaml")

RUN = [
    *(("--voxel-size", text) for text in ("nan", "-1", "0", "1e-9", "1e-300", "1e9", "1e300", "inf")),
    *(("--target-points", text) for text in ("0", "1", "-5", "5", "999999999999", "9" * 30)),
    *(("--workers", text) for text in ("0", "1")),  # for a folder of recordings
    *(("--max-depth", text) for text in ("inf", "0", "1e-300", "1e300", "nan")),
    *(("--max-iteration", text) for text in ("0", "-5", "9" * 25)),
    *(("--partner-distance", text) for text in ("0", "1e-300", "1e300")),
    *(("--max-rotation-error", text) for text in ("nan", "0", "-1")),
    ("--min-overlap", "2"),
    ("--min-overlap", "nan"),
    *(("--pairs", text) for text in ("9" * 5000, "0-" + "9" * 30, "0-" + "9" * 5000, "²", "٣", "0," * 3000 + "x")),
    *(("--port", text) for text in ("99999", "-1", "9" * 30)),
    ("--step", "-1"),
    ("--url", "http://[::1"),
    ("--url", "http://127.0.0.1:notaport"),
    ("--output", "x" * 5000),
    ("--output", "a\0b"),
    ("--calibration", "x" * 5000),
    ("--calibration", "a\0b"),
]
FUSE = [
    *(("--voxel-size", text) for text in ("nan", "0", "1e-9", "1e300")),
    *(("--max-memory", text) for text in ("nan", "-1", "inf")),
    *(("--target-points", text) for text in ("-1", "9" * 30)),
    *(("--max-depth", text) for text in ("nan", "0.1", "1e9")),
    ("--moment", "x" * 5000),
    ("--moment", "\x1b"),
]
OTHERS = [
    *(["simulate", "OUT", "--pairs", text] for text in ("0", "-1", "9" * 25)),
    ["simulate", "OUT", "--seed", "-1"],
    *(["verify", RIG, SHIPPED, *more] for more in (["--frames", "0"], ["--max-rotation", "nan"])),
    *(
        ["calibrate", SHIPPED, "--square", "0.1", "--chessboard", text]
        for text in ("99999999999x6", "9" * 5000 + "x6", "0x0", "²x٣", "")
    ),
    ["calibrate", SHIPPED, "--chessboard", "9x6", "--square", "nan"],
    ["calibrate", SHIPPED, "--chessboard", "9x6", "--square", "0.1", "--depth-scale", "inf"],
    ["calibrate", SHIPPED, "--charuco", "80000x60000", "--square", "0.1", "--marker", "0.05"],
    ["convert-rig", f"a={RIG}", "--output", "OUT", "--size", "9" * 30 + "x9"],
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [["run", SHIPPED, *more] for more in RUN] + [["fuse", SHIPPED, *more] for more in FUSE] + OTHERS,
    ids=lambda arguments: ascii(" ".join([arguments[0], *(word[:20] for word in arguments[2:])])),
)
def test_a_number_beyond_what_can_be_meant(arguments, tmp_path, monkeypatch, capsys):
    def never(*_, **__):
        raise AssertionError("it began to work")

    for place in ("commands.run.run_pairs", "sequence.registration.register_scene", "sequence.fused_mesh.fuse_frames"):
        monkeypatch.setattr(f"adagmm_fusion.{place}", never)
    monkeypatch.chdir(tmp_path)
    assert main([str(tmp_path / "out") if word == "OUT" else word for word in arguments]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("adagmm-fusion: ")
    assert len(err) < MAX_LENGTH + 100 and err.rstrip("\n").isprintable()


BENCH = [
    *(["sim2d", "--trials", text] for text in ("0", "-1", "9" * 30)),
    ["sim2d", "--seed", "-1", "--trials", "1"],
    ["sim2d", "--rotation-range", "1e300", "--trials", "1", "--sweeps", "noise"],
    ["ablation", "--trials", "9" * 30],
    ["covariance", "--trials", "9" * 30],
    ["covariance", "--seeds", "9" * 30],
    ["speed", "--repeats", "9" * 30],
    ["gpu", "--repeats", "-1"],
]


@pytest.mark.parametrize("arguments", BENCH, ids=lambda arguments: " ".join(word[:12] for word in arguments))
def test_a_number_of_the_bench(arguments, tmp_path, capsys):
    assert adagmm_bench.cli.main([*arguments, "--output", str(tmp_path)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert "expected " in lines[-1] and all(line.startswith(("adagmm-bench: ", "left out ")) for line in lines)


@pytest.mark.parametrize("name", LIMITS)
def test_settings_up_to_their_limits(name):
    least, most = LIMITS[name]
    for value in (least, most):
        assert getattr(Settings(**{name: value}), name) == value
    for value in (0.99 * least, 1.01 * most):
        with pytest.raises(InputError, match=f"^{name}: expected "):
            Settings(**{name: value})


def test_more_points_than_there_are_leave_the_cloud_whole():
    """No grid has them, however fine it is; finer and finer ones had no numbers left."""
    points = np.random.default_rng(0).uniform(0.0, 3.0, (500, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    size = find_voxel_size([cloud], 10_000_000)
    assert 0.0 < size < 0.01 and len(cloud.voxel_down_sample(size).points) == 500


@pytest.mark.parametrize("text", ["9" * 5000, "1," * 10 + "9" * 101])
def test_very_many_digits_are_not_repeated(text):
    with pytest.raises(InputError, match=r"^--pairs: expected") as caught:
        selected_pairs(text, 5)
    assert len(str(caught.value)) < 250
    with pytest.raises(InputError, match=r"^size: expected columns x rows") as caught:
        parse_board_size(text, "size")
    assert len(str(caught.value)) < 250


def test_a_long_message_keeps_both_ends():
    line = one_line(InputError("file.yaml: " + "x" * 100_000 + "; do this"))
    assert line.startswith("file.yaml: ") and line.endswith("; do this") and len(line) < MAX_LENGTH + 10
