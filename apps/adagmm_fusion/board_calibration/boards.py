"""Calibration boards and how their corners are found: plain chessboards and ChArUco boards, as OpenCV has them.

A board's own frame has its first corner as origin, x along a row of corners, y along a column, z away from the camera
that looks at its front.
"""

import re
from dataclasses import dataclass

import cv2
import numpy as np

from adagmm_o3d.errors import InputError

# A corner is refined in a window that reaches this far, so that no other corner is in it.
REACH_IN_SQUARES, MIN_REACH_PX, MAX_REACH_PX = 1.0 / 3.0, 2, 11
# Fewer corners of a ChArUco board say too little about its pose.
MIN_CORNERS = 8
MAX_DIGITS = 5  # of a board's columns or rows, or of an image's
BOARD_SIZE = re.compile(rf"([0-9]{{1,{MAX_DIGITS}}})x([0-9]{{1,{MAX_DIGITS}}})")
DICTIONARIES = tuple(
    sorted(n.removeprefix("DICT_") for n in dir(cv2.aruco) if re.fullmatch(r"DICT_[4-7]X[4-7]_\d+", n))
)


@dataclass(frozen=True, eq=False)
class BoardCorners:
    """Corners found in one image: `ids` (K,) into the board's points, `pixels` (K, 2) float64."""

    ids: np.ndarray
    pixels: np.ndarray

    def common(self, other: "BoardCorners") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The ids that both have, and their pixels in each."""
        ids, mine, others = np.intersect1d(self.ids, other.ids, return_indices=True)
        return ids, self.pixels[mine], other.pixels[others]


class Chessboard:
    """A chessboard with `columns` x `rows` inner corners, one number even and the other odd, of squares `square_m` [m].

    Raises
    ------
    InputError  for fewer than 3 corners a side, two even or two odd numbers, or a square that has no size.
    """

    may_be_hidden = False

    def __init__(self, columns: int, rows: int, square_m: float) -> None:
        _check_length("square", square_m)
        if min(columns, rows) < 3:
            raise InputError(f"chessboard: expected at least 3x3 inner corners, got {columns}x{rows}")
        if (columns + rows) % 2 == 0:
            raise InputError(
                f"chessboard: expected an even and an odd number of inner corners, as 9x6, got {columns}x{rows}; "
                "turned by 180 degrees such a board looks the same"
            )
        self.columns, self.rows = columns, rows
        y, x = np.indices((rows, columns), dtype=np.float64)
        self.points = np.stack((x.ravel() * square_m, y.ravel() * square_m, np.zeros(x.size)), axis=-1)

    def find(self, gray: np.ndarray) -> BoardCorners | None:
        """All corners, or None if they are not all in sight."""
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE
        size = (self.columns, self.rows)
        found, pixels = cv2.findChessboardCornersSB(gray, size, flags=flags)
        if not found:
            found, pixels = cv2.findChessboardCornersSB(gray, size, flags=flags | cv2.CALIB_CB_EXHAUSTIVE)
        if not found:
            return None
        pixels = _refined(gray, pixels.reshape(-1, 2), REACH_IN_SQUARES)
        grid = self._turned_upright(gray, pixels.reshape(self.rows, self.columns, 2))
        return BoardCorners(np.arange(grid.shape[0] * grid.shape[1]), grid.reshape(-1, 2))

    def mirrored(self, corners: BoardCorners, width: int) -> BoardCorners:
        """What would have been found in the image mirrored left to right."""
        grid = corners.pixels.reshape(self.rows, self.columns, 2) * (-1.0, 1.0) + (width - 1.0, 0.0)
        # Turned over along the side with an odd number of squares between its corners, dark squares stay dark.
        grid = grid[:, ::-1] if self.columns % 2 == 0 else grid[::-1]
        return BoardCorners(corners.ids, grid.reshape(-1, 2))

    def _turned_upright(self, gray: np.ndarray, grid: np.ndarray) -> np.ndarray:
        """The corners in the one order that is right-handed and has a dark square between its first four."""
        across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if across[0] * down[1] - across[1] * down[0] < 0:
            grid = grid[:, ::-1]
        middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4.0
        columns, rows = np.rint(middles).astype(int).transpose(2, 0, 1)
        brightness = gray[np.clip(rows, 0, gray.shape[0] - 1), np.clip(columns, 0, gray.shape[1] - 1)]
        even = np.indices(brightness.shape).sum(axis=0) % 2 == 0
        return grid[::-1, ::-1] if brightness[even].mean() > brightness[~even].mean() else grid


class Charuco:
    """A ChArUco board of `columns` x `rows` squares [m] with ArUco markers [m] in the white ones.

    Raises
    ------
    InputError  for fewer than 3 squares a side, markers as large as the squares, or an unknown dictionary.
    """

    may_be_hidden = True

    def __init__(self, columns: int, rows: int, square_m: float, marker_m: float, dictionary: str) -> None:
        _check_length("square", square_m)
        _check_length("marker", marker_m)
        if min(columns, rows) < 3:
            raise InputError(f"charuco: expected at least 3x3 squares, got {columns}x{rows}")
        if marker_m >= square_m:
            raise InputError(f"marker: expected less than the square's {square_m:g} m, got {marker_m:g} m")
        if dictionary not in DICTIONARIES:
            raise InputError(f"dictionary: expected one of {', '.join(DICTIONARIES)}, got {dictionary!r}")
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
        if (needed := columns * rows // 2) > (there := len(markers.bytesList)):
            raise InputError(f"dictionary: {dictionary} has {there} markers, a {columns}x{rows} board needs {needed}")
        self.board = cv2.aruco.CharucoBoard((columns, rows), square_m, marker_m, markers)
        self.points = np.asarray(self.board.getChessboardCorners(), dtype=np.float64)
        self._detector = cv2.aruco.CharucoDetector(self.board)
        self._reach = min(REACH_IN_SQUARES, 0.5 * (1.0 - marker_m / square_m))  # up to the markers

    def find(self, gray: np.ndarray) -> BoardCorners | None:
        """The corners in sight, or None if they are too few or all in one line.

        Raises
        ------
        InputError  if the image is mirrored.
        """
        corners = self._detected(gray)
        if corners is None and self._detected(np.ascontiguousarray(gray[:, ::-1])) is not None:
            raise InputError("the board is mirrored; switch off the mirroring of the sensor's images")
        return corners

    def _detected(self, gray: np.ndarray) -> BoardCorners | None:
        pixels, ids, _, _ = self._detector.detectBoard(gray)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        ids = ids.ravel()
        if np.linalg.matrix_rank(self.points[ids] - self.points[ids[0]]) < 2:
            return None
        return BoardCorners(ids, _refined(gray, pixels.reshape(-1, 2), self._reach))


def parse_board_size(text: str, name: str) -> tuple[int, int]:
    """(columns, rows) of "9x6". Raises InputError."""
    match = BOARD_SIZE.fullmatch(text)
    if not match:
        raise InputError(f"{name}: expected columns x rows as 9x6, got {text[:40]!r}")
    return int(match[1]), int(match[2])


def _refined(gray: np.ndarray, pixels: np.ndarray, reach: float) -> np.ndarray:
    """(K, 2) float64: the corners moved to where the edges around them meet; `reach` is in squares."""
    distances = np.linalg.norm(pixels[:, None] - pixels, axis=-1) + np.diag(np.full(len(pixels), np.inf))
    window = int(np.clip(reach * distances.min(), MIN_REACH_PX, MAX_REACH_PX))
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    corners = np.ascontiguousarray(pixels, dtype=np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(gray, corners, (window, window), (-1, -1), criteria).reshape(-1, 2).astype(np.float64)


def _check_length(name: str, length_m: float) -> None:
    if not (np.isfinite(length_m) and length_m > 0):
        raise InputError(f"{name}: expected a positive length [m], got {length_m}")
