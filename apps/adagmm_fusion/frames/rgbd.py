"""What a depth camera delivers, checked once at the door: intrinsics, one RGB-D frame, and a pair of frames.

Camera frames are right-handed, x right, y down, z forward (RDF). Pixel (0, 0) is the centre of the top left pixel, so a
point (x, y, z) is at u = fx x/z + cx, v = fy y/z + cy before distortion (OpenCV's model and order of coefficients).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.lie import project_to_rotation

DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
MAX_COORDINATE = 1e12  # metres; products of a few such numbers are finite
MAX_PX = 1e9  # of a focal length or principal point; the inverse of a focal length is bounded as well
LEAST_FOCAL = 0.02  # of the image's width: a view of 175°
DEPTH_DTYPES = (np.dtype(np.uint16), np.dtype(np.float32), np.dtype(np.float64))


def checked_rigid_transformation(transformation: ArrayLike, name: str, *, tolerance: float = 1e-3) -> np.ndarray:
    """A (4, 4) float64 copy whose rotation is exactly one; rounding as in text files, up to `tolerance`, is removed.

    Raises
    ------
    InputError  if the shape is not (4, 4), a value is not finite or beyond MAX_COORDINATE, the last row is not 0 0 0 1,
        or the upper left block differs from its nearest rotation by more than `tolerance` in any entry (a mirror, a
        scale and a shear do).
    """
    try:
        T = np.array(transformation, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected a (4, 4) matrix of numbers, got {type(transformation).__name__}") from error
    if T.shape != (4, 4):
        raise InputError(f"{name}: expected a (4, 4) rigid transformation, got shape {T.shape}")
    if not np.isfinite(T).all():
        raise InputError(f"{name}: expected finite numbers, got NaN or infinity")
    if np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        if np.abs(T[:, 3] - (0.0, 0.0, 0.0, 1.0)).max() <= 1e-9:
            raise InputError(f"{name}: looks transposed, 0 0 0 1 is its last column; write it row by row")
        raise InputError(f"{name}: expected 0 0 0 1 in the last row, got {' '.join(f'{x:g}' for x in T[3])}")
    if np.abs(T).max() > MAX_COORDINATE:
        raise InputError(f"{name}: expected numbers up to {MAX_COORDINATE:g}, got {np.abs(T).max():g}; check the units")
    try:
        rotation = project_to_rotation(T[:3, :3])
        off = np.abs(T[:3, :3] - rotation).max()
    except InputError:  # no rotation is nearest
        off = np.inf
    if off > tolerance:
        determinant = np.linalg.det(T[:3, :3])
        raise InputError(
            f"{name}: the upper left 3x3 block is not a rotation: {off:.2g} from one, determinant {determinant:.4g}; "
            "check the rows' order and that it is not scaled or mirrored"
        )
    if off > 1e-12:  # else its bits stay, and a file that is written and read again does not change
        T[:3, :3] = rotation
    T[3] = (0.0, 0.0, 0.0, 1.0)
    return T


@dataclass(frozen=True)
class PinholeIntrinsics:
    """A pinhole camera: size and focal lengths in pixels, principal point, and OpenCV distortion coefficients
    (k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tx, ty]]]]), empty for none.

    Raises
    ------
    InputError  if a size is not a positive integer, a focal length not positive, a value not finite or beyond MAX_PX,
        or the number of coefficients not 0, 4, 5, 8, 12 or 14.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self):
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise InputError(f"intrinsics.{name}: expected a positive integer [px], got {value!r}")
            object.__setattr__(self, name, int(value))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, _finite(getattr(self, name), f"intrinsics.{name}"))
            value = getattr(self, name)
            if name in ("fx", "fy") and value <= 0:
                raise InputError(f"intrinsics.{name}: expected a positive focal length, got {value:g}")
            if abs(value) > MAX_PX or (name in ("fx", "fy") and value < 1.0 / MAX_PX):
                raise InputError(f"intrinsics.{name}: expected pixels, up to {MAX_PX:g}, got {value:g}")
            if name in ("fx", "fy") and value < LEAST_FOCAL * self.width:
                raise InputError(
                    f"intrinsics.{name}: expected pixels, got {value:g} for a width of {self.width}; were they divided "
                    "by the image's size?"
                )
        distortion = tuple(_finite(k, f"intrinsics.distortion[{i}]") for i, k in enumerate(self.distortion))
        if len(distortion) not in DISTORTION_LENGTHS:
            wanted = ", ".join(map(str, DISTORTION_LENGTHS))
            raise InputError(f"intrinsics.distortion: expected one of {wanted} coefficients, got {len(distortion)}")
        object.__setattr__(self, "distortion", distortion)

    def matrix(self) -> np.ndarray:
        """The (3, 3) float64 camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distorted(self) -> bool:
        return any(k != 0.0 for k in self.distortion)


@dataclass(frozen=True, eq=False)
class RGBDFrame:
    """One colour image and the depth image on the same pixel grid, from one sensor at one time.

    Attributes
    ----------
    color : (H, W, 3) uint8, RGB.
    depth : (H, W) uint16, float32 or float64, in units of 1/depth_scale metre, along the optical axis; 0, negative or
        not finite where there is none.
    intrinsics : of that pixel grid.
    depth_scale : depth units per metre (1000 for millimetres, 5000 for TUM).
    timestamp : seconds, of the depth image.

    Raises
    ------
    InputError  if shapes disagree, or depth_scale is not positive.    InputTypeError  for another dtype (8-bit).
    """

    name: str
    color: np.ndarray
    depth: np.ndarray
    intrinsics: PinholeIntrinsics
    depth_scale: float
    sensor: str
    timestamp: float | None = None

    def __post_init__(self):
        color, depth = np.asarray(self.color), np.asarray(self.depth)
        if color.dtype != np.uint8:
            raise InputTypeError(f"{self.name}: color: expected uint8 RGB, got {color.dtype}")
        if color.ndim != 3 or color.shape[2] != 3:
            raise InputError(f"{self.name}: color: expected (H, W, 3), got shape {color.shape}")
        if depth.dtype not in DEPTH_DTYPES:
            hint = "; a depth image must not be an 8-bit preview, use the 16-bit one" if depth.dtype == np.uint8 else ""
            raise InputTypeError(f"{self.name}: depth: expected uint16, float32 or float64, got {depth.dtype}{hint}")
        if depth.ndim != 2:
            raise InputError(f"{self.name}: depth: expected one channel, (H, W), got shape {depth.shape}")
        if color.shape[:2] != depth.shape:
            raise InputError(
                f"{self.name}: color is {_size(color.shape)} and depth {_size(depth.shape)}; "
                "they must share one pixel grid, register the depth to the colour first"
            )
        if not isinstance(self.intrinsics, PinholeIntrinsics):
            got = type(self.intrinsics).__name__
            raise InputTypeError(f"{self.name}: intrinsics: expected PinholeIntrinsics, got {got}")
        if depth.shape != (self.intrinsics.height, self.intrinsics.width):
            wanted = f"{self.intrinsics.width}x{self.intrinsics.height}"
            raise InputError(f"{self.name}: the images are {_size(depth.shape)} and the intrinsics are for {wanted}")
        depth_scale = _finite(self.depth_scale, f"{self.name}: depth_scale")
        if depth_scale <= 0:
            raise InputError(f"{self.name}: depth_scale: expected positive depth units per metre, got {depth_scale:g}")
        object.__setattr__(self, "color", color)
        object.__setattr__(self, "depth", depth)
        object.__setattr__(self, "depth_scale", depth_scale)
        if self.timestamp is not None:
            object.__setattr__(self, "timestamp", _finite(self.timestamp, f"{self.name}: timestamp"))

    def depth_m(self) -> np.ndarray:
        """(H, W) float32 metres, NaN where there is no depth: the only place where depth changes its unit."""
        with np.errstate(over="ignore"):  # too far for a float32 is no depth
            metres = (self.depth.astype(np.float64) / self.depth_scale).astype(np.float32)
        metres[~(np.isfinite(metres) & (metres > 0))] = np.nan
        return metres


@dataclass(frozen=True, eq=False)
class RGBDPair:
    """Two frames to register: `source` moves onto `target`. `T_target_source` (4, 4) is the known answer, or None.

    Raises
    ------
    InputError  if T_target_source is not a rigid transformation.
    """

    name: str
    source: RGBDFrame
    target: RGBDFrame
    T_target_source: np.ndarray | None
    index: int

    def __post_init__(self):
        if self.T_target_source is not None:
            T = checked_rigid_transformation(self.T_target_source, f"{self.name}: T_target_source")
            object.__setattr__(self, "T_target_source", T)


def _finite(value: Any, name: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a number, got {value!r}") from None
    if not np.isfinite(number):
        raise InputError(f"{name}: expected a finite number, got {number}")
    return number


def _size(shape: Sequence[int]) -> str:
    return f"{shape[1]}x{shape[0]}"
