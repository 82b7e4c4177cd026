"""Which tiles and points a cluster can reach, against every one looked at."""

import numpy as np
import pytest

from adagmm_o3d.kernels.cpu import culling
from adagmm_o3d.kernels.cpu.convolved_pass import points_in_reach
from adagmm_o3d.kernels.cpu.culling import GROUP, RUN, TILE, Box, Boxes, closest_tile, next_run, reach, reach_sq
from adagmm_o3d.kernels.cpu.tiles import make_tiles, morton_order

COUNT = 3 * GROUP * TILE + 5 * TILE + 3


class Scene:
    """A target in the kernels' order, cut into tiles, and boxes of source clusters in and around it."""

    def __init__(self, seed, vague=1.0):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=(COUNT, 3))
        points = points[morton_order(points, np.zeros(COUNT, bool))]
        self.x = np.ascontiguousarray(points.T, np.float32)
        self.variances = (vague * rng.uniform(0.2, 2.0, COUNT) ** 3).astype(np.float32)
        self.bits = rng.uniform(5.0, 24.0, COUNT).astype(np.float32)
        self.tiles = make_tiles(self.x, self.variances, self.bits)
        self.boxes = []
        for _ in range(12):
            corner = rng.normal(size=3) * 1.5
            lo, hi = corner.astype(np.float32), (corner + rng.uniform(0.01, 0.3, 3)).astype(np.float32)
            variance, bits = np.float32(vague * rng.uniform(0.2, 3.0)), np.float32(rng.uniform(4.0, 26.0))
            self.boxes.append(Box(lo, hi, variance, bits))

    def tiles_in_reach(self, box, sigma):
        """Of the paper's weights."""
        return reached(box, self.tiles.lo, self.tiles.hi, sigma * self.tiles.variance, self.tiles.bits, False)


def reached(box, lo, hi, variances, bits, convolved):
    """(n,) bool: whether each of (3, n) boxes is near enough that a pair's weight is not lost."""
    own_lo, own_hi, variance, own_bits = box
    gaps = np.maximum(np.maximum(lo - own_hi[:, None], own_lo[:, None] - hi), 0.0)
    if convolved:
        limits = (variance + variances) * np.minimum(own_bits, bits)
    else:
        limits = np.maximum(variance * own_bits, variances * bits)
    return (gaps.astype(float) ** 2).sum(axis=0) < limits


@pytest.mark.parametrize("vague", [1e-4, 1e-2, 1e-1])
@pytest.mark.parametrize("kind", ["groups", "tiles", "points"])
def test_what_is_in_reach(kind, vague):
    scene = Scene(0, vague)
    t = scene.tiles
    of_groups = Boxes(t.group_lo, t.group_hi, t.group_variance, t.group_bits)
    of_tiles = Boxes(t.lo, t.hi, t.variance, t.bits)
    of_points = Boxes(scene.x, scene.x, scene.variances, scene.bits)
    others, step = {"groups": (of_groups, 1), "tiles": (of_tiles, GROUP), "points": (of_points, TILE)}[kind]
    count, counts = len(others[2]), []
    for box in scene.boxes:
        expected = reached(box, *others, True)
        for first in range(0, count, step):
            last = min(count, first + step)
            beyond = np.empty(step, np.float32)
            hits = reach(first, last, box, others, beyond)
            np.testing.assert_array_equal(beyond[: last - first] < 0.0, expected[first:last])
            assert hits == expected[first:last].sum()
            counts.append(hits)
    assert vague == 1e-1 or min(counts) < np.mean(counts) < max(counts)


@pytest.mark.parametrize("vague", [1e-4, 1e-2, 1e-1])
def test_the_points_in_reach_are_put_behind_those_before(vague):
    scene, before = Scene(1, vague), np.array([7, 8, 9])
    tiles, chosen = np.arange(1, scene.tiles.lo.shape[1]), 0
    for box in scene.boxes:
        expected = reached(box, scene.x, scene.x, scene.variances, scene.bits, True)
        beyond = np.where(tiles % 3 == 0, 1.0, -1.0).astype(np.float32)
        expected[np.isin(np.arange(COUNT) // TILE, tiles[beyond < 0.0], invert=True)] = False
        index = np.full(3 + len(tiles) * TILE + 1, -1, np.int32)
        index[:3] = before
        count = points_in_reach(
            tiles[0], tiles[-1] + 1, box, Boxes(scene.x, scene.x, scene.variances, scene.bits),
            beyond, np.empty(TILE, np.float32), index, 3,
        )  # fmt: skip
        np.testing.assert_array_equal(index[:count], [*before, *np.flatnonzero(expected)])
        chosen += expected.sum()
    assert chosen > 0


@pytest.mark.parametrize("vague", [1e-4, 1e-2, 1.0])
def test_runs_are_the_stretches_of_tiles_in_reach(vague):
    scene, longest = Scene(2, vague), 0
    count = scene.tiles.lo.shape[1]
    for box in scene.boxes:
        sigma = np.float32(0.5)
        inside = scene.tiles_in_reach(box, sigma=0.5)
        expected, start = [], None
        for tile in range(count + 1):
            if start is not None and (tile == count or not inside[tile] or (tile - start) * TILE >= RUN):
                expected.append((start * TILE, min(tile * TILE, COUNT)))
                start = None
            if tile < count and inside[tile] and start is None:
                start = tile
        got, tile = [], 0
        while tile < count:
            first, last, following = next_run(tile, box, sigma, scene.tiles, COUNT)
            assert following > tile
            tile = following
            if first < last:
                got.append((first, last))
                longest = max(longest, last - first)
        assert got == expected
    assert vague < 1.0 or longest == RUN


def test_the_closest_tile_is_the_one_with_the_smallest_gap():
    scene = Scene(3)
    tiles = scene.tiles
    for lo, hi, _, _ in scene.boxes:
        found = closest_tile(lo, hi, tiles.lo, tiles.hi, tiles.group_lo, tiles.group_hi)
        gaps = [culling.gap_sq(lo, hi, tiles.lo, tiles.hi, tile) for tile in range(tiles.lo.shape[1])]
        assert gaps[found] == min(gaps)


def test_a_pair_of_equals_reaches_as_far_as_its_weight_lives():
    # exp2(-d²/(a + b)) falls to 2^-bits at d² = (a + b) bits; the paper's weight is the sum of both exp2(-d²/a).
    assert reach_sq(True, 2.0, 20.0, 3.0, 10.0) == 50.0
    assert reach_sq(True, 2.0, 10.0, 3.0, 20.0) == 50.0
    assert reach_sq(False, 2.0, 20.0, 3.0, 10.0) == 40.0
    assert reach_sq(False, 2.0, 10.0, 3.0, 20.0) == 60.0


def test_the_first_tile_behind_a_group_left_out_is_not():
    line = np.linspace(0.0, 1.0, COUNT)
    x = np.ascontiguousarray(np.stack([line, 0.0 * line, 0.0 * line]), np.float32)
    variance, bits = np.float32(1e-10), np.float32(20.0)
    tiles = make_tiles(x, np.full(COUNT, variance), np.full(COUNT, bits))
    for tile in range(tiles.lo.shape[1]):
        middle = x[:, tile * TILE + 1]
        first, last, _ = next_run(0, (middle, middle, variance, bits), np.float32(1.0), tiles, COUNT)
        assert (first, last) == (tile * TILE, min((tile + 1) * TILE, COUNT))
