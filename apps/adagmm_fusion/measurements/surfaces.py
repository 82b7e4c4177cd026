"""Two depth images as measurements of a pose: every pixel against the plane that the other image sees in its place.

Each pixel's normal is that of all the pixels around it, so all measured points of the overlap take part, however many
of them are looked at. Nothing is averaged over voxels first, which moves points where noise is thicker than a voxel.

Source
------
G. Blais, M. Levine: Registering multiview range data to create 3D computer objects, PAMI 17, 1995 (partners by
projection).   Y. Chen, G. Medioni: Object modelling by registration of multiple range images, 1992 (planes).
"""

from dataclasses import dataclass, replace

import numpy as np

from adagmm_fusion.clouds.sensor_models import NONE
from adagmm_fusion.clouds.surface_grid import SurfaceGrid, surface_grid
from adagmm_fusion.frames.depth_geometry import project
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.measurements.depth_errors import by_depth
from adagmm_fusion.measurements.residuals import NormalEquations, Residuals, counted_once, normal_equations
from adagmm_o3d.lie import se_inverse
from adagmm_o3d.trust.observability import FREE_SHARE, generalised_eigen
from adagmm_o3d.uncertainty.sensor_models import DEFAULT, estimate_sensor_covariances

# A pixel and the plane in its place are of one surface when they are this near [m] and their normals within 30°.
NEAR_M, LEAST_COSINE = 0.1, 0.866
# A point this far [m] behind what the other image sees is hidden by it, and says nothing.
HIDDEN_M = NEAR_M
# Of all poses at random, a pixel would see a surface anywhere within this range [m]; and so many see another one.
RANGE_M, OTHERS = 1.0, 0.3
# Without a sensor's noise all pixels are alike; the scale is estimated in any case [m²].
ALIKE = 1e-6
LEAST_SCALE = 1e-4
# Covariances of so many points at a time.
CHUNK = 50_000


@dataclass(frozen=True, eq=False)
class _Side:
    """One frame's surface, with the variance across it (H, W) [m²]."""

    grid: SurfaceGrid
    variances: np.ndarray
    intrinsics: PinholeIntrinsics


@dataclass(frozen=True, eq=False)
class _Partners:
    """Pixels of one image and what the other sees in their place, all in the frame of the other.

    points, planes (n, 3), normals (n, 3) of the planes, cosines (n,) between the normals, variances (n,).
    place : (3,) of the camera that measured the points.   depths : (n,) of these.
    """

    points: np.ndarray
    planes: np.ndarray
    place: np.ndarray
    depths: np.ndarray
    normals: np.ndarray
    cosines: np.ndarray
    variances: np.ndarray


class SurfaceMeasurements:
    """The surfaces of a pair; `sensor_model` says how far measured points may be off."""

    def __init__(self, pair: RGBDPair, *, sensor_model: str, min_depth_m: float, max_depth_m: float) -> None:
        self._source, self._target = (
            _side(frame, sensor_model, min_depth_m, max_depth_m) for frame in (pair.source, pair.target)
        )

    def equations(self, T_target_source: np.ndarray, most: int) -> NormalEquations | None:
        """What the surfaces say of a pose by `most` pixels of either image; nothing of motions along them."""
        residuals = self._residuals(T_target_source, most)
        found = normal_equations(residuals, LEAST_SCALE)
        return None if found is None else _without_free(found, residuals.places)

    def evidence(self, T_target_source: np.ndarray, scale: float, most: int) -> float:
        """Log-likelihood ratio of a pose [nats]: one surface in both images, over one anywhere."""
        total = 0.0
        for partners, T in self._both(T_target_source, most):
            behind = partners.points[:, 2] > partners.planes[:, 2] + HIDDEN_M
            off = np.einsum("ni,ni->n", partners.normals, partners.points - partners.planes)
            variances = scale * partners.variances
            likely = np.exp(-0.5 * off**2 / variances) * RANGE_M / np.sqrt(2.0 * np.pi * variances)
            likely[(partners.cosines < LEAST_COSINE) | behind] = 0.0
            gains = np.log((1.0 - OTHERS) * likely + OTHERS)
            seen = ~behind
            total += counted_once(partners.points[seen] @ T[:3, :3].T + T[:3, 3], gains[seen])
        return 0.5 * total

    def _residuals(self, T_target_source: np.ndarray, most: int) -> Residuals:
        values, jacobians, depth_derivatives, places = [], [], [], []
        for backwards, (partners, T) in enumerate(self._both(T_target_source, most)):
            off = np.einsum("ni,ni->n", partners.normals, partners.points - partners.planes)
            alike = (partners.cosines >= LEAST_COSINE) & (np.abs(off) < NEAR_M)
            normals = partners.normals[alike] @ T[:3, :3].T
            points, planes = (p[alike] @ T[:3, :3].T + T[:3, 3] for p in (partners.points, partners.planes))
            # The source's points move, or, seen from the target's points, the source's planes.
            turns, shifts = np.cross(points, normals), normals
            sign = -1.0 if backwards else 1.0
            deviations = np.sqrt(partners.variances[alike])
            values.append(off[alike] / deviations)
            jacobians.append(sign * np.hstack([turns, shifts]) / deviations[:, None])
            across = partners.normals[alike] / deviations[:, None]
            seen, there = partners.points[alike] - partners.place, partners.planes[alike]
            of_points = np.einsum("ni,nij->nj", across, by_depth(seen, partners.depths[alike]))
            of_planes = -np.einsum("ni,nij->nj", across, by_depth(there, there[:, 2]))
            depth_derivatives.append(np.hstack([of_planes, of_points] if backwards else [of_points, of_planes]))
            places.append(planes)
        return Residuals(
            np.concatenate(values)[:, None],
            np.concatenate(jacobians)[:, None],
            np.concatenate(depth_derivatives)[:, None],
            np.concatenate(places),
        )

    def _both(self, T_target_source: np.ndarray, most: int) -> list[tuple[_Partners, np.ndarray]]:
        """The source's pixels among the target's and the other way round, each with the pose that brings it home."""
        back = se_inverse(T_target_source)
        return [
            (_partners(self._source, self._target, T_target_source, most), np.eye(4)),
            (_partners(self._target, self._source, back, most), T_target_source),
        ]


def _side(frame: RGBDFrame, sensor_model: str, min_depth_m: float, max_depth_m: float) -> _Side:
    grid = surface_grid(frame, min_depth_m, max_depth_m)
    points, normals = grid.points[grid.known], grid.normals[grid.known]
    across = np.full(len(points), ALIKE)
    # Across the surface the default is what noise alone leaves.
    model = "nguyen" if sensor_model == DEFAULT else sensor_model
    focal_lengths = (frame.intrinsics.fx, frame.intrinsics.fy)
    if model not in (NONE, "surface"):
        for start in range(0, len(points), CHUNK):
            part = slice(start, start + CHUNK)
            covariances = estimate_sensor_covariances(model, points[part], normals[part], focal_lengths)
            across[part] = np.einsum("ni,nij,nj->n", normals[part], covariances, normals[part])
    variances = np.full(grid.known.shape, np.nan)
    variances[grid.known] = across
    return _Side(grid, variances, frame.intrinsics)


def _partners(own: _Side, other: _Side, T_other_own: np.ndarray, most: int) -> _Partners:
    """Evenly chosen pixels of `own` that fall on a known one of `other`."""
    index = np.flatnonzero(own.grid.known)
    index = index[:: max(1, -(-len(index) // most))]
    R, t = T_other_own[:3, :3], T_other_own[:3, 3]
    points = own.grid.points.reshape(-1, 3)[index] @ R.T + t
    columns, rows = np.floor(project(points, other.intrinsics) + 0.5)
    height, width = other.grid.known.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    index, points, columns, rows = index[inside], points[inside], columns[inside].astype(int), rows[inside].astype(int)
    known = other.grid.known[rows, columns]
    index, points, columns, rows = index[known], points[known], columns[known], rows[known]
    normals = other.grid.normals[rows, columns]
    return _Partners(
        points,
        other.grid.points[rows, columns],
        t,
        own.grid.points.reshape(-1, 3)[index, 2],
        normals,
        np.einsum("ni,ni->n", normals, own.grid.normals.reshape(-1, 3)[index] @ R.T),
        own.variances.ravel()[index] + other.variances[rows, columns],
    )


def _without_free(found: NormalEquations, places: np.ndarray) -> NormalEquations:
    """Without the motions that the surfaces hardly hold: noise of the normals feigns some hold of those as well."""
    share = np.trace(found.hessian[3:, 3:]) / len(places)
    mean = places.mean(axis=0)
    centred = np.eye(6)
    centred[3:, :3] = np.array([[0, mean[2], -mean[1]], [-mean[2], 0, mean[0]], [mean[1], -mean[0], 0]])
    offsets = places - mean
    everywhere = np.zeros((6, 6))
    everywhere[:3, :3] = share * ((offsets**2).sum() * np.eye(3) - offsets.T @ offsets)
    everywhere[3:, 3:] = share * len(places) * np.eye(3)
    everywhere = centred.T @ everywhere @ centred
    shares, motions = generalised_eigen(found.hessian, everywhere)
    held = motions[:, shares >= FREE_SHARE]
    outward = everywhere @ held
    hessian = (outward * shares[shares >= FREE_SHARE]) @ outward.T
    gradient, cross = (outward @ (held.T @ of_pose) for of_pose in (found.gradient, found.cross))
    return replace(found, hessian=hessian, gradient=gradient, cross=cross)
