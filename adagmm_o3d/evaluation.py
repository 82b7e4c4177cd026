"""How good a registration is: against a known pose, and by how well the two clouds meet.

Transformations map source to target and are homogeneous, (3, 3) in the plane and (4, 4) in space. Rotations with few
digits are accepted up to `POSE_TOLERANCE`; between two of them, the errors compare the nearest true rotations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d import lie
from adagmm_o3d.arguments import Array, check_coordinates, distance_limit, float_array
from adagmm_o3d.errors import InputError
from adagmm_o3d.neighbors import NeighborIndex

POSE_TOLERANCE = 1e-2
"""Largest entry of RᵀR − I that is put down to rounding; a rotation with three digits has up to 2e-3."""


@dataclass(frozen=True)
class PoseErrors:
    """The three distances of an estimated pose from the true one."""

    rotation_frobenius: float
    """‖I − R_true R_est⁻¹‖_F, 0 … 2√2."""
    rotation_deg: float
    """Angle of R_true R_est⁻¹ [deg], 0 … 180."""
    translation: float
    """‖t_true − t_est‖ in the unit of the transformations."""


@dataclass(frozen=True)
class RegistrationFit:
    """How well two clouds meet, as `open3d.pipelines.registration.evaluate_registration` defines it."""

    fitness: float
    """Share of source points with a target point nearer than the given distance, 0 … 1."""
    inlier_rmse: float
    """Root mean square distance of those pairs [input units]; 0 without any."""
    correspondence_set: NDArray[np.int32]
    """(K, 2) indices: source point, its nearest target point."""


def pose_errors(T_true: ArrayLike, T_est: ArrayLike) -> PoseErrors:
    """Rotation and translation errors together.

    Parameters
    ----------
    T_true, T_est : (3, 3) or (4, 4) rigid, homogeneous, source to target.

    Returns
    -------
    PoseErrors

    Raises
    ------
    InputTypeError, InputError  if one is not a finite rigid transformation, or their sizes differ.
    """
    return PoseErrors(
        rotation_frobenius=rotation_error_frobenius(T_true, T_est),
        rotation_deg=rotation_error_deg(T_true, T_est),
        translation=translation_error(T_true, T_est),
    )


def rotation_error_frobenius(T_true: ArrayLike, T_est: ArrayLike) -> float:
    """‖I − R_true R_est⁻¹‖_F, the paper's measure; 2√2 sin(θ/2) for an angle θ between the two.

    Parameters
    ----------
    T_true, T_est : (3, 3) or (4, 4) rigid, homogeneous, source to target.

    Returns
    -------
    float, 0 … 2√2.

    Raises
    ------
    InputTypeError, InputError  if one is not a finite rigid transformation, or their sizes differ.

    Source
    ------
    D. Q. Huynh, Metrics for 3D Rotations: Comparison and Analysis, J. Math. Imaging and Vision 35(2), 2009.
    """
    difference = _rotation_between(T_true, T_est)
    return float(np.linalg.norm(np.eye(len(difference)) - difference))


def rotation_error_deg(T_true: ArrayLike, T_est: ArrayLike) -> float:
    """The angle between the two rotations, accurate near 0° and near 180° alike.

    Parameters
    ----------
    T_true, T_est : (3, 3) or (4, 4) rigid, homogeneous, source to target.

    Returns
    -------
    float [deg], 0 … 180.

    Raises
    ------
    InputTypeError, InputError  if one is not a finite rigid transformation, or their sizes differ.
    """
    return float(np.degrees(np.linalg.norm(lie.so_log(_rotation_between(T_true, T_est)))))


def translation_error(T_true: ArrayLike, T_est: ArrayLike) -> float:
    """‖t_true − t_est‖: how far apart the two poses put the source's origin.

    Parameters
    ----------
    T_true, T_est : (3, 3) or (4, 4) rigid, homogeneous, source to target.

    Returns
    -------
    float in the unit of the transformations.

    Raises
    ------
    InputTypeError, InputError  if one is not a finite rigid transformation, or their sizes differ.
    """
    (_, t_true), (_, t_est) = _pose_pair(T_true, T_est)
    return float(np.linalg.norm(t_true - t_est))


def overlap_ratio(
    source_points: ArrayLike, target_points: ArrayLike, transformation: ArrayLike, distance: float
) -> float:
    """Share of the source points that have a target point nearer than `distance` once moved.

    Parameters
    ----------
    source_points, target_points : (M, D) and (N, D), D = 2 or 3, not empty; points that are not finite have no partner.
    transformation : (D + 1, D + 1) rigid, homogeneous, source to target.
    distance : in the unit of the points, > 0; infinity for no limit.

    Returns
    -------
    float, 0 … 1; Open3D's fitness.

    Raises
    ------
    InputTypeError, InputError  if an argument is no array of that shape, a cloud is empty or the target has no finite
                                point, the transformation is not rigid or the distance not positive.
    """
    limit = distance_limit("distance", distance)
    source, target = _clouds(source_points, target_points)
    _, squares = _nearest(source, target, transformation, limit)
    return float(np.mean(squares < limit * limit))


def evaluate_registration(
    source_points: ArrayLike,
    target_points: ArrayLike,
    max_correspondence_distance: float,
    transformation: ArrayLike,
) -> RegistrationFit:
    """Open3D's `evaluate_registration` on arrays, in the plane too.

    Parameters
    ----------
    source_points, target_points : (M, D) and (N, D), D = 2 or 3, not empty; points that are not finite have no partner.
    max_correspondence_distance : in the unit of the points, > 0; a pair must be nearer. Infinity for no limit.
    transformation : (D + 1, D + 1) rigid, homogeneous, source to target.

    Returns
    -------
    RegistrationFit

    Raises
    ------
    InputTypeError, InputError  as `overlap_ratio`.
    """
    limit = distance_limit("max_correspondence_distance", max_correspondence_distance)
    source, target = _clouds(source_points, target_points)
    indices, squares = _nearest(source, target, transformation, limit)
    inliers = np.flatnonzero(squares < limit * limit)
    return RegistrationFit(
        fitness=len(inliers) / len(source),
        inlier_rmse=float(np.sqrt(squares[inliers].mean())) if len(inliers) else 0.0,
        correspondence_set=np.column_stack([inliers, indices[inliers]]).astype(np.int32),
    )


def information_matrix(
    source_points: ArrayLike,
    target_points: ArrayLike,
    max_correspondence_distance: float,
    transformation: ArrayLike,
) -> Array:
    """Open3D's `get_information_matrix_from_point_clouds` on arrays, in the plane too: what its pose graphs take.

    `global_optimization` reads its last entry as the number of pairs, and from that how wrong an edge has to be before
    it is dropped. The inverse of a result's `pose_covariance` is no such matrix; it suits optimisers without that rule.

    Σ Jᵀ J over the corresponding target points q, with J = [−hat(q), I] the motion of q under a left perturbation
    (ω, v): every corresponding pair counts as one measurement of unit variance along each axis.

    Parameters
    ----------
    source_points, target_points : (M, D) and (N, D), D = 2 or 3, not empty; points that are not finite have no partner.
    max_correspondence_distance : in the unit of the points, > 0; a pair must be nearer. Infinity for no limit.
    transformation : (D + 1, D + 1) rigid, homogeneous, source to target.

    Returns
    -------
    (3, 3) or (6, 6) float64 in the order (ω, v); zero without correspondences.

    Raises
    ------
    InputTypeError, InputError  as `overlap_ratio`.

    Source
    ------
    S. Choi, Q.-Y. Zhou, V. Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, Section 3.
    """
    fit = evaluate_registration(source_points, target_points, max_correspondence_distance, transformation)
    jacobian = lie.moved_by(np.asarray(target_points, float)[fit.correspondence_set[:, 1]])
    return np.einsum("nki,nkj->ij", jacobian, jacobian)


def _pose_pair(T_true: ArrayLike, T_est: ArrayLike) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    true = lie.split(T_true, name="T_true", tolerance=POSE_TOLERANCE)
    est = lie.split(T_est, name="T_est", tolerance=POSE_TOLERANCE)
    if len(true[1]) != len(est[1]):
        raise InputError(f"T_est: expected shape {np.shape(T_true)} like T_true, got {np.shape(T_est)}")
    return true, est


def _rotation_between(T_true: ArrayLike, T_est: ArrayLike) -> Array:
    (r_true, _), (r_est, _) = _pose_pair(T_true, T_est)
    return lie.project_to_rotation(r_true) @ lie.project_to_rotation(r_est).T


def _clouds(source_points: ArrayLike, target_points: ArrayLike) -> tuple[Array, Array]:
    source = float_array("source_points", source_points, ("M", (2, 3)), finite=False)
    if len(source) == 0:
        raise InputError("source_points: expected at least one point, got none")
    return source, float_array("target_points", target_points, ("N", source.shape[1]), finite=False)


def _nearest(source: Array, target: Array, transformation: ArrayLike, limit: float) -> tuple[NDArray[np.int64], Array]:
    """Index of and squared distance to the target point nearest to every moved source point, (M,) each.

    Of one with no target point within `limit` the distance is no less than that, and the index means nothing; so of
    points that are not finite, which are nowhere.
    """
    rotation, translation = lie.split(transformation, tolerance=POSE_TOLERANCE)
    if len(translation) != source.shape[1]:
        size = source.shape[1] + 1
        raise InputError(
            f"transformation: expected shape ({size}, {size}) for points in {source.shape[1]}D, "
            f"got {np.shape(transformation)}"
        )
    check_coordinates("transformation", translation)
    seen, known = (np.flatnonzero(np.isfinite(points).all(axis=1)) for points in (source, target))
    moving, fixed = source[seen], target[known]
    check_coordinates("source_points", moving)
    check_coordinates("target_points", fixed)
    index = NeighborIndex(fixed, name="target_points")
    found, distances = index.query(moving @ rotation.T + translation, within=limit)
    indices, squares = np.zeros(len(source), np.int64), np.full(len(source), np.inf)
    indices[seen], squares[seen] = np.append(known, 0)[found[:, 0]], distances[:, 0]
    return indices, squares
