"""A folder of board images, searched for corners one image at a time.

<sensor>/color/<view>.png   .png, .jpg or .jpeg; images of one view, in all sensors of the same name, show the board
                            at one moment
<sensor>/depth/<view>.png   optional: 16 bit, 0 none, registered to the colour image
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.board_calibration.boards import BoardCorners, Charuco, Chessboard
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, read_color, read_depth
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.options import listed_images
from adagmm_fusion.rigs.rig import SENSOR_NAME
from adagmm_o3d.errors import InputError

# The depth at a corner is the median of a square with this many pixels a side, as the corner's own may be missing.
DEPTH_WINDOW = 5


@dataclass
class SensorViews:
    """What one sensor saw.

    corners : by view, of the views with a board.    without_board : names of the others.
    corner_depths : by view with a depth image, (K,) float64 depth units at the corners, NaN where there is none.
    """

    name: str
    size: tuple[int, int] | None = None
    corners: dict[str, BoardCorners] = field(default_factory=dict)
    corner_depths: dict[str, np.ndarray] = field(default_factory=dict)
    without_board: list[str] = field(default_factory=list)


def find_boards(
    folder: str | Path, board: Chessboard | Charuco, *, on_image: Callable[[int, int], None] | None = None
) -> dict[str, SensorViews]:
    """Search all images of all sensors. `on_image` is called with the number of images done, and of all.

    Raises
    ------
    RecordingError  naming folder or file, if there is no sensor or image, an image is damaged, of another size than the
        sensor's others, or mirrored.
    """
    folder = Path(folder)
    images = {sensor.name: listed_images(sensor / "color", COLOR_SUFFIXES) for sensor in _sensor_folders(folder)}
    for sensor, paths in images.items():
        if not paths:
            raise RecordingError(f"{folder / sensor / 'color'}: expected images of the board, got none")
    total, done = sum(map(len, images.values())), 0
    found = {sensor: SensorViews(sensor) for sensor in images}
    for sensor, paths in images.items():
        for path in paths:
            _add_image(found[sensor], path, board)
            done += 1
            if on_image is not None:
                on_image(done, total)
    return found


def _sensor_folders(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise RecordingError(f"{folder}: there is no such folder of board images")
    sensors = sorted(path.parent for path in folder.glob("*/color") if path.is_dir())
    if not sensors:
        raise RecordingError(f"{folder}: expected <sensor>/color/ folders with board images, got none")
    for sensor in sensors:
        if not SENSOR_NAME.fullmatch(sensor.name):
            raise RecordingError(f"{sensor}: expected a sensor name of letters, digits, _ - and . (not first)")
    return sensors


def _add_image(views: SensorViews, path: Path, board: Chessboard | Charuco) -> None:
    if path.stem in views.corners or path.stem in views.without_board:
        raise RecordingError(f"{path}: there is another image of view {path.stem}; keep one of them")
    color = read_color(path)
    size = color.shape[1], color.shape[0]
    views.size = views.size or size
    if size != views.size:
        raise RecordingError(
            f"{path}: expected {views.size[0]}x{views.size[1]} pixels as the sensor's other images, got "
            f"{size[0]}x{size[1]}; use images as the sensor delivered them"
        )
    try:
        corners = board.find(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
    except InputError as problem:
        raise RecordingError(f"{path}: {problem}") from problem
    if corners is None:
        views.without_board.append(path.stem)
        return
    views.corners[path.stem] = corners
    depth_path = path.parent.parent / "depth" / f"{path.stem}.png"
    if is_given(depth_path):
        depth = read_depth(depth_path)
        if depth.shape != color.shape[:2]:
            raise RecordingError(
                f"{depth_path}: expected {size[0]}x{size[1]} pixels as the colour image, got "
                f"{depth.shape[1]}x{depth.shape[0]}; register the depth to the colour first"
            )
        views.corner_depths[path.stem] = _depth_at(depth, corners.pixels)


def _depth_at(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    padded = np.pad(depth.astype(np.float64), DEPTH_WINDOW // 2)
    padded[padded == 0] = np.nan
    windows = np.lib.stride_tricks.sliding_window_view(padded, (DEPTH_WINDOW, DEPTH_WINDOW))
    columns, rows = np.rint(pixels).astype(int).T
    columns, rows = np.clip(columns, 0, depth.shape[1] - 1), np.clip(rows, 0, depth.shape[0] - 1)
    around = windows[rows, columns].reshape(len(pixels), -1)
    depths = np.full(len(pixels), np.nan)
    seen = np.isfinite(around).any(axis=1)
    depths[seen] = np.nanmedian(around[seen], axis=1)
    return depths
