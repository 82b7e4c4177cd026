"""Covariances from the surface itself: wide along it, thin across it, for clouds whose sensor is unknown."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d.arguments import (
    LARGEST_COORDINATE,
    Array,
    check_coordinates,
    float_array,
    real_number,
    unit_vectors,
    whole_number,
)
from adagmm_o3d.errors import DegenerateError, InputError
from adagmm_o3d.grouping import cells_of, even_edge, widest_edge
from adagmm_o3d.kernels.limits import EPSILON, KNN, LINE_RATIO
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.principal import principal_axes, scatter_among
from adagmm_o3d.sampling import distinct_places, some_of
from adagmm_o3d.uncertainty.planes import CHUNK, LINE, find_planes

CELLS = (0.5, 1.0, 2.0)
"""Edges of the cells of a dense cloud, in those of even ones, the smallest that will do.

From a quarter on, simulated scans with exact beams end a third nearer to the truth, those with noisy beams up to a half
farther from it.
"""

AVERAGED = 4.0
"""So many of the smallest cells are in an even one, and its mean, by which a registration goes, is so much less rough.

The number of points that a cell averages would say more of noise, but sensors bend what they see, too, and no mean gets
better of it: false alarms on whole depth frames came of that.
"""

SCAN_LINES, LINED = (1000, 100_000), 0.25
"""So many points are scan lines if the neighbours of more than this share of them lie along a line: 0.8 to 1 in scans
of 16 beams, 0.3 to 0.5 in what voxels of 0.25 m leave of these; in 240 clouds of depth cameras and models 0.19 at most.
More points come from sensors of many beams."""

WITHOUT, BETWEEN_LINES = 0.25, 4.0
"""Where more than this share of the cells finds no plane, the next edge is tried for those: with 16 beams it is 0.4 to
0.7 of them, in denser scans of streets 0.06 at most. There larger cells find planes that are none: the LiDAR is pulled
back along its way by 1.4 mm a metre instead of 0.9."""

PROBES = 500
"""Points that are asked where all need not be."""

VAGUE = 10.0
"""How much more what is no surface varies: of a pole or a bush each sensor sees the side that faces it."""

TINY = float(np.finfo(np.float64).tiny)
"""Divides what is zero itself."""


def estimate_surface_covariances(
    points: ArrayLike, normals: ArrayLike | None = None, *, knn: int = KNN, epsilon: float = EPSILON
) -> Array:
    """Plane covariances as in Generalized ICP: 1 along the surface, `epsilon` across it; in 2D along a curve.

    Σ = I − (1 − epsilon) n nᵀ with n the normal. Where no normals are given, n is the direction in which the `knn`
    nearest points, the point itself among them, vary least. Where these lie on one line or coincide there is no such
    direction, and Σ = I.

    A dense cloud, of 10 000 points and more (`grouping.even_edge`), and one of scan lines, as of a LiDAR of few beams,
    is first thinned to one point in a cell, and each point gets the covariance of its cell. The cells grow until the
    neighbours span a plane, see `planes.find_planes`; where they never do, Σ = 10 I. There the variance across is that
    of the neighbours relative to their smaller one along the surface, over the four cells that are averaged for a
    registration, where that is more than `epsilon`: no surface is known better than its roughness allows.

    Parameters
    ----------
    points : (N, D), D = 2 or 3, any unit.
    normals : (N, D) or None; any non-zero length, either sign.
    knn : neighbours per point, at least D + 1; all points where there are fewer. Unused when normals are given.
    epsilon : variance across the surface, 0 < epsilon ≤ 1.

    Returns
    -------
    (N, D, D) float64, positive definite, relative (unitless).

    Raises
    ------
    InputTypeError, InputError  if an argument is no finite array of that shape, a normal has length 0, or a number is
                                out of range.
    DegenerateError             if normals have to be estimated from no more than D points.

    Source
    ------
    A. Segal, D. Haehnel, S. Thrun, Generalized-ICP, RSS 2009, Section III; the defaults are Open3D's.
    """
    p = float_array("points", points, ("N", (2, 3)))
    check_coordinates("points", p)
    dimension = p.shape[1]
    neighbors = whole_number("knn", knn, minimum=dimension + 1)
    thickness = real_number("epsilon", epsilon, above=0.0)
    if thickness > 1.0:
        raise InputError(f"epsilon: expected at most 1, got {thickness:g}; it is the variance across the surface")
    if normals is None:
        check_count("points", *p.shape)
        edge = even_edge(p)
        if edge is None:
            found, along_line = _estimate_normals(p, neighbors, np.arange(len(p)))
            if not (_may_be_scan(p) and along_line.mean() > LINED):
                return _plane_covariances(found, thickness)
            edge = widest_edge(p)
        return _cell_covariances(p, edge, neighbors, thickness)
    n = unit_vectors("normals", normals, ("N", dimension))
    if len(n) != len(p):
        raise InputError(f"normals: expected {p.shape} to match the points, got {n.shape}")
    return _plane_covariances(n, thickness)


def stand_in_covariances(
    points: Array, normals: Array | None = None, *, epsilon: float = EPSILON, name: str = "points"
) -> Array | None:
    """What stands for the covariances that a cloud does not have: those of its surface, as in Open3D's GICP.

    Parameters
    ----------
    points : (N, D), D = 2 or 3, any unit. Those that are not finite are nobody's neighbours; for them Σ = I.
    normals : (N, D) as the cloud has them, of any length and sign, or None. Neighbours speak for a point whose normal
        is zero or not finite; where there are no more than D points, Σ = I. Of scan lines they are not looked at: those
        that come from the nearest points, as Open3D makes them, stand across a line in any direction.
    epsilon : as in `estimate_surface_covariances`.   name : what an error calls the points.

    Returns
    -------
    (N, D, D) float64, or None for fewer than three finite points or some so large that their squares overflow, which no
    registration takes.

    Raises
    ------
    DegenerateError  if there are no usable normals, and no more than D points.
    """
    measured = np.isfinite(points).all(axis=1)
    if not measured.all():
        of_these = None if normals is None else normals[measured]
        found = stand_in_covariances(points[measured], of_these, epsilon=epsilon, name=name)
        if found is None:
            return None
        covariances = np.tile(np.eye(points.shape[1]), (len(points), 1, 1))
        covariances[measured] = found
        return covariances
    if len(points) < 3 or not (np.abs(points) <= LARGEST_COORDINATE).all():
        return None
    usable: NDArray[np.bool_] = np.zeros(len(points), bool)
    if normals is not None:
        usable = np.asarray(np.isfinite(normals).all(axis=1) & normals.any(axis=1))
    if normals is None or not usable.any() or _are_scan_lines(points):
        check_count(name, *points.shape)
        return estimate_surface_covariances(points, epsilon=epsilon)
    n = np.zeros(points.shape)
    n[usable] = unit_vectors("normals", normals[usable], ("N", points.shape[1]))
    if not usable.all() and len(points) > points.shape[1]:
        n[~usable], _ = _estimate_normals(points, KNN, np.flatnonzero(~usable))
    return _plane_covariances(n, epsilon)


def scan_covariances(points: Array) -> Array | None:
    """What stands for the covariances that an array of (N, D) points does not have where no isotropic ones will do.

    The points of scan lines, and of a dense cloud in space, are nearer to each other along a ring than the rings are:
    as balls those of one scan would be laid on those of the other. Their surface's do, see `stand_in_covariances`; None
    of all other arrays.
    """
    measured = points[np.isfinite(points).all(axis=1)]
    if points.shape[1] == 2 or len(measured) < SCAN_LINES[0] or not (np.abs(measured) <= LARGEST_COORDINATE).all():
        return None
    return stand_in_covariances(points) if even_edge(measured) is not None or _are_scan_lines(measured) else None


def _may_be_scan(points: Array) -> bool:
    """Whether (N, D) points are as many as those of a LiDAR of few beams."""
    return points.shape[1] == 3 and SCAN_LINES[0] <= len(points) <= SCAN_LINES[1]


def _are_scan_lines(points: Array) -> bool:
    """Whether (N, D) finite points are on lines, as those of a LiDAR of few beams are, by a few of them."""
    if not _may_be_scan(points):
        return False
    return bool(_estimate_normals(points, KNN, some_of(np.arange(len(points)), PROBES))[1].mean() > LINED)


def check_count(name: str, count: int, dimension: int) -> None:
    """Raise if so few points have no normals."""
    if count <= dimension:
        raise DegenerateError(
            f"{name}: expected more than {dimension} to estimate normals from, got {count}; pass normals or covariances"
        )


def _plane_covariances(normals: Array, thickness: float | Array) -> Array:
    """(N, D, D) of unit normals (N, D), the identity where one is zero; a thickness for all or (N,)."""
    factors = np.sqrt(1.0 - np.asarray(thickness))
    scaled = normals * (factors if factors.ndim == 0 else factors[:, None])
    return np.eye(normals.shape[1]) - scaled[:, :, None] * scaled[:, None, :]


def _cell_covariances(points: Array, edge: float, knn: int, thickness: float) -> Array:
    """(N, D, D) of a cloud (N, D) with even cells of that edge."""
    cells = cells_of(points, CELLS[0] * edge)
    means = cells.means(points)
    normals, variances = find_planes(points, means, [factor * edge for factor in CELLS], knn)
    alone = ~normals.any(axis=1)
    if alone.mean() > WITHOUT:
        normals[alone], variances[alone] = find_planes(points, means[alone], [BETWEEN_LINES * edge], knn)
    roughness = variances[:, 0] / np.maximum(variances[:, 1], TINY) / AVERAGED
    covariances = _plane_covariances(normals, np.maximum(roughness, thickness))
    covariances[~normals.any(axis=1)] *= VAGUE
    return cells.each(covariances)


def _estimate_normals(points: Array, knn: int, chosen: NDArray[np.intp]) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals of the chosen points (K, D), zero where the neighbourhood has none; and (K,) whether it is along a
    line in space."""
    # Points that are given again would be nobody's neighbours but each other's.
    places = points[np.sort(distinct_places(points))]
    index = NeighborIndex(places)
    normals, along_line = np.empty((len(chosen), points.shape[1])), np.zeros(len(chosen), bool)
    for start in range(0, len(chosen), CHUNK):
        chunk = slice(start, start + CHUNK)
        rows, _ = index.query(points[chosen[chunk]], knn)
        variances, directions = principal_axes(scatter_among(places, rows)[0])
        has_normal = variances[:, 1] > LINE_RATIO * variances.sum(axis=1)
        normals[chunk] = np.where(has_normal[:, None], directions[:, :, 0], 0.0)
        if points.shape[1] == 3:
            along_line[chunk] = variances[:, 1] <= LINE * variances[:, 2]
    return normals, along_line
