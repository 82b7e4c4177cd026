"""Pairs of random clouds, the reference's answer, and both pair loops on them."""

import numpy as np
import reference
from mixtures import random_points_and_covariances, random_pose

from adagmm_o3d.kernels.cuda import pair_loop
from adagmm_o3d.kernels.pair_loop import PairLoop
from adagmm_o3d.mixture import make_mixture

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
        self.mixtures = (
            make_mixture("source", self.source, self.source_covariances),
            make_mixture("target", self.target, self.target_covariances),
        )

    def cpu_loop(self):
        return PairLoop(*self.mixtures)

    def cuda_loop(self):
        """With everything spoiled that a pass has to write."""
        loop = pair_loop.CudaPairLoop(*self.mixtures)
        spoil(loop)
        return loop

    def unit(self):
        """What the kernels divide the reference's adaptive weights by: the largest amplitude on either side."""
        largest = [np.linalg.det(p).max() ** 0.5 for p in (self.A, self.B)]
        return largest[0] * largest[1]
