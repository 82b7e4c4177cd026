"""Every entity and timeline name of a recording, in one place. The entity tree is the frame tree.

    /world                    right, down, forward; the target sensor's frame
    /world/target             the fixed sensor (identity)
    /world/source             the moving sensor: one transform per EM iteration
    /world/recorded/source    the source as recorded, at the identity
    /world/initial/source     where the registration started
    /world/truth/source       where the calibration puts it
    /world/fused              the surface of all sensors at the estimate, textured
    /world/eye                from where the views look
    /world/ways/<sensor>      where each frame of a whole recording was taken
    /world/true_ways/<sensor> where it truly was
    /world/loops              registrations between the frames
    /world/camera             the frame of the timeline

A sensor's own data lies below it, in its own frame, and never moves: only the sensor's transform does.
"""

from dataclasses import dataclass

WORLD = "world"
RECORDED = f"{WORLD}/recorded"
INITIAL = f"{WORLD}/initial"
TRUTH = f"{WORLD}/truth"
FUSED = f"{WORLD}/fused"
WAYS = f"{WORLD}/ways"
TRUE_WAYS = f"{WORLD}/true_ways"
LOOPS = f"{WORLD}/loops"
DIFFERENCE = f"{WORLD}/difference"
EYE = f"{WORLD}/eye"
EYE_WITH_SENSORS = f"{WORLD}/eye_with_sensors"
EYE_AT_END = f"{WORLD}/eye_at_end"
UNOBSERVABLE = f"{WORLD}/unobservable"

METRICS = "metrics"
ENERGY = f"{METRICS}/energy"
SIGMA = f"{METRICS}/sigma"
ROTATION_ERROR_DEG = f"{METRICS}/rotation_error_deg"
TRANSLATION_ERROR_MM = f"{METRICS}/translation_error_mm"
FITNESS = f"{METRICS}/fitness"
INLIER_RMSE = f"{METRICS}/inlier_rmse"
SPREAD_MM = f"{METRICS}/spread_mm"
# The viewer has no logarithmic axis: what is shown on one is logged as its decadic logarithm as well.
LOG10 = "log10"
STAGES = f"{LOG10}/stages"

REPORT = "report"
LOG = "log"
SUMMARY_TABLE = "summary/table"
GUIDE = "guide"
MATCHES = "matches"
DIAGNOSTICS = "diagnostics"
RESIDUAL_HISTOGRAM = f"{DIAGNOSTICS}/residual_histogram"
RESIDUAL_LEGEND = f"{DIAGNOSTICS}/residual_legend"
WEIGHT_LEGEND = f"{DIAGNOSTICS}/weight_legend"
OVERLAP_LEGEND = f"{DIAGNOSTICS}/overlap_legend"
COLOR_LEGEND = f"{DIAGNOSTICS}/color_legend"

FRAME = "frame"
ITERATION = "iteration"
EM_STEP = "em_step"
CLOCK = "recorded at"
SECONDS = "recorded after"


def log10_of(metric: str) -> str:
    """Where a metric's decadic logarithm is."""
    return metric.replace(METRICS, LOG10, 1)


def stages_of(metric: str) -> str:
    """Below which the decadic logarithms of a metric at each stage are."""
    return metric.replace(METRICS, STAGES, 1)


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
    def features(self) -> str:
        return f"{self.root}/image/features"

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
RECORDED_SOURCE = Sensor(f"{RECORDED}/source")
INITIAL_SOURCE = Sensor(f"{INITIAL}/source")
FUSED_CAMERA = Sensor(f"{WORLD}/camera")
TRUE_SOURCE = Sensor(f"{TRUTH}/source")
