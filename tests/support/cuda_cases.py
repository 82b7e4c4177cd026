"""Pairs of random clouds on the CPU and on the GPU or its simulator, and what holds for every size and shape."""

import numpy as np
import reference
from mixtures import random_colours, random_points_and_covariances, random_pose

from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.pairs import cuda_pairs
from adagmm_o3d.pairs.cpu_pairs import PairLoop

FREE = {2: [2, 3, 4], 3: [0, 1, 2, 3, 4, 5]}


def lift(pose):
    if len(pose) == 4:
        return pose
    lifted = np.eye(4)
    lifted[:2, :2], lifted[:2, 3] = pose[:2, :2], pose[:2, 2]
    return lifted


def spoil(loop):
    """Fill what the passes are to write with NaN: whatever is read without having been written shows."""
    for array in loop.work_arrays():
        array.copy_to_device(np.full(array.shape, np.nan, array.dtype))


class Case:
    """Two clouds at a pose, and what the reference needs to know of them.

    apart : > 0 makes two heaps of each cloud, so far apart along x, and leaves the pose at the identity.
    """

    def __init__(self, seed, m, n, dimension, isotropic, sigmas=(0.2, 0.35), radius=1.0, apart=0.0):
        rng = np.random.default_rng(seed)
        make = random_points_and_covariances
        self.source, self.source_covariances = make(rng, m, dimension, isotropic=isotropic, radius=radius)
        self.target, self.target_covariances = make(rng, n, dimension, isotropic=isotropic, radius=radius)
        self.pose, self.sigmas, self.dimension = random_pose(rng, dimension), sigmas, dimension
        if apart > 0.0:
            self.pose = np.eye(dimension + 1)
            for points in (self.source, self.target):
                points[len(points) // 2 :, 0] += apart
        self.R, self.t = self.pose[:-1, :-1], self.pose[:-1, -1]
        self.lifted = lift(self.pose)
        self.y = reference.move(self.source, self.R, self.t)
        self.B = np.linalg.inv(sigmas[0] * reference.turn(self.source_covariances, self.R))
        self.A = np.linalg.inv(sigmas[1] * self.target_covariances)
        self.mixtures = self.mixtures_of_the_clouds()

    def mixtures_of_the_clouds(self):
        return (
            make_mixture("source", self.source, self.source_covariances),
            make_mixture("target", self.target, self.target_covariances),
        )

    def paint(self):
        """Give both clouds colours; a model of them, and what the reference makes of the two."""
        colours, model = random_colours(len(self.source), len(self.target))
        self.mixtures = tuple(m.coloured(c) for m, c in zip(self.mixtures, colours, strict=True))
        return model, reference.colour_ratios(*colours, model)

    def cpu_loop(self):
        return PairLoop(*self.mixtures)

    def cuda_loop(self):
        """With everything spoiled that a pass has to write."""
        loop = cuda_pairs.CudaPairLoop(*self.mixtures)
        spoil(loop)
        return loop

    def unit(self):
        """What the kernels divide the reference's adaptive weights by: the largest amplitude on either side."""
        largest = [np.linalg.det(p).max() ** 0.5 for p in (self.A, self.B)]
        return largest[0] * largest[1]


def check_sums(case):
    """The paper's sums are those of the naive reference."""
    sums = case.cuda_loop().sums(case.lifted, *case.sigmas)
    C = reference.pair_weights(case.y, case.B, case.target, case.A) / case.unit()
    args = (C, case.y, case.B, case.target, case.A)
    free = np.ix_(FREE[case.dimension], FREE[case.dimension])
    hessian = 0.5 * reference.gauss_newton_hessian(*args, turning=False)
    gradient = 0.5 * reference.gradient(*args)
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(sums.row_weights, C.sum(axis=1), rtol=2e-6, atol=1e-7 * C.sum() / len(C))
    np.testing.assert_allclose(sums.weight, C.sum(), rtol=1e-6, atol=0)
    np.testing.assert_allclose(sums.energy, reference.energy(*args), rtol=1e-6, atol=0)
    np.testing.assert_allclose(sums.hessian[free], hessian, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(sums.gradient[FREE[case.dimension]], gradient, rtol=1e-5, atol=1e-6 * scale)


def check_posterior_sums(case, mutuality, coloured=False):
    """The sums on convolved Gaussians, and the densities on both sides, are those of the naive reference."""
    model, ratios = case.paint() if coloured else (None, 1.0)
    sigma, uniform = 0.2, 0.05
    S, T = sigma * reference.turn(case.source_covariances, case.R), sigma * case.target_covariances
    args = (case.y, S, case.target, T, uniform)
    columns = reference.posterior_sums(*args, np.zeros(len(case.target)), 0.0, ratios=ratios).column_densities
    expected = reference.posterior_sums(*args, columns, mutuality, ratios=ratios)
    sums = case.cuda_loop().posterior_sums(case.lifted, sigma, uniform, mutuality, model)
    free = np.ix_(FREE[case.dimension], FREE[case.dimension])
    scale = np.abs(expected.hessian).max()
    np.testing.assert_allclose(sums.hessian[free], expected.hessian, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(sums.gradient[FREE[case.dimension]], expected.gradient, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=1e-6, atol=0)
    posterior = expected.densities / (expected.densities + uniform)
    np.testing.assert_allclose(sums.row_weights, posterior, rtol=2e-6, atol=1e-9)
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-6, atol=1e-9)
    np.testing.assert_allclose(sums.overlap, posterior.mean(), rtol=1e-6, atol=0)


def check_nearest(case):
    """Nearest distances are those of the naive reference."""
    nearest = np.sqrt(case.cuda_loop().nearest_sq(case.lifted))
    np.testing.assert_allclose(nearest, reference.nearest_distances(case.y, case.target), rtol=1e-5, atol=1e-6)


def check_same(sums, expected, dimension=3):
    """Two passes over the same pairs, summed up differently; what leaves the plane is nobody's business in 2D."""
    free = FREE[dimension]
    hessian = expected.hessian[np.ix_(free, free)]
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], hessian, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(sums.gradient[free], expected.gradient[free], rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=1e-6, atol=0)
    np.testing.assert_allclose(sums.row_weights, expected.row_weights, rtol=2e-6, atol=1e-9)


def check_against_the_cpu(case):
    """Both E-steps are those of the CPU kernels."""
    cpu, cuda = case.cpu_loop(), case.cuda_loop()
    check_same(cuda.sums(case.lifted, *case.sigmas), cpu.sums(case.lifted, *case.sigmas), case.dimension)
    for mutuality in (0.0, 0.3):
        sums, expected = (loop.posterior_sums(case.lifted, 0.2, 0.04, mutuality) for loop in (cuda, cpu))
        check_same(sums, expected, case.dimension)
        np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-6, atol=1e-9)


def bits(case):
    """What a pass leaves behind, to the last bit."""
    sums = case.cuda_loop().sums(case.lifted, *case.sigmas)
    return sums.hessian.tobytes(), sums.gradient.tobytes(), sums.energy, sums.row_weights.tobytes()
