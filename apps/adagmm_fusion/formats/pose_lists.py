"""Camera poses in whatever files people keep them, before it is known which way round they are meant.

    a file a frame      in a folder called pose, poses, extrinsics, c2w, ..., or beside the images: 3x4 or 4x4 numbers
    one file            a line a frame of 16 or 12 numbers, also behind the frame's number or time; of 8: time tx ty tz
                        qx qy qz qw; of 7: without time; or Redwood's .log: three integers and four lines of four

Lines without number or time must be as many as frames. Arrays (.npy) are not read.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.formats.image_lists import NUMBER, number_of
from adagmm_fusion.formats.text_table import parse_numbers, parse_pose, parse_quaternion_pose, read_rows
from adagmm_fusion.formats.time_units import units_per_second

NAME = re.compile(
    r"pose|traj|ground_?truth|(^|[._-])gt([._-]|$)|odom|extrinsic|c2w|w2c|cam_?to_?world|world_?to_?cam", re.I
)
SUFFIXES = (".txt", ".csv", ".log", ".freiburg", ".tum", ".kitti")
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

    def __init__(self, by_frame: list[np.ndarray | None], path: Path) -> None:
        self.by_frame, self.path = by_frame, path
        name = f"{path.parent.name}/{path.name}"
        self.to_world = True if TO_WORLD.search(name) else False if TO_CAMERA.search(name) else None


def find_poses(folder: Path, images: Sequence[Path]) -> PoseList | None:
    """The poses of the frames whose depth images these are; None if there is no file of poses.

    Raises
    ------
    RecordingError  naming file and line, if a file of poses cannot be read or does not fit the frames.
    """
    for place in (folder, *(p for p in sorted(folder.iterdir()) if p.is_dir() and NAME.search(p.name))):
        named = [path for path in sorted(place.iterdir()) if path.suffix.lower() in SUFFIXES]
        if place == folder:
            named = [path for path in named if NAME.search(path.name)]
        named = [path for path in named if not NO_POSE.search(path.name)]
        named.sort(key=lambda path: (_rank(path.name), path.name))
        named = [inside(folder, str(path.relative_to(folder)), str(folder)) for path in named]
        numbered = {number: path for path in named if (number := number_of(_without_kind(path))) is not None}
        if len(numbered) == len(named) and len(named) > 1:
            return _a_file_a_frame(numbered, images)
        for path in named:
            if (poses := _one_file(path, images)) is not None:
                return PoseList(poses, path)
    return None


def _rank(name: str) -> int:
    """The surer poses first."""
    return next((i for i, words in enumerate(BETTER_FIRST) if re.search(words, name, re.IGNORECASE)), len(BETTER_FIRST))


def _without_kind(path: Path) -> Path:
    return Path(re.sub(r"\.(pose|extrinsic|c2w|w2c)$", "", path.stem))


def _a_file_a_frame(numbered: dict[float, Path], images: Sequence[Path]) -> PoseList:
    poses = []
    for image in images:
        path = numbered.get(-1.0 if (number := number_of(image)) is None else number)
        poses.append(None if path is None else read_pose_file(path))
    return PoseList(poses, next(iter(numbered.values())))


def read_pose_file(path: Path) -> np.ndarray | None:
    """A file of one pose, 3x4 or 4x4, as (4, 4); None where it holds NaN or infinity: tracking was lost."""
    words = [word for _, row in read_rows(path) for word in row if word]
    words = re.sub(r"[\[\],;]", " ", " ".join(words)).split()
    if any(word.lower().lstrip("+-") in ("nan", "inf") for word in words):
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


def _one_file(path: Path, images: Sequence[Path]) -> list[np.ndarray | None] | None:
    rows = [(where, re.sub(r"[,;\[\]]", " ", " ".join(words)).split()) for where, words in read_rows(path)]
    if rows and re.match(r"[A-Za-z_]", rows[0][1][0] if rows[0][1] else ""):
        rows = rows[1:]  # headings
    counts = {len(words) for _, words in rows}
    if counts == {3, 4} and len(rows) % 5 == 0:
        rows = [
            (rows[i][0], sum((words for _, words in rows[i + 1 : i + 5]), rows[i][1][:1]))
            for i in range(0, len(rows), 5)
        ]
        counts = {17}
    if (len(rows) == 4 and counts == {4}) or not rows or len(counts) != 1:
        return None
    count = counts.pop()
    if count not in (7, 8, 12, 13, 16, 17):
        return None
    numbers = [parse_numbers(words, count, where) for where, words in rows]
    poses = [
        _pose(row if count in (7, 8, 12, 16) else row[1:], where) for row, (where, _) in zip(numbers, rows, strict=True)
    ]
    if count in (7, 12, 16):
        if len(poses) != len(images):
            raise RecordingError(f"{path}: expected {len(images)} poses, as there are frames, got {len(poses)}")
        return list(poses)
    return _matched([row[0] for row in numbers], poses, images)


def _matched(keys: list[float], poses: list[np.ndarray], images: Sequence[Path]) -> list[np.ndarray | None]:
    """The pose of each frame by the last number in its name, or the first (Redwood has the time behind it); else the
    nearest in time."""
    exact = dict(zip(keys, poses, strict=True))
    wanted = [number_of(image) for image in images]
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
