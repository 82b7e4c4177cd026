"""Where covariances can come from: the plugin's sensor models, those of other packages, or nowhere."""

from adagmm_o3d.uncertainty.sensor_models import sensor_model_names

NONE = "none"


def sensor_models() -> tuple[str, ...]:
    """What --sensor-model takes."""
    return (*sensor_model_names(), NONE)
