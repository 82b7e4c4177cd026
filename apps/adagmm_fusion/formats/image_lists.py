"""Which files of a folder are colour and which are depth images, and which belong together."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from adagmm_fusion.files.depth_files import DEPTH_SUFFIXES
from adagmm_fusion.files.image_files import COLOR_SUFFIXES
from adagmm_fusion.formats.time_units import units_per_second

# Names of folders and files, the surer ones first.
DEPTH_WORDS = ("depth", "range", "tof", "disp")
COLOR_WORDS = ("color", "colour", "rgb", "images", "image", "img", "frames", "frame", "cam")
NEITHER = re.compile(r"vis|mask|seg|label|conf|normal|jet|preview|infra|(^|[^a-z])ir([^a-z]|$)", re.IGNORECASE)
WORDS = re.compile(r"depth|colou?r|rgb|images?|img|frames?|aligned|registered|raw|to|left|right|[-_. ]", re.IGNORECASE)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
MAX_ENTRIES = 200_000
# Images this far apart in time [s] are no partners.
MAX_GAP_S = 0.1


@dataclass(frozen=True)
class ImageLists:
    """Paths of all colour and all depth images, by name."""

    colors: tuple[Path, ...]
    depths: tuple[Path, ...]


def find_images(folder: Path) -> ImageLists | None:
    """The colour and depth images of a folder: in subfolders that are called so, or side by side; None without both.

    What lies deeper is not looked at: a folder of recordings is none itself.
    """
    groups: dict[Path, list[Path]] = {}
    for path in islice(_files(folder), MAX_ENTRIES):
        if path.suffix.lower() in (*COLOR_SUFFIXES, *DEPTH_SUFFIXES):
            groups.setdefault(path.parent, []).append(path)
    found = {}
    for kind, words, suffixes in (("depth", DEPTH_WORDS, DEPTH_SUFFIXES), ("color", COLOR_WORDS, COLOR_SUFFIXES)):
        ranked = []
        for parent, paths in groups.items():
            fitting = [path for path in paths if path.suffix.lower() in suffixes]
            rank = None if parent == folder else _rank(parent.name.lower(), words)
            if parent == folder:
                # Side by side: the files' own names say what they are.
                fitting, rank = [path for path in fitting if _is(kind, path, paths)], len(words)
            elif kind == "color" and _rank(parent.name.lower(), DEPTH_WORDS) is not None:
                continue
            if fitting and rank is not None and not NEITHER.search("" if parent == folder else parent.name):
                ranked.append((rank, -len(fitting), parent, fitting))
        found[kind] = min(ranked)[-1] if ranked else None
    if not (found["depth"] and found["color"]):
        return None
    return ImageLists(tuple(sorted(found["color"])), tuple(sorted(found["depth"])))


def pair_images(lists: ImageLists) -> list[tuple[str, Path, Path]]:
    """(name of the frame, colour, depth): by what is left of the names without words such as color, else by their last
    number, else by time; in the order of the numbers in the depth's names."""
    for key in (_without_words, _last_number):
        colors, depths = ({key(path): path for path in paths} for paths in (lists.colors, lists.depths))
        common = [name for name in depths if name is not None and name in colors]
        unique = len(colors) == len(lists.colors) and len(depths) == len(lists.depths)
        if unique and 2 * len(common) >= min(len(colors), len(depths)):
            return sorted(
                ((depths[name].stem, colors[name], depths[name]) for name in common), key=lambda f: in_order(f[2])
            )
    return _paired_by_time(lists)


def number_of(path: Path) -> float | None:
    """The last number in a file's name, or None."""
    found = NUMBER.findall(path.stem)
    return float(found[-1]) if found else None


def _files(folder: Path) -> Iterator[Path]:
    """The files in a folder and in those in it."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if not path.is_dir():
            yield path
        elif not path.is_symlink():
            yield from (child for child in sorted(path.iterdir()) if not child.is_dir())


def _rank(name: str, words: tuple[str, ...]) -> int | None:
    return next((i for i, word in enumerate(words) if word in name), None)


def _is(kind: str, path: Path, beside: list[Path]) -> bool:
    stem = path.name.lower()
    if NEITHER.search(stem):
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


def in_order(path: Path) -> tuple[float, str]:
    """What images are sorted by: the number in the name."""
    number = number_of(path)
    return (np.inf if number is None else number, path.name)


def _paired_by_time(lists: ImageLists) -> list[tuple[str, Path, Path]]:
    """Each depth image with the colour image nearest in time, each once, the best partners first."""
    times = []
    for paths in (lists.colors, lists.depths):
        known = [(number, path) for path in paths if (number := number_of(path)) is not None]
        units = units_per_second(number for number, _ in known)
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
    return sorted(frames, key=lambda frame: in_order(frame[2]))
