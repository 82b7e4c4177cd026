"""Random rigid motions, and points and pairs of clouds moved by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d

from adagmm_bench.pairs.problem import PairClouds
from adagmm_o3d import lie


def rigid(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def turn(rng: np.random.Generator, angle_deg: float | None) -> np.ndarray:
    """(3, 3): about a random axis, by an angle or, for None, any rotation alike."""
    if angle_deg is None:
        return lie.project_to_rotation(rng.standard_normal((3, 3)))
    axis = rng.standard_normal(3)
    return lie.so_exp(np.radians(angle_deg) * axis / np.linalg.norm(axis))


def moved(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(..., D) points after a motion (D+1, D+1)."""
    return points @ motion[:-1, :-1].T + motion[:-1, -1]


def about(centre: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The motion with its rotation about a centre instead of the origin."""
    return rigid(motion[:3, :3], motion[:3, 3] + centre - motion[:3, :3] @ centre)


def with_moved_source(pair: PairClouds, motion: np.ndarray) -> PairClouds:
    """The same pair with the frame of its source moved: clouds, viewpoint, centre and truth."""

    T, viewpoint = pair.T_target_source, pair.source_viewpoint
    return replace(
        pair,
        source=o3d.geometry.PointCloud(pair.source).transform(motion),
        peers_source=o3d.geometry.PointCloud(pair.peers_source).transform(motion),
        T_target_source=None if T is None else T @ lie.se_inverse(motion),
        centre=moved(pair.centre, motion),
        source_viewpoint=None if viewpoint is None else moved(viewpoint, motion),
    )
