"""`gpu`: are the CUDA kernels right on this machine's card, and how fast; exit code 1 without a card or if they err."""

from __future__ import annotations

import argparse
import secrets
import shutil
import subprocess
import sys
from pathlib import Path

from adagmm_bench.commands.options import add_output, check_count, check_reports
from adagmm_bench.gpu.card import Card, current_card
from adagmm_bench.gpu.checks import Check, run_checks
from adagmm_bench.gpu.operations import PAIR_OPERATIONS
from adagmm_bench.gpu.rates import POINTS, Rate, pair_rates
from adagmm_bench.gpu.registrations import SIZES, Timing, crossing_point, registration_timings
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import DeviceError
from adagmm_o3d.kernels.cuda.availability import obstacle, simulated
from adagmm_o3d.pairs.device import CROSSING_PAIRS

PAPER_SECONDS = 10.0  # a 3D trial of the paper, on its GTX 1080
SANITIZER_TOOLS = ("memcheck", "racecheck", "synccheck", "initcheck")
RATE_COLUMNS = ("kernel", "operations a pair", "pairs/s (billions)", "TFLOP/s", "share of peak")
TIME_COLUMNS: tuple[str, ...] = (
    "points",
    "clouds on the GPU (s)",
    "GPU (s)",
    "CPU (s)",
    "CPU / GPU",
    "paper's 10 s / GPU",
)
TIME_COLUMNS += ("error GPU (deg)", "error CPU (deg)")
RATE_TITLE = f"Pair kernels, {POINTS} x {POINTS} points in space, every pair evaluated"
TIME_TITLE = "Whole registrations, default options"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, help="of the random clouds of the checks (default: a fresh one, printed)")
    parser.add_argument("--repeats", type=int, default=5, help="of each registration (default %(default)s)")
    add_output(parser, "gpu")


def run(arguments: argparse.Namespace) -> int:
    check_count("repeats", arguments.repeats)
    if (reason := "this is the CUDA simulator" if simulated() else obstacle()) is not None:
        raise DeviceError(f"gpu: there is nothing to measure: {reason}")
    check_reports(arguments)
    card = current_card()
    print(card)
    seed = secrets.randbelow(2**32) if arguments.seed is None else arguments.seed
    checks = list(run_checks(seed))
    failed = [check for check in checks if not check.passed]
    sanitizer, clean = sanitize()
    verdict = describe(checks, failed, seed, sanitizer)
    print(verdict)
    head = f"# {card.name}\n\n{card}\n\n{machine_note()}\n\n`{command_line()}`\n\n{verdict}\n"
    report = arguments.output / "report.md"
    write_text(report, head)
    if failed or not clean:
        return 1
    measure(card, arguments.repeats, report, head)
    print(printable(f"written to {report}"))
    return 0


def measure(card: Card, repeats: int, report: Path, head: str) -> None:
    """The figures, printed and written below `head` as they come."""
    rates = rate_rows(pair_rates(), card)
    print_table(RATE_TITLE, RATE_COLUMNS, rates)
    head += f"\n## {RATE_TITLE}\n\n{markdown_table(RATE_COLUMNS, rates)}"
    write_text(report, head)
    timings: list[Timing] = []
    body = ""
    for timing in registration_timings(SIZES, repeats):
        timings.append(timing)
        print(f"{timing.points} points registered in {timing.seconds['cuda']:.3g} s", flush=True)
        body = f"\n## {TIME_TITLE}\n\n{markdown_table(TIME_COLUMNS, time_rows(timings))}"
        write_text(report, head + body)
    print_table(TIME_TITLE, TIME_COLUMNS, time_rows(timings))
    crossing = crossing_point(repeats)
    beyond = "not up to the largest size tried" if crossing is None else f"from {crossing} pairs on"
    line = f"A pass is faster on the GPU {beyond}; 'auto' takes it from {CROSSING_PAIRS} on."
    print(line)
    write_text(report, f"{head}{body}\n{line}\n")


def sanitize() -> tuple[str, bool]:
    """What compute-sanitizer says of the checks, and whether it found nothing; it need not be installed."""
    program = shutil.which("compute-sanitizer")
    if program is None:
        return "compute-sanitizer is not on PATH: not run", True
    for tool in SANITIZER_TOOLS:
        print(f"compute-sanitizer --tool {tool} …", flush=True)
        command = [program, "--tool", tool, "--error-exitcode", "9", sys.executable, "-m", "adagmm_bench.gpu.checks"]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
        if done.returncode:
            lines = (done.stdout + done.stderr).strip().splitlines()
            return f"compute-sanitizer {tool} failed: {' / '.join(lines[-5:])}", False
    return f"compute-sanitizer ({', '.join(SANITIZER_TOOLS)}) found nothing", True


def describe(checks: list[Check], failed: list[Check], seed: int, sanitizer: str) -> str:
    worst = max(checks, key=lambda check: (not check.passed, check.error / check.tolerance))
    lines = [
        f"{len(checks) - len(failed)} of {len(checks)} checks against float64 passed (seed {seed}); the worst is "
        f"{worst.what}: {worst.error:.2g} where {worst.tolerance:g} is allowed.",
        f"{sanitizer[0].upper()}{sanitizer[1:]}.",
    ]
    return "\n".join([*lines, *(f"failed: {check.what}: {check.error:.2g}" for check in failed)])


def rate_rows(rates: list[Rate], card: Card) -> list[tuple[str, ...]]:
    return [
        (
            rate.kernel,
            str(PAIR_OPERATIONS[rate.kernel]),
            f"{rate.pairs / 1e9:.1f}",
            f"{rate.operations / 1e12:.2f}",
            "unknown" if card.peak is None else f"{100 * rate.operations / card.peak:.0f} %",
        )
        for rate in rates
    ]


def time_rows(timings: list[Timing]) -> list[tuple[str, ...]]:
    return [
        (
            str(timing.points),
            f"{timing.seconds['resident']:.3g}",
            f"{timing.seconds['cuda']:.3g}",
            f"{timing.seconds['cpu']:.3g}",
            f"{timing.seconds['cpu'] / timing.seconds['cuda']:.1f}",
            f"{PAPER_SECONDS / timing.seconds['cuda']:.0f}",
            f"{timing.errors_deg['cuda']:.3f}",
            f"{timing.errors_deg['cpu']:.3f}",
        )
        for timing in timings
    ]
