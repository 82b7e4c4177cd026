"""Parts of a recording that no registration joins for sure, joined by several that say the same.

A pose that the clouds alone propose, of frames that share little, may be a chance fit, and is not believed. But two
chance fits of different frames do not agree on where one part lies to the other: where several registrations do, and
far more than agree on anything else, they confirm each other.

Source
------
J. Mangelson, D. Dominic, R. Eustice, R. Vasudevan, Pairwise Consistent Measurement Set Maximization for Robust
Multi-Robot Map Merging, ICRA 2018; here the largest set that agrees with one registration takes the clique's place.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from adagmm_fusion.sequence.edges import Edge
from adagmm_fusion.sequence.pose_graph import Poses, chained_poses, connected_sets
from adagmm_o3d.lie import se_inverse

# So many have to agree, and so many times as many as agree on another place.
AGREEING, CLEARLY_MORE = 3, 2
# Two agree that place the parts within this of each other, at the frames that they were found with.
SAME_DEG, SAME_M = 2.0, 0.15


def joined(edges: Iterable[Edge], frames: Iterable[int]) -> list[Edge]:
    """The edges, those doubtful ones made usable that confirm each other; the pose graph may drop them yet."""
    edges, frames = list(edges), list(frames)
    while True:
        confirmed = _confirmed(edges, frames)
        if not confirmed:
            return edges
        for k in confirmed:
            edges[k] = replace(edges[k], reason="", loop_closure=True, only_together=True)


def _confirmed(edges: Sequence[Edge], frames: Iterable[int]) -> list[int]:
    """The indices of the most doubtful edges between any two parts that agree with each other; none if too few do."""
    parts = connected_sets(edges, frames)
    part_of = {frame: number for number, part in enumerate(parts) for frame in part}
    between: dict[tuple[int, int], list[int]] = defaultdict(list)
    counted = set()  # the same two frames the other way round confirm nothing
    for k, edge in enumerate(edges):
        if edge.doubtful and edge.source in part_of and edge.target in part_of:
            a, b = sorted((part_of[edge.source], part_of[edge.target]))
            two = frozenset((edge.source, edge.target))
            if a != b and two not in counted:
                between[a, b].append(k)
                counted.add(two)
    chains: dict[int, Poses] = {}
    best: list[int] = []
    for (a, b), candidates in sorted(between.items()):
        if len(candidates) < max(AGREEING, len(best) + 1):
            continue
        for part in (a, b):
            if part not in chains:
                chains[part] = chained_poses(edges, parts[part][0])
        agree = _agreement([edges[k] for k in candidates], chains[a], chains[b])
        most = agree[np.argmax(agree.sum(axis=1))]
        others = agree[np.ix_(~most, ~most)].sum(axis=1).max(initial=0)
        if most.sum() > len(best) and most.sum() >= max(AGREEING, CLEARLY_MORE * others):
            best = [candidates[i] for i in np.flatnonzero(most)]
    return best


def _agreement(edges: Sequence[Edge], here: Poses, there: Poses) -> np.ndarray:
    """(k, k) which of the edges between two parts, with the poses of their frames, place the parts alike."""
    T, seen = [], []
    for edge in edges:
        forward = edge.source in there
        own, other = (edge.target, edge.source) if forward else (edge.source, edge.target)
        T_own_other = edge.transformation if forward else se_inverse(edge.transformation)
        T.append(here[own] @ T_own_other @ se_inverse(there[other]))
        seen.append(there[other][:3, 3])
    T_here_there, points = np.array(T), np.array(seen)
    placed = np.einsum("iab,jb->ija", T_here_there[:, :3, :3], points) + T_here_there[:, None, :3, 3]
    # of each edge and each frame, how far the others' places for that frame are from its own
    off = np.linalg.norm(placed - placed[np.arange(len(T)), np.arange(len(T))][None], axis=2)
    traces = np.einsum("iab,jab->ij", T_here_there[:, :3, :3], T_here_there[:, :3, :3])
    turned = np.degrees(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))
    return (turned < SAME_DEG) & (np.maximum(off, off.T) < SAME_M)
