"""Which files of a folder are colour and which are depth images, and which belong together."""

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np

from adagmm_fusion.files.depth_files import DEPTH_SUFFIXES
from adagmm_fusion.files.image_files import COLOR_SUFFIXES
from adagmm_fusion.files.input_file import visible
from adagmm_fusion.formats.time_units import units_per_second

# Names of folders and files, the surer ones first; see _words.
DEPTH_WORDS = ("depth", "range", "tof", "disp", "disparity")
COLOR_WORDS = ("color", "colour", "rgb", "images", "image", "img", "frames", "frame", "cam")
# Of these a part of a longer word is as good; others are also in strange, display or tofu.
ANYWHERE = ("depth", *COLOR_WORDS)
# Words alone, for a part of a word may be anything: jetson, visit, config.
NEITHER = re.compile(
    r"(vis|visual\w*|mask\w*|segs?|segment\w*|label\w*|conf|confidences?|normal\w*|jet|"
    r"preview\w*|infra|infrared|ir)(map|maps|image|images)?\d*"
)
SPLIT = re.compile(r"(?<=[a-z])(?=[A-Z])|[^A-Za-z0-9]+|(?<=\d)(?=[A-Za-z])")
GLUED = re.compile(r"depth|colou?r|rgb|images?|imgs?|frames?")
WORDS = re.compile(r"depth|colou?r|rgb|images?|img|frames?|aligned|registered|raw|to|left|right|[-_. ]", re.IGNORECASE)
# 2024-05-01_12-00-00_123, also without what is between; the last digits are of a second.
DATE_TIME = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_ T.]?"
    r"(\d\d)[-_:.h]?(\d\d)[-_:.m]?(\d\d)(?:[-_.,s]?(\d{1,9}))?(?!\d)"
)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
MAX_ENTRIES = 200_000
# Images this far apart in time [s] are no partners.
MAX_GAP_S = 0.1
# So many images of either kind that are all as far from each other are no coincidence.
LEAST_ALIKE = 4


@dataclass(frozen=True)
class ImageLists:
    """Paths of all colour and all depth images, by name."""

    colors: tuple[Path, ...]
    depths: tuple[Path, ...]


def find_images(folder: Path) -> ImageLists | None:
    """The colour and depth images of a folder: in subfolders that are called so, or side by side; None without both.

    What lies deeper is not looked at: a folder of recordings is none itself. Folders that are links count where there
    are no others; whoever reads the images sees to it that they do not lead out.
    """
    return _find_images(folder, links=False) or _find_images(folder, links=True)


def _find_images(folder: Path, *, links: bool) -> ImageLists | None:
    groups: dict[Path, list[Path]] = {}
    for path in islice(_files(folder, links=links), MAX_ENTRIES):
        if path.suffix.lower() in (*COLOR_SUFFIXES, *DEPTH_SUFFIXES):
            groups.setdefault(path.parent, []).append(path)
    found = {}
    for kind, words, suffixes in (("depth", DEPTH_WORDS, DEPTH_SUFFIXES), ("color", COLOR_WORDS, COLOR_SUFFIXES)):
        ranked = []
        for parent, paths in groups.items():
            fitting = [path for path in paths if path.suffix.lower() in suffixes]
            rank = None if parent == folder else _rank(parent.name, words)
            if parent == folder:
                # Side by side: the files' own names say what they are.
                fitting, rank = [path for path in fitting if _is(kind, path, paths)], len(words)
            elif kind == "color" and _rank(parent.name, DEPTH_WORDS) is not None:
                continue
            if fitting and rank is not None and not (parent != folder and _is_neither(parent.name)):
                ranked.append((rank, -len(fitting), parent, fitting))
        found[kind] = min(ranked)[-1] if ranked else None
    if not (found["depth"] and found["color"]):
        return None
    return ImageLists(tuple(sorted(found["color"])), tuple(sorted(found["depth"])))


def pair_images(lists: ImageLists) -> list[tuple[str, Path, Path]]:
    """(name of the frame, colour, depth): by what is left of the names without words such as color, else by their last
    number, else by time; in the order of the numbers in the depth's names. Where these are dates with times, their last
    numbers are seconds or less, and say nothing alone."""
    times = _date_times(lists)
    least = 1.0 if times else 0.5  # the nearest in time are surer than half of the names
    for key in (_without_words,) if times else (_without_words, _last_number):
        colors, depths = ({key(path): path for path in paths} for paths in (lists.colors, lists.depths))
        common = [name for name in depths if name is not None and name in colors]
        unique = len(colors) == len(lists.colors) and len(depths) == len(lists.depths)
        if unique and len(common) >= least * min(len(colors), len(depths)):
            frames = [(depths[name].stem, colors[name], depths[name]) for name in common]
            break
    else:
        frames = _paired_by_time(lists, times)
    place = _order(times)
    return sorted(frames, key=lambda frame: place(frame[2]))


def number_of(path: Path) -> float | None:
    """The last number in a file's name, or None."""
    found = NUMBER.findall(path.stem)
    return float(found[-1]) if found else None


def constant_lag(lists: ImageLists) -> float | None:
    """By how much the numbers or times in the depth images' names are beyond those of as many colour images, in order,
    all alike and by more than half a step; None where it is not so."""
    times = _date_times(lists)
    numbers = [sorted(number for number, _ in _numbered(paths, times)) for paths in (lists.colors, lists.depths)]
    if len(numbers[0]) != len(numbers[1]) or len(numbers[0]) < LEAST_ALIKE:
        return None
    lags, step = np.subtract(numbers[1], numbers[0]), float(np.median(np.diff(numbers[0])))
    lag = float(np.median(lags))
    return lag if abs(lag) > 0.5 * step and np.abs(lags - lag).max() < 0.25 * step else None


def counted_otherwise(numbers: Collection[float], others: Collection[float]) -> float:
    """What to add to numbers that count from 0 to have the others, which count the same frames from 1: 1, or -1 where
    it is the other way round; 0 where they are not just that."""
    for shift, first in ((1.0, 0.0), (-1.0, 1.0)):
        if min(numbers, default=None) == first and {number + shift for number in numbers} == set(others):
            return shift
    return 0.0


def _files(folder: Path, *, links: bool) -> Iterator[Path]:
    """The files in a folder and in those in it."""
    for path in visible(folder.iterdir()):
        if not path.is_dir():
            yield path
        elif links or not path.is_symlink():
            yield from (child for child in visible(path.iterdir()) if not child.is_dir())


def _words(name: str) -> list[str]:
    """The words of a name, small: depthVis, depth_vis and depthvis are depth and vis."""
    words = []
    for part in SPLIT.split(name):
        words += [word for word in re.split(r"[^a-z0-9]+", GLUED.sub(r"-\g<0>-", part.lower())) if word]
    return words


def _is_neither(name: str) -> bool:
    return any(NEITHER.fullmatch(word) for word in _words(name))


def _rank(name: str, words: tuple[str, ...]) -> int | None:
    """How surely a folder's name is one of these words: depth, color and the like anywhere, shorter words alone."""
    own = {word.rstrip("0123456789") for word in _words(name)}
    small = name.lower()
    return next((i for i, word in enumerate(words) if (word in small if word in ANYWHERE else word in own)), None)


def _is(kind: str, path: Path, beside: list[Path]) -> bool:
    stem = path.name.lower()
    if _is_neither(path.stem):
        return False
    has_depth = any("depth" in other.name.lower() for other in beside)
    if kind == "depth":
        return "depth" in stem
    return "depth" not in stem and has_depth and path.suffix.lower() in COLOR_SUFFIXES


def _without_words(path: Path) -> str | None:
    return WORDS.sub("", path.stem) or None


def _last_number(path: Path) -> int | None:
    found = re.findall(r"\d+", path.stem)
    return int(found[-1][-18:]) if found else None


def in_order(lists: ImageLists) -> Callable[[Path], tuple[float, str]]:
    """What these images are sorted by: the time, where the names are dates with times, else the number in the name."""
    return _order(_date_times(lists))


def _order(times: dict[Path, float]) -> Callable[[Path], tuple[float, str]]:
    def key(path: Path) -> tuple[float, str]:
        number = times.get(path, number_of(path))
        return (np.inf if number is None else number, path.name)

    return key


def _date_times(lists: ImageLists) -> dict[Path, float]:
    """The times [s] of all images whose names are dates with times; empty if one's is not."""
    paths = (*lists.colors, *lists.depths)
    found = [match for path in paths if (match := DATE_TIME.search(path.stem))]
    if len(found) < len(paths):
        return {}
    parts = {len(match[7]) for match in found if match[7] is not None}
    # 7, 65 and 123 are milliseconds that nobody padded; equally long ones are decimals.
    digits = max(parts, default=0) if len(parts) < 2 else max(*parts, 3)
    times = {}
    for path, match in zip(paths, found, strict=True):
        try:
            year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
            whole = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:  # in no calendar
            return {}
        times[path] = whole.timestamp() + int(match[7] or 0) / 10.0**digits
    return times


def _numbered(paths: Collection[Path], dates: dict[Path, float]) -> list[tuple[float, Path]]:
    """The images that have a time or a number in their names, each with it."""
    return [(number, path) for path in paths if (number := dates[path] if dates else number_of(path)) is not None]


def _paired_by_time(lists: ImageLists, dates: dict[Path, float]) -> list[tuple[str, Path, Path]]:
    """Each depth image with the colour image nearest in time, each once, the best partners first."""
    times = []
    for paths in (lists.colors, lists.depths):
        known = _numbered(paths, dates)
        units = 1.0 if dates else units_per_second(number for number, _ in known)
        times.append([(number / units, path) for number, path in known])
    if not times[0] or not times[1]:
        return []
    stamps = np.array([time for time, _ in times[0]])
    candidates = sorted(
        (float(np.abs(stamps - time).min()), int(np.abs(stamps - time).argmin()), i)
        for i, (time, _) in enumerate(times[1])
    )
    used: set[int] = set()
    frames = []
    for gap, color, depth in candidates:
        if gap <= MAX_GAP_S and color not in used:
            used.add(color)
            frames.append((times[1][depth][1].stem, times[0][color][1], times[1][depth][1]))
    return frames
