"""A street seen by a spinning LiDAR: rings of points, and exact poses.

Frames are those of road vehicles: x forward, y left, z up, the sensor HEIGHT above the ground. The street runs along x
for as long as it is driven, between facades with bays, with parked boxes, poles, trunks and crowns on either side, so
that it holds a pose in every direction.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import open3d as o3d

from adagmm_o3d.lie import se_exp

HEIGHT = 1.73


@dataclass(frozen=True)
class Lidar:
    """A sensor with n_rings beams turning about z.

    azimuth_step_deg : between two shots of a beam.   elevation_deg : of the lowest and the highest beam.
    range_noise [m], angular_noise [rad] : standard deviations along and across a beam.   max_range, min_range : [m].
    """

    n_rings: int = 32
    azimuth_step_deg: float = 0.4
    elevation_deg: tuple[float, float] = (-24.0, 4.0)
    range_noise: float = 0.02
    angular_noise: float = 0.0
    max_range: float = 80.0
    min_range: float = 1.0

    def directions(self, phase_deg=0.0):
        """(n_rings, shots, 3) unit vectors, ring by ring."""
        azimuths = np.radians(np.arange(0.0, 360.0 - 1e-9, self.azimuth_step_deg) + phase_deg)
        elevations = np.radians(np.linspace(*self.elevation_deg, self.n_rings))
        flat = np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
        rings = [np.column_stack([np.cos(e) * flat, np.full(len(flat), np.sin(e))]) for e in elevations]
        return np.stack(rings)


class Scan(NamedTuple):
    """What a sensor returns, in its own frame.

    points : (n, 3) [m], with noise.   normals : (n, 3) unit, of the surfaces that were hit.   rings : (n,) beams.
    """

    points: np.ndarray
    normals: np.ndarray
    rings: np.ndarray


class Street:
    """The street as something that rays can be cast at; `seed` chooses what stands where."""

    def __init__(self, seed=0, length=120.0):
        rng = np.random.default_rng(seed)
        self._scene = o3d.t.geometry.RaycastingScene()
        self._add(_ground(length))
        for side in (-1.0, 1.0):
            self._add_facade(rng, side, length)
            self._add_kerb(rng, side, length)

    def scan(self, T_world_sensor, lidar=None, *, seed=0):
        """One turn of the head at a pose (4, 4); noise, and where the turn begins, follow from `seed`."""
        lidar = lidar or Lidar()
        rng = np.random.default_rng([seed, 7])
        directions = lidar.directions(rng.uniform(0.0, lidar.azimuth_step_deg))
        rings = np.repeat(np.arange(lidar.n_rings), directions.shape[1])
        shot = directions.reshape(-1, 3)
        aimed = shot + lidar.angular_noise * rng.normal(size=shot.shape)
        aimed /= np.linalg.norm(aimed, axis=1, keepdims=True)
        R_world_sensor = T_world_sensor[:3, :3]
        origin = np.broadcast_to(T_world_sensor[:3, 3], aimed.shape)
        rays = np.concatenate([origin, aimed @ R_world_sensor.T], axis=1)
        answer = self._scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))
        ranges = answer["t_hit"].numpy().astype(float)
        hit = (ranges < lidar.max_range) & (ranges > lidar.min_range)
        ranges = ranges[hit] + lidar.range_noise * rng.normal(size=hit.sum())
        normals = answer["primitive_normals"].numpy()[hit].astype(float) @ R_world_sensor
        return Scan(shot[hit] * ranges[:, None], normals, rings[hit])

    def _add(self, mesh):
        self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))

    def _add_facade(self, rng, side, length):
        """Houses side by side at 7 to 12 m, no two at the same distance, with bays in front."""
        x = -length
        while x < length:
            width, distance, height = rng.uniform(6.0, 14.0), rng.uniform(7.0, 12.0), rng.uniform(5.0, 12.0)
            self._add(_box(x, width, side * (distance + 3.0), 6.0, 0.0, height))
            self._add(_box(x + 0.3 * width, 0.2 * width, side * distance, 1.2, 1.0, 0.6 * height))
            x += width + (rng.uniform(1.0, 4.0) if rng.random() < 0.3 else 0.0)

    def _add_kerb(self, rng, side, length):
        """Parked cars, poles and trees at 3 to 6 m."""
        x = -length
        while x < length:
            kind, y = rng.random(), side * rng.uniform(3.5, 5.0)
            if kind < 0.5:
                self._add(_box(x, 4.2, y, 1.8, 0.2, 0.7))
                self._add(_box(x + 0.9, 2.2, y, 1.6, 0.9, 0.6))
            else:
                pole = o3d.geometry.TriangleMesh.create_cylinder(0.08 if kind < 0.75 else 0.2, 5.0, 12)
                self._add(pole.translate([x, y, 2.5]))
            if kind > 0.75:
                self._add(o3d.geometry.TriangleMesh.create_sphere(1.5, 8).translate([x, y, 5.0]))
            x += rng.uniform(5.0, 11.0)


def drive(count, *, step=1.0, turn_deg=1.0, seed=0):
    """(count, 4, 4) poses T_world_sensor along the street, `step` [m] apart, with sway, pitch and roll."""
    rng = np.random.default_rng([seed, 11])
    swing = rng.uniform(0.0, 2.0 * np.pi, 3)
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        phase = 0.15 * k + swing
        turn = np.radians(turn_deg) * np.array([0.2, 0.3, 3.0]) * np.sin(phase)
        poses[k] = se_exp(np.concatenate([turn, np.zeros(3)]))
        poses[k][:3, 3] = [step * k - 0.5 * step * count, 0.6 * np.sin(phase[2]), HEIGHT + 0.02 * np.sin(phase[0])]
    return poses


def scan_pair(seed, distance, angle_deg, lidar=None):
    """Two scans of one street and the exact T_target_source, `distance` [m] and `angle_deg` about z apart."""
    rng = np.random.default_rng([seed, 13])
    street = Street(seed)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    there = np.eye(4)
    there[:3, 3] = [rng.uniform(-5.0, 5.0), rng.uniform(-1.0, 1.0), HEIGHT]
    motion = se_exp(np.concatenate([np.radians([0.0, 0.0, angle_deg]), np.zeros(3)]))
    motion[:3, 3] = distance * np.array([np.cos(heading), np.sin(heading), 0.02])
    source, target = street.scan(there @ motion, lidar, seed=2 * seed), street.scan(there, lidar, seed=2 * seed + 1)
    return source.points, target.points, motion


def _box(x, width, y, depth, low, height):
    """From x on along the street, about y across it, from `low` on upwards [m]."""
    return o3d.geometry.TriangleMesh.create_box(width, depth, height).translate([x, y - 0.5 * depth, low])


def _ground(length):
    """A road with a camber and shallow waves, as triangles."""
    x, y = np.meshgrid(np.arange(-length - 80.0, length + 80.0, 2.0), np.arange(-60.0, 61.0, 2.0), indexing="ij")
    z = 0.03 * np.sin(0.2 * x) * np.cos(0.15 * y) - 0.002 * np.abs(y)
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (corner[i:j, k:m].ravel() for i, j, k, m in QUAD)
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))


QUAD = ((None, -1, None, -1), (1, None, None, -1), (None, -1, 1, None), (1, None, 1, None))
