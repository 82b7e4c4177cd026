"""Which frames of a recording are registered with each other, and doing it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from adagmm_fusion.clouds import dense_cloud, find_voxel_size
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frame_sequence import Recording
from adagmm_fusion.frames import RGBDFrame, RGBDPair
from adagmm_fusion.pipeline import register_pair
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.pose_graph import Edge, best_connected, chained_poses
from adagmm_fusion.settings import Settings
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.evaluation import information_matrix, pose_errors

# A frame that cannot be registered with the one before is tried with those before that.
MAX_GAP = 3
# One wrong pose bends the whole path, so geometry that the colour images do not confirm must overlap this much.
MIN_OVERLAP_ALONE = 0.6
# Frames this near that are not neighbours close a loop; of each frame, the nearest ones.
LOOP_ROTATION_DEG, LOOP_TRANSLATION_M, LOOPS_PER_FRAME = 25.0, 0.5, 2
LOOP_MIN_GAP = 3

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Scene:
    """The frames that show one unmoving scene: indices into recording.entries, and the pairs to register first."""

    frames: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    is_path: bool


def scene_of(recording: Recording, moment: str | None = None) -> Scene:
    """One sensor's whole path; of several sensors, what they see at one moment, by default the first.

    Raises
    ------
    RecordingError  if there is no such moment, or `moment` is given for a path.
    """
    entries = recording.entries
    if len(recording.sensors) == 1:
        if moment is not None:
            raise RecordingError(f"{recording.path}: one sensor's path is fused as a whole; leave out --moment")
        frames = tuple(range(len(entries)))
        listed = ((pair.source, pair.target) for pair in recording.pairs)
        return Scene(frames, tuple(dict.fromkeys([*((i + 1, i) for i in frames[:-1]), *listed])), is_path=True)
    moment = entries[recording.pairs[0].target].name if moment is None else moment
    pairs = [
        (p.source, p.target) for p in recording.pairs if entries[p.source].name == entries[p.target].name == moment
    ]
    if not pairs:
        raise RecordingError(f"{recording.path}: there is no pair of sensors at moment {moment!r}")
    frames = tuple(dict.fromkeys(index for source, target in pairs for index in (target, source)))
    return Scene(frames, tuple(pairs), is_path=False)


def fixed_voxel_size(frame: RGBDFrame, settings: Settings) -> Settings:
    """The settings with one voxel size [m] for all frames: what fits this one."""
    if settings.voxel_size_m is not None:
        return settings
    cloud = dense_cloud(frame, max_depth=settings.max_depth_m)
    return replace(settings, voxel_size_m=find_voxel_size([cloud], settings.target_points))


def register_scene(recording: Recording, scene: Scene, settings: Settings, file: EdgeFile, progress: Progress) -> None:
    """Fill the file with the edges that it lacks: neighbours along the path first, then loop closures."""
    frames = _LastFrames(recording)
    for done, (source, target) in enumerate(scene.pairs):
        progress(done, len(scene.pairs))
        edge = _registered(frames, source, target, settings, file, loop_closure=False)
        for gap in range(2, MAX_GAP + 1) if scene.is_path and not edge.usable else ():
            if (
                source - gap >= 0
                and _registered(frames, source, source - gap, settings, file, loop_closure=False).usable
            ):
                break
    poses = chained_poses(file.edges, best_connected(file.edges, scene.frames))
    loops = list(loop_candidates(poses)) if scene.is_path else []
    for done, (source, target) in enumerate(loops):
        progress(done, len(loops))
        _registered(frames, source, target, settings, file, loop_closure=True)


def loop_candidates(poses: dict[int, np.ndarray]) -> Iterator[tuple[int, int]]:
    """(source, target) of frames near each other that are not neighbours on the path, each one's nearest."""
    frames = sorted(poses)
    for source in frames:
        near = []
        for target in frames:
            if target > source - LOOP_MIN_GAP:
                break
            apart = pose_errors(poses[target], poses[source])
            if apart.rotation_deg <= LOOP_ROTATION_DEG and apart.translation <= LOOP_TRANSLATION_M:
                distance = apart.rotation_deg / LOOP_ROTATION_DEG + apart.translation / LOOP_TRANSLATION_M
                near.append((distance, target))
        yield from ((source, target) for _, target in sorted(near)[:LOOPS_PER_FRAME])


class _LastFrames:
    """Loads frames and keeps the last few, so that memory does not grow with the recording."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._kept = recording, {}

    def pair(self, source: int, target: int) -> RGBDPair:
        frames = [self._frame(index) for index in (source, target)]
        entries = self._recording.entries
        return RGBDPair(f"{entries[source].name}_to_{entries[target].name}", *frames, None, 0)

    def _frame(self, index: int) -> RGBDFrame:
        frame = self._kept.pop(index, None) or self._recording.entries[index].load()
        self._kept[index] = frame
        while len(self._kept) > 2:
            self._kept.pop(next(iter(self._kept)))
        return frame


def _registered(frames, source: int, target: int, settings: Settings, file: EdgeFile, *, loop_closure: bool) -> Edge:
    edge = file.find(source, target)
    if edge is None:
        edge = _register(frames, source, target, settings, loop_closure)
        file.add(edge)
    return edge


def _register(frames: _LastFrames, source: int, target: int, settings: Settings, loop_closure: bool) -> Edge:
    try:
        outcome = register_pair(frames.pair(source, target), settings)
    except AdaGMMError as problem:
        return Edge(source, target, None, None, loop_closure, " ".join(str(problem).split()))
    if outcome.status != "ok":
        return Edge(source, target, None, None, loop_closure, outcome.reason)
    if outcome.features is None and outcome.evaluation.overlap < MIN_OVERLAP_ALONE:
        reason = (
            f"overlap {outcome.evaluation.overlap:.2f} is below {MIN_OVERLAP_ALONE:g} and the colours do not confirm it"
        )
        return Edge(source, target, None, None, loop_closure, reason)
    T = np.asarray(outcome.T_estimate)
    points = (np.asarray(cloud.points) for cloud in (outcome.source_cloud, outcome.target_cloud))
    information = information_matrix(*points, partner_distance(settings), T)
    return Edge(source, target, T, information, loop_closure)


def partner_distance(settings: Settings) -> float:
    """How near points count as partners in the information matrices [m]; the same for all of a graph."""
    return settings.partner_distance_m or 1.5 * settings.voxel_size_m
