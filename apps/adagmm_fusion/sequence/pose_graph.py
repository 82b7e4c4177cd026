"""Registrations between frames made into one consistent set of poses by Open3D's global optimisation."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from adagmm_fusion.frames import inverse_rigid

# A loop closure that moves its points farther than this against the rest of the graph is taken for wrong. Drift is what
# loop closures are there to take out, so it must not be much smaller.
LOOP_TOLERANCE_M = 0.25


@dataclass(frozen=True, eq=False)
class Edge:
    """One registration between two frames.

    transformation : (4, 4) T_target_source.    information : (6, 6), as adagmm_o3d.evaluation.information_matrix.
    loop_closure : it may be wrong, and the optimisation may drop it.    reason : why it cannot be used, or empty.
    """

    source: int
    target: int
    transformation: np.ndarray | None
    information: np.ndarray | None
    loop_closure: bool
    reason: str = ""

    @property
    def usable(self) -> bool:
        return not self.reason


def chained_poses(edges: list[Edge], first: int = 0) -> dict[int, np.ndarray]:
    """T_first_frame of each frame that usable edges lead to, over few of them, sure ones before others."""
    poses = {first: np.eye(4)}
    for pool in ([e for e in edges if e.usable and not e.loop_closure], [e for e in edges if e.usable]):
        reached = list(poses)
        while reached:
            following = []
            for frame in reached:
                for edge in pool:
                    if edge.source == frame and edge.target not in poses:
                        poses[edge.target] = poses[frame] @ inverse_rigid(edge.transformation)
                        following.append(edge.target)
                    elif edge.target == frame and edge.source not in poses:
                        poses[edge.source] = poses[frame] @ edge.transformation
                        following.append(edge.source)
            reached = following
    return poses


def best_connected(edges: list[Edge], frames: tuple[int, ...]) -> int:
    """The first frame of the largest set of frames that usable edges hold together."""
    left, best = list(frames), {}
    while left:
        reached = chained_poses(edges, left[0])
        left = [frame for frame in left if frame not in reached]
        best = max(best, reached, key=len)
    return min(best)


def optimized_poses(edges: list[Edge], *, first: int = 0) -> tuple[dict[int, np.ndarray], int]:
    """T_first_frame of each frame that can be reached, and how many loop closures were dropped as wrong."""
    start = chained_poses(edges, first)
    used = [edge for edge in edges if edge.usable and edge.source in start and edge.target in start]
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
    if len(nodes) < 3 or len(used) < len(nodes):
        return start, 0  # a tree: nothing contradicts anything
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            registration.GlobalOptimizationOption(
                max_correspondence_distance=LOOP_TOLERANCE_M, edge_prune_threshold=0.25, reference_node=0
            ),
        )
    T_first_world = inverse_rigid(np.asarray(graph.nodes[0].pose))
    poses = {frame: T_first_world @ np.asarray(graph.nodes[i].pose) for frame, i in nodes.items()}
    return poses, len(used) - len(graph.edges)
