"""Ray casting of a scene: what is hit, and what light comes back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d

from adagmm_fusion.simulation.parts import Part

_LIFT = 1e-3  # secondary rays start this far off the surface [m]


@dataclass(frozen=True)
class Hits:
    """What N rays met. Where nothing was met, part is -1 and the rest is zero."""

    distance: np.ndarray  # (N,) in lengths of the ray's direction
    points: np.ndarray  # (N, 3) world [m]
    facet_normals: np.ndarray  # (N, 3) world, towards the ray's origin
    part: np.ndarray  # (N,) int


class Scene:
    """Parts in an Open3D RaycastingScene; world frame z up, metres."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = list(parts)
        self._raycaster = o3d.t.geometry.RaycastingScene()
        for part in self.parts:
            vertices, triangles = part.shape.triangles()
            world = vertices @ part.T_world_part[:3, :3].T + part.T_world_part[:3, 3]
            self._raycaster.add_triangles(
                o3d.core.Tensor(world.astype(np.float32)), o3d.core.Tensor(triangles.astype(np.uint32))
            )

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """The first hit of each ray; origins (3,) or (N, 3), directions (N, 3), any length."""
        rays = _rays(origins, directions)
        answer = self._raycaster.cast_rays(o3d.core.Tensor(rays))
        distance = answer["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(distance)
        distance = np.where(hit, distance, 0.0)
        normals = answer["primitive_normals"].numpy().astype(np.float64)
        facing_away = (normals * directions).sum(axis=1) > 0.0
        normals = np.where(facing_away[:, None], -normals, normals)
        part = np.where(hit, answer["geometry_ids"].numpy().astype(np.int64), -1)
        return Hits(distance, origins + distance[:, None] * directions, normals, part)

    def visible(self, points: np.ndarray, normals: np.ndarray, to: np.ndarray) -> np.ndarray:
        """(N,) bool: does nothing stand between the surface points and the places `to`, (3,) or (N, 3)?"""
        start = points + _LIFT * normals
        rays = _rays(start, to - start)
        return ~self._raycaster.test_occlusions(o3d.core.Tensor(rays), tfar=0.999).numpy()

    def openness(self, points: np.ndarray, directions: np.ndarray, normals: np.ndarray, reach: float) -> np.ndarray:
        """(N,) bool: is there nothing within `reach` [m] along the unit directions?"""
        rays = _rays(points + _LIFT * normals, directions)
        return ~self._raycaster.test_occlusions(o3d.core.Tensor(rays), tfar=reach).numpy()

    def surface(self, hits: Hits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Albedo (N, 3), smooth outward normals (N, 3) in the world, and own light (N,) at the hits."""
        albedo, normals, glow = np.zeros((len(hits.part), 3)), hits.facet_normals.copy(), np.zeros(len(hits.part))
        for index in np.unique(hits.part[hits.part >= 0]):
            part, here = self.parts[index], hits.part == index
            rotation = part.T_world_part[:3, :3]
            local = (hits.points[here] - part.T_world_part[:3, 3]) @ rotation
            local_facets = hits.facet_normals[here] @ rotation
            smooth = part.shape.smooth_normals(local, local_facets)
            # Inside of an open shape (a lamp shade, a mug) the side that is seen faces inwards.
            smooth = np.where((smooth * local_facets).sum(axis=1, keepdims=True) < 0.0, -smooth, smooth)
            albedo[here] = np.clip(part.texture(local, smooth), 0.0, 1.0)
            normals[here] = smooth @ rotation.T
            glow[here] = part.glow
        return albedo, normals, glow


def _rays(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.empty((len(directions), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return rays
