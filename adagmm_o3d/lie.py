"""Rotations and rigid transformations of the plane and of space: SO(2), SO(3), SE(2), SE(3).

The dimension follows from the size of the argument, so that a solver reads the same in 2D and 3D:

    group   matrix               tangent vector                   generator
    SO(2)   (2, 2)               (1,)  ω [rad]                    hat(ω) = [[0, −ω], [ω, 0]]
    SO(3)   (3, 3)               (3,)  ω [rad]                    hat(ω) u = ω × u
    SE(2)   (3, 3) homogeneous   (3,)  (ω, v): angle first        [[hat(ω), v], [0, 0]]
    SE(3)   (4, 4) homogeneous   (6,)  (ω, v): rotation first     [[hat(ω), v], [0, 0]]

The tangent order (ω, v) is Open3D's. A perturbation stands on the left, se_exp(δ) @ T: δ lives in the target's frame,
and a transformed point p moves by ω × p + v to first order.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, float_array, real_number
from adagmm_o3d.errors import InputError

ROTATION_TOLERANCE = 1e-6
"""Largest entry of RᵀR − I that still counts as a rotation; float32 matrices pass."""
LAST_ROW_TOLERANCE = 1e-6
"""By how much an entry of a transformation's last row may differ from (0, …, 0, 1): inverses and fits are rounded."""


def hat(omega: ArrayLike) -> Array:
    """The skew matrix of a rotation vector: hat(ω) u = ω × u.

    Parameters
    ----------
    omega : (1,) or (3,) [rad].

    Returns
    -------
    (2, 2) or (3, 3) float64, skew-symmetric.

    Raises
    ------
    InputTypeError, InputError  if it is not one or three finite numbers.
    """
    w = float_array("omega", omega, ((1, 3),))
    if len(w) == 1:
        return np.array([[0.0, -w[0]], [w[0], 0.0]])
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def moved_by(points: Array) -> Array:
    """The derivative by (ω, v) of points p that move by ω × p + v, as with a left perturbation of their pose.

    Parameters
    ----------
    points : (N, D) float64, D = 2 or 3.

    Returns
    -------
    (N, D, 3) or (N, D, 6) float64, [−hat(p), I] in 3D.
    """
    count, dimension = points.shape
    turned = np.zeros((count, dimension, 2 * dimension - 3))
    if dimension == 2:
        turned[:, 0, 0], turned[:, 1, 0] = -points[:, 1], points[:, 0]
    else:
        x, y, z = points.T
        turned[:, 0, 1], turned[:, 0, 2] = z, -y
        turned[:, 1, 0], turned[:, 1, 2] = -z, x
        turned[:, 2, 0], turned[:, 2, 1] = y, -x
    return np.concatenate([turned, np.broadcast_to(np.eye(dimension), (count, dimension, dimension))], axis=2)


def vee(skew: ArrayLike) -> Array:
    """The inverse of `hat`; of a matrix that is not skew, that of its skew part.

    Parameters
    ----------
    skew : (2, 2) or (3, 3).

    Returns
    -------
    (1,) or (3,) float64.

    Raises
    ------
    InputTypeError, InputError  if it is not a finite 2x2 or 3x3 matrix.
    """
    k = _square("skew", skew, (2, 3))
    if len(k) == 2:
        return np.array([0.5 * (k[1, 0] - k[0, 1])])
    return 0.5 * np.array([k[2, 1] - k[1, 2], k[0, 2] - k[2, 0], k[1, 0] - k[0, 1]])


def so_exp(omega: ArrayLike) -> Array:
    """The rotation by |ω| about ω (Rodrigues), accurate at every angle, zero included.

    Parameters
    ----------
    omega : (1,) or (3,) [rad].

    Returns
    -------
    (2, 2) or (3, 3) float64 rotation.

    Raises
    ------
    InputTypeError, InputError  as `hat`.
    """
    w = float_array("omega", omega, ((1, 3),))
    k = hat(w)
    sine, versine, _ = _coefficients(float(np.linalg.norm(w)))
    return np.eye(len(k)) + sine * k + versine * (k @ k)


def so_log(rotation: ArrayLike) -> Array:
    """The shortest rotation vector whose `so_exp` is the rotation, accurate near 0 and near π alike.

    Goes through the unit quaternion, divided by its largest component (Shepperd), never through arccos of the trace. At
    exactly π either of the two opposite vectors is right and one is returned.

    Parameters
    ----------
    rotation : (2, 2) or (3, 3).

    Returns
    -------
    (1,) or (3,) float64 [rad], length at most π.

    Raises
    ------
    InputTypeError, InputError  if it is not a finite 2x2 or 3x3 rotation.

    Source
    ------
    S. W. Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1(3), 1978.
    """
    r = _rotation("rotation", rotation)
    if len(r) == 2:
        return np.array([math.atan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])])
    return _rotation_vector(r)


def so_left_jacobian(omega: ArrayLike) -> Array:
    """V(ω), with which se_exp((ω, v)) translates by V(ω) v.

    Parameters
    ----------
    omega : (1,) or (3,) [rad].

    Returns
    -------
    (2, 2) or (3, 3) float64; singular at full turns only.

    Raises
    ------
    InputTypeError, InputError  as `hat`.
    """
    w = float_array("omega", omega, ((1, 3),))
    k = hat(w)
    _, versine, rest = _coefficients(float(np.linalg.norm(w)))
    return np.eye(len(k)) + versine * k + rest * (k @ k)


def se_exp(tangent: ArrayLike) -> Array:
    """The rigid transformation of a tangent vector (ω, v).

    Parameters
    ----------
    tangent : (3,) for SE(2) or (6,) for SE(3): rotation [rad] first, then translation [input units].

    Returns
    -------
    (3, 3) or (4, 4) float64 homogeneous matrix.

    Raises
    ------
    InputTypeError, InputError  if it is not three or six finite numbers.
    """
    xi = float_array("tangent", tangent, ((3, 6),))
    dimension = 2 if len(xi) == 3 else 3
    omega, v = xi[:-dimension], xi[-dimension:]
    return _homogeneous(so_exp(omega), so_left_jacobian(omega) @ v)


def se_log(transformation: ArrayLike) -> Array:
    """The tangent vector (ω, v) whose `se_exp` is the transformation, with |ω| at most π.

    Parameters
    ----------
    transformation : (3, 3) or (4, 4) rigid, homogeneous.

    Returns
    -------
    (3,) or (6,) float64.

    Raises
    ------
    InputTypeError, InputError  if it is not a finite rigid transformation.
    """
    r, t = split(transformation)
    omega = so_log(r)
    return np.concatenate([omega, np.linalg.solve(so_left_jacobian(omega), t)])


def se_adjoint(transformation: ArrayLike) -> Array:
    """Ad(T), which carries a right perturbation to a left one: T exp(δ) = exp(Ad(T) δ) T.

    Parameters
    ----------
    transformation : (3, 3) or (4, 4) rigid, homogeneous.

    Returns
    -------
    (3, 3) or (6, 6) float64 in the order (ω, v).

    Raises
    ------
    InputTypeError, InputError  if it is not a finite rigid transformation.
    """
    r, t = split(transformation)
    if len(r) == 2:
        return np.block([[np.eye(1), np.zeros((1, 2))], [np.array([[t[1]], [-t[0]]]), r]])
    return np.block([[r, np.zeros((3, 3))], [hat(t) @ r, r]])


def se_inverse(transformation: ArrayLike) -> Array:
    """The inverse of a rigid transformation, by transposing its rotation.

    Parameters
    ----------
    transformation : (3, 3) or (4, 4) rigid, homogeneous.

    Returns
    -------
    (3, 3) or (4, 4) float64.

    Raises
    ------
    InputTypeError, InputError  if it is not a finite rigid transformation.
    """
    r, t = split(transformation)
    return _homogeneous(r.T, -r.T @ t)


def split(
    transformation: ArrayLike, *, name: str = "transformation", tolerance: float = ROTATION_TOLERANCE
) -> tuple[Array, Array]:
    """Rotation and translation of a rigid transformation.

    Parameters
    ----------
    transformation : (3, 3) or (4, 4) rigid, homogeneous.
    name : what an error calls it.
    tolerance : largest accepted entry of RᵀR − I.

    Returns
    -------
    (D, D) and (D,) float64, D = 2 or 3, the numbers as they came.

    Raises
    ------
    InputTypeError, InputError  if it is not finite, its last row is not (0, …, 0, 1) but for rounding or its rotation
                                is not one.
    """
    m = _square(name, transformation, (3, 4))
    last = np.eye(len(m))[-1]
    if np.abs(m[-1] - last).max() > LAST_ROW_TOLERANCE:
        raise InputError(
            f"{name}: expected a homogeneous matrix with last row {_row(last)}, got {_row(m[-1])}; "
            "embed a rotation R as eye(D + 1) with [:D, :D] = R"
        )
    return _rotation(name, m[:-1, :-1], tolerance), m[:-1, -1].copy()


def is_rotation(matrix: ArrayLike, *, tolerance: float = ROTATION_TOLERANCE) -> bool:
    """Whether a matrix is a proper rotation: no entry of RᵀR − I beyond `tolerance`, determinant positive.

    Parameters
    ----------
    matrix : (2, 2) or (3, 3); NaN makes the answer False.

    Returns
    -------
    bool

    Raises
    ------
    InputTypeError, InputError  if it is not a 2x2 or 3x3 matrix of numbers, or `tolerance` is not positive.
    """
    limit = real_number("tolerance", tolerance, above=0.0)
    r = _square("matrix", matrix, (2, 3), finite=False)
    if not np.isfinite(r).all():
        return False
    return bool(np.abs(r.T @ r - np.eye(len(r))).max() <= limit and np.linalg.det(r) > 0.0)


def project_to_rotation(matrix: ArrayLike) -> Array:
    """The rotation nearest to a matrix in the Frobenius norm (orthogonal Procrustes).

    Parameters
    ----------
    matrix : (2, 2) or (3, 3), for instance a rotation read from a file with few digits.

    Returns
    -------
    (2, 2) or (3, 3) float64 rotation.

    Raises
    ------
    InputTypeError, InputError  if it is not a finite 2x2 or 3x3 matrix, or several rotations are equally near.

    Source
    ------
    W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
    """
    a = _square("matrix", matrix, (2, 3))
    u, s, vt = np.linalg.svd(a)
    sign = 1.0 if np.linalg.det(u) * np.linalg.det(vt) > 0.0 else -1.0
    if s[-2] + sign * s[-1] <= 1e-12 * s[0]:
        raise InputError(
            f"matrix: expected a matrix with one nearest rotation, got singular values {_row(s)} "
            f"and determinant {np.linalg.det(a):.3g}; is it a rotation at all?"
        )
    u[:, -1] *= sign
    return u @ vt


def _coefficients(angle: float) -> tuple[float, float, float]:
    """sin θ / θ, (1 − cos θ) / θ² and (θ − sin θ) / θ³ for θ ≥ 0."""
    sine = float(np.sinc(angle / math.pi))
    versine = 0.5 * float(np.sinc(0.5 * angle / math.pi)) ** 2
    # the third cancels near 0, but only by what its matrix, of size θ², takes back; below 1e-4 its limit is exact
    rest = (angle - math.sin(angle)) / angle**3 if angle > 1e-4 else 1.0 / 6.0
    return sine, versine, rest


def _rotation_vector(r: Array) -> Array:
    squares = np.array([1.0 + r[0, 0] + r[1, 1] + r[2, 2], *(1.0 - np.trace(r) + 2.0 * np.diag(r))])
    w, x, y, z = range(4)
    products = np.empty((4, 4))
    products[np.diag_indices(4)] = squares
    products[w, x] = products[x, w] = r[2, 1] - r[1, 2]
    products[w, y] = products[y, w] = r[0, 2] - r[2, 0]
    products[w, z] = products[z, w] = r[1, 0] - r[0, 1]
    products[x, y] = products[y, x] = r[1, 0] + r[0, 1]
    products[x, z] = products[z, x] = r[0, 2] + r[2, 0]
    products[y, z] = products[z, y] = r[2, 1] + r[1, 2]
    quaternion = products[np.argmax(squares)]  # 4 q_k q of the unit quaternion q, k its largest component
    quaternion = quaternion / np.linalg.norm(quaternion)
    if quaternion[0] < 0.0:
        quaternion = -quaternion
    half_sine = float(np.linalg.norm(quaternion[1:]))
    if half_sine < 1e-150:  # below it the square underflows and the ratio is 2 anyway
        return 2.0 * quaternion[1:]
    return (2.0 * math.atan2(half_sine, quaternion[0]) / half_sine) * quaternion[1:]


def _homogeneous(r: Array, t: Array) -> Array:
    m = np.eye(len(t) + 1)
    m[:-1, :-1], m[:-1, -1] = r, t
    return m


def _square(name: str, value: ArrayLike, sizes: tuple[int, ...], *, finite: bool = True) -> Array:
    m = float_array(name, value, (sizes, sizes), finite=finite, booleans=True)
    if m.shape[0] != m.shape[1]:
        raise InputError(f"{name}: expected a square matrix, got shape {m.shape}")
    return m


def _rotation(name: str, value: ArrayLike, tolerance: float = ROTATION_TOLERANCE) -> Array:
    r = _square(name, value, (2, 3))
    if not is_rotation(r, tolerance=tolerance):
        deviation = float(np.abs(r.T @ r - np.eye(len(r))).max())
        raise InputError(
            f"{name}: expected a rotation, got determinant {np.linalg.det(r):.6g} and RᵀR − I up to {deviation:.3g}; "
            "see project_to_rotation()"
        )
    return r


def _row(numbers: Array) -> str:
    # digits enough to tell what is refused from what is wanted
    return f"({', '.join(f'{x:.9g}' for x in numbers)})"
