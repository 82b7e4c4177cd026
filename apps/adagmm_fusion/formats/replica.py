"""Replica scenes as iMAP and NICE-SLAM rendered them.

    results/frame000000.jpg    colour
    results/depth000000.png    16 bit, 6553.5 units a metre
    traj.txt                   16 numbers a line, camera to world row by row, metres
    cam_params.json            here or in the folder above: camera: w, h, fx, fy, cx, cy, scale; else 1200 680 600 600
                               599.5 339.5 6553.5

Source: Sucar et al. 2021, Zhu et al. 2022.
"""

from pathlib import Path

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.files.json_file import json_number, json_object, read_json
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.text_table import parse_numbers, parse_pose, read_rows
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.errors import InputError

NAME = "replica"
SUMMARY = "Replica scene (results/frame000000.jpg, depth000000.png, traj.txt)"
SENSOR = "camera"
INTRINSICS, DEPTH_SCALE = PinholeIntrinsics(1200, 680, 600.0, 600.0, 599.5, 339.5), 6553.5


def matches(folder: Path) -> bool:
    return is_given(folder / "traj.txt") and any((folder / "results").glob("depth*.png"))


def read(folder: Path, options: ReadOptions) -> Recording:
    poses = [parse_pose(parse_numbers(words, 16, where), where) for where, words in read_rows(folder / "traj.txt")]
    intrinsics, depth_scale = _camera(folder)
    frames = []
    for path in sorted((folder / "results").glob("depth*.png")):
        number = path.stem.removeprefix("depth")
        if not number.isdecimal() or int(number[:12]) >= len(poses):
            raise RecordingError(f"{path}: expected a number up to {len(poses) - 1}, as traj.txt has poses")
        color, depth = (inside(folder, f"results/{name}", str(folder)) for name in (f"frame{number}.jpg", path.name))
        if not color.exists():
            color = inside(folder, f"results/frame{number}.png", str(folder))
        frames.append(ListedFrame(number, color, depth, intrinsics, depth_scale, poses[int(number)]))
    return recording_of_frames(folder, NAME, SENSOR, frames, options)


def _camera(folder: Path) -> tuple[PinholeIntrinsics, float]:
    path = next(
        (p / "cam_params.json" for p in (folder, folder.resolve().parent) if is_given(p / "cam_params.json")), None
    )
    if path is None:
        return INTRINSICS, DEPTH_SCALE
    where = str(path)
    values = json_object(json_object(read_json(path), where).get("camera"), f"{where}: camera")
    w, h, fx, fy, cx, cy, scale = (
        json_number(values, name, f"{where}: camera") for name in ("w", "h", "fx", "fy", "cx", "cy", "scale")
    )
    if scale <= 0:
        raise RecordingError(f"{where}: camera: scale: expected positive depth units per metre, got {scale:g}")
    try:
        return PinholeIntrinsics(int(w), int(h), fx, fy, cx, cy), scale
    except InputError as problem:
        raise RecordingError(f"{where}: camera: {problem}") from problem
