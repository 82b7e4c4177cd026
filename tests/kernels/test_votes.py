"""Votes for shifts against NumPy, cell by cell."""

import numpy as np
import pytest

from adagmm_o3d.kernels.cpu.votes import vote_for_shifts
from adagmm_o3d.lie import so_exp

EDGE, COSINE = 0.25, 0.8


class Surfaces:
    """Two clouds with normals of either sign, a weight for every point, and a few rotations."""

    def __init__(self, m, n, seed=0):
        rng = np.random.default_rng(seed)
        self.source, self.source_normals = self.cloud(rng, m)
        self.target, self.target_normals = self.cloud(rng, n)
        self.rotations = np.array([np.eye(3), *(so_exp(v) for v in rng.normal(size=(2, 3)))])

    @staticmethod
    def cloud(rng, n):
        normals = rng.normal(size=(n, 3))
        points = rng.uniform(-1.0, 1.0, (n, 3))
        return np.column_stack([points, rng.uniform(0.5, 2.0, n)]), normals / np.linalg.norm(normals, axis=1)[:, None]

    def peaks(self, count):
        peaks = np.empty((len(self.rotations), count, 4))
        clouds = self.source, self.source_normals, self.target, self.target_normals
        vote_for_shifts(*clouds, self.rotations, EDGE, COSINE, peaks)
        return peaks

    def expected(self, rotation, count):
        moved, normals = self.source[:, :3] @ rotation.T, self.source_normals @ rotation.T
        shifts = self.target[None, :, :3] - moved[:, None]
        low = shifts.min(axis=(0, 1)) - EDGE
        votes = np.zeros(((shifts.max(axis=(0, 1)) - low) / EDGE).astype(int) + 2)
        alike = np.abs(normals @ self.target_normals.T) >= COSINE
        cells = ((shifts - low) / EDGE).astype(int)
        np.add.at(votes, tuple(cells[alike].T), np.outer(self.source[:, 3], self.target[:, 3])[alike])
        for axis in (2, 1, 0):
            v = np.moveaxis(votes, axis, 0).copy()
            np.moveaxis(votes, axis, 0)[1:-1] += 0.5 * (v[:-2] + v[2:])
        found = []
        for cell in np.ndindex(*votes.shape):
            around = votes[tuple(slice(c - 1, c + 2) for c in cell)]
            if around.shape == (3, 3, 3) and votes[cell] == around.max() > 0.0:
                found.append([*(low + (np.array(cell) + 0.5) * EDGE), votes[cell]])
        found.sort(key=lambda peak: -peak[3])
        return np.array([*found, *[[-1.0] * 4] * count])[:count]


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 3), (40, 60)])
@pytest.mark.parametrize("count", [1, 4])
def test_peaks_are_those_of_the_votes_counted_one_by_one(m, n, count):
    surfaces = Surfaces(m, n, seed=10 * m + n)
    for rotation, peaks in zip(surfaces.rotations, surfaces.peaks(count), strict=True):
        np.testing.assert_allclose(peaks, surfaces.expected(rotation, count), rtol=1e-5, atol=1e-6)


def test_a_cloud_and_its_shifted_copy_vote_for_the_shift():
    surfaces = Surfaces(80, 1)
    shift = np.array([0.4, -0.7, 0.2])
    surfaces.target, surfaces.target_normals = surfaces.source + np.array([*shift, 0.0]), -surfaces.source_normals
    np.testing.assert_allclose(surfaces.peaks(1)[0, 0, :3], shift, rtol=0, atol=EDGE)


def test_of_equal_cells_side_by_side_one_is_the_peak():
    """Two points one cell apart, each with one partner, make two equal cells."""
    surfaces = Surfaces(2, 1)
    surfaces.source = np.array([[0.0, 0.0, 0.0, 1.0], [EDGE, 0.0, 0.0, 1.0]])
    surfaces.target = np.array([[0.1, 0.1, 0.1, 1.0]])
    surfaces.source_normals = surfaces.target_normals = np.tile([0.0, 0.0, 1.0], (2, 1))
    peaks = surfaces.peaks(2)[0]
    assert peaks[0, 3] > 0.0
    np.testing.assert_array_equal(peaks[1], -1.0)
