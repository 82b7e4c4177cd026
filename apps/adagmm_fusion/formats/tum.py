"""TUM RGB-D folders: one moving Kinect with motion capture.

    rgb.txt, depth.txt      lines "timestamp path", e.g. 1305031233.731201 depth/1305031233.731201.png; # comments
    associations.txt        optional: lines "timestamp path timestamp path", colour and depth in either order, told
                            apart by depth.txt or the folder name depth/; without it the nearest stamps within 20 ms
                            are associated. With it rgb.txt and depth.txt need not be there
    groundtruth.txt         optional: lines "timestamp tx ty tz qx qy qz qw", or as a comment above names the columns,
                            camera to world, metres; interpolated at the depth stamp (linear, slerp) where the samples
                            around it are at most 0.1 s apart; a pose of NaN is none
    pairs.txt               optional: lines "source_depth_stamp target_depth_stamp"

Times are seconds; whole numbers that must be milli-, micro- or nanoseconds, by their size or distance, are taken so.
Depth: 16-bit PNG, 5000 units a metre, 0 none, registered to the colour image. Images that are listed and not there
(both of them: a trimmed copy) are passed over. Intrinsics: a file of them here (see camera_files.py), else by the
sensor's name (freiburg1 to 3) in the folder's name or the comments of depth.txt, else from a rig. Source: Sturm et al.
2012 and the file format page of the benchmark.
"""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside, load_frame
from adagmm_fusion.files.input_file import is_given, read_input_text, visible
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.own_camera import calibration_with_own
from adagmm_fusion.formats.pose_columns import in_usual_order, quaternion_columns
from adagmm_fusion.formats.text_table import is_lost, parse_numbers, read_rows
from adagmm_fusion.formats.time_units import units_per_second
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs

NAME = "tum"
SUMMARY = "TUM RGB-D folder (rgb.txt, depth.txt, groundtruth.txt)"
SENSOR = "kinect"
DEPTH_SCALE = 5000.0
MAX_ASSOCIATION_GAP_S = 0.02
MAX_WITHIN_GAP = 100  # no camera is that fast; all pairs of so many would be compared
MAX_POSE_GAP_S = 0.1
MAX_ABSENT = 0.5  # of the images that a list names
LISTS = ("rgb.txt", "depth.txt")
ASSOCIATIONS = ("associations.txt", "associate.txt", "association.txt")
# The benchmark's calibrations of the colour cameras, which the depth is registered to.
INTRINSICS = {
    "1": PinholeIntrinsics(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": PinholeIntrinsics(640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": PinholeIntrinsics(640, 480, 535.4, 539.2, 320.1, 247.6),
}


def matches(folder: Path) -> bool:
    if all(is_given(folder / name) for name in LISTS):
        return True
    listed = _associations_file(folder)
    if listed is None or any(visible(folder.glob("*.gt.freiburg"))):  # the latter is ICL-NUIM's
        return False
    try:
        first = next(read_rows(listed), ("", []))[1]
    except RecordingError:
        return False
    return len(first) == 4 and any(word.replace("\\", "/").startswith("depth/") for word in first[1::2])


def read(folder: Path, options: ReadOptions) -> Recording:
    listed = _associations_file(folder)
    if listed is not None and not all(is_given(folder / name) for name in LISTS):
        associations, depth_units = _read_associations(folder, listed, ())
        named = {listed.name: [path for _, *paths in associations for path in paths]}
    else:
        (colors, _), (depths, depth_units) = _read_stamps(folder, "rgb.txt"), _read_stamps(folder, "depth.txt")
        if listed is None:
            associations = _associate(folder, colors, depths)
        else:
            associations, _ = _read_associations(folder, listed, depths)
        named = {name: [path for _, path in images] for name, images in zip(LISTS, (colors, depths), strict=True)}
    present = [a for a in associations if a[2].exists() or a[1].exists()]
    if not present:
        first = f", such as {associations[0][1].relative_to(folder)}" if associations else ""
        raise RecordingError(
            f"{folder}: none of the {len(associations)} associated colour and depth images is there{first}"
        )
    stamps = np.array([depth_stamp for depth_stamp, _, _ in present])
    poses, time_notes = _poses_at(folder / "groundtruth.txt", stamps)
    intrinsics, depth_scale, camera_notes = calibration_with_own(
        folder, options, SENSOR, _known_intrinsics(folder), DEPTH_SCALE, (depth for _, _, depth in present)
    )
    entries = tuple(
        FrameEntry(
            depth.stem,
            SENSOR,
            partial(load_frame, depth.stem, SENSOR, color, depth, intrinsics, depth_scale, stamp),
            pose,
            stamp,
            depth,
        )
        for (stamp, color, depth), pose in zip(present, poses, strict=True)
    )
    if is_given(folder / "pairs.txt"):
        pairs = _read_pairs(folder / "pairs.txt", stamps, depth_units)
    else:
        pairs = sequential_pairs(len(entries), options.step)
    return Recording(
        folder.name, folder, NAME, entries, pairs, notes=(*camera_notes, *time_notes, *_absent(folder, named))
    )


def _read_stamps(folder: Path, name: str) -> tuple[list[tuple[float, Path]], float]:
    """(timestamp [s], image path), by time, and how many units of the file a second has."""
    listed = []
    for where, words in read_rows(folder / name):
        if len(words) != 2:
            raise RecordingError(f"{where}: expected 'timestamp path', got {' '.join(words)!r}")
        listed.append((parse_numbers(words[:1], 1, where)[0], inside(folder, words[1], where)))
    if not listed:
        raise RecordingError(f"{folder / name}: lists no image")
    units = units_per_second(stamp for stamp, _ in listed)
    return sorted((stamp / units, path) for stamp, path in listed), units


def _absent(folder: Path, named: dict[str, list[Path]]) -> list[str]:
    """What to say of lists most of whose images are not there; a few may be left out of any copy."""
    notes = []
    for name, paths in named.items():
        absent = [path for path in paths if not path.exists()]
        if len(absent) > MAX_ABSENT * len(paths):
            notes.append(
                f"{name}: {len(absent)} of its {len(paths)} images are not there, such as "
                f"{absent[0].relative_to(folder)}; frames that lack both are left out: is the copy whole?"
            )
    return notes


def _associations_file(folder: Path) -> Path | None:
    return next((folder / name for name in ASSOCIATIONS if is_given(folder / name)), None)


def _read_associations(
    folder: Path, listed: Path, depths: Sequence[tuple[float, Path]]
) -> tuple[list[tuple[float, Path, Path]], float]:
    """(depth stamp [s], colour path, depth path), by time, and how many units of the file a second has."""
    depth_paths = {path for _, path in depths}
    associations = []
    for where, words in read_rows(listed):
        if len(words) != 4:
            raise RecordingError(f"{where}: expected 'timestamp path timestamp path', got {' '.join(words)!r}")
        stamps = parse_numbers(words[0::2], 2, where)
        first, second = (inside(folder, word, where) for word in words[1::2])
        if first in depth_paths or first.is_relative_to(folder / "depth"):
            associations.append((stamps[0], second, first))
        else:
            associations.append((stamps[1], first, second))
    units = units_per_second(stamp for stamp, _, _ in associations)
    return sorted((stamp / units, color, depth) for stamp, color, depth in associations), units


def _associate(
    folder: Path, colors: Sequence[tuple[float, Path]], depths: Sequence[tuple[float, Path]]
) -> list[tuple[float, Path, Path]]:
    """The best partners first, each image once, as the benchmark's associate.py does."""
    color_stamps = np.array([stamp for stamp, _ in colors])
    candidates = []
    for j, (stamp, _) in enumerate(depths):
        first, last = np.searchsorted(color_stamps, (stamp - MAX_ASSOCIATION_GAP_S, stamp + MAX_ASSOCIATION_GAP_S))
        if last - first > MAX_WITHIN_GAP:
            what = f"{last - first} colour images within {MAX_ASSOCIATION_GAP_S:g} s of depth {stamp:g}"
            raise RecordingError(f"{folder / 'rgb.txt'}: expected timestamps in seconds, there are {what}")
        candidates += [(abs(color_stamps[i] - stamp), i, j) for i in range(first, last)]
    used_colors, used_depths, associations = set(), set(), []
    for _, i, j in sorted(candidates):
        if i not in used_colors and j not in used_depths:
            used_colors.add(i)
            used_depths.add(j)
            associations.append((depths[j][0], colors[i][1], depths[j][1]))
    return sorted(associations)


def _poses_at(path: Path, stamps: np.ndarray) -> tuple[list[np.ndarray | None], tuple[str, ...]]:
    """T_world_camera at each time, None outside the trajectory and in its gaps; and what to say if all are outside."""
    if not is_given(path):
        return [None] * len(stamps), ()
    rows, columns = [], quaternion_columns(path)
    for where, words in read_rows(path):
        words = in_usual_order(words, columns, where)
        if is_lost(words[1:]):
            continue
        numbers = parse_numbers(words, 8, where)
        if abs(np.linalg.norm(numbers[4:]) - 1) > 0.01:
            raise RecordingError(f"{where}: expected a unit quaternion qx qy qz qw, got {' '.join(words[4:])}")
        rows.append(numbers)
    if len(rows) < 2:
        raise RecordingError(f"{path}: expected at least two poses, got {len(rows)}")
    table = np.array(sorted(rows))
    table[:, 0] /= units_per_second(table[:, 0])
    times, translations, rotations = table[:, 0], table[:, 1:4], Rotation.from_quat(table[:, 4:])
    poses: list[np.ndarray | None] = []
    for stamp in stamps:
        after = np.searchsorted(times, stamp)
        exact = after < len(times) and times[after] == stamp
        before = after if exact else after - 1
        if before < 0 or after == len(times) or times[after] - times[before] > MAX_POSE_GAP_S:
            poses.append(None)
            continue
        pose = np.eye(4)
        if exact:
            pose[:3, :3], pose[:3, 3] = rotations[after].as_matrix(), translations[after]
        else:
            share = (stamp - times[before]) / (times[after] - times[before])
            pose[:3, :3] = Slerp([0.0, 1.0], rotations[[before, after]])(share).as_matrix()
            pose[:3, 3] = (1 - share) * translations[before] + share * translations[after]
        poses.append(pose)
    if np.any((stamps >= times[0]) & (stamps <= times[-1])):
        return poses, ()
    return poses, (
        f"{path.name}: it reaches from {times[0]:.3f} to {times[-1]:.3f} s and the frames from {stamps.min():.3f} to "
        f"{stamps.max():.3f} s, none within it; do their clocks differ? no pose is known, give both the same times",
    )


def _read_pairs(path: Path, stamps: np.ndarray, units: float) -> tuple[PairEntry, ...]:
    pairs = []
    for where, words in read_rows(path):
        indices = []
        for number in parse_numbers(words, 2, where):
            stamp = number / units
            after = int(np.searchsorted(stamps, stamp))
            nearest = min((i for i in (after - 1, after) if 0 <= i < len(stamps)), key=lambda i: abs(stamps[i] - stamp))
            if abs(stamps[nearest] - stamp) > 1e-6:
                raise RecordingError(
                    f"{where}: no frame has its depth at {stamp:.6f}; the nearest is {stamps[nearest]:.6f}"
                )
            indices.append(nearest)
        pairs.append(PairEntry(indices[0], indices[1]))
    return tuple(pairs)


def _known_intrinsics(folder: Path) -> PinholeIntrinsics | None:
    head = read_input_text(folder / "depth.txt", RecordingError)[:1000] if is_given(folder / "depth.txt") else ""
    found = re.search(r"freiburg([123])|\bfr([123])(?![0-9])", folder.resolve().name.replace("_", " ")) or re.search(
        r"freiburg([123])", head
    )
    return INTRINSICS[found[1] or found[2]] if found else None
