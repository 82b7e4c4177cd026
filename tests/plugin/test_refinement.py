"""The last level on dense clouds: condensed, then ever larger parts, then all points."""

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_o3d import register_points
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.result import StopReason
from adagmm_o3d.search import refinement

N, NOISE = 90_000, 0.002


@pytest.fixture(scope="module")
def dense():
    """Two samplings of one shape with noise, and the pose between them."""
    rng = np.random.default_rng(0)
    T = random_pose(rng, 3, angle=0.3, distance=0.2)
    points = bumpy(rng, 2 * N, 3) + NOISE * rng.normal(size=(2 * N, 3))
    return points[:N], move(points[N:], T), T


@pytest.fixture
def sizes(monkeypatch):
    """How many points the source and the target had, each time that pairs were asked for."""
    asked = []
    make_pair_loop = refinement.make_pair_loop

    def recorded(source, target, device):
        asked.append((len(source), len(target)))
        return make_pair_loop(source, target, device)

    monkeypatch.setattr(refinement, "make_pair_loop", recorded)
    return asked


def test_dense_clouds_are_refined_on_ever_larger_parts(dense, sizes):
    source, target, T = dense
    result = register_points(source, target)
    condensed, *parts = sizes
    assert max(condensed) < N // 2
    assert parts == [(N // 4, N // 4), (N, N)]
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < 0.02 and errors.translation < 2e-4
    assert result.converged and result.row_weights.shape == (N,)


def test_parts_cost_no_accuracy(dense, monkeypatch):
    source, target, T = dense
    errors = []
    for least in (refinement.SAMPLED_FROM, 10 * N):
        monkeypatch.setattr(refinement, "SAMPLED_FROM", least)
        result = register_points(source, target)
        errors.append((pose_errors(T, result.transformation), result.sigma))
    (by_parts, sigma), (at_once, sigma_at_once) = errors
    assert by_parts.rotation_deg < at_once.rotation_deg + 0.01
    assert sigma == pytest.approx(sigma_at_once, rel=0.1)


def test_a_small_cloud_is_not_thinned_with_a_large_one():
    rng = np.random.default_rng(1)
    many, few = (make_mixture("source", rng.normal(size=(n, 3)), None) for n in (400_000, 30_000))
    parts = [(len(a), len(b)) for a, b in refinement._parts(many, few)]
    assert parts == [(25_000, 25_000), (100_000, 30_000), (400_000, 30_000)]


def test_the_iterations_of_all_parts_are_bounded_together(dense):
    source, target, _ = dense
    levels = []
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=9)
    result = register_points(
        source, target, criteria=criteria, callback_after_iteration=lambda step: levels.append(step["scale_index"])
    )
    assert len(levels) == result.iterations == 9 and levels.count(refinement.LEVEL) == 6
    assert result.stop_reason is StopReason.MAX_ITERATION and result.row_weights.shape == (N,)
