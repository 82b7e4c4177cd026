"""The checks of `adagmm-bench gpu`, in the simulator: right kernels pass them, wrong ones do not."""

from adagmm_bench.gpu import checks
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
