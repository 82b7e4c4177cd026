"""`adagmm-bench gpu`: what it says without a GPU, and how it judges and reports where there is one."""

import math

import pytest

from adagmm_bench.cli import main
from adagmm_bench.commands import gpu
from adagmm_bench.gpu.card import Card
from adagmm_bench.gpu.checks import TOLERANCE, Check
from adagmm_bench.gpu.rates import Rate
from adagmm_bench.gpu.registrations import Timing
from adagmm_o3d.kernels.cuda.availability import obstacle

GTX_1080_TI_LIKE = Card("a card", (8, 6), 28, 1.5e9)


@pytest.mark.skipif(obstacle() is None, reason="there is a GPU")
def test_without_a_gpu_there_is_one_clear_line(capsys, tmp_path):
    assert main(["gpu", "--output", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("adagmm-bench: gpu: there is nothing to measure: ")
    assert captured.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_repeats_below_one_are_refused(capsys, tmp_path):
    assert main(["gpu", "--repeats", "0", "--output", str(tmp_path)]) == 1
    assert "repeats: expected 1 or more, got 0" in capsys.readouterr().err


def test_peak_counts_two_operations_for_each_lane_and_clock():
    assert GTX_1080_TI_LIKE.peak == 2 * 128 * 28 * 1.5e9
    assert Card("of the future", (99, 0), 1, 1e9).peak is None


def test_share_of_peak_follows_from_the_pairs():
    pairs = 0.5 * GTX_1080_TI_LIKE.peak / gpu.PAIR_OPERATIONS["adaptive"]
    (row,) = gpu.rate_rows([Rate("adaptive", pairs)], GTX_1080_TI_LIKE)
    assert row[0] == "adaptive"
    assert row[-1] == "50 %"
    assert gpu.rate_rows([Rate("adaptive", pairs)], Card("?", (99, 0), 1, 1e9))[0][-1] == "unknown"


def test_registrations_are_set_beside_the_cpu_and_the_paper():
    seconds = {"resident": 0.015, "cuda": 0.02, "cpu": 0.1}
    (row,) = gpu.time_rows([Timing(4000, seconds, {"resident": 0.01, "cuda": 0.01, "cpu": 0.02})])
    assert row == ("4000", "0.015", "0.02", "0.1", "5.0", "500", "0.010", "0.020")
    assert len(row) == len(gpu.TIME_COLUMNS)


def test_what_is_measured_stays_when_the_rest_is_interrupted(tmp_path, monkeypatch, capsys):
    def interrupted(sizes, repeats):
        seconds = {"resident": 0.015, "cuda": 0.02, "cpu": 0.1}
        yield Timing(sizes[0], seconds, dict.fromkeys(seconds, 0.01))
        raise KeyboardInterrupt

    monkeypatch.setattr(gpu, "pair_rates", lambda: [Rate("adaptive", 1e9)])
    monkeypatch.setattr(gpu, "registration_timings", interrupted)
    report = tmp_path / "report.md"
    with pytest.raises(KeyboardInterrupt):
        gpu.measure(GTX_1080_TI_LIKE, 1, report, "checked\n")
    text = report.read_text()
    assert text.startswith("checked\n")
    assert "| adaptive | 87 | 1.0 | 0.09 | 1 % |" in text
    assert "| 1000 | 0.015 | 0.02 | 0.1 | 5.0 | 500 | 0.010 | 0.010 |" in text
    assert "1000 points registered in 0.02 s" in capsys.readouterr().out


def test_an_error_that_is_no_number_is_a_failure_and_the_worst():
    checks = [Check("fine", 0.5 * TOLERANCE), Check("spoiled", math.nan)]
    assert [check.passed for check in checks] == [True, False]
    text = gpu.describe(checks, [checks[1]], 7, "not run")
    assert "1 of 2 checks" in text
    assert "seed 7" in text
    assert text.endswith("failed: spoiled: nan")


@pytest.mark.parametrize(("exit_code", "clean"), [(0, True), (9, False)])
def test_what_compute_sanitizer_finds_decides(exit_code, clean, tmp_path, monkeypatch):
    program = tmp_path / "compute-sanitizer"
    program.write_text(f'#!/bin/sh\necho "tool $2"\nexit {exit_code}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    text, found_nothing = gpu.sanitize()
    assert found_nothing is clean
    assert ("found nothing" in text) is clean
    if not clean:
        assert text == "compute-sanitizer memcheck failed: tool memcheck"


def test_without_compute_sanitizer_the_report_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert gpu.sanitize() == ("compute-sanitizer is not on PATH: not run", True)
