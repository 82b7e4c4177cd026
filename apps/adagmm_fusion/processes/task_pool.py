"""Many independent tasks on local processes or on a Dask cluster; a worker that dies loses nothing.

    for key, result in run_tasks(function, {"a": task_a, "b": task_b}, scheduler="tcp://10.0.0.1:8786"):
        ...                                   # as each ends, in any order; a TaskFailure where there is no result

`function` must be importable by its name, tasks and results must pickle. A worker keeps to one thread and one core: a
library that adds up in parallel gives other last digits on every run. On a cluster every worker needs this package, and
files at the same paths; start its workers with --nthreads 1.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from adagmm_o3d.errors import AdaGMMError, InputError

MAX_DEATHS = 3  # a task that has ended this many workers is given up
CONNECT_SECONDS = 20
ONE_THREAD = {name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}


class SchedulerError(AdaGMMError, RuntimeError):
    """The Dask scheduler cannot be reached, or was lost while it held unfinished tasks."""


class WorkerError(AdaGMMError, RuntimeError):
    """Local workers end before they take a task; what they wrote on stderr says why."""


@dataclass(frozen=True)
class TaskFailure:
    """Why a task has no result, in one line."""

    reason: str


def run_tasks(
    function: Callable[[Any], Any],
    tasks: Mapping[str, Any],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[tuple[str, Any]]:
    """Yield (key, function(task)) for every task as it ends, or (key, TaskFailure) if it raised or kept ending its
    worker.

    workers : local processes, by default one for each core; `scheduler` : address of a Dask scheduler to use instead.

    Raises
    ------
    InputError      if `workers` is not positive, or dask.distributed is not installed.
    SchedulerError  if the scheduler cannot be reached, or is lost before the end.
    WorkerError     if local workers cannot start.
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers: expected 1 or more, got {workers}")
    if scheduler is not None:
        yield from _run_on_cluster(function, tasks, scheduler)
    else:
        yield from _run_locally(function, tasks, workers or os.cpu_count() or 1)


@dataclass
class _Worker:
    process: multiprocessing.process.BaseProcess
    connection: Connection
    key: str | None = None
    started: bool = False


def _run_locally(function: Callable, tasks: Mapping[str, Any], count: int) -> Iterator[tuple[str, Any]]:
    waiting: deque[str] = deque(tasks)
    deaths: Counter[str] = Counter()
    crew: list[_Worker] = []
    started = 0
    try:
        while waiting or any(worker.key is not None for worker in crew):
            while len(crew) < min(count, len(waiting) + sum(worker.key is not None for worker in crew)):
                crew.append(_start_worker(function, index=started))
                started += 1
            for worker in crew:
                if worker.started and worker.key is None and waiting:
                    worker.key = waiting.popleft()
                    with suppress(OSError):  # it may have died; the read that follows says so
                        worker.connection.send(tasks[worker.key])
            talking = {w.connection: w for w in crew if w.key is not None or not w.started}
            ready: list[Any] = wait(list(talking))
            for connection in ready:
                worker = talking[connection]
                try:
                    message = connection.recv()
                except (EOFError, OSError):
                    crew.remove(worker)
                    failure = _bury(worker, deaths)
                    if failure is not None:
                        yield worker.key, failure
                    else:
                        waiting.append(worker.key)
                    continue
                if not worker.started:
                    worker.started = True
                    continue
                key, worker.key = worker.key, None
                yield key, message
    finally:
        for worker in crew:
            worker.connection.close()  # an idle worker ends by itself
            if worker.key is not None or not worker.started:
                worker.process.kill()
        for worker in crew:
            worker.process.join()


def _bury(worker: _Worker, deaths: Counter) -> TaskFailure | None:
    """After a worker's death: None if its task is to be tried again, a failure if it has been tried enough.

    Raises
    ------
    WorkerError  if the worker died before it was ready.
    """
    worker.process.join()
    worker.connection.close()
    if not worker.started:
        raise WorkerError(f"workers: one ended while it started, exit code {worker.process.exitcode}; see above")
    deaths[worker.key] += 1
    if deaths[worker.key] < MAX_DEATHS:
        return None
    return TaskFailure(f"its worker died {MAX_DEATHS} times, exit code {worker.process.exitcode}")


def _start_worker(function: Callable, index: int) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, function), daemon=True)
    with _environment(ONE_THREAD), _one_core(index):
        process.start()
    theirs.close()  # so that the worker's death reads as the end of the pipe
    return _Worker(process, ours)


def _serve(connection: Connection, function: Callable) -> None:
    """A worker's life: ready, then a task in, a result out, until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    connection.send("ready")
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            result = function(task)
        except Exception as error:
            result = _failure(error)
        with suppress(BrokenPipeError):  # the parent has gone; the next read says so
            connection.send(result)


@contextmanager
def _one_core(index: int) -> Iterator[None]:
    """Processes started within keep to one of the cores this one may use, where the system can do that.

    Threading Building Blocks, inside Open3D, takes its number of threads from there when it is loaded.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[index % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for the processes started within."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _run_on_cluster(function: Callable, tasks: Mapping[str, Any], address: str) -> Iterator[tuple[str, Any]]:
    try:
        from dask.distributed import CancelledError, Client, as_completed
    except ImportError as error:
        raise InputError(f"scheduler: needs dask.distributed ({error}); install the [distributed] extra") from error
    _check_scheduler(address)
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise SchedulerError(f"scheduler: no Dask scheduler answers at {address} ({error})") from error
    with client:
        run = uuid.uuid4().hex  # a cluster keeps results by key: two runs must not share them
        futures = {
            client.submit(pickle.loads, _as_bytes(function, task), key=f"{key}-{run}", pure=False): key
            for key, task in tasks.items()
        }
        for future in as_completed(list(futures), loop=client.loop):
            try:
                # `future.status` would not do: a result that nobody has fetched dies with its worker, and is made anew.
                result = future.result()
            except CancelledError as error:
                raise SchedulerError(
                    f"scheduler: lost {address} with {len(futures)} tasks left; run again to go on"
                ) from error
            except Exception as error:
                result = _failure(error)
            yield futures.pop(future), result


def _check_scheduler(address: str) -> None:
    """Ask who is there. A client of Dask's that meets something else waits, warns, and prints tracebacks to the end."""
    from distributed.core import rpc

    async def identity() -> Any:
        async with rpc(address, timeout=CONNECT_SECONDS) as there:
            return await there.identity()

    async def asked() -> Any:
        return await asyncio.wait_for(identity(), CONNECT_SECONDS)

    try:
        with _quiet("distributed"):
            answer = asyncio.run(asked())
    except Exception as error:  # whatever the bytes of another program lead to
        strange = isinstance(error, MemoryError)  # its first bytes are taken for a length
        reason = "something else does" if strange else " ".join(str(error).split())[:200] or type(error).__name__
        raise SchedulerError(f"scheduler: no Dask scheduler answers at {address!r} ({reason})") from error
    kind = answer.get("type") if isinstance(answer, dict) else None
    if kind != "Scheduler":
        raise SchedulerError(
            f"scheduler: expected a Dask scheduler at {address}, there is a {kind or 'something else'}"
        )


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Within, a library's logger says nothing."""
    logger = logging.getLogger(name)
    handlers, propagates = logger.handlers, logger.propagate
    logger.handlers, logger.propagate = [logging.NullHandler()], False
    try:
        yield
    finally:
        logger.handlers, logger.propagate = handlers, propagates


class _Call:
    """Unpickling it is calling `_call_on_cluster`, which travels as code."""

    def __init__(self, call: bytes) -> None:
        self._call = call

    def __reduce__(self):
        return _call_on_cluster, (self._call, ONE_THREAD)


def _as_bytes(function: Callable, task: Any) -> bytes:
    """A call that a cluster's worker makes by `pickle.loads`.

    Nothing of this package may be imported there before the worker keeps to one core: Threading Building Blocks, inside
    Open3D, decides on its threads when it is loaded. A function sent to Dask by its name would be imported first.
    """
    import cloudpickle

    this = sys.modules[__name__]
    cloudpickle.register_pickle_by_value(this)
    try:
        return cloudpickle.dumps(_Call(pickle.dumps((function, task))))
    finally:
        cloudpickle.unregister_pickle_by_value(this)


def _call_on_cluster(call: bytes, environment: Mapping[str, str]) -> Any:
    """Make a cluster's worker like a local one, then call. Its process id chooses its core: its place is not known."""
    import os
    import pickle

    os.environ.update(environment)
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(os.getpid()))
        core = {cores[os.getpid() % len(cores)]}
        os.sched_setaffinity(0, core)
        os.sched_setaffinity(os.getpid(), core)  # the main thread: Threading Building Blocks looks there
    function, task = pickle.loads(call)
    return function(task)


def _failure(error: BaseException) -> TaskFailure:
    if isinstance(error, AdaGMMError):  # says by itself what and where
        return TaskFailure(" ".join(str(error).split()))
    where = traceback.extract_tb(error.__traceback__)
    place = f" at {os.path.basename(where[-1].filename)}:{where[-1].lineno}" if where else ""
    return TaskFailure(f"{type(error).__name__}: {' '.join(str(error).split())}{place}")
