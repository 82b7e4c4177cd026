"""The checks of `adagmm-bench gpu`, in the simulator: right kernels pass them, wrong ones do not."""

from adagmm_bench.gpu import checks, rates, registrations
from adagmm_bench.gpu.operations import PAIR_OPERATIONS
from adagmm_o3d.kernels.cuda import pair_loop
from adagmm_o3d.kernels.cuda.front_end import TILE


def run(monkeypatch):
    monkeypatch.setattr(pair_loop, "WANTED_BLOCKS", 1)
    monkeypatch.setattr(checks, "SIZES", ((TILE + 1, 2 * TILE - 1),))
    return list(checks.run_checks(seed=3))


def test_right_kernels_pass(monkeypatch):
    results = run(monkeypatch)
    assert len(results) == 4 * 10
    assert [check for check in results if not check.passed] == []


def test_a_pass_that_leaves_something_unwritten_is_found(monkeypatch):
    class Forgetful(pair_loop.CudaPairLoop):
        def launch_convolved_columns(self, sigma):
            """Writes nothing."""

    monkeypatch.setattr(pair_loop, "CudaPairLoop", Forgetful)
    failed = {check.what.split(": ")[1] for check in run(monkeypatch) if not check.passed}
    assert failed == {"column densities"}


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


def test_the_crossing_point_is_where_the_gpu_stays_ahead(monkeypatch):
    monkeypatch.setattr(pair_loop, "WANTED_BLOCKS", 1)
    monkeypatch.setattr(registrations, "CROSSING_SIZES", (3, 5, 7, 9))
    seconds = iter([1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 1.0])  # CPU, GPU of each size: ahead at 5, behind at 7
    monkeypatch.setattr(registrations, "_median_seconds", lambda run, repeats: next(seconds))
    assert registrations.crossing_point(repeats=1) == 9**2
