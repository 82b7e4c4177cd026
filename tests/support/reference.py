"""The whole algorithm, slow and plain, in float64 NumPy: what the kernels and the solvers are held to account with.

Follows the paper (Pu, Li, Fisher: Robust Rigid Point Registration based on Convolution of Adaptive Gaussian Mixture
Models) for D = 2 and 3 and shares no code with `adagmm_o3d`. Throughout:

    y (M, D) and B (M, D, D)    the moved source points y = R y0 + t and their precisions B = R B0 Rᵀ
    x (N, D) and A (N, D, D)    the target points and their precisions; all precisions are inverse covariances over σ
    d = y_m − x_n, C (M, N)     differences, and the coefficients of the E-step
    δ = (ω, v)                  tangent vectors; perturbations stand on the left, exp(δ)·(R, t)
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.optimize import NonlinearConstraint, minimize


def move(points, rotation, translation):
    """y = R y0 + t, (M, D)."""
    return points @ rotation.T + translation


def turn(matrices, rotation):
    """R S Rᵀ of every matrix, (M, D, D): covariances and precisions turn with the points."""
    return rotation @ matrices @ rotation.T


def apply_tangent(delta, rotation, translation):
    """exp(δ)·(R, t) for δ = (ω, v)."""
    dimension = len(translation)
    generator = np.zeros((dimension + 1, dimension + 1))
    generator[:-1, :-1] = _hat(delta[:-dimension])
    generator[:-1, -1] = delta[-dimension:]
    step = expm(generator)
    return step[:-1, :-1] @ rotation, step[:-1, :-1] @ translation + step[:-1, -1]


# E-step


def pair_weights(y, B, x, A, source_weights=None, target_weights=None):
    """C_mn, (M, N): the paper's coefficient of Eq. 5 without the constant (2π)^−D, times the components' weights."""
    u = np.ones(len(y)) if source_weights is None else np.asarray(source_weights, float)
    v = np.ones(len(x)) if target_weights is None else np.asarray(target_weights, float)
    C = np.empty((len(y), len(x)))
    for m in range(len(y)):
        d = y[m] - x
        near_target = np.exp(-0.5 * np.einsum("ni,nij,nj->n", d, A, d))
        near_source = np.exp(-0.5 * np.einsum("ni,ij,nj->n", d, B[m], d))
        C[m] = np.sqrt(np.linalg.det(A) * np.linalg.det(B[m])) * (near_target + near_source)
    return C * u[:, None] * v[None, :]


@dataclass(frozen=True)
class PairSums:
    """Sums over the target points, one row per source point; packed is (xx, xy, xz, yy, yz, zz), in 2D (xx, xy, yy)."""

    weight: np.ndarray
    """(M,) Σ C."""
    energy: np.ndarray
    """(M,) Σ C dᵀ(A + B)d."""
    precision: np.ndarray
    """(M, 6 or 3) Σ C A, packed."""
    target_pull: np.ndarray
    """(M, D) Σ C A d."""
    offset: np.ndarray
    """(M, D) Σ C d; B Σ C d is the source's own pull."""
    pull: np.ndarray
    """(M, D) Σ C (A + B) d."""
    turn: np.ndarray
    """(M, 3 or 1) Σ C d × (B d)."""
    scatter: np.ndarray
    """(M, 6 or 3) Σ C d dᵀ, packed."""

    def rows(self):
        """(M, 14): weight, energy, precision, pull, turn; 2D as the plane z = 0 of 3D."""
        if self.offset.shape[1] == 3:
            parts = [self.precision, self.pull, self.turn]
        else:
            xx, xy, yy = self.precision.T
            zero = np.zeros(len(xx))
            parts = [
                np.stack([xx, xy, zero, yy, zero, zero], axis=1),
                np.column_stack([self.pull, zero]),
                np.column_stack([zero, zero, self.turn]),
            ]
        return np.column_stack([self.weight, self.energy, *parts])


def pair_sums(y, B, x, A, source_weights=None, target_weights=None):
    """Everything that an M-step needs to know of the pairs, as `PairSums`."""
    C = pair_weights(y, B, x, A, source_weights, target_weights)
    d = y[:, None] - x[None]
    Ad = np.einsum("nij,mnj->mni", A, d)
    Bd = np.einsum("mij,mnj->mni", B, d)
    upper = np.triu_indices(y.shape[1])
    return PairSums(
        weight=C.sum(axis=1),
        energy=np.einsum("mn,mni,mni->m", C, d, Ad + Bd),
        precision=np.einsum("mn,nij->mij", C, A)[:, *upper],
        target_pull=np.einsum("mn,mni->mi", C, Ad),
        offset=np.einsum("mn,mni->mi", C, d),
        pull=np.einsum("mn,mni->mi", C, Ad + Bd),
        turn=np.einsum("mn,mnk->mk", C, _cross(d, Bd)),
        scatter=np.einsum("mn,mni,mnj->mij", C, d, d)[:, *upper],
    )


# E-step on convolved Gaussians


@dataclass(frozen=True)
class PosteriorSums:
    """What a pass with posterior weights leaves behind; see `posterior_sums`."""

    hessian: np.ndarray
    """(3, 3) or (6, 6) Σ w JᵀPJ of y alone, P held."""
    gradient: np.ndarray
    """(3,) or (6,) Σ w JᵀPd."""
    weight: float
    """Σ w."""
    energy: float
    """Σ w dᵀPd."""
    densities: np.ndarray
    """(M,) density of the target mixture at the source points, without (2π)^(−D/2)."""
    column_densities: np.ndarray
    """(N,) density of the source mixture at the target points, without (2π)^(−D/2)."""


def colour_ratios(source_colours, target_colours, model):
    """(M, N) how much likelier two colours (M, 3) and (N, 3) are of the same place than of two that have nothing to do
    with each other; `model` as `adagmm_o3d.mixtures.colours.ColourModel`."""
    seen = model.gain * source_colours + model.offset
    half = 0.5 * (((seen[:, None] - target_colours[None]) / model.deviations) ** 2).sum(axis=2)
    return np.exp(-np.minimum(half, model.floor)) / model.expected


def posterior_sums(
    y, S, x, T, uniform, column_densities, mutuality, source_weights=None, target_weights=None, ratios=1.0
):
    """The E-step on N(d; 0, S_m + T_n), S (M, D, D) and T (N, D, D) being covariances, already turned and scaled.

    A pair's weight w is the weighted geometric mean of its share of the density at y_m and of the one at x_n, the
    latter to the power of `mutuality`. `uniform` is the density of points without a partner; `ratios` (M, N) what the
    pairs' colours add, see `colour_ratios`.
    """
    u = np.full(len(y), 1.0 / len(y)) if source_weights is None else source_weights / np.sum(source_weights)
    v = np.full(len(x), 1.0 / len(x)) if target_weights is None else target_weights / np.sum(target_weights)
    d = y[:, None] - x[None]
    summed = S[:, None] + T[None]
    P = np.linalg.inv(summed)
    density = np.linalg.det(summed) ** -0.5 * np.exp(-0.5 * np.einsum("mni,mnij,mnj->mn", d, P, d))
    density = density * ratios
    rows, columns = density @ v, u @ density
    seen_from_source = (rows + uniform)[:, None] ** (1.0 - mutuality)
    w = density * u[:, None] * v / (seen_from_source * (column_densities + uniform)[None] ** mutuality)
    size = y.shape[1] * (y.shape[1] + 1) // 2
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    for m in range(len(y)):
        J = _point_jacobian(y[m])
        hessian += J.T @ np.einsum("n,nij->ij", w[m], P[m]) @ J
        gradient += J.T @ np.einsum("n,nij,nj->i", w[m], P[m], d[m])
    energy = np.einsum("mn,mni,mnij,mnj->", w, d, P, d)
    return PosteriorSums(hessian, gradient, w.sum(), energy, rows, columns)


# M-step


def energy(C, y, B, x, A):
    """Q of Eq. 5: Σ C dᵀ(A + B)d."""
    d = y[:, None] - x[None]
    return np.einsum("mn,mni,nij,mnj->", C, d, A, d) + np.einsum("mn,mni,mij,mnj->", C, d, B, d)


def energy_at(C, y0, B0, x, A, rotation, translation):
    """Q(R, t) with C held: the source's precisions turn with R."""
    return energy(C, move(y0, rotation, translation), turn(B0, rotation), x, A)


def gradient(C, y, B, x, A):
    """dQ/dδ at δ = 0 of exp(δ)·(R, t), (3,) or (6,).

    With r = A^½ d and s = B0^½ Rᵀ d, Q = Σ C (rᵀr + sᵀs); a perturbation moves r by A^½ (ω × y + v) and s by
    B0^½ Rᵀ (ω × x + v): seen from a source point it is the target that turns. Hence y × A d and x × B d, which is
    y × (A + B) d with the turning term − d × B d split off.
    """
    d = y[:, None] - x[None]
    Ad = np.einsum("nij,mnj->mni", A, d)
    Bd = np.einsum("mij,mnj->mni", B, d)
    omega = np.einsum("mn,mnk->k", C, _cross(y[:, None], Ad) + _cross(x[None], Bd))
    return 2.0 * np.concatenate([omega, np.einsum("mn,mni->i", C, Ad + Bd)])


def gauss_newton_hessian(C, y, B, x, A, *, turning=True):
    """The Gauss-Newton matrix of Q for exp(δ)·(R, t), (3, 3) or (6, 6); the factor 2 of `gradient` included.

    `turning` False leaves B as it is while the points move, as if it were isotropic: both residuals then move with y.
    """
    dimension = y.shape[1]
    size = dimension * (dimension + 1) // 2
    H = np.zeros((size, size))
    for m in range(len(y)):
        at_y = _point_jacobian(y[m])
        for n in range(len(x)):
            at_source = _point_jacobian(x[n]) if turning else at_y
            H += 2.0 * C[m, n] * (at_y.T @ A[n] @ at_y + at_source.T @ B[m] @ at_source)
    return H


def gradient_by_differences(C, y0, B0, x, A, rotation, translation, step=1e-6):
    """dQ/dδ by central differences of `energy_at` along exp(δ)·(R, t)."""
    dimension = len(translation)
    size = dimension * (dimension + 1) // 2
    slopes = [
        energy_at(C, y0, B0, x, A, *apply_tangent(delta, rotation, translation))
        - energy_at(C, y0, B0, x, A, *apply_tangent(-delta, rotation, translation))
        for delta in step * np.eye(size)
    ]
    return np.array(slopes) / (2.0 * step)


def gauss_newton_m_step(C, y0, B0, x, A, rotation, translation, *, iterations=50, turning=True):
    """Minimise Q(R, t) on the manifold: Gauss-Newton steps with the exact gradient, halved until Q falls."""
    value = energy_at(C, y0, B0, x, A, rotation, translation)
    for _ in range(iterations):
        y, B = move(y0, rotation, translation), turn(B0, rotation)
        delta = -np.linalg.solve(gauss_newton_hessian(C, y, B, x, A, turning=turning), gradient(C, y, B, x, A))
        while np.linalg.norm(delta) > 1e-14:
            candidate = apply_tangent(delta, rotation, translation)
            new = energy_at(C, y0, B0, x, A, *candidate)
            if new <= value:
                break
            delta = 0.5 * delta
        else:
            break
        (rotation, translation), value = candidate, new
    return rotation, translation


def exact_m_step(C, y0, B0, x, A, rotation, translation):
    """The paper's M-step: interior point on the quartic Q over the 12 (in 2D 6) entries of R and t, R orthonormal.

    The equality constraints are RᵀR = I; det R ≥ ½ keeps mirror images out and is what the barrier acts on.
    Returns R and t, R orthonormal to about 1e-9.
    """
    dimension = len(translation)
    upper = np.triu_indices(dimension)
    scale = max(energy_at(C, y0, B0, x, A, rotation, translation), np.finfo(float).tiny)

    def unpack(z):
        return z[:-dimension].reshape(dimension, dimension), z[-dimension:]

    def objective(z):
        R, t = unpack(z)
        return energy_at(C, y0, B0, x, A, R, t) / scale

    def objective_gradient(z):
        R, t = unpack(z)
        d = move(y0, R, t)[:, None] - x[None]
        S = turn(B0, R)
        pull = 2.0 * (np.einsum("mn,nij,mnj->mi", C, A, d) + np.einsum("mn,mij,mnj->mi", C, S, d))
        scatter = np.einsum("mn,mni,mnj->mij", C, d, d)
        by_rotation = pull.T @ y0 + 2.0 * (scatter @ R @ B0).sum(axis=0)
        return np.concatenate([by_rotation.ravel(), pull.sum(axis=0)]) / scale

    def gram(z):
        R, _ = unpack(z)
        return (R.T @ R)[upper]

    def gram_jacobian(z):
        R, _ = unpack(z)
        rows = np.zeros((len(upper[0]), len(z)))
        for k, (i, j) in enumerate(zip(*upper, strict=True)):
            by_rotation = np.zeros((dimension, dimension))
            by_rotation[:, i] += R[:, j]
            by_rotation[:, j] += R[:, i]
            rows[k, :-dimension] = by_rotation.ravel()
        return rows

    def determinant(z):
        return np.linalg.det(unpack(z)[0])

    def determinant_jacobian(z):
        R, _ = unpack(z)
        return np.concatenate([(np.linalg.det(R) * np.linalg.inv(R).T).ravel(), np.zeros(dimension)])

    identity = np.eye(dimension)[upper]
    solution = minimize(
        objective,
        np.concatenate([rotation.ravel(), translation]),
        jac=objective_gradient,
        hess="3-point",
        method="trust-constr",
        constraints=[
            NonlinearConstraint(gram, identity, identity, jac=gram_jacobian, hess="3-point"),
            NonlinearConstraint(determinant, 0.5, np.inf, jac=determinant_jacobian, hess="3-point"),
        ],
        options={"gtol": 1e-10, "xtol": 1e-14, "barrier_tol": 1e-10, "maxiter": 500},
    )
    return unpack(solution.x)


# The scale σ


def nearest_distances(y, x):
    """Distance from every y to its nearest x, (M,)."""
    return np.array([np.linalg.norm(x - point, axis=1).min() for point in y])


def sigma_figure2(y, x):
    """The paper's Figure 2 to the letter: σ = mean nearest distance."""
    return nearest_distances(y, x).mean()


def sigma_nearest(y, x):
    """σ = mean squared nearest distance / D: the variance along one axis."""
    return (nearest_distances(y, x) ** 2).mean() / y.shape[1]


def figure2_mixture(y0, x, source_covariances, target_covariances, rotation, translation):
    """(σ, B, A) as Figure 2 has them: σ scales the moving cloud's covariances alone."""
    sigma = sigma_figure2(move(y0, rotation, translation), x)
    return sigma, np.linalg.inv(sigma * turn(source_covariances, rotation)), np.linalg.inv(target_covariances)


def nearest_mixture(y0, x, source_covariances, target_covariances, rotation, translation):
    """(σ, B, A) of the nearest-distance rule: σ scales both clouds' covariances."""
    sigma = sigma_nearest(move(y0, rotation, translation), x)
    return sigma, np.linalg.inv(sigma * turn(source_covariances, rotation)), np.linalg.inv(sigma * target_covariances)


def em_iteration(y0, x, source_covariances, target_covariances, rotation, translation, *, mixture=nearest_mixture):
    """One round of Figure 2 with the exact M-step: (R, t, σ)."""
    sigma, B, A = mixture(y0, x, source_covariances, target_covariances, rotation, translation)
    C = pair_weights(move(y0, rotation, translation), B, x, A)
    B0 = turn(B, rotation.T)
    return *exact_m_step(C, y0, B0, x, A, rotation, translation), sigma


# Small algebra


def _hat(omega):
    if len(omega) == 1:
        return np.array([[0.0, -omega[0]], [omega[0], 0.0]])
    x, y, z = omega
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _cross(a, b):
    """a × b along the last axis; in 2D its one component, kept as an axis of length 1."""
    if a.shape[-1] == 3:
        return np.cross(a, b)
    return (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])[..., None]


def _point_jacobian(p):
    """d(ω × p + v)/d(ω, v), (D, 3 or 6)."""
    rotation_part = np.array([[-p[1]], [p[0]]]) if len(p) == 2 else -_hat(p)
    return np.hstack([rotation_part, np.eye(len(p))])
