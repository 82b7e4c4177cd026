"""The journal, continuing a run, and the whole command on a cluster that loses a worker."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from adagmm_bench.journal import Journal
from adagmm_bench.methods import METHODS, registry
from adagmm_bench.models import load_models, make_outline, models_digest
from adagmm_bench.runner import Placement, TrialError, run_jobs
from adagmm_bench.simulation import TrialId
from adagmm_bench.trial import SimulatedProblem, TrialJob, run_trial
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.journal_lines import sealed
from adagmm_o3d.errors import InputError

METHOD = "open3d-gicp-covariances"


def jobs(count: int = 4, method: str = METHOD) -> list[TrialJob]:
    return [TrialJob(SimulatedProblem(TrialId(2, "noise", 0.13, i), None), method, "centroids") for i in range(count)]


def without_times(records):
    return [{k: v for k, v in record.items() if k not in ("seconds", "cpu_seconds")} for record in records]


def refuse(job):
    raise RuntimeError(f"the bench is broken for {job.key}")


def fail_second(job):
    if job.problem.trial_id.trial == 1:
        raise RuntimeError("broken")
    return run_trial(job)


def from_elsewhere(job):
    return run_trial(job) | {"version": "open3d 0.0.1"}


def test_records_survive_and_the_last_of_a_key_counts(tmp_path):
    path = tmp_path / "deep" / "results.jsonl"
    with Journal(path) as journal:
        journal.append({"key": "a", "value": 1})
        journal.append({"key": "b", "value": 2})
        journal.append({"key": "a", "value": 3})
    with Journal(path) as journal:
        assert journal.records == {"a": {"key": "a", "value": 3}, "b": {"key": "b", "value": 2}}


@pytest.mark.parametrize("torn", [b'{"key":"c","val', b"{", b"\xff\xfe"])
def test_a_torn_last_line_is_dropped_and_the_next_record_is_whole(tmp_path, torn):
    path = tmp_path / "results.jsonl"
    with Journal(path) as journal:
        journal.append({"key": "a"})
    with open(path, "ab") as file:
        file.write(torn)
    with Journal(path) as journal:
        assert list(journal.records) == ["a"]
        journal.append({"key": "c"})
    with Journal(path) as journal:
        assert list(journal.records) == ["a", "c"]


@pytest.mark.parametrize("line", ["not json", "[1]", '{"no": "key"}'])
def test_a_line_that_is_no_record_is_named(tmp_path, line):
    path = tmp_path / "results.jsonl"
    path.write_text(f"{sealed({'key': 'a'})}\n{line}\n{sealed({'key': 'b'})}\n")
    with pytest.raises(InputError, match=r"results\.jsonl:2: expected a JSON record with a key"):
        Journal(path)


def test_two_runs_do_not_write_to_one_journal(tmp_path):
    path = tmp_path / "results.jsonl"
    with Journal(path), pytest.raises(OutputError, match="another run is writing here"):
        Journal(path)
    with Journal(path):
        pass


def test_numbers_that_json_does_not_know_are_refused(tmp_path):
    with Journal(tmp_path / "results.jsonl") as journal, pytest.raises(ValueError, match="not JSON compliant"):
        journal.append({"key": "a", "value": float("nan")})


@pytest.mark.slow
def test_a_run_continues_where_it_was_stopped(tmp_path):
    path = tmp_path / "results.jsonl"
    with Journal(path) as journal:
        first = run_jobs(jobs(2), journal, Placement(workers=1))
    with Journal(path) as journal:
        both = run_jobs(jobs(4), journal, Placement(workers=1))
    assert both[:2] == first, "records that were there, times and all, are not made again"
    assert [record["problem"]["trial"] for record in both] == [0, 1, 2, 3]
    with Journal(path) as journal:
        assert run_jobs(jobs(4), journal, Placement(workers=1), run=refuse) == both


@pytest.mark.slow
def test_results_of_another_version_are_made_again(tmp_path):
    path = tmp_path / "results.jsonl"
    with Journal(path) as journal:
        (record,) = run_jobs(jobs(1), journal, Placement(workers=1))
        journal.append(record | {"version": "open3d 0.0.1", "rotation_error": 7.0})
    with Journal(path) as journal:
        (again,) = run_jobs(jobs(1), journal, Placement(workers=1))
    assert without_times([again]) == without_times([record])


@pytest.mark.slow
def test_results_of_other_data_are_made_again(tmp_path):
    """A file of models under the same name, whose models are others now."""
    models = tmp_path / "models.npz"
    job = TrialJob(SimulatedProblem(TrialId(2, "noise", 0.13, 0), models), METHOD, "centroids")
    records = []
    with Journal(tmp_path / "results.jsonl") as journal:
        for model, run in ((0, run_trial), (0, refuse), (1, run_trial)):
            np.savez(models, shape=make_outline(model))
            models_digest.cache_clear()
            load_models.cache_clear()
            records += run_jobs([job], journal, Placement(workers=1), run=run)
    assert records[0] == records[1] and records[0]["T_target_source"] != records[2]["T_target_source"]


@pytest.mark.parametrize("library", ["adagmm_o3d", "open3d"])
def test_a_version_changes_with_what_a_trial_is_made_by(library, monkeypatch):
    """With the sources of the problem and of the methods' settings, also where the method is another library's."""
    before = registry._version.__wrapped__(library)
    monkeypatch.setattr(registry, "source_digest", lambda *names, **more: f"{sorted(names)}")
    after = registry._version.__wrapped__(library)
    assert before.split(" (")[0] == after.split(" (")[0]
    for module in ("adagmm_bench.methods", "adagmm_bench.simulation", "adagmm_bench.problem", "adagmm_bench.trial"):
        assert f"'{module}'" in after


@pytest.mark.slow
def test_a_worker_with_another_version_is_refused(tmp_path):
    with Journal(tmp_path / "r.jsonl") as journal, pytest.raises(TrialError, match=r"a worker has open3d 0\.0\.1"):
        run_jobs(jobs(1), journal, Placement(workers=1), run=from_elsewhere)


@pytest.mark.slow
def test_a_broken_trial_is_named_and_the_others_are_kept(tmp_path):
    with Journal(tmp_path / "r.jsonl") as journal:
        with pytest.raises(TrialError, match="1 of 3 trials left without a result, the first is 2D noise"):
            run_jobs(jobs(3), journal, Placement(workers=1), run=fail_second)
        assert len(journal.records) == 2


def test_a_method_that_raises_is_a_result_with_its_reason(monkeypatch):
    def give_up(source, target):
        raise RuntimeError("nothing\nfound")

    entry = METHODS[METHOD]
    monkeypatch.setitem(METHODS, METHOD, type(entry)(**{**vars(entry), "function": give_up}))
    record = run_trial(jobs(1)[0])
    assert record["status"] == "failed" and record["reason"] == "RuntimeError: nothing found"
    truth = SimulatedProblem(TrialId(2, "noise", 0.13, 0), None).load().T_target_source
    # Counted with the error of its start: no rotation.
    assert record["rotation_error"] == pytest.approx(((truth[:2, :2] - [[1, 0], [0, 1]]) ** 2).sum() ** 0.5, rel=1e-9)


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed", reason="needs the [distributed] extra")
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as local:
        yield local


@pytest.mark.slow
def test_the_command_on_a_cluster_that_loses_a_worker_gives_the_bits_of_local_processes(cluster, tmp_path):
    command = [sys.executable, "-m", "adagmm_bench", "sim2d", "--trials", "1", "--starts", "centroids"]
    command += ["--methods", f"{METHOD},open3d-point-to-plane", "--sweeps", "noise", "--data", str(tmp_path)]
    local, remote = tmp_path / "local", tmp_path / "remote"
    subprocess.run([*command, "--workers", "1", "--output", local], check=True, capture_output=True, timeout=120)

    import distributed

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        pids = list(client.run(os.getpid).values())
    process = subprocess.Popen(
        [*command, "--scheduler", cluster.scheduler_address, "--output", remote],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    journal = remote / "results.jsonl"
    give_up = time.monotonic() + 60
    while not (journal.exists() and journal.read_bytes().count(b"\n") >= 3) and time.monotonic() < give_up:
        assert process.poll() is None, "the run was to be caught in its middle"
        time.sleep(0.02)
    os.kill(pids[0], signal.SIGKILL)
    assert process.wait(timeout=120) == 0
    here, there = (json.loads((folder / "report.json").read_text())["trials"] for folder in (local, remote))
    assert len(here) == 20
    assert without_times(here) == without_times(there)
