"""What a recording is of, and how it was made: shown by the viewer beside its name."""

from collections.abc import Mapping, Sequence
from importlib import metadata

import open3d as o3d
import rerun as rr

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
    # Open3D comes in one of two packages: open3d or open3d-cpu.
    versions = {
        package.replace("-", "_"): o3d.__version__ if package == "open3d" else metadata.version(package)
        for package in PACKAGES
    }
    rec.send_property("versions", rr.AnyValues(**versions))
