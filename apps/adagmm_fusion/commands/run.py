"""`adagmm-fusion run`: the pairs of a recording, one by one, into a table, reports, clouds and a Rerun recording."""

import argparse
import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from adagmm_fusion.commands.progress import progress
from adagmm_fusion.errors import OutputError, one_line
from adagmm_fusion.files.atomic_file import check_output_file
from adagmm_fusion.files.output_folder import check_apart, exclusive
from adagmm_fusion.files.stale_results import (
    REPORTS,
    check_not_foreign,
    remove_untouched,
    results_of_report,
    states_of,
)
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.meshes.textured_mesh import TexturedMesh, save_textured_mesh
from adagmm_fusion.pairs.fusion import RigEstimate, fused_cloud, fused_mesh, save_cloud
from adagmm_fusion.pairs.moved_sensors import moved_sensors_notes
from adagmm_fusion.pairs.pipeline import PairOutcome, compile_kernels, run_pairs
from adagmm_fusion.pairs.plausibility import recording_warnings
from adagmm_fusion.pairs.record import PairRecord, pair_record
from adagmm_fusion.pairs.report import FULL_WIDTH, Report, terminal_table, write_report
from adagmm_fusion.pairs.scaled_ways import scaled_ways_notes
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.processes.interruption import exit_code
from adagmm_fusion.processes.terminal import printable, table_console
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rerun_arguments import logs_to_file
from adagmm_fusion.rerun_log import (
    Limits,
    Progress,
    check_destination,
    dashboard,
    log_pair,
    log_recording_properties,
    log_recording_summary,
    log_refused_pair,
    log_result,
    open_stream,
)
from adagmm_fusion.rigs.rig import save_rig
from adagmm_o3d.errors import InputError

MAX_DIGITS = 100  # of a range of pairs
# The summary is logged again when there are so many times more pairs: a file keeps all of them.
SUMMARY_GROWTH = 1.1
# Exit codes. 1 is an error, 2 wrong usage, and 3 and 4 are `verify`'s.
SOME_FAILED, ALL_FAILED = 5, 6


def run(args: argparse.Namespace, settings: Settings) -> int:
    """Run over args.recording; returns the exit code, see `verdict`, or 130 or 143 if it was stopped, with what was
    finished kept.

    Raises
    ------
    AdaGMMError  if the recording or its rig cannot be used, or a result cannot be written.
    """
    recording = open_recording(args.recording, format=args.format, rig=args.calibration, step=args.step)
    indices = selected_pairs(args.pairs, len(recording))
    folder = Path(args.output) if args.output else Path("output") / recording.path.resolve().name
    own_names = [*REPORTS, "rig.yaml"]
    if not args.no_clouds:
        own_names += [f"fused/{recording.pair_name(index)}.{kind}" for index in indices for kind in ("ply", "glb")]
    if logs_to_file(args) and args.save is None:
        args.save = str(folder / f"{recording.path.resolve().name}.rrd")
        own_names.append(Path(args.save).name)
    check_destination(args)
    check_apart(recording.path, folder, args.save)

    notes = (*recording.notes, *recording_warnings(recording))
    results: dict[str, str] = {}
    records: list[PairRecord] = []
    rig_estimate = RigEstimate()
    stopped: KeyboardInterrupt | None = None
    failure: Exception | None = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(exclusive(folder))
        for name in (*REPORTS, "rig.yaml"):
            check_output_file(folder / name)
        earlier = states_of(folder, results_of_report(folder))
        check_not_foreign(folder, own_names, earlier)
        viewing = stack.enter_context(contextlib.ExitStack())
        viewer = None if args.no_rerun else viewing.enter_context(_viewer(args, recording, settings, len(indices)))
        display = stack.enter_context(progress())
        task = display.add_task("compiling kernels", total=len(indices))
        compile_kernels(settings.device)
        display.update(task, description=recording.name)
        try:
            for outcome in run_pairs(recording, settings, indices):
                wanted = outcome.estimate is not None and not (viewer is None and args.no_clouds)
                mesh = _fused(outcome, settings) if wanted else None
                records.append(pair_record(outcome, settings))
                if viewer is not None:
                    viewer.log(outcome, mesh, records)
                rig_estimate.add(outcome)
                if mesh is not None and not args.no_clouds:
                    results |= _saved(outcome, mesh, folder, settings)
                display.advance(task)
        except KeyboardInterrupt as stop:
            stopped = stop
        except Exception as problem:
            failure = problem
        # Whatever ended the run, the pairs that were finished are reported. A Rerun recording is put in place before,
        # or taken away: on a full disk it makes room when it goes.
        try:
            if viewer is not None and failure is None:
                viewer.summarize(records, finished=True)
                if logs_to_file(args):
                    viewing.close()
                    results["Rerun recording"] = os.path.relpath(args.save, folder)
        except OutputError as problem:
            failure = problem
        if failure is not None:
            with contextlib.suppress(OutputError):
                viewing.__exit__(type(failure), failure, failure.__traceback__)
        rig = rig_estimate.rig(f"{recording.path.resolve().name}_estimated")
        if rig is not None:
            results["estimated rig"] = "rig.yaml"
        scaled = scaled_ways_notes(records, notes)
        report = Report(
            recording=recording.name,
            path=str(args.recording),
            format=recording.format,
            sensors=recording.sensors,
            calibration=args.calibration,
            settings=settings,
            pairs_asked=len(indices),
            records=records,
            interrupted=stopped is not None,
            notes=(*notes, *scaled, *moved_sensors_notes(records, recording, (*notes, *scaled))),
            results=results,
        )
        paths = write_report(folder, report)
        if rig is not None:
            save_rig(folder / "rig.yaml", rig)
        remove_untouched(folder, earlier)
        # Whoever has hung up reads no more of it.
        with contextlib.nullcontext() if stopped is None else contextlib.suppress(OSError):
            display.stop()
            if not args.quiet:
                _print(report, folder, paths, to_stderr=args.stdout)
    if isinstance(failure, OutputError):
        raise OutputError(f"{failure}; what was finished is in {paths[1]}") from failure
    if failure is not None:
        raise failure
    ok = sum(record.status == "ok" for record in records)
    return verdict(ok, len(records), strict=args.strict) if stopped is None else exit_code(stopped)


def verdict(ok: int, pairs: int, *, strict: bool) -> int:
    """The exit code of a run of which `ok` pairs of `pairs` succeeded."""
    if pairs and not ok:
        return ALL_FAILED
    return SOME_FAILED if strict and ok < pairs else 0


def selected_pairs(text: str | None, count: int) -> list[int]:
    """Indices from "0,3,5-7", in that order and each once; all for None.

    Raises
    ------
    InputError  if the text is something else, or an index is not there.
    """
    if text is None:
        return list(range(count))
    indices: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not (first.isdecimal() and (last.isdecimal() if dash else not last)) or len(part) > MAX_DIGITS:
            shown = text if len(text) <= MAX_DIGITS else f"{text[:MAX_DIGITS]}…"
            raise InputError(f"--pairs: expected numbers and ranges as in 0,3,5-7, got {shown!r}")
        chosen = range(int(first), int(last if dash else first) + 1)
        if not chosen or chosen[-1] >= count:
            raise InputError(f"--pairs: expected ranges within 0-{count - 1}, the recording's pairs, got {part!r}")
        indices += chosen
    return list(dict.fromkeys(indices))


def _fused(outcome: PairOutcome, settings: Settings) -> TexturedMesh | None:
    return fused_mesh(outcome.pair, outcome.T_estimate, max_depth_m=settings.max_depth_m)


def _saved(outcome: PairOutcome, mesh: TexturedMesh, folder: Path, settings: Settings) -> dict[str, str]:
    """Write a pair's fused cloud and textured mesh; names of results and their files in the folder."""
    stem = f"fused/{outcome.pair_name}"
    cloud = fused_cloud(outcome.pair, outcome.T_estimate, max_depth_m=settings.max_depth_m, mesh=mesh)
    save_cloud(folder / f"{stem}.ply", cloud)
    save_textured_mesh(folder / f"{stem}.glb", mesh)
    return {
        f"fused cloud {outcome.pair_name}": f"{stem}.ply",
        f"textured mesh {outcome.pair_name}": f"{stem}.glb",
    }


class _Viewer:
    """Logs outcomes to a Rerun stream as they come."""

    def __init__(self, stream: Any, settings: Settings, pair_count: int) -> None:
        self._stream, self._many = stream, pair_count > 1
        self._limits = Limits(settings.max_rotation_error_deg, settings.max_translation_error_mm)
        self._next_frame, self._em_step = 0, 0
        self._before: RGBDPair | None = None
        self._pair_count, self._began, self._summarized = pair_count, time.monotonic(), 0
        self.summarize([])

    def log(self, outcome: PairOutcome, fused: TexturedMesh | None, records: list[PairRecord]) -> None:
        """Log an outcome and, in a recording of many pairs, the summary so far; its record is the last one."""
        self._log_outcome(outcome, fused, records[-1])
        if len(records) >= self._summarized * SUMMARY_GROWTH:
            self.summarize(records)

    def _log_outcome(self, outcome: PairOutcome, fused: TexturedMesh | None, record: PairRecord) -> None:
        frame_index = self._next_frame
        self._next_frame += 1
        shown_as: dict[str, Any] = {"frame_index": frame_index if self._many else None, "em_step": self._em_step}
        if outcome.source_cloud is None:
            shown_as["before"] = self._before
            self._em_step = log_refused_pair(self._stream, outcome.pair_name, outcome.reason, **shown_as)
            return
        self._before = outcome.pair
        self._em_step = log_pair(
            self._stream,
            outcome.pair,
            outcome.source_cloud,
            outcome.target_cloud,
            outcome.estimate,
            **shown_as,
            status=outcome.status,
            reason=outcome.reason,
            seconds=outcome.seconds_registration,
            limits=self._limits,
            partner_distance=None if outcome.evaluation is None else outcome.evaluation.partner_distance_m,
            fused=fused,
            features=outcome.features,
            diagnosis=record.diagnosis,
        )

    def summarize(self, records: list[PairRecord], *, finished: bool = False) -> None:
        """Log the first page again, with the time left while the run goes on."""
        if finished:
            log_result(self._stream, records)
        if not self._many:
            return
        self._summarized = len(records)
        left = (time.monotonic() - self._began) * (self._pair_count / max(len(records), 1) - 1.0)
        progress = None if finished else Progress(self._pair_count, left)
        log_recording_summary(self._stream, records, progress=progress)


@contextlib.contextmanager
def _viewer(args: argparse.Namespace, recording: Recording, settings: Settings, pair_count: int) -> Iterator[_Viewer]:
    many = pair_count > 1
    with open_stream(args, recording.name, dashboard(many_pairs=many), kind="" if many else "pair") as stream:
        log_recording_properties(
            stream,
            recording=printable(args.recording),
            sensors=recording.sensors,
            calibration=args.calibration,
            parameters=asdict(settings),
        )
        yield _Viewer(stream, settings, pair_count)


def _print(report: Report, folder: Path, paths: tuple[Path, Path], *, to_stderr: bool) -> None:
    console = table_console(FULL_WIDTH, stderr=to_stderr)
    console.print(terminal_table(report, console.width))
    for note in report.notes:
        console.print(f"note: {one_line(note)}", style="yellow", markup=False)
    for line in report.failures():
        console.print(printable(f"failed: {line}"), style="red", markup=False)
    for record in report.records:
        if record.status != "ok" or record.worse_than_start:
            style = "red" if record.status != "ok" else "yellow"
            console.print(printable(f"why: {record.pair}: {record.diagnosis}"), style=style, markup=False)
    console.print(printable(f"report: {paths[0]}, {paths[1]}"), markup=False)
    for what, path in report.results.items():
        console.print(printable(f"{what}: {os.path.normpath(folder / path)}"), markup=False)
