"""Sensor models by name: how the covariances of a depth camera's points follow from where and how it saw them.

Another package adds one by an entry point of the group `adagmm_o3d.sensor_models`, a function like those of `OURS`.
"""

from __future__ import annotations

from collections.abc import Callable

from adagmm_o3d.arguments import Array, float_array
from adagmm_o3d.entry_points import entry_points, load
from adagmm_o3d.errors import InputError
from adagmm_o3d.uncertainty.kinect import estimate_kinect_covariances
from adagmm_o3d.uncertainty.kinect_surface import estimate_kinect_surface_covariances
from adagmm_o3d.uncertainty.nguyen2012 import estimate_nguyen_covariances
from adagmm_o3d.uncertainty.surface import estimate_surface_covariances

# Points (N, 3) [m, camera frame], unit normals (N, 3), focal lengths (fx, fy) [px] → covariances (N, 3, 3).
SensorModel = Callable[[Array, Array, tuple[float, float]], Array]

GROUP = "adagmm_o3d.sensor_models"
DEFAULT = "kinect-surface"
OURS: dict[str, SensorModel] = {
    DEFAULT: estimate_kinect_surface_covariances,
    "kinect": lambda points, normals, focal_lengths: estimate_kinect_covariances(points, normals),
    "nguyen": estimate_nguyen_covariances,
    "surface": lambda points, normals, focal_lengths: estimate_surface_covariances(points, normals),
}


def sensor_model_names() -> tuple[str, ...]:
    """The names that `estimate_sensor_covariances` takes: ours, then those of other packages."""
    return (*OURS, *entry_points(GROUP, tuple(OURS)))


def estimate_sensor_covariances(name: str, points: Array, normals: Array, focal_lengths: tuple[float, float]) -> Array:
    """Covariances of a depth camera's points by the sensor model of that name.

    Parameters
    ----------
    points : (N, 3) float64 [m], camera frame.
    normals : (N, 3) float64, unit length, any sign.
    focal_lengths : (fx, fy) [px].

    Returns
    -------
    (N, 3, 3) float64.

    Raises
    ------
    InputError, InputTypeError : there is no such model, or it cannot be loaded or returns something else.
    """
    model = OURS.get(name)
    if model is None:
        others = entry_points(GROUP, tuple(OURS))
        if name not in others:
            raise InputError(f"sensor_model: expected one of {', '.join((*OURS, *others))}, got {name!r}")
        model = load(others[name])
    covariances = model(points, normals, focal_lengths)
    return float_array(f"covariances of the sensor model {name!r}", covariances, (len(points), 3, 3))
