"""Recordings that are whole and wrong: swapped images, absurd calibrations, wrong units, stamps that do not match,
paths that lead out. Each is refused with its reason, or fails as a pair with one; nothing is made of it."""

import dataclasses

import numpy as np
import pytest
from reader_cases import INTRINSICS, files_of, read_everything, write_files

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.pairs.pipeline import run_pairs
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.errors import InputError

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
CPU = Settings(device="cpu", target_points=200)


@pytest.fixture
def own(tmp_path):
    write_files(tmp_path / "room", files_of("adagmm"))
    return tmp_path / "room"


def edited(path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize("sensor", ["left", "right"])
def test_colour_and_depth_swapped(own, sensor):
    color, depth = (own / sensor / kind / "000000.png" for kind in ("color", "depth"))
    content = color.read_bytes()
    color.write_bytes(depth.read_bytes())
    depth.write_bytes(content)
    with pytest.raises(RecordingError, match=r"color/000000\.png: expected colours of 8 bits, got 16; is it the depth"):
        open_recording(own)[0]


def test_the_same_colours_for_both(own):
    """Depth that is a copy of the colour image, as an export for viewing leaves it."""
    depth = own / "left" / "depth" / "000000.png"
    depth.write_bytes((own / "left" / "color" / "000000.png").read_bytes())
    with pytest.raises(RecordingError, match=r"depth/000000\.png: expected depth with one 16-bit channel, got 3 of 8"):
        open_recording(own)[0]


ABSURD = [
    {"fx": 0.4, "fy": 0.4},
    {"fx": 1e9, "fy": 1e9},
    {"cx": -1e9, "cy": 1e9},
    {"distortion": (1e300, -1e300, 0.0, 0.0)},
    {"distortion": (1e6, 1e6, 1e6, 1e6, 1e6)},
    {"distortion": (0.0,) * 5 + (-1e9, 1e9, -1e9)},
]


def rig_with(depth_scale=1000.0, **changes) -> Rig:
    intrinsics = dataclasses.replace(INTRINSICS, **changes)
    pose = np.eye(4)
    return Rig("absurd", {n: SensorCalibration(n, intrinsics, depth_scale, pose) for n in ("left", "right")})


@pytest.mark.parametrize("changes", ABSURD, ids=str)
def test_absurd_intrinsics_are_no_success(own, changes):
    (outcome,) = run_pairs(open_recording(own, rig=rig_with(**changes)), CPU, [0])
    assert outcome.status == "failed" and outcome.reason


@pytest.mark.parametrize("changes", [{"fx": 1e-300}, {"fy": 1e300}, {"cx": 1e300}, {"cy": -1e10}], ids=str)
def test_intrinsics_beyond_all_measure(changes):
    with pytest.raises(InputError, match=r"^intrinsics\.[fc][xy]: expected pixels, up to 1e\+09, got "):
        rig_with(**changes)


@pytest.mark.parametrize("focal", [1e-9, 0.3])
def test_focal_lengths_that_were_divided_by_the_images_size(focal):
    with pytest.raises(InputError, match=rf"^intrinsics\.fx: expected pixels, got {focal:g} for a width of 16; were"):
        rig_with(fx=focal, fy=focal)


@pytest.mark.parametrize("depth_scale", [1e-300, 1e-5, 1e9, 1e300])
def test_absurd_depth_scales_leave_no_cloud(own, depth_scale):
    (outcome,) = run_pairs(open_recording(own, rig=rig_with(depth_scale)), CPU, [0])
    assert outcome.judged_by == "error" and "check depth_scale" in outcome.reason


@pytest.mark.parametrize("width", [0, -16, 17, 160_000, 10**17])
def test_intrinsics_of_another_image(own, width):
    edited(own / "rig.yaml", "width: 16", f"width: {width}")
    problems = read_everything(own)
    assert problems and all(isinstance(problem, InputError) for problem in problems)
    assert all("width" in str(p) or f"{width}x12" in str(p) for p in problems)


@pytest.mark.parametrize("units", ["millimetre", "m", "metres", "foot", ""])
def test_a_rig_in_other_units(own, units):
    edited(own / "rig.yaml", "units: metre", f"units: {units}")
    with pytest.raises(RigError, match=r"rig\.yaml:\d+: units: expected (metre|text)"):
        open_recording(own)


def test_extrinsics_beyond_all_measure(own):
    rig = (own / "rig.yaml").read_text().splitlines()
    row = next(i for i, line in enumerate(rig) if line.strip().startswith("- ["))
    numbers = rig[row].split(", ")
    rig[row] = ", ".join([*numbers[:3], "1e300]"])
    (own / "rig.yaml").write_text("\n".join(rig))
    with pytest.raises(RigError, match=r"T_rig_sensor: expected numbers up to 1e\+12, got 1e\+300; check the units"):
        open_recording(own)


@pytest.mark.parametrize(
    "text", ["name: &a two\n", "name: *a\n", "name: !!str two\n", 'name: "\\uD800"\n', 'name: "\\x1b"\n']
)
def test_yaml_that_is_not_plain_data(own, text):
    edited(own / "recording.yaml", "name: two in a room\n", text)
    with pytest.raises(RecordingError, match=r"recording\.yaml:3: ") as caught:
        open_recording(own)
    assert str(caught.value).isprintable()


def test_a_number_of_very_many_digits(own):
    edited(own / "rig.yaml", "width: 16", "width: " + "9" * 5000)
    with pytest.raises(RigError, match="width: expected an integer"):
        open_recording(own)


def test_stamps_that_do_not_match(tmp_path):
    write_files(tmp_path / "freiburg1", files_of("tum"))
    rgb = tmp_path / "freiburg1" / "rgb.txt"
    rgb.write_text("".join(f"{200.0 + i} rgb/{i}.png\n" for i in range(3)))
    with pytest.raises(RecordingError, match="none of the 0 associated colour and depth images is there"):
        open_recording(tmp_path / "freiburg1")


@pytest.mark.parametrize("stamp", ["nan", "inf", "1e999", "-", "0x10"])
def test_stamps_that_are_no_numbers(tmp_path, stamp):
    write_files(tmp_path / "freiburg1", files_of("tum"))
    depth = tmp_path / "freiburg1" / "depth.txt"
    depth.write_text(f"{stamp} depth/100.000000.png\n")
    with pytest.raises(RecordingError, match=r"depth\.txt:1: expected "):
        open_recording(tmp_path / "freiburg1")


@pytest.mark.parametrize("path", ["../outside.png", "/etc/hostname", "depth/../../outside.png", "a\x00b", "x" * 5000])
def test_paths_that_lead_out(tmp_path, path):
    (tmp_path / "outside.png").write_bytes(files_of("tum")["depth/100.000000.png"])
    for format, file, line in (
        ("tum", "depth.txt", f"100.0 {path}\n"),
        ("tum", "rgb.txt", f"99.996 {path}\n"),
        ("tum", "associations.txt", f"99.996 rgb/99.996000.png 100.0 {path}\n"),
        ("posefile", "all_frame_names.txt", f"../../{path}\n00007.png\n"),
    ):
        folder = tmp_path / f"{format} {file}" / "freiburg1"
        write_files(folder, files_of(format))
        (folder / file).write_text(line)
        with pytest.raises(RecordingError, match=r"txt:1: .*(leads out of the recording folder|is not a path)"):
            open_recording(folder)


def test_names_that_cannot_be_printed(tmp_path):
    files = files_of("redwood")
    depth, color = (next(n for n in files if n.startswith(f"{k}/00001")) for k in ("depth", "color"))
    renamed = {n: data for n, data in files.items() if n not in (depth, color)}
    renamed |= {"depth/\x1b[2J-1.png": files[depth], "color/\x1b[2J-1.png": files[color]}
    write_files(tmp_path, renamed)
    with pytest.raises(RecordingError, match=r"the name '\\x1b\[2J-1' cannot be printed; rename it"):
        open_recording(tmp_path)
