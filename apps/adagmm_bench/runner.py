"""Jobs that are not in the journal yet, run on processes or a cluster, shown as they advance."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from adagmm_bench.journal import Journal
from adagmm_bench.methods import METHODS
from adagmm_bench.trial import TrialJob, run_trial
from adagmm_fusion.processes.task_pool import TaskFailure, run_tasks
from adagmm_o3d.errors import AdaGMMError


class TrialError(AdaGMMError, RuntimeError):
    """A trial has no record at all: its worker kept dying, or the bench itself failed."""


@dataclass(frozen=True)
class Placement:
    """Where jobs run: `workers` local processes, or the Dask cluster behind `scheduler`."""

    workers: int | None = None
    scheduler: str | None = None


def run_jobs(
    jobs: Iterable[TrialJob],
    journal: Journal,
    placement: Placement,
    *,
    run: Callable[[TrialJob], dict] = run_trial,
    version_of: Callable[[str], str] = lambda name: METHODS[name].version(),
) -> list[dict]:
    """Run what the journal does not hold yet, made by the same version of its method of the same data; return all
    records in job order.

    Raises
    ------
    TrialError  if jobs were left without a record; all others are in the journal by then.
    """
    jobs = list(jobs)
    versions = {name: version_of(name) for name in {job.method for job in jobs}}
    digests = {key: problem.content() for key, problem in {job.problem.key: job.problem for job in jobs}.items()}
    contents = {job.key: digests[job.problem.key] for job in jobs}
    known = journal.records

    def is_current(job: TrialJob) -> bool:
        kept = known.get(job.key, {})
        return kept.get("version") == versions[job.method] and kept.get("content") == contents[job.key]

    left = {job.key: job for job in jobs if not is_current(job)}
    failures = []
    if left:
        with _progress() as progress:
            bar = progress.add_task("trials", total=len(jobs), completed=len(jobs) - len(left))
            for key, result in run_tasks(run, left, workers=placement.workers, scheduler=placement.scheduler):
                if isinstance(result, TaskFailure):
                    failures.append(f"{key}: {result.reason}")
                elif result["version"] != versions[result["method"]]:
                    failures.append(f"{key}: a worker has {result['version']}, here is {versions[result['method']]}")
                else:
                    journal.append(result | {"content": contents[key]})
                progress.update(bar, advance=1, description=_short(key))
    if failures:
        raise TrialError(f"{len(failures)} of {len(jobs)} trials left without a result, the first is {failures[0]}")
    return [journal.records[job.key] for job in jobs]


def _short(key: str) -> str:
    return key if len(key) <= 60 else key[:57] + "..."


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        # Without a terminal there is no width to fit, and a log should not lose the ends of its lines.
        console=Console(file=sys.stderr, width=None if sys.stderr.isatty() else 140),
    )
