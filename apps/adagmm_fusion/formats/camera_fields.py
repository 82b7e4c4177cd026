"""Which fields of a nested document are of the colour camera and which of the depth camera.

A camera is an object with a focal length or a matrix. Whose it is say the words in its key or in those above it (color,
rgb, depth, ir, ...); the same words before a field, as in depth_fx or rgbDistortion, say whose that field is. Fields of
two cameras are never mixed, and two cameras that no words tell apart are refused.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.opencv_nodes import plain_name
from adagmm_fusion.rigs.depth_units import SCALES, UNITS
from adagmm_fusion.rigs.importing import DISTORTION_NAMES, HEIGHTS, MATRIX_NAMES, SPEAKS_OF_DISTORTION, WIDTHS

COLOR, DEPTH, BOTH = "color", "depth", "both"
MATRICES = (*MATRIX_NAMES, "camk", "intrinsics", "intrinsic")
SCALARS = {
    "fx": ("fx", "flx", "focalx", "focallengthx"),
    "fy": ("fy", "fly", "focaly", "focallengthy"),
    "cx": ("cx", "ppx", "principalpointx"),
    "cy": ("cy", "ppy", "principalpointy"),
}
# Width and height, or rows and columns as an array's shape has them.
SIZES, SHAPES = ("imagesize", "imgsize", "resolution", "size", "imageresolution"), ("imageshape", "imgshape", "shape")
COUNTING = {name for names in SCALARS.values() for name in names}
COUNTING |= {*MATRICES, *WIDTHS, *HEIGHTS, *SIZES, *SHAPES, *SCALES, *UNITS}
OF_DEPTH = {"scale": "depthscale", "units": "depthunits", "unit": "depthunits"}
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
COLOR_WORD, DEPTH_WORD = re.compile(r"colou?r|rgb(?!d)"), re.compile(r"depth|infra(?:red)?|^ir$|^tof$")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
MAX_DEPTH = 8


@dataclass(frozen=True)
class CameraFields:
    """One camera's fields by their plain name; `role` is COLOR, DEPTH or None, `name` where it is in the document."""

    role: str | None
    name: str
    values: dict[str, Any]


@dataclass(frozen=True)
class _Field:
    role: str | None
    path: tuple[str, ...]
    name: str
    value: Any


def role_of(name: str) -> str | None:
    """Whose a key or a file of this name is: COLOR, DEPTH, BOTH where it names both cameras, None where neither."""
    words = [word.lower() for word in WORD.findall(name)]
    color, depth = (any(kind.search(word) for word in words) for kind in (COLOR_WORD, DEPTH_WORD))
    return BOTH if color and depth else COLOR if color else DEPTH if depth else None


def camera_fields(document: Any, where: str) -> list[CameraFields]:
    """The cameras of a document: none, one, or the colour and the depth camera.

    Raises
    ------
    RecordingError  starting with `where`, if there are more, or it is not clear which is which.
    """
    fields = list(_fields(document, None, (), 0))
    places: dict[str | None, list[tuple[str, ...]]] = {}
    for role, path in dict.fromkeys((field.role, field.path) for field in fields if _is_focal(field)):
        places.setdefault(role, []).append(path)
    for role, paths in places.items():
        places[role] = _different(fields, role, paths)
    found = [(role, path) for role, paths in places.items() for path in paths]
    if (len(found) > 1 and {role for role, _ in found} != {COLOR, DEPTH}) or len(found) > 2:
        names = " and ".join(dict.fromkeys(_name(role, path) for role, path in found[:3]))
        raise RecordingError(
            f"{where}: it holds the intrinsics of {len(found)} cameras ({names}), and which is the colour camera's is "
            "not clear; call them color and depth, or keep only the colour camera's"
        )
    return [
        CameraFields(role, _name(role, path), _values(fields, role, path, where, alone=len(found) == 1))
        for role, path in found
    ]


def _fields(value: Any, role: str | None, path: tuple[str, ...], depth: int) -> Iterator[_Field]:
    if not isinstance(value, dict) or depth > MAX_DEPTH:
        return
    for key, item in value.items():
        head, dot, rest = key.partition(".")
        if dot and head and rest:  # Camera.fx, as ORB-SLAM has it
            yield from _fields({head: {rest: item}}, role, path, depth + 1)
            continue
        plain = plain_name(key)
        if plain in (*SCALES, *UNITS):  # of the depth images, whoever says it
            yield _Field(None, path, plain, _plain(item))
            continue
        own = role_of(key)
        if own == BOTH:  # where the cameras are to each other
            continue
        its = own or role
        name = _without_role(key)
        if isinstance(item, dict) and isinstance(item.get("data"), list):
            item = item["data"]
        if isinstance(item, dict):
            if "fisheye" in plain and item:
                yield _Field(its, path, "fisheye", True)
            yield from _fields(item, its, (*path, key), depth + 1)
        elif its == DEPTH and name in OF_DEPTH:
            yield _Field(None, path, OF_DEPTH[name], _plain(item))
        else:
            yield _Field(its, path, name, _plain(item))


def _without_role(key: str) -> str:
    words = (word for word in WORD.findall(key) if word.lower() not in ("ir", "tof"))
    return re.sub(r"depth|colou?r|rgb(?!d)|infra(?:red)?", "", "".join(words).lower()) or plain_name(key)


def _is_focal(field: _Field) -> bool:
    return field.name in SCALARS["fx"] or (field.name in MATRICES and isinstance(field.value, list))


def _different(fields: list[_Field], role: str | None, paths: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The places of a role's cameras without those that repeat another, word by word."""
    below: dict[tuple[str, ...], list[tuple[str, str]]] = {path: [] for path in sorted(paths, key=len)}
    for field in fields:
        for length in range(len(field.path) + 1) if field.role == role else ():
            below.get(field.path[:length], []).append((field.name, repr(field.value)))
    kept: dict[str, tuple[str, ...]] = {}
    for path, content in below.items():
        kept.setdefault(repr(sorted(content)), path)
    return list(kept.values())


def _name(role: str | None, path: tuple[str, ...]) -> str:
    name = ".".join(path)[:60]
    return ascii(name or role or "the outermost object")


def _values(
    fields: list[_Field], role: str | None, path: tuple[str, ...], where: str, *, alone: bool
) -> dict[str, Any]:
    """The fields of the camera at a place: its own, else those around it that are not of the other camera."""
    roles = {None, role}
    if role is None:  # then what is said of the colour camera, or else of the depth camera, is of this one
        roles.add(next((kind for kind in (COLOR, DEPTH) if any(field.role == kind for field in fields)), None))
    values: dict[str, Any] = {}
    ranks: dict[str, int] = {}
    for field in sorted(fields, key=lambda field: _rank(field.path, path)):
        rank, name, value = _rank(field.path, path), field.name, field.value
        if field.role not in roles:
            continue
        of_lens = name in DISTORTION_NAMES or SPEAKS_OF_DISTORTION.search(name) is not None
        if not alone and field.role is None and of_lens and is_something(value):
            raise RecordingError(
                f"{where}: {name}: of which camera is this lens distortion? Put it into color or into depth"
            )
        again = ranks.setdefault(name, rank) == rank and values.setdefault(name, value) != value
        if again and (of_lens or name in COUNTING):
            raise RecordingError(
                f"{where}: {name}: given twice, {str(values[name])[:40]} and {str(value)[:40]}; keep the right one"
            )
    return values


def _rank(path: tuple[str, ...], camera: tuple[str, ...]) -> int:
    """How near a field is to a camera's object: in it, below it, above it the nearer the better, elsewhere."""
    if path[: len(camera)] == camera:
        return 0 if path == camera else 1
    return 2 + len(camera) - len(path) if camera[: len(path)] == path else 2 + MAX_DEPTH * 2


def _plain(value: Any) -> Any:
    """Numbers that are written as text as numbers, several of them as a list."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    words = re.split(r"[\s,;]+", value.strip(" \t\n[]()")) if isinstance(value, str) and len(value) < 2000 else []
    if not words or not all(NUMBER.fullmatch(word) for word in words):
        return value
    return float(words[0]) if len(words) == 1 else [float(word) for word in words]


def is_something(value: Any) -> bool:
    """Whether there is a number in it that is not zero."""
    if isinstance(value, list):
        return any(is_something(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool) and value != 0
