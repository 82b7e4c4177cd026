"""Opening a recording, whatever its format."""

from collections import Counter
from itertools import islice
from pathlib import Path

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats import FORMATS, matching
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.recordings.frame_sequence import FrameEntry, FrameSequence, PairEntry, Recording
from adagmm_fusion.rigs.rig import Rig, load_rig
from adagmm_o3d.errors import InputError

# Of a folder that is no recording, so many entries are looked at, and so many subfolders tried.
MOST_LISTED, MOST_TRIED = 10_000, 100

__all__ = ["FORMATS", "FrameEntry", "FrameSequence", "PairEntry", "Recording", "open_recording", "recordings_inside"]


def open_recording(
    path: str | Path, *, format: str | None = None, rig: Rig | str | Path | None = None, step: int = 1
) -> Recording:
    """Open a recording. Nothing but its lists, poses and calibration is read now; images are read when asked
    for.

    Parameters
    ----------
    path : the recording's folder, or a video file.
    format : a name in FORMATS; None looks at what is there.
    rig : a Rig or a rig file that replaces the recording's own intrinsics, depth scales and (our layout) sensor poses.
    step : distance in frames of the two frames of a pair, for one moving sensor whose recording does not list its
    pairs.

    Raises
    ------
    RecordingError, RigError  naming the file, the line where there is one, what was wanted and what is there.
    """
    path = Path(path)
    try:
        there = path.exists()
    except OSError as problem:  # a name that is too long, a folder above it that may not be looked into
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from problem
    if not there:
        raise RecordingError(f"{path}: there is no such recording")
    if isinstance(step, bool) or not isinstance(step, int) or step < 1:
        raise InputError(f"step: expected a positive number of frames, got {step!r}")
    if rig is not None and not isinstance(rig, Rig):
        rig = load_rig(rig)
    if format is not None and format not in FORMATS:
        raise InputError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    try:
        return FORMATS[format or _detect(path)].read(path, ReadOptions(rig, step))
    except OSError as problem:  # folders that may not be listed, links in a circle
        raise RecordingError(f"{path}: cannot be read: {problem}") from problem


def _detect(path: Path) -> str:
    found = matching(path)
    if len(found) == 1:
        return found[0]
    if found:
        raise RecordingError(f"{path}: could be {' or '.join(found)}; say which with format")
    if inside := [] if path.is_file() else recordings_inside(path, MOST_LISTED, MOST_TRIED):
        more = " and others" if len(inside) > 1 else ""
        raise RecordingError(f"{path}: not a recording itself; name one of those in it, {inside[0]}{more}")
    raise RecordingError(f"{path}: not a recording of a known format; {_what_is_there(path)}; see recordings/README.md")


def recordings_inside(folder: Path, listed: int | None = None, tried: int | None = None) -> list[Path]:
    """The recordings among a folder's subfolders: among so many of its entries and so many subfolders; None for all."""
    folders = (child for child in sorted(islice(folder.iterdir(), listed)) if child.is_dir())
    return [child for child in islice(folders, tried) if matching(child)]


def _what_is_there(path: Path) -> str:
    """The kinds of files at a path, in a few words."""
    if path.is_file():
        return f"files ending in {path.suffix!r} are not read by themselves"
    listed = islice(path.iterdir(), MOST_LISTED)
    kinds = Counter("folders" if child.is_dir() else child.suffix.lower() or child.name for child in listed)
    common = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common(4))
    archives = any(file.suffix.lower() == ".npz" for file in islice(path.glob("*/*"), MOST_LISTED))
    hint = "; .npz archives are not read: save each array as .npy" if archives else ""
    return f"it holds {common or 'nothing'}, but no folder of colour and one of depth images{hint}"
