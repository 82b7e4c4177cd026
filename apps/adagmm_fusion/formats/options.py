"""What a reader may be told, and what the readers share."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import visible
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import Rig
from adagmm_o3d.errors import InputError

# The PrimeSense sensor's nominal intrinsics, which Kinect v1, Xtion and Open3D's samples go by.
PRIMESENSE = PinholeIntrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)


@dataclass(frozen=True, eq=False)
class ReadOptions:
    """`rig` replaces the intrinsics and depth scale that the format has itself; `step` is the distance of the two
    frames of a pair, in frames, where the recording is one sensor's path and does not list its pairs."""

    rig: Rig | None = None
    step: int = 1

    def calibration(
        self, sensor: str, intrinsics: PinholeIntrinsics | None, depth_scale: float, path: Path
    ) -> tuple[PinholeIntrinsics, float]:
        """The rig's intrinsics and depth scale of `sensor` (of its only sensor, if there is one), else the format's
        own.

        Raises
        ------
        RigError  if the rig has several sensors and none of that name.
        RecordingError  if neither rig nor format knows the intrinsics.
        """
        if self.rig is not None:
            one = len(self.rig.sensors) == 1
            known = next(iter(self.rig.sensors.values())) if one else self.rig.sensor(sensor)
            return known.intrinsics, known.depth_scale
        if intrinsics is None:
            raise RecordingError(
                f"{path}: the intrinsics of {sensor} are not known here; give a rig file that has them"
            )
        return intrinsics, depth_scale

    def sensor_pose(self, sensor: str) -> np.ndarray | None:
        """The rig's T_rig_sensor (4, 4), or None without a rig or where it is unknown. Raises RigError as above."""
        return None if self.rig is None else self.rig.sensor(sensor).T_rig_sensor


def intrinsics_from_matrix(K: ArrayLike, size: tuple[int, int], path: Path) -> PinholeIntrinsics:
    """Intrinsics from a 3x3 camera matrix without skew, for images of `size` (width, height)."""
    K = np.asarray(K, dtype=np.float64)
    if K.shape != (3, 3) or K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0, 0, 1)):
        raise RecordingError(f"{path}: expected a camera matrix fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}")
    try:
        return PinholeIntrinsics(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    except InputError as problem:
        raise RecordingError(f"{path}: {problem}") from problem


def unpaired_notes(colors: Collection[str], depths: Collection[str], where: Path) -> tuple[str, ...]:
    """What to say of frames, by name, of which only one image is there, and which are left out.

    Raises
    ------
    RecordingError  if no frame has both.
    """
    notes = []
    for there, other, missing in ((colors, depths, "depth"), (depths, colors, "colour")):
        alone = sorted(name for name in there if name not in other)
        if alone:
            more = f" and {len(alone) - 3} more" if len(alone) > 3 else ""
            notes.append(f"left out, without their {missing} image: {', '.join(alone[:3])}{more}")
    if not any(name in depths for name in colors):
        raise RecordingError(
            f"{where}: no frame has both images; {'; '.join(notes) or 'there are none'}; give partners equal names"
        )
    return tuple(notes)


def listed_images(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """The image files of a folder, by name."""
    return [path for path in visible(folder.iterdir()) if path.suffix.lower() in suffixes]
