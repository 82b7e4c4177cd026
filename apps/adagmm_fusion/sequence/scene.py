"""Which frames of a recording show one scene, and how they follow each other."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from adagmm_fusion.clouds.building import dense_cloud, find_voxel_size
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.sequence.edges import Edge, rig_edge

ALL = "all"


@dataclass(frozen=True, eq=False)
class Scene:
    """Frames as indices into recording.entries; one pose is sought for each place that a sensor was in.

    frames : to be fused.    paths : each moving sensor's frames in order; none of fixed sensors.
    pairs : to be registered in any case.    rig : edges known from the extrinsics of a moving rig.
    moments : of each frame, the number of its moment.
    place_of : of each frame, the frame whose pose it shares: the sensor's first one where the sensors stand still.
    """

    frames: tuple[int, ...]
    paths: tuple[tuple[int, ...], ...]
    pairs: tuple[tuple[int, int], ...]
    rig: tuple[Edge, ...]
    moments: dict[int, int]
    place_of: dict[int, int]

    @property
    def places(self) -> tuple[int, ...]:
        return tuple(dict.fromkeys(self.place_of.values()))


def scene_of(recording: Recording, moment: str | None = None) -> Scene:
    """A moving sensor's or rig's whole way; of fixed sensors, what they see at one moment, by default the first, or at
    all of them ("all"), each sensor's pose following from all moments.

    Raises
    ------
    RecordingError  if there is no such moment, or `moment` is given for what moves.
    """
    entries = recording.entries
    names = {name: i for i, name in enumerate(dict.fromkeys(entry.name for entry in entries))}
    moves = len(recording.sensors) == 1 or recording.moving
    # A single sensor's frames need not have names of their own.
    moments = {i: i if len(recording.sensors) == 1 else names[entry.name] for i, entry in enumerate(entries)}
    if moves:
        if moment is not None:
            raise RecordingError(f"{recording.path}: what moves is fused as a whole; leave out --moment")
        return _moving(recording, moments)
    pairs = tuple((p.source, p.target) for p in recording.pairs if moments[p.source] == moments[p.target])
    paired = tuple(dict.fromkeys(index for source, target in pairs for index in (target, source)))
    if not paired:
        raise RecordingError(f"{recording.path}: there is no pair of sensors at one moment")
    first: dict[str, int] = {}
    for index in paired:
        first.setdefault(entries[index].sensor, index)
    shown = entries[paired[0]].name if moment is None else moment
    frames = tuple(index for index in paired if shown in (ALL, entries[index].name))
    if not frames:
        raise RecordingError(f"{recording.path}: there is no pair of sensors at moment {moment!r}")
    return Scene(frames, (), pairs, (), moments, {index: first[entries[index].sensor] for index in paired})


def _moving(recording: Recording, moments: dict[int, int]) -> Scene:
    frames = tuple(moments)
    paths = tuple(tuple(i for i in frames if recording.entries[i].sensor == sensor) for sensor in recording.sensors)
    known = {(p.source, p.target): p.T_target_source for p in recording.pairs if moments[p.source] == moments[p.target]}
    rig = tuple(rig_edge(*pair, T) for pair, T in known.items() if T is not None and len(paths) > 1)
    held = {(edge.source, edge.target) for edge in rig}
    listed = [(p.source, p.target) for p in recording.pairs]
    pairs = dict.fromkeys([*(step for path in paths for step in steps(path)), *listed])
    return Scene(frames, paths, tuple(pair for pair in pairs if pair not in held), rig, moments, {i: i for i in frames})


def steps(path: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    """(source, target) of each frame and the one before it."""
    return ((later, earlier) for earlier, later in pairwise(path))


def fixed_voxel_size(frame: RGBDFrame, settings: Settings) -> Settings:
    """The settings with one voxel size [m] for all frames: what fits this one."""
    if settings.voxel_size_m is not None:
        return settings
    cloud = dense_cloud(frame, max_depth=settings.max_depth_m)
    return replace(settings, voxel_size_m=find_voxel_size([cloud], settings.target_points))


def placed_edges(scene: Scene, edges: list[Edge]) -> list[Edge]:
    """The rig's edges and registered ones, between places."""
    return [
        *scene.rig,
        *(replace(edge, source=scene.place_of[edge.source], target=scene.place_of[edge.target]) for edge in edges),
    ]
