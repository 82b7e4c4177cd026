"""Parts of a scene: a shape with a texture at a place."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import open3d as o3d

from adagmm_fusion.simulation.textures import Texture


class Shape(Protocol):
    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3) [m] in the part's frame and triangles (T, 3)."""

    def smooth_normals(self, points: np.ndarray, facet_normals: np.ndarray) -> np.ndarray:
        """Outward unit normals (N, 3) of the shape that the triangles approximate."""


@dataclass(frozen=True)
class Box:
    """An axis-aligned box centred on the origin; size in metres."""

    size: tuple[float, float, float]

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        mesh = o3d.geometry.TriangleMesh.create_box(*self.size)
        return np.asarray(mesh.vertices) - 0.5 * np.asarray(self.size), np.asarray(mesh.triangles)

    def smooth_normals(self, points: np.ndarray, facet_normals: np.ndarray) -> np.ndarray:
        return facet_normals


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid centred on the origin; half axes in metres."""

    radii: tuple[float, float, float]

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        mesh = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=40)
        return np.asarray(mesh.vertices) * np.asarray(self.radii), np.asarray(mesh.triangles)

    def smooth_normals(self, points: np.ndarray, facet_normals: np.ndarray) -> np.ndarray:
        gradient = points / np.square(self.radii)
        return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


@dataclass(frozen=True)
class Lathe:
    """A surface of revolution about z through a profile of (radius, height) [m], listed upwards."""

    profile: tuple[tuple[float, float], ...]
    segments: int = 72

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        angle = np.arange(self.segments) * (2.0 * np.pi / self.segments)
        rings = [np.stack([r * np.cos(angle), r * np.sin(angle), np.full_like(angle, z)], 1) for r, z in self.profile]
        here = np.arange(self.segments)
        there = (here + 1) % self.segments
        strips = []
        for ring in range(len(self.profile) - 1):
            low, high = ring * self.segments, (ring + 1) * self.segments
            strips.append(np.stack([low + here, low + there, high + there], 1))
            strips.append(np.stack([low + here, high + there, high + here], 1))
        return np.concatenate(rings), np.concatenate(strips)

    def smooth_normals(self, points: np.ndarray, facet_normals: np.ndarray) -> np.ndarray:
        radial = np.linalg.norm(facet_normals[:, :2], axis=1, keepdims=True)
        outward = points[:, :2] / np.maximum(np.linalg.norm(points[:, :2], axis=1, keepdims=True), 1e-9)
        return np.concatenate([radial * outward, facet_normals[:, 2:]], axis=1)


def cylinder(radius: float, height: float) -> Lathe:
    """A closed cylinder centred on the origin, its axis along z."""
    return Lathe(((0.0, -0.5 * height), (radius, -0.5 * height), (radius, 0.5 * height), (0.0, 0.5 * height)))


@dataclass(frozen=True)
class Part:
    """A shape, its texture, and where it stands.

    T_world_part : (4, 4) maps the part's frame into the world's (z up, metres).
    glow : light it gives off itself, 0 = none.     returns_infrared : False for glass, which a Kinect does not see.
    """

    shape: Shape
    texture: Texture
    T_world_part: np.ndarray = field(default_factory=lambda: np.eye(4))
    glow: float = 0.0
    returns_infrared: bool = True


def at(x: float, y: float, z: float, turn_deg: float = 0.0) -> np.ndarray:
    """A pose in the world: a place, and a turn about the vertical."""
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])
