"""What a recording is of, and how it was made: shown by the viewer beside its name."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from adagmm_fusion.package_versions import package_version
from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.rerun_log.words import shown

PACKAGES = ("adagmm-o3d", "open3d", "numpy", "numba", "rerun-sdk")


def log_recording_properties(
    rec: rr.RecordingStream,
    *,
    recording: str,
    sensors: Sequence[str],
    calibration: str | None = None,
    parameters: Mapping[str, object] | None = None,
) -> None:
    """Log where the data came from, the parameters of the run and the versions of what computed it."""
    rec.send_property(
        "input",
        rr.AnyValues(
            recording=shown(recording), sensors=[*map(shown, sensors)], calibration=shown(calibration or "none")
        ),
    )
    if parameters:
        rec.send_property("parameters", rr.AnyValues(**{name: shown(value) for name, value in parameters.items()}))
    versions = {package.replace("-", "_"): package_version(package) for package in PACKAGES}
    rec.send_property("versions", rr.AnyValues(**versions))


def log_result(rec: rr.RecordingStream, records: Sequence[PairRecord]) -> None:
    """Log what became of all pairs, which the viewer's table of recordings shows and sorts by."""
    failed = sum(record.status != "ok" for record in records)
    values: dict[str, float] = {"failed_pairs": failed, "pairs": len(records)}
    known = [record for record in records if record.rotation_error_deg is not None]
    if known:
        values["median_deg"] = float(np.median([record.rotation_error_deg for record in known]))
        values["median_mm"] = float(np.median([record.translation_error_mm for record in known]))
    rec.send_property("found", rr.AnyValues(**values))
