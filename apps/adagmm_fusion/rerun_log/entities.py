"""Every entity and timeline name of a recording, in one place. The entity tree is the frame tree.

    /world                    right, down, forward; the target sensor's frame
    /world/target             the fixed sensor (identity)
    /world/source             the moving sensor: one transform per EM iteration
    /world/initial/source     where the estimate started
    /world/truth/source       where the calibration puts it
    /world/fused              the surface of all sensors at the estimate, textured
    /world/ways/<sensor>      where each frame of a whole recording was taken

A sensor's own data lies below it, in its own frame, and never moves: only the sensor's transform does.
"""

from dataclasses import dataclass

WORLD = "world"
INITIAL = f"{WORLD}/initial"
TRUTH = f"{WORLD}/truth"
FUSED = f"{WORLD}/fused"
WAYS = f"{WORLD}/ways"
DIFFERENCE = f"{WORLD}/difference"
UNOBSERVABLE = f"{WORLD}/unobservable"

METRICS = "metrics"
ENERGY = f"{METRICS}/energy"
SIGMA = f"{METRICS}/sigma"
ROTATION_ERROR_DEG = f"{METRICS}/rotation_error_deg"
TRANSLATION_ERROR_MM = f"{METRICS}/translation_error_mm"
FITNESS = f"{METRICS}/fitness"
INLIER_RMSE = f"{METRICS}/inlier_rmse"

CHARTS = "charts"

REPORT = "report"
LOG = "log"
SUMMARY_TABLE = "summary/table"
SUMMARY_ROTATION_ERROR_DEG = "summary/rotation_error_deg"
SUMMARY_TRANSLATION_ERROR_MM = "summary/translation_error_mm"
DIAGNOSTICS = "diagnostics"
RESIDUAL_HISTOGRAM = f"{DIAGNOSTICS}/residual_histogram"
RESIDUAL_LEGEND = f"{DIAGNOSTICS}/residual_legend"
WEIGHT_LEGEND = f"{DIAGNOSTICS}/weight_legend"
OVERLAP_LEGEND = f"{DIAGNOSTICS}/overlap_legend"

FRAME = "frame"
ITERATION = "iteration"
EM_STEP = "em_step"


def chart_of(metric: str) -> str:
    """Where one pair's whole curve of a metric is, in a recording of many pairs."""
    return metric.replace(METRICS, CHARTS, 1)


@dataclass(frozen=True)
class Sensor:
    """The entities below one sensor's transform `root`; the pinhole is a child, so that it never resets it."""

    root: str

    @property
    def image(self) -> str:
        return f"{self.root}/image"

    @property
    def rgb(self) -> str:
        return f"{self.root}/image/rgb"

    @property
    def depth(self) -> str:
        return f"{self.root}/image/depth"

    @property
    def overlay(self) -> str:
        return f"{self.root}/image/overlay"

    @property
    def checkerboard(self) -> str:
        return f"{self.root}/image/checkerboard"

    @property
    def points(self) -> str:
        return f"{self.root}/points"

    @property
    def shape(self) -> str:
        return f"{self.root}/shape"

    @property
    def covariances(self) -> str:
        return f"{self.root}/covariances"


TARGET = Sensor(f"{WORLD}/target")
SOURCE = Sensor(f"{WORLD}/source")
INITIAL_SOURCE = Sensor(f"{INITIAL}/source")
TRUE_SOURCE = Sensor(f"{TRUTH}/source")
