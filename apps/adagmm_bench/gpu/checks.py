"""The CUDA kernels against float64 on fresh random clouds, with everything spoiled beforehand that they have to write.

`python -m adagmm_bench.gpu.checks` runs the checks by themselves, for compute-sanitizer.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.mixture import Mixture, make_mixture

# Relative to the largest entry: float32 pairs, summed in float64.
TOLERANCE = 1e-5
SIZES = ((3, 63), (64, 64), (65, 127), (127, 129), (129, 640), (1000, 4097))
SIGMA, UNIFORM, MUTUALITY = 0.2, 0.05, 0.5


@dataclass(frozen=True)
class Check:
    """The largest error of a quantity relative to its largest entry."""

    what: str
    error: float
    tolerance: float = TOLERANCE

    @property
    def passed(self) -> bool:
        return self.error <= self.tolerance  # false for NaN


def run_checks(seed: int) -> Iterator[Check]:
    """All kernels at every size, in 2D and 3D, isotropic and not."""
    from adagmm_bench.gpu.cloud_checks import check_tensors, cloud_errors

    rng = np.random.default_rng(seed)
    for dimension in (2, 3):
        for isotropic in (True, False):
            for m, n in SIZES:
                kind = f"{dimension}D {'isotropic' if isotropic else 'anisotropic'} {m} x {n}"
                source, target = (_random_mixture(rng, size, dimension, isotropic) for size in (m, n))
                pose = _random_pose(rng, dimension)
                for name, error in _errors(source, target, pose):
                    yield Check(f"{kind}: {name}", error)
                if dimension == 3:
                    for name, error, tolerance in cloud_errors(source, target, pose):
                        yield Check(f"{kind}: {name}", error, tolerance)
    yield from (Check(f"a tensor on the card: {name}", error) for name, error in check_tensors(rng))


def _errors(source: Mixture, target: Mixture, pose: np.ndarray) -> Iterator[tuple[str, float]]:
    from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

    loop = CudaPairLoop(source, target)
    for array in loop.work_arrays():
        array.copy_to_device(np.full(array.shape, np.nan, array.dtype))
    sums = loop.sums(pose, SIGMA, SIGMA)
    weights, *system = _adaptive(source, target, pose)
    yield "adaptive weights", _relative(sums.row_weights, weights)
    for name, error in _system_errors(sums, system, source.dimension):
        yield f"adaptive {name}", error
    posterior_sums = loop.posterior_sums(pose, SIGMA, UNIFORM, MUTUALITY)
    posteriors, column_densities, *system = _convolved(source, target, pose)
    yield "posteriors", _relative(posterior_sums.row_weights, posteriors)
    yield "column densities", _relative(posterior_sums.column_densities, column_densities)
    for name, error in _system_errors(posterior_sums, system, source.dimension):
        yield f"convolved {name}", error
    y = source.points @ pose[:3, :3].T + pose[:3, 3]
    nearest = ((y[:, None] - target.points[None]) ** 2).sum(axis=2).min(axis=1)
    yield "nearest distances", float(np.abs(np.sqrt(loop.nearest_sq(pose)) - np.sqrt(nearest)).max())


def _system_errors(sums: Any, expected: list, dimension: int) -> Iterator[tuple[str, float]]:
    hessian, gradient, energy = expected
    free = FREE[dimension]  # in the plane z = 0 the rest means nothing
    block = hessian[np.ix_(free, free)]
    yield "Hessian", _relative(sums.hessian[np.ix_(free, free)], block)
    yield "gradient", float(np.abs(sums.gradient - gradient)[free].max() / np.abs(block).max())
    yield "energy", abs(sums.energy / energy - 1.0)


def _relative(values: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(values - expected).max() / np.abs(expected).max())


def _adaptive(source: Mixture, target: Mixture, pose: np.ndarray) -> tuple:
    y, B, A = _moved(source, target, pose)
    A, B = _inverse(A, source.dimension), _inverse(B, source.dimension)
    amplitudes = [mixture.variances ** (-0.5 * source.dimension) for mixture in (source, target)]
    u, v = (a / a.max() for a in amplitudes)
    d = y[:, None] - target.points[None]
    qa, qb = np.einsum("mni,nij,mnj->mn", d, A, d), np.einsum("mni,mij,mnj->mn", d, B, d)
    C = u[:, None] * v * (np.exp(-0.5 * qa) + np.exp(-0.5 * qb))
    P = np.einsum("mn,nij->mij", C, A) + C.sum(axis=1)[:, None, None] * B
    Bd = np.einsum("mij,mnj->mni", B, d)
    pull = np.einsum("mn,mni->mi", C, np.einsum("nij,mnj->mni", A, d) + Bd)
    turn = np.einsum("mn,mni->mi", C, np.cross(d, Bd))
    hessian, gradient = _system(y, P, pull)
    gradient[:3] -= turn.sum(axis=0)
    return C.sum(axis=1), hessian, gradient, float((C * (qa + qb)).sum())


def _convolved(source: Mixture, target: Mixture, pose: np.ndarray) -> tuple:
    y, S, T = _moved(source, target, pose)
    dimension = source.dimension
    u, v = (mixture.weights / mixture.weights.sum() for mixture in (source, target))
    hessian, gradient, energy = np.zeros((6, 6)), np.zeros(6), 0.0

    def pairs(m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        summed = S[m] + T
        P = _inverse(summed, dimension)
        d = y[m] - target.points
        q = np.einsum("ni,nij,nj->n", d, P, d)
        return np.linalg.det(summed[:, :dimension, :dimension]) ** -0.5 * np.exp(-0.5 * q), P, d, q

    rows, columns = np.empty(len(y)), np.zeros(len(target))
    for m in range(len(y)):
        density, *_ = pairs(m)
        rows[m] = density @ v
        columns += u[m] * density
    for m in range(len(y)):
        density, P, d, q = pairs(m)
        mean = (rows[m] + UNIFORM) ** (1.0 - MUTUALITY) * (columns + UNIFORM) ** MUTUALITY
        w = u[m] * v * density / mean
        h, g = _system(y[m : m + 1], np.einsum("n,nij->ij", w, P)[None], np.einsum("n,nij,nj->i", w, P, d)[None])
        hessian, gradient, energy = hessian + h, gradient + g, energy + float(w @ q)
    return rows / (rows + UNIFORM), columns, hessian, gradient, energy


def _moved(source: Mixture, target: Mixture, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    R = pose[:3, :3]
    return source.points @ R.T + pose[:3, 3], SIGMA * R @ source.covariances @ R.T, SIGMA * target.covariances


def _inverse(covariances: np.ndarray, dimension: int) -> np.ndarray:
    precisions = np.zeros_like(covariances)
    precisions[:, :dimension, :dimension] = np.linalg.inv(covariances[:, :dimension, :dimension])
    return precisions


def _system(y: np.ndarray, P: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Σ JᵀPJ and Σ Jᵀ pull for J = (-[y]ₓ, I)."""
    J = np.zeros((len(y), 3, 6))
    J[:, [0, 1, 2], [3, 4, 5]] = 1.0
    J[:, 0, 1], J[:, 0, 2] = y[:, 2], -y[:, 1]
    J[:, 1, 0], J[:, 1, 2] = -y[:, 2], y[:, 0]
    J[:, 2, 0], J[:, 2, 1] = y[:, 1], -y[:, 0]
    return np.einsum("mai,mab,mbj->ij", J, P, J), np.einsum("mai,ma->i", J, pull)


def _random_mixture(rng: np.random.Generator, n: int, dimension: int, isotropic: bool) -> Mixture:
    if isotropic:
        covariances = rng.uniform(0.5, 3.0, n)[:, None, None] * np.eye(dimension)
    else:
        factors = rng.normal(size=(n, dimension, dimension))
        covariances = factors @ factors.transpose(0, 2, 1) + 0.3 * np.eye(dimension)
    return make_mixture("cloud", rng.normal(size=(n, dimension)), covariances)


def _random_pose(rng: np.random.Generator, dimension: int) -> np.ndarray:
    delta = rng.uniform(-0.3, 0.3, 6)
    return se_exp(delta * (1.0 if dimension == 3 else np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])))


def main() -> int:
    """All checks once, the failed ones on stderr; 1 if there is one."""
    try:
        failed = [check for check in run_checks(seed=1) if not check.passed]
    except AdaGMMError as error:
        print(error, file=sys.stderr)
        return 1
    for check in failed:
        print(f"{check.what}: {check.error:.2g}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
