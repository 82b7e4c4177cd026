"""ICL-NUIM sequences in its TUM-compatible layout: a rendered room or office, without noise or with.

    associations.txt          lines "number depth/0.png number rgb/0.png"
    rgb/0.png, depth/0.png    depth 16 bit, 5000 units a metre
    livingRoom2.gt.freiburg   or traj0.gt.freiburg: lines "number tx ty tz qx qy qz qw", from number 1 on

The renderer's camera has y up (its fy is -480), so the poses are of left-handed frames: mirrored in y, camera and
world, they are ours. Source: Handa et al. 2014.
"""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import is_given, visible
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.pose_columns import in_usual_order, quaternion_columns
from adagmm_fusion.formats.text_table import parse_numbers, parse_quaternion_pose, read_rows
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording

NAME = "icl-nuim"
SUMMARY = "ICL-NUIM sequence (associations.txt, *.gt.freiburg)"
SENSOR = "camera"
DEPTH_SCALE = 5000.0
INTRINSICS = PinholeIntrinsics(640, 480, 481.2, 480.0, 319.5, 239.5)
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def matches(folder: Path) -> bool:
    return is_given(folder / "associations.txt") and any(visible(folder.glob("*.gt.freiburg")))


def read(folder: Path, options: ReadOptions) -> Recording:
    truths = visible(folder.glob("*.gt.freiburg"))
    if len(truths) != 1:
        raise RecordingError(f"{folder}: expected one file *.gt.freiburg, got {len(truths)}")
    poses = _read_poses(inside(folder, truths[0].name, str(folder)))
    frames = []
    for where, words in read_rows(folder / "associations.txt"):
        if len(words) != 4:
            raise RecordingError(f"{where}: expected 'number depth/0.png number rgb/0.png', got {' '.join(words)!r}")
        number, paths = parse_numbers(words[:1], 1, where)[0], words[1::2]
        color, depth = paths if "depth" in paths[1] else paths[::-1]
        color_path, depth_path = (inside(folder, path, where) for path in (color, depth))
        if not (color_path.exists() or depth_path.exists()):  # a trimmed copy
            continue
        frames.append(
            ListedFrame(
                depth_path.stem, color_path, depth_path, INTRINSICS, DEPTH_SCALE, poses.get(number), number / 30.0
            )
        )
    return recording_of_frames(folder, NAME, SENSOR, frames, options)


def _read_poses(path: Path) -> dict[float, np.ndarray]:
    poses, columns = {}, quaternion_columns(path)
    for where, words in read_rows(path):
        words = in_usual_order(words, columns, where)
        number, *numbers = parse_numbers(words, 8, where)
        poses[number] = MIRROR @ parse_quaternion_pose(numbers, where) @ MIRROR
    return poses
