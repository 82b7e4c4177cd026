"""A recording in memory: what frames and pairs there are, read from disk one at a time when asked for."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_o3d.lie import se_inverse


@dataclass(frozen=True, eq=False)
class FrameEntry:
    """A frame that can be loaded, again and again. `T_world_camera` (4, 4) is its true pose, or None; `depth_file` is
    what its depth alone is read from, where there is such a file."""

    name: str
    sensor: str
    load: Callable[[], RGBDFrame]
    T_world_camera: np.ndarray | None = None
    timestamp: float | None = None
    depth_file: Path | None = None


@dataclass(frozen=True, eq=False)
class PairEntry:
    """Indices of the two frames of a pair; the source moves onto the target. `T_target_source` is given where the
    frames' poses do not say it."""

    source: int
    target: int
    T_target_source: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """All frames of a recording, of all its sensors, in order."""

    entries: tuple[FrameEntry, ...]

    def __len__(self) -> int:
        return len(self.entries)

    def frame(self, index: int) -> RGBDFrame:
        """Load a frame. Raises RecordingError if its files cannot be used."""
        return self.entries[index].load()

    def pose(self, index: int) -> np.ndarray | None:
        """The true T_world_camera (4, 4), or None where it is not known."""
        return self.entries[index].T_world_camera

    def timestamp(self, index: int) -> float | None:
        """Seconds, or None."""
        return self.entries[index].timestamp

    def name(self, index: int) -> str:
        return self.entries[index].name

    def sensor(self, index: int) -> str:
        return self.entries[index].sensor


@dataclass(frozen=True, eq=False)
class Recording:
    """Pairs of frames to register: `len(recording)`, `recording[i]`, `for pair in recording`, loaded at each access.

    moving : whether several sensors are on one moving rig; a single sensor is taken to move.
    notes : what reading left out or took for granted, a line each.

    Raises
    ------
    RecordingError  if there is no pair, one of a frame with itself, or two of one name, or a name cannot be printed.
    """

    name: str
    path: Path
    format: str
    entries: tuple[FrameEntry, ...]
    pairs: tuple[PairEntry, ...]
    moving: bool = False
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        for name in dict.fromkeys([self.name, *(n for entry in self.entries for n in (entry.sensor, entry.name))]):
            if not name.isprintable():
                raise RecordingError(f"{self.path}: the name {name!a} cannot be printed; rename it")
        if not self.pairs:
            raise RecordingError(
                f"{self.path}: no pair of frames to register, there is {len(self.entries)} frame(s) in all; "
                "record more, or take a smaller step" + "".join(f"; {note}" for note in self.notes)
            )
        names = set()
        for index, pair in enumerate(self.pairs):
            name = self.pair_name(index)
            if pair.source == pair.target:
                raise RecordingError(f"{self.path}: pair {name}: expected two frames, got one as both")
            if name in names:  # its results would take the place of the other's
                raise RecordingError(
                    f"{self.path}: two pairs are {name}; list each once, with frames of different names"
                )
            names.add(name)

    @property
    def sensors(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(entry.sensor for entry in self.entries))

    def frames(self) -> FrameSequence:
        return FrameSequence(self.entries)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> RGBDPair:
        pair = self.pairs[index]
        source, target = self.entries[pair.source], self.entries[pair.target]
        T_target_source = pair.T_target_source
        if T_target_source is None and source.T_world_camera is not None and target.T_world_camera is not None:
            T_target_source = se_inverse(target.T_world_camera) @ source.T_world_camera
        position = index % len(self.pairs)
        return RGBDPair(self.pair_name(position), source.load(), target.load(), T_target_source, position)

    def __iter__(self) -> Iterator[RGBDPair]:
        return (self[i] for i in range(len(self)))

    def pair_name(self, index: int) -> str:
        """A name fit for files and the viewer, without loading the pair."""
        source, target = (self.entries[i] for i in (self.pairs[index].source, self.pairs[index].target))
        if source.sensor == target.sensor:
            return f"{source.name}_to_{target.name}"
        if source.name == target.name:
            return f"{source.name}_{source.sensor}_to_{target.sensor}"
        return f"{source.sensor}_{source.name}_to_{target.sensor}_{target.name}"


def sequential_pairs(count: int, step: int) -> tuple[PairEntry, ...]:
    """Pairs along one sensor's path, `step` frames apart, the later frame onto the earlier one, end to end."""
    return tuple(PairEntry(i + step, i) for i in range(0, count - step, step))
