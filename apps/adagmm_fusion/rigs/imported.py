"""What another program's file says of one sensor."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.frames.rgbd import PinholeIntrinsics


@dataclass(frozen=True, eq=False)
class ImportedSensor:
    """`T_rig_sensor` (4, 4) [m]: camera frame (RDF) to the rig's. `depth_scale`: depth units a metre. None where the
    file does not say it."""

    intrinsics: PinholeIntrinsics
    T_rig_sensor: np.ndarray | None
    depth_scale: float | None = None
