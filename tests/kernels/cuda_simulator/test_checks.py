"""The checks of `adagmm-bench gpu`, in the simulator: right kernels pass them, wrong ones do not."""

import numpy as np

from adagmm_bench.gpu import checks, rates, registrations
from adagmm_bench.gpu.operations import PAIR_OPERATIONS
from adagmm_o3d import register_points
from adagmm_o3d.kernels.cuda.front_end import TILE
from adagmm_o3d.pairs import cuda_pairs


def run(monkeypatch):
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)
    monkeypatch.setattr(checks, "SIZES", ((TILE + 1, 2 * TILE - 1),))
    return list(checks.run_checks(seed=3))


def test_right_kernels_pass(monkeypatch):
    results = run(monkeypatch)
    assert len(results) == 2 * 10 + 2 * (10 + 13 + 4)
    assert [check for check in results if not check.passed] == []


def test_a_pass_that_leaves_something_unwritten_is_found(monkeypatch):
    class Forgetful(cuda_pairs.CudaPairLoop):
        def launch_convolved_columns(self, sigma, hues):
            """Writes nothing."""

    monkeypatch.setattr(cuda_pairs, "CudaPairLoop", Forgetful)
    failed = {check.what.split(": ")[1] for check in run(monkeypatch) if not check.passed}
    assert failed == {
        "column densities",
        *(f"convolved {what}" for what in ("Hessian", "gradient", "energy")),
        *(f"{kind}scores, {what}" for kind in ("", "coloured ") for what in ("curvature", "by_points", "by_blocks")),
    }


def test_every_pair_kernel_is_timed(monkeypatch):
    def once(launch):
        launch()
        return 0.5

    monkeypatch.setattr(rates, "POINTS", TILE)
    monkeypatch.setattr(rates, "_median_seconds", once)
    measured = {rate.kernel: rate for rate in rates.pair_rates()}
    assert set(measured) == set(PAIR_OPERATIONS)
    assert measured["adaptive"].pairs == 2 * TILE**2
    assert measured["adaptive"].operations == 2 * TILE**2 * PAIR_OPERATIONS["adaptive"]


def test_clouds_on_the_card_are_registered_as_those_from_the_host():
    rng = np.random.default_rng(0)
    target = rng.normal(size=(2 * TILE + 1, 3)) * (1.0, 0.7, 0.4)
    source = target + np.array([0.02, -0.01, 0.03])
    resident = registrations.register_resident(*registrations.cuda_arrays(source, target))
    expected = register_points(source, target, device="cpu")
    np.testing.assert_allclose(resident.transformation, expected.transformation, rtol=0, atol=1e-6)


def test_the_crossing_point_is_where_the_gpu_stays_ahead(monkeypatch):
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)
    monkeypatch.setattr(registrations, "CROSSING_SIZES", (3, 5, 7, 9))
    seconds = iter([1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 1.0])  # CPU, GPU of each size: ahead at 5, behind at 7
    monkeypatch.setattr(registrations, "_median_seconds", lambda run, repeats: next(seconds))
    assert registrations.crossing_point(repeats=1) == 9**2
