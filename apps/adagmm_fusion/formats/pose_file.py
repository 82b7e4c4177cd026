"""Folders with one pose file, as deep-video-mvs keeps HoloLens recordings.

    images/*.png            RGB
    depth/*.png             16 bit, millimetres, 0 none, registered to the colour image, same names as in images/
    K.txt                   3x3 camera matrix
    all_frame_names.txt     one image name a line
    poses.txt               16 numbers a line, T_world_camera row by row, metres; as many lines as all_frame_names.txt;
                            one of NaN where tracking was lost
    pairs.txt               optional: lines "source_name target_name"

Frames that are listed and of which neither image is there (a trimmed copy) are passed over.
"""

from functools import partial
from pathlib import Path

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import image_size, inside, load_frame
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose_or_lost, read_matrix, read_rows
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs

NAME = "posefile"
SUMMARY = "folder with images/, depth/, K.txt, poses.txt, all_frame_names.txt"
SENSOR = "camera"
DEPTH_SCALE = 1000.0


def matches(folder: Path) -> bool:
    return all(is_given(folder / name) for name in ("K.txt", "poses.txt", "all_frame_names.txt"))


def read(folder: Path, options: ReadOptions) -> Recording:
    names = []
    for where, words in read_rows(folder / "all_frame_names.txt"):
        if len(words) != 1:
            raise RecordingError(f"{where}: expected one image name, got {' '.join(words)!r}")
        color, depth = (inside(folder, f"{kind}/{words[0]}", where) for kind in ("images", "depth"))
        names.append((words[0], color, depth))
    poses = [parse_pose_or_lost(words, where) for where, words in read_rows(folder / "poses.txt")]
    if len(poses) != len(names):
        raise RecordingError(
            f"{folder / 'poses.txt'}: expected {len(names)} poses, as all_frame_names.txt has names, got {len(poses)}"
        )
    present = [
        (name, color, depth, pose)
        for (name, color, depth), pose in zip(names, poses, strict=True)
        if color.exists() or depth.exists()
    ]
    if not present:
        raise RecordingError(f"{folder}: none of the {len(names)} images of all_frame_names.txt is there")
    own = intrinsics_from_matrix(read_matrix(folder / "K.txt", 3, 3), image_size(present[0][2]), folder / "K.txt")
    intrinsics, depth_scale = options.calibration(SENSOR, own, DEPTH_SCALE, folder)
    entries = tuple(
        FrameEntry(
            depth.stem,
            SENSOR,
            partial(load_frame, depth.stem, SENSOR, color, depth, intrinsics, depth_scale),
            pose,
            depth_file=depth,
        )
        for _, color, depth, pose in present
    )
    if is_given(folder / "pairs.txt"):
        pairs = _read_pairs(folder / "pairs.txt", [name for name, *_ in present])
    else:
        pairs = sequential_pairs(len(entries), options.step)
    return Recording(folder.name, folder, NAME, entries, pairs)


def _read_pairs(path: Path, names: list[str]) -> tuple[PairEntry, ...]:
    index = {name: i for i, name in enumerate(names)}
    pairs = []
    for where, words in read_rows(path):
        if len(words) != 2:
            raise RecordingError(f"{where}: expected 'source_name target_name', got {' '.join(words)!r}")
        for word in words:
            if word not in index:
                raise RecordingError(f"{where}: there is no frame {word!r}")
        pairs.append(PairEntry(index[words[0]], index[words[1]]))
    return tuple(pairs)
