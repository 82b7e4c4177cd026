"""Registrations between frames made into one consistent set of poses by Open3D's global optimisation."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import open3d as o3d

from adagmm_fusion.sequence.edges import Edge
from adagmm_o3d import lie
from adagmm_o3d.lie import se_inverse

# A loop closure counts as wrong if it moves its points farther than this against the rest of the graph. A much smaller
# number would drop right ones: they move points by the drift that they take out.
LOOP_TOLERANCE_M = 0.25
# Open3D solves for all poses in one dense matrix, so larger graphs are optimised in fragments, and these as a whole.
MAX_NODES, FRAGMENT_FRAMES = 200, 100

Poses = dict[int, np.ndarray]


def chained_poses(edges: Iterable[Edge], first: int = 0) -> Poses:
    """T_first_frame of each frame that usable edges lead to, over few of them, sure ones before others."""
    usable = [edge for edge in edges if edge.usable]
    poses = {first: np.eye(4)}
    for pool in ([edge for edge in usable if not edge.loop_closure], usable):
        ends = defaultdict(list)
        for edge in pool:
            ends[edge.source].append((edge, edge.target))
            ends[edge.target].append((edge, edge.source))
        reached = list(poses)
        while reached:
            following = []
            for frame in reached:
                for edge, other in ends[frame]:
                    if other not in poses:
                        forward = other == edge.source
                        T = edge.transformation if forward else se_inverse(edge.transformation)
                        poses[other] = poses[frame] @ T
                        following.append(other)
            reached = following
    return poses


def optimized_poses(edges: list[Edge], *, first: int = 0) -> tuple[Poses, list[Edge]]:
    """T_first_frame of each frame that can be reached, and those of `edges` that were dropped: wrong loop closures."""
    start = chained_poses(edges, first)
    used = [edge for edge in edges if edge.usable and edge.source in start and edge.target in start]
    if len(start) <= MAX_NODES:
        return _optimized(start, used)
    fragments, dropped_inside = _fragments(start, used)
    fragment_of = {frame: number for number, fragment in enumerate(fragments) for frame in fragment}
    crossing = [edge for edge in used if _crosses(edge, fragment_of)]
    between = [_between(edge, fragments, fragment_of) for edge in crossing]
    placed, dropped_between = _optimized(chained_poses(between, fragment_of[first]), between)
    dropped = [edge for edge, moved in zip(crossing, between, strict=True) if moved in dropped_between]
    poses = {frame: placed[fragment_of[frame]] @ fragments[fragment_of[frame]][frame] for frame in start}
    T_first_world = se_inverse(poses[first])
    return {frame: T_first_world @ pose for frame, pose in poses.items()}, dropped_inside + dropped


def connected_sets(edges: Iterable[Edge], frames: Iterable[int]) -> list[list[int]]:
    """The frames in sets that usable edges hold together, each in order, the largest first."""
    parent = {frame: frame for frame in frames}

    def root(frame: int) -> int:
        while parent[frame] != frame:
            parent[frame] = frame = parent[parent[frame]]
        return frame

    for edge in edges:
        if edge.usable and edge.source in parent and edge.target in parent:
            a, b = root(edge.source), root(edge.target)
            parent[max(a, b)] = min(a, b)
    found = defaultdict(list)
    for frame in sorted(parent):
        found[root(frame)].append(frame)
    return sorted(found.values(), key=len, reverse=True)


def _fragments(start: Poses, used: list[Edge]) -> tuple[list[Poses], list[Edge]]:
    """Poses of each fragment's frames in the frame of its first, and the loop closures that were dropped.

    A fragment's frames follow each other and hang together.
    """
    frames, fragments, dropped = sorted(start), [], []
    for i in range(0, len(frames), FRAGMENT_FRAMES):
        some = frames[i : i + FRAGMENT_FRAMES]
        for together in connected_sets(used, some):
            members = set(together)
            inside = [edge for edge in used if edge.source in members and edge.target in members]
            poses, dropped_here = _optimized(chained_poses(inside, together[0]), inside)
            fragments.append(poses)
            dropped += dropped_here
    return fragments, dropped


def _crosses(edge: Edge, fragment_of: dict[int, int]) -> bool:
    return fragment_of[edge.source] != fragment_of[edge.target]


def _between(edge: Edge, fragments: list[Poses], fragment_of: dict[int, int]) -> Edge:
    """An edge between two frames as one between their fragments."""
    source, target = fragment_of[edge.source], fragment_of[edge.target]
    T_target_frame, T_source_frame = fragments[target][edge.target], fragments[source][edge.source]
    # Open3D applies the information to motions in the source's frame; the adjoint carries it to the fragment's frame.
    adjoint = lie.se_adjoint(se_inverse(T_source_frame))
    return replace(
        edge,
        source=source,
        target=target,
        transformation=T_target_frame @ edge.transformation @ se_inverse(T_source_frame),
        information=adjoint.T @ edge.information @ adjoint,
    )


def _optimized(start: Poses, used: list[Edge]) -> tuple[Poses, list[Edge]]:
    """The poses of a connected graph from where they are in `start`, whose first one stays; loop closures dropped."""
    if len(start) < 2 or len(used) < len(start):
        return start, []  # a tree: nothing contradicts anything
    nodes = {frame: i for i, frame in enumerate(start)}
    registration = o3d.pipelines.registration
    graph = registration.PoseGraph()
    for pose in start.values():
        graph.nodes.append(registration.PoseGraphNode(pose))
    for edge in used:
        graph.edges.append(
            registration.PoseGraphEdge(
                nodes[edge.source], nodes[edge.target], edge.transformation, edge.information, edge.loop_closure
            )
        )
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            registration.GlobalOptimizationOption(
                max_correspondence_distance=LOOP_TOLERANCE_M, edge_prune_threshold=0.25, reference_node=0
            ),
        )
    T_first_world = se_inverse(np.asarray(graph.nodes[0].pose))
    poses = {frame: T_first_world @ np.asarray(graph.nodes[i].pose) for frame, i in nodes.items()}
    return poses, _missing(used, nodes, graph.edges)


def _missing(
    used: list[Edge], nodes: dict[int, int], kept: o3d.pipelines.registration.PoseGraphEdgeVector
) -> list[Edge]:
    """Those of `used` that are not among the edges that Open3D has kept, in their order and as they were."""
    missing, remaining = [], iter(kept)
    following = next(remaining, None)
    for edge in used:
        if (
            following is not None
            and (following.source_node_id, following.target_node_id) == (nodes[edge.source], nodes[edge.target])
            and np.array_equal(following.transformation, edge.transformation)
        ):
            following = next(remaining, None)
        else:
            missing.append(edge)
    return missing
