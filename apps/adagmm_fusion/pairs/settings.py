"""Everything a run can be told, in one place, checked when it is made."""

from dataclasses import dataclass

from adagmm_o3d.errors import InputError
from adagmm_o3d.options import DeviceName
from adagmm_o3d.uncertainty.sensor_models import DEFAULT

# What makes sense with depth cameras and can be computed with; a number beyond is a slip or another unit.
LIMITS = {
    "voxel_size_m": (1e-4, 10.0),
    "target_points": (100, 10_000_000),
    "max_depth_m": (0.2, 1000.0),
    "partner_distance_m": (1e-6, 1000.0),
    "max_iteration": (1, 100_000),
}
STARTS = ("features", "geometry")
COLORS = ("auto", "off")


@dataclass(frozen=True)
class Settings:
    """How pairs are registered, and when a registration counts as a success.

    sensor_model : how the points' covariances are made; see adagmm_fusion.clouds.
    voxel_size_m : edge of the averaging voxel grid [m]; None chooses it so that the clouds have about target_points.
    target_points : points per cloud aimed at when the voxel size is chosen; the paper used 3000 to 4000.
    max_depth_m : farther measurements are ignored [m].
    partner_distance_m : how near two points must be to count as partners in fitness, inlier RMSE and overlap [m];
        None is twice the mean distance of neighbouring target points.
    start : "features": where the features of the two colour images agree on a pose, from there, else from the geometry
        alone; "geometry": always that.
    color : "auto": the points' colours count beside the geometry, where both frames have any; "off": never.
    max_iteration : EM iterations at most; None is the plugin's own default.
    device : "auto", "cpu" or "cuda".
    max_rotation_error_deg, max_translation_error_mm : with ground truth, a pair succeeded up to these errors.
    min_overlap : without ground truth, a pair succeeded if its estimate is trustworthy and overlaps this much; None is
        0.3, and 0.15 where the features of the colour images agree with it.
    """

    sensor_model: str = DEFAULT
    voxel_size_m: float | None = None
    target_points: int = 3500
    max_depth_m: float = 5.0
    partner_distance_m: float | None = None
    start: str = "features"
    color: str = "auto"
    max_iteration: int | None = None
    device: DeviceName = "auto"
    max_rotation_error_deg: float = 3.0
    max_translation_error_mm: float = 100.0
    min_overlap: float | None = None

    def __post_init__(self) -> None:
        positive = ("target_points", "max_depth_m", "max_rotation_error_deg", "max_translation_error_mm")
        optional = ("voxel_size_m", "partner_distance_m", "max_iteration")
        for name in positive + optional:
            value = getattr(self, name)
            if not (value is None and name in optional) and not (value is not None and 0 < value < float("inf")):
                raise InputError(f"{name}: expected a positive number, got {value}")
            least, most = LIMITS.get(name, (0.0, float("inf")))
            if value is not None and not least <= value <= most:
                raise InputError(f"{name}: expected {least:g} to {most:g}, got {value:g}")
        for name, choices in (("start", STARTS), ("color", COLORS)):
            if (value := getattr(self, name)) not in choices:
                raise InputError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
        if self.min_overlap is not None and not 0 <= self.min_overlap <= 1:
            raise InputError(f"min_overlap: expected a share between 0 and 1, got {self.min_overlap}")
