"""Stray Scanner (iOS): one phone with LiDAR.

    rgb.mp4               HEVC, 1920x1440; or rgb/000000.jpg, ... taken out of it
    depth/000000.png      16 bit, 256x192, millimetres, of the same view
    confidence/000000.png optional, 8 bit: 0, 1 or 2; where it is 0 the depth is left out
    camera_matrix.csv     3x3, of the video's picture
    odometry.csv          headings, then: timestamp [s], frame, x, y, z, qx, qy, qz, qw; camera (RDF) to world, metres

Depth is drawn out over the colour image, which is made smaller. Source: the app's docs/format.md.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, read_color
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.files.video_file import video_picture
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix, listed_images
from adagmm_fusion.formats.phone_depth import MILLIMETRES_PER_METRE, confident_depth
from adagmm_fusion.formats.text_table import parse_numbers, parse_quaternion_pose, read_rows
from adagmm_fusion.recordings.frame_sequence import Recording

NAME = "stray"
SUMMARY = "Stray Scanner folder (rgb.mp4, depth/, odometry.csv, camera_matrix.csv)"
SENSOR = "phone"


def matches(folder: Path) -> bool:
    return is_given(folder / "odometry.csv") and is_given(folder / "camera_matrix.csv")


def read(folder: Path, options: ReadOptions) -> Recording:
    K = np.array([parse_numbers(words, 3, where) for where, words in _read_csv(folder / "camera_matrix.csv")])
    if K.shape != (3, 3):
        raise RecordingError(f"{folder / 'camera_matrix.csv'}: expected 3 lines of 3 numbers, got {len(K)}")
    if not (folder / "depth").is_dir():
        raise RecordingError(f"{folder}: the folder depth/ is missing")
    depths = {path.stem: path for path in listed_images(folder / "depth", (".png",))}
    frames, size = [], None
    for where, words in list(_read_csv(folder / "odometry.csv"))[1:]:
        if len(words) != 9:
            raise RecordingError(f"{where}: expected timestamp, frame, x, y, z, qx, qy, qz, qw, got {len(words)} words")
        name = words[1]
        numbers = parse_numbers(words[:1] + words[2:], 8, where)
        if name not in depths:
            continue
        if not name.isdecimal():
            raise RecordingError(f"{where}: expected a frame's number, got {name[:40]!r}")
        color = _color(folder, name)
        if size is None:
            first = read_color(color) if isinstance(color, Path) else color()
            size = first.shape[1], first.shape[0]
        depth = inside(folder, f"depth/{depths[name].name}", where)
        confidence = inside(folder, f"confidence/{name}.png", where)
        frames.append(
            ListedFrame(
                name,
                color,
                partial(confident_depth, depth, confidence),
                intrinsics_from_matrix(K, size, folder / "camera_matrix.csv"),
                MILLIMETRES_PER_METRE,
                parse_quaternion_pose(numbers[1:], where),
                numbers[0],
                where=depth,
            )
        )
    return recording_of_frames(folder, NAME, SENSOR, frames, options)


def _color(folder: Path, name: str) -> Path | Callable[[], np.ndarray]:
    for suffix in COLOR_SUFFIXES:
        path = inside(folder, f"rgb/{name}{suffix}", str(folder))
        if path.exists():
            return path
    return partial(video_picture, inside(folder, "rgb.mp4", str(folder)), int(name[:9]))


def _read_csv(path: Path) -> Iterator[tuple[str, list[str]]]:
    for where, words in read_rows(path):
        yield where, [word.strip() for word in " ".join(words).split(",")]
