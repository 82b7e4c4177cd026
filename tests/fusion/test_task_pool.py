"""Tasks on local processes and on a real Dask cluster: nothing is lost when workers die."""

import contextlib
import gc
import os
import signal
import socket
import threading
import time

import pytest

from adagmm_fusion.processes import task_pool
from adagmm_fusion.processes.task_pool import SchedulerError, TaskFailure, WorkerError, run_tasks
from adagmm_o3d.errors import InputError

DEAD_SCHEDULER = "tcp://127.0.0.1:9"
PATIENCE_S = 120  # on a busy machine


def square(x):
    return x * x


def refuse(x):
    raise ValueError(f"no\nto {x}")


def refuse_by_name(_):
    raise InputError("depth.png: expected\n16 bits, got 8")


def threads(_):
    return os.environ["NUMBA_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def cores(_):
    return tuple(os.sched_getaffinity(0))


def die_once(task):
    """Ends its process the first time it sees this task, by a file that remembers."""
    folder, name = task
    marker = folder / f"{name}.seen"
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return name


def die_always(x):
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def slow_square(x):
    time.sleep(0.1)
    return os.getpid(), x * x


class Unloadable:
    """A function whose module a worker cannot import."""

    def __call__(self, x):
        return x

    def __reduce__(self):
        return __import__, ("a_module_that_is_nowhere",)


def test_every_task_comes_back_once():
    results = list(run_tasks(square, {str(i): i for i in range(20)}, workers=2))
    assert len(results) == 20 and dict(results) == {str(i): i * i for i in range(20)}


def test_no_tasks_start_no_workers():
    assert list(run_tasks(square, {}, workers=2)) == []


def test_an_error_is_a_failure_in_one_line_and_others_go_on():
    results = dict(run_tasks(refuse, {"a": 1, "b": 2}, workers=1))
    assert all(isinstance(result, TaskFailure) for result in results.values())
    assert results["a"].reason.startswith("ValueError: no to 1 at test_task_pool.py:")
    assert "\n" not in results["a"].reason


def test_an_error_of_ours_is_its_own_line():
    (result,) = dict(run_tasks(refuse_by_name, {"a": 1}, workers=1)).values()
    assert result == TaskFailure("depth.png: expected 16 bits, got 8")


def test_workers_have_one_kernel_thread():
    assert dict(run_tasks(threads, {"a": 0}, workers=1)) == {"a": ("1", "1")}


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system does not tie processes to cores")
def test_workers_keep_to_one_core_each():
    before = os.sched_getaffinity(0)
    results = dict(run_tasks(cores, {str(i): i for i in range(12)}, workers=2))
    assert all(len(cores) == 1 for cores in results.values())
    assert os.sched_getaffinity(0) == before


@pytest.mark.slow
def test_a_worker_that_dies_loses_nothing(tmp_path):
    tasks = {str(i): (tmp_path, str(i)) for i in range(2)}
    assert dict(run_tasks(die_once, tasks, workers=2)) == {name: name for name in tasks}


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_given_up():
    results = dict(run_tasks(die_always, {str(i): i for i in range(5)}, workers=1))
    assert results.pop("3").reason == "its worker died 3 times, exit code -9"
    assert results == {str(i): i for i in (0, 1, 2, 4)}


def test_workers_that_cannot_start_are_an_error_at_once(capfd):
    with pytest.raises(WorkerError, match="one ended while it started, exit code 1"):
        list(run_tasks(Unloadable(), {"a": 1}, workers=1))
    assert "a_module_that_is_nowhere" in capfd.readouterr().err


def test_leaving_early_ends_the_workers():
    results = run_tasks(slow_square, {str(i): i for i in range(50)}, workers=1)
    _, (pid, _) = next(results)
    results.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize("workers", [0, -1])
def test_fewer_than_one_worker_is_refused(workers):
    with pytest.raises(InputError, match="workers: expected 1 or more"):
        list(run_tasks(square, {"a": 1}, workers=workers))


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed", reason="needs the [distributed] extra")
    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as local,
    ):
        patch.setattr(task_pool, "CONNECT_SECONDS", PATIENCE_S)
        yield local


def until(happened):
    """Wait for what must come."""
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
def test_a_cluster_survives_the_death_of_a_worker_in_mid_run(cluster):
    tasks = {str(i): i for i in range(40)}
    results, killed = {}, None
    for key, (pid, value) in run_tasks(slow_square, tasks, scheduler=cluster.scheduler_address):
        results[key] = value
        if killed is None:
            killed = pid
            os.kill(pid, signal.SIGKILL)
    assert results == {key: i * i for key, i in tasks.items()}


@pytest.mark.slow
def test_results_that_a_dead_worker_still_held_are_worked_out_anew(cluster):
    """All tasks have ended, one result has been fetched; then the worker that holds it and others dies."""
    tasks = {str(i): i for i in range(12)}
    scheduler = cluster.scheduler
    running = run_tasks(slow_square, tasks, scheduler=cluster.scheduler_address)
    key, (pid, value) = next(running)
    results = {key: value}
    until(lambda: all(task.state == "memory" for task in list(scheduler.tasks.values())))
    address = next(nanny.worker_address for nanny in cluster.workers.values() if nanny.pid == pid)
    os.kill(pid, signal.SIGKILL)
    until(lambda: address not in scheduler.workers)
    results |= {key: value for key, (_, value) in running}
    assert results == {key: i * i for key, i in tasks.items()}


@pytest.mark.slow
def test_an_error_on_a_cluster_is_a_failure_in_one_line(cluster):
    results = dict(run_tasks(refuse, {"a": 1}, scheduler=cluster.scheduler_address))
    assert results["a"].reason.startswith("ValueError: no to 1")


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed", reason="needs the [distributed] extra")
    monkeypatch.setattr("adagmm_fusion.processes.task_pool.CONNECT_SECONDS", 1)
    with pytest.raises(SchedulerError, match=DEAD_SCHEDULER):
        list(run_tasks(square, {"a": 1}, scheduler=DEAD_SCHEDULER))


@pytest.fixture
def somebody_else():
    """The address of a server that talks another language, and of one that says nothing."""
    servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]

    def talk():
        with contextlib.suppress(OSError):  # closed in the end
            while True:
                connection, _ = servers[0].accept()
                connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 20)
                connection.close()

    threading.Thread(target=talk, daemon=True).start()
    yield [f"tcp://127.0.0.1:{server.getsockname()[1]}" for server in servers]
    for server in servers:
        server.shutdown(socket.SHUT_RDWR)
        server.close()


@pytest.mark.slow
def test_a_scheduler_that_is_none_is_one_line(somebody_else, monkeypatch, capfd):
    """Dask's client would print tracebacks, also when it is thrown away."""
    pytest.importorskip("distributed", reason="needs the [distributed] extra")
    monkeypatch.setattr(task_pool, "CONNECT_SECONDS", 2)
    wrong = [*somebody_else, "tls://127.0.0.1:1", "tcp://127.0.0.1:99999", "http://127.0.0.1:80", "", "a:b", "x" * 3000]
    for address in wrong:
        with pytest.raises(SchedulerError, match=r"^scheduler: no Dask scheduler answers at ") as caught:
            list(run_tasks(square, {"a": 2}, scheduler=address))
        assert "\n" not in str(caught.value)
        del caught
    gc.collect()
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_a_worker_is_no_scheduler():
    distributed = pytest.importorskip("distributed", reason="needs the [distributed] extra")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0", silence_logs=50
    ) as local:
        address = next(iter(local.workers.values())).address
        with pytest.raises(SchedulerError, match=r"expected a Dask scheduler at .*, there is a Worker"):
            list(run_tasks(square, {"a": 2}, scheduler=address))
