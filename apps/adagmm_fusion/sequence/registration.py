"""Registering a scene's frames with each other: neighbours first, then whatever else may show the same place, and at
last, where parts hang together by nothing, frames of one part with those of another."""

from collections.abc import Callable

from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.edges import NOT_CONFIRMED, Edge, registered_edge
from adagmm_fusion.sequence.joining import joined
from adagmm_fusion.sequence.loop_candidates import alike_frames, evenly, near_frames, thinned
from adagmm_fusion.sequence.pose_graph import chained_poses, connected_sets
from adagmm_fusion.sequence.scene import Scene
from adagmm_o3d.errors import AdaGMMError

# If a frame cannot be registered with the one before it, this many earlier ones are tried.
MAX_GAP = 3

Progress = Callable[[str, int, int], None]


def register_scene(recording: Recording, scene: Scene, settings: Settings, file: EdgeFile, progress: Progress) -> None:
    """Fill the file with the edges that it lacks. `progress` is told what is done, how much of it, and of how many."""
    registrar = _Registrar(recording, settings, file)
    before = {frame: path[:i][::-1] for path in scene.paths for i, frame in enumerate(path)}
    for done, (source, target) in enumerate(scene.pairs):
        progress("registering neighbours", done, len(scene.pairs))
        # Fixed sensors are registered again and again: a moment that contradicts the others may be dropped.
        usable = registrar.edge(source, target, loop_closure=not scene.paths).usable
        if not usable and target in before.get(source, ())[:1]:
            any(registrar.edge(source, further).usable for further in before[source][1:MAX_GAP])
    if not scene.paths:
        return
    alike = alike_frames(
        recording, scene.frames, scene.moments, lambda done, total: progress("comparing images", done, total)
    )
    alike = thinned(alike, scene.moments)
    for done, (source, target) in enumerate(alike):
        progress("registering images that are alike", done, len(alike))
        registrar.edge(source, target, loop_closure=True, confirmed_only=True)
    edges = [*scene.rig, *file.edges]
    poses = chained_poses(edges, connected_sets(edges, scene.frames)[0][0])
    sensors = {frame: recording.entries[frame].sensor for frame in scene.frames}
    near = thinned(near_frames(poses, scene.moments, sensors), scene.moments)
    for done, (source, target) in enumerate(near):
        progress("closing loops", done, len(near))
        registrar.edge(source, target, loop_closure=True)
    _join(scene, file, registrar, progress)


def _join(scene: Scene, file: EdgeFile, registrar: "_Registrar", progress: Progress) -> None:
    """Register frames of different parts until nothing is apart, those that follow each other closest first."""
    pairs = evenly(scene.frames, scene.moments)
    part_of = _parts(scene, file)
    for done, (source, target) in enumerate(pairs):
        known = [edge for edge in (file.find(source, target), file.find(target, source)) if edge is not None]
        looked_at = any(edge.reason != NOT_CONFIRMED or edge.doubtful for edge in known)
        if looked_at or part_of[source] == part_of[target]:
            continue
        progress("joining parts", done, len(pairs))
        edge = registrar.edge(source, target, loop_closure=True, joining=True)
        if edge.usable or edge.doubtful:
            part_of = _parts(scene, file)


def _parts(scene: Scene, file: EdgeFile) -> dict[int, int]:
    """Of each frame the number of the part that it belongs to, by what is registered so far."""
    edges = joined([*scene.rig, *file.edges], scene.frames)
    return {frame: number for number, part in enumerate(connected_sets(edges, scene.frames)) for frame in part}


class _Registrar:
    """Registers pairs that the file lacks. Keeps the last frames that it has loaded, so memory does not grow."""

    def __init__(self, recording: Recording, settings: Settings, file: EdgeFile) -> None:
        self._recording, self._settings, self._file = recording, settings, file
        self._kept: dict[int, RGBDFrame] = {}

    def edge(
        self,
        source: int,
        target: int,
        *,
        loop_closure: bool = False,
        confirmed_only: bool = False,
        joining: bool = False,
    ) -> Edge:
        """The edge between two frames; see `registered_edge`. With `joining` whatever is known of them."""
        edge = self._file.find(source, target)
        if edge is None or joining:
            try:
                pair = self._pair(source, target)
            except AdaGMMError as problem:
                edge = Edge(source, target, None, None, loop_closure, " ".join(str(problem).split()))
            else:
                more = {"loop_closure": loop_closure, "confirmed_only": confirmed_only, "joining": joining}
                edge = registered_edge(pair, source, target, self._settings, **more)
            self._file.add(edge)
        return edge

    def _pair(self, source: int, target: int) -> RGBDPair:
        entries = self._recording.entries
        return RGBDPair(
            f"{entries[source].name}_to_{entries[target].name}", self._frame(source), self._frame(target), None, 0
        )

    def _frame(self, index: int) -> RGBDFrame:
        frame = self._kept.pop(index, None) or self._recording.entries[index].load()
        self._kept[index] = frame
        while len(self._kept) > 2:
            self._kept.pop(next(iter(self._kept)))
        return frame
