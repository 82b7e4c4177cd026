"""Camera poses in whatever files people keep them, before it is known which way round they are meant.

    a file a frame      in a folder called pose, poses, extrinsics, c2w, ..., or beside the images: 3x4 or 4x4 numbers
    one file            a line a frame of 16 or 12 numbers, also behind the frame's number or time; of 8: time tx ty tz
                        qx qy qz qw; of 7: without time; or 4x4 or 3x4 numbers one below the other, also below the
                        frame's number or, as in Redwood's .log, three integers
    an array            poses.npy of (N, 4, 4), (N, 3, 4) or such lines

Headings or a comment above may name other columns of x y z and the quaternion. Lines without number or time must be as
many as frames, or as colour or as depth images where some have no partner. A pose of NaN is none: tracking was lost.
"""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import read_array
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import visible
from adagmm_fusion.formats.image_lists import NUMBER, counted_otherwise, find_images, in_order, number_of, pair_images
from adagmm_fusion.formats.pose_columns import in_usual_order, quaternion_columns
from adagmm_fusion.formats.text_table import (
    is_lost,
    parse_numbers,
    parse_pose,
    parse_quaternion_pose,
    read_rows,
    with_decimal_points,
)
from adagmm_fusion.formats.time_units import units_per_second

NAME = re.compile(
    r"pose|traj|ground_?truth|(^|[._-])gt([._-]|$)|odom|extrinsic|c2w|w2c|cam_?to_?world|world_?to_?cam", re.I
)
BINARY = (".npy",)
SUFFIXES = (".txt", ".csv", ".log", ".freiburg", ".tum", ".kitti", *BINARY)
NOT_READ = (".json", ".yaml", ".yml", ".npz", ".mat", ".pkl")
EXPECTED = "a pose of 7, 12 or 16 numbers a line, with the frame's number or time before it or without"
MAX_POSES = 1_000_000
NO_POSE = re.compile(r"depth_?(2|to)|color_?(2|to)|extrinsic_?(depth|colou?r)|readme|license", re.I)
BETTER_FIRST = (r"ground_?truth|(^|[._-])gt([._-]|$)", "traj", "pose|c2w|w2c")
# Names that say which way round.
TO_WORLD = re.compile(r"c2w|cam(era)?_?(2|to)_?world|T_world_cam|T_wc", re.I)
TO_CAMERA = re.compile(r"w2c|world_?(2|to)_?cam|T_cam(era)?_world|T_cw", re.I)
# A pose this far in time [s] from a frame is not its own.
MAX_GAP_S = 0.05


class PoseList:
    """Poses of frames, as given: `by_frame` (4, 4) or None for each; `path` is where they came from.

    to_world : whether the names say that they map the camera to the world; None where they do not say.
    """

    def __init__(self, by_frame: list[np.ndarray | None], path: Path, folder: Path) -> None:
        self.by_frame, self.path = by_frame, path
        name = str(path.relative_to(folder))  # that of the recording says nothing
        self.to_world = True if TO_WORLD.search(name) else False if TO_CAMERA.search(name) else None


def find_poses(folder: Path, images: Sequence[Path], notes: list[str]) -> PoseList | None:
    """The poses of the frames whose depth images these are; None if there is no file of poses.

    Parameters
    ----------
    notes : gets a line for each file that by its name has poses and is not understood.

    Raises
    ------
    RecordingError  naming file and line, if a file of poses cannot be read or does not fit the frames.
    """
    for place in (folder, *(p for p in visible(folder.iterdir()) if p.is_dir() and NAME.search(p.name))):
        named = [path for path in visible(place.iterdir()) if path.suffix.lower() in (*SUFFIXES, *NOT_READ)]
        if place == folder:
            named = [path for path in named if NAME.search(path.name)]
        named = [path for path in named if not NO_POSE.search(path.name)]
        named.sort(key=lambda path: (_rank(path.name), path.name))
        named = [inside(folder, str(path.relative_to(folder)), str(folder)) for path in named]
        known = [path for path in named if path.suffix.lower() in SUFFIXES]
        numbered = [(number, path) for path in known if (number := number_of(_without_kind(path))) is not None]
        by_number = dict(numbered)
        # What has no number beside a file a frame is about something else.
        if len(by_number) == len(numbered) > 1 and any(number_of(image) in by_number for image in images):
            return PoseList(_a_file_a_frame(by_number, images, notes), next(iter(by_number.values())), folder)
        left_out = []
        for path in named:
            poses = _one_file(path, folder, images, notes) if path in known else None
            if poses is not None:
                return PoseList(poses, path, folder)
            left_out.append(str(path.relative_to(folder)))
        if left_out:
            more = f" and {len(left_out) - 3} more" if len(left_out) > 3 else ""
            notes.append(f"{', '.join(left_out[:3])}{more}: not understood, left out; expected {EXPECTED}")
    return None


def _rank(name: str) -> int:
    """The surer poses first."""
    return next((i for i, words in enumerate(BETTER_FIRST) if re.search(words, name, re.IGNORECASE)), len(BETTER_FIRST))


def _without_kind(path: Path) -> Path:
    return Path(re.sub(r"\.(pose|extrinsic|c2w|w2c)$", "", path.stem))


def _a_file_a_frame(numbered: dict[float, Path], images: Sequence[Path], notes: list[str]) -> list[np.ndarray | None]:
    poses = []
    for number in _as_counted([number_of(image) for image in images], numbered, notes):
        path = numbered.get(-1.0 if number is None else number)
        poses.append(None if path is None else read_pose_file(path))
    return poses


def _as_counted(numbers: Sequence[float | None], keys: Collection[float], notes: list[str]) -> Sequence[float | None]:
    """The frames' numbers as the poses' keys count them; says so where one of both counts from 0 and one from 1."""
    shift = counted_otherwise([number for number in numbers if number is not None], keys)
    if not shift:
        return numbers
    first = ("0", "1") if shift > 0 else ("1", "0")
    notes.append(f"frames are counted from {first[0]} and their poses from {first[1]}: each has the pose of its place")
    return [None if number is None else number + shift for number in numbers]


def read_pose_file(path: Path) -> np.ndarray | None:
    """A file of one pose, 3x4 or 4x4, as (4, 4); None where it holds NaN or infinity: tracking was lost."""
    words = [word for _, row in _rows(path) for word in row]
    if is_lost(words):
        return None
    if len(words) not in (12, 16):
        raise RecordingError(f"{path}: expected a pose of 12 or 16 numbers, got {len(words)} words")
    return _pose(parse_numbers(words, len(words), str(path)), str(path))


def _pose(numbers: Sequence[float], where: str) -> np.ndarray:
    if len(numbers) in (7, 8):
        return parse_quaternion_pose(numbers[-7:], where)
    if len(numbers) == 12:
        numbers = [*numbers, 0.0, 0.0, 0.0, 1.0]
    T = np.reshape(numbers, (4, 4))
    if np.any(T[3, :3]) and not np.any(T[:3, 3]):  # column by column
        T = T.T
    return parse_pose(T, where)


def _one_file(path: Path, folder: Path, images: Sequence[Path], notes: list[str]) -> list[np.ndarray | None] | None:
    rows = _rows(path)
    if rows and re.match(r"[A-Za-z_]", rows[0][1][0] if rows[0][1] else ""):
        rows = rows[1:]  # headings
    rows = _blocks(rows)
    counts = {len(words) for _, words in rows}
    columns = quaternion_columns(path) if path.suffix.lower() not in BINARY else None
    if columns is not None:
        rows = [(where, in_usual_order(words, columns, where)) for where, words in rows]
        counts = {len(words) for _, words in rows}
    if len(counts) != 1 or not counts <= {7, 8, 12, 13, 16, 17}:
        return None
    with_key = not counts <= {7, 12, 16}
    keys = [parse_numbers(words[:1], 1, where)[0] for where, words in rows] if with_key else None
    poses = [_pose_or_lost(words[1:] if with_key else words, where) for where, words in rows]
    return _by_line(path, poses, folder, images) if keys is None else _matched(keys, poses, images, notes)


def _rows(path: Path) -> list[tuple[str, list[str]]]:
    """("file:line", the words) of each line; of an array each matrix is a line, of a single one each row."""
    if path.suffix.lower() not in BINARY:
        rows = ((where, with_decimal_points(" ".join(words))) for where, words in read_rows(path))
        return [(where, re.sub(r"[,;\[\]]", " ", row).split()) for where, row in rows]
    array = read_array(path)
    table = array.reshape(len(array), -1) if array.ndim in (2, 3) else np.zeros((0, 0))
    return [(f"{path}: [{i}]", [repr(float(x)) for x in row]) for i, row in enumerate(table[:MAX_POSES])]


def _blocks(rows: list[tuple[str, list[str]]]) -> list[tuple[str, list[str]]]:
    """A row a pose, where each has several: 4x4 or 3x4 numbers one below the other, or Redwood's or the frame's number
    above each."""
    counts = {len(words) for _, words in rows}
    if counts == {4} and len(rows) > 4:
        last_rows = {tuple(words) for _, words in rows[3::4]}
        has_last_row = len(rows) % 4 == 0 and all(_is_last_row(words) for words in last_rows)
        height = 4 if has_last_row else 3
        if not has_last_row and not _is_pose([word for _, words in rows[:3] for word in words]):
            return rows  # such as a place and a time a line
    elif counts in ({3, 4}, {1, 4}):
        height = 5
    else:
        return rows
    first = 1 if height == 5 else 4  # words that count of a pose's first row
    if len(rows) % height or (height == 5 and any(len(words) == 4 for _, words in rows[::5])):
        return rows
    return [
        (rows[i][0], [*rows[i][1][:first], *(word for _, words in rows[i + 1 : i + height] for word in words)])
        for i in range(0, len(rows), height)
    ]


def _is_pose(words: list[str]) -> bool:
    try:
        _pose_or_lost(words, "")
    except RecordingError:
        return False
    return True


def _is_last_row(words: Sequence[str]) -> bool:
    try:
        return [float(word) for word in words] == [0, 0, 0, 1] or is_lost(words)
    except ValueError:
        return False


def _pose_or_lost(words: list[str], where: str) -> np.ndarray | None:
    """None where it holds NaN or infinity: tracking was lost."""
    return None if is_lost(words) else _pose(parse_numbers(words, len(words), where), where)


def _by_line(
    path: Path, poses: list[np.ndarray | None], folder: Path, images: Sequence[Path]
) -> list[np.ndarray | None]:
    """The poses of a file without numbers: a line a frame, or, where some have no partner, a line a colour or a depth
    image, or a number that any of them has, in order."""
    if len(poses) == len(images):
        return list(poses)
    lists = find_images(folder)
    found = []
    if lists is not None:
        partners = {depth: color for _, color, depth in pair_images(lists)}
        for all_images, own in ((lists.colors, [partners.get(path) for path in images]), (lists.depths, images)):
            place = {image: i for i, image in enumerate(sorted(all_images, key=in_order(lists)))}
            if len(all_images) == len(poses) and all(image in place for image in own):
                found.append([place[image] for image in own if image is not None])
        # Where either list lacks images, all of them may be numbered.
        numbers = {path: number_of(_without_kind(path)) for path in (*lists.colors, *lists.depths)}
        row = {at: i for i, at in enumerate(sorted({n for n in numbers.values() if n is not None}))}
        if not found and None not in numbers.values() and len(row) == len(poses):
            found.append([row[at] for path in images if (at := numbers[path]) is not None])
    if not found or any(places != found[0] for places in found):
        which = ", and colour and depth images count differently" if found else ""
        raise RecordingError(
            f"{path}: expected {len(images)} poses, as there are frames, got {len(poses)}{which}; "
            "put each frame's number before its pose"
        )
    return [poses[i] for i in found[0]]


def _matched(
    keys: list[float], poses: list[np.ndarray | None], images: Sequence[Path], notes: list[str]
) -> list[np.ndarray | None]:
    """The pose of each frame by the last number in its name, or the first (Redwood has the time behind it); else the
    nearest in time."""
    exact = dict(zip(keys, poses, strict=True))
    wanted = _as_counted([number_of(image) for image in images], keys, notes)
    for numbers in (wanted, [_first_number(image) for image in images]):
        if sum(number in exact for number in numbers) * 2 >= len(numbers):
            return [exact.get(np.nan if number is None else number) for number in numbers]
    known = [number for number in wanted if number is not None]
    if not known:
        return [None] * len(wanted)
    times, units = np.array(keys) / units_per_second(keys), units_per_second(known)
    nearest_frames: dict[int, tuple[float, int]] = {}  # a pose is of one frame, the next ones have another
    for i, number in enumerate(wanted):
        gaps = np.abs(times - (np.inf if number is None else number / units))
        nearest = int(gaps.argmin())
        if gaps[nearest] <= MAX_GAP_S:
            nearest_frames[nearest] = min(nearest_frames.get(nearest, (np.inf, 0)), (float(gaps[nearest]), i))
    found: list[np.ndarray | None] = [None] * len(wanted)
    for nearest, (_, i) in nearest_frames.items():
        found[i] = poses[nearest]
    return found


def _first_number(image: Path) -> float | None:
    found = NUMBER.search(image.stem)
    return None if found is None else float(found[0])
