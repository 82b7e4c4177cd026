"""How a depth camera sees a surface point: its depth, and the angle at which the ray meets the surface."""

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, check_coordinates, float_array, unit_vectors
from adagmm_o3d.errors import InputError

MAX_DEPTH = 100.0
"""No depth camera of this kind sees farther [m]; beyond it the numbers are millimetres."""


def depth_and_incidence(points: ArrayLike, normals: ArrayLike) -> tuple[Array, Array, Array]:
    """Points, their depths, and the cosines of their angles of incidence, checked.

    Parameters
    ----------
    points : (N, 3) [m], camera frame (RDF: x right, y down, z forward).
    normals : (N, 3), any non-zero length and either sign.

    Returns
    -------
    points (N, 3), depth z (N,) [m], and |cos| of the angle between normal and ray to the camera (N,), all float64.

    Raises
    ------
    InputTypeError, InputError  if an argument is no finite array of that shape, the lengths disagree, a normal has
                                length 0, or a point does not lie in front of the camera or lies beyond `MAX_DEPTH`
                                (the first such row is named).
    """
    p = float_array("points", points, ("N", 3))
    check_coordinates("points", p)
    n = unit_vectors("normals", normals, ("N", 3))
    if len(n) != len(p):
        raise InputError(f"normals: expected ({len(p)}, 3) to match the points, got {n.shape}")
    depth = p[:, 2]
    if not np.all(depth > 0.0):
        row = int(np.flatnonzero(depth <= 0.0)[0])
        raise InputError(
            f"points: expected z > 0 in the camera frame, got z = {depth[row]:g} at row {row}; "
            "estimate covariances before moving the cloud out of its camera's frame"
        )
    if not np.all(depth <= MAX_DEPTH):
        row = int(np.flatnonzero(depth > MAX_DEPTH)[0])
        raise InputError(
            f"points: expected metres, at most {MAX_DEPTH:g} from the camera, got z = {depth[row]:g} at row {row}; "
            "divide by the depth scale first"
        )
    cosine = np.abs(np.einsum("ni,ni->n", p, n)) / np.linalg.norm(p, axis=1)
    return p, depth, np.minimum(cosine, 1.0)
