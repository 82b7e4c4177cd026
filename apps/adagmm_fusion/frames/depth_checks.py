"""Checks of depth images by what depth cannot be: beside its colour, in a wrong unit, mirrored, a disparity, or
a distance along the ray.

Each takes some frames of one sensor and answers only if they leave little doubt.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import pixel_rays
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_o3d.errors import InputError

# Depth differences larger than this share and length [m] are outlines of objects.
OUTLINE, OUTLINE_M = 0.05, 0.05
MIN_OUTLINE_PIXELS = 300
# How far colour is sought from depth, as a share of the width, and how far off counts.
REACH, OFF = 1 / 16, 1 / 128
# How far a peak stands out: in standard deviations of the surface, and over where it should be.
PEAK_DEVIATIONS, PEAK_RATIO = 4.0, 1.5

# Structured light steps from depth to depth by this much times depth squared [1/m]: one eighth of a pixel of disparity,
# 580 px and 75 mm (Khoshelham and Elberink 2012), as registration changes it.
STEP_LOWEST, STEP_HIGHEST = 2.2e-3, 4.4e-3
STEPS_ALIKE = 0.15
MIN_LEVELS = 40
# Units that are taken for each other: what is read is this many times what is true.
UNIT_MISTAKES = (0.001, 0.1, 0.2, 5.0, 10.0, 1000.0)
UNIT_TOLERANCE = 1.45
# Few depth cameras see anything so near: half of each frame nearer than the first [m], all but a share than the second.
NEAR_M, NOT_BEYOND_M, BEYOND_SHARE = 0.25, 0.5, 0.01

MILLIMETRES_PER_METRE = 1000.0
FAR_M = 100.0  # no depth camera sees so far

WINDOW = 48  # px, of the planes that disparity and depth are told apart by
MIN_WINDOWS = 25
SLANT_LEAST, SLANT_MOST = 1.15, 2.0  # farthest over nearest depth of such a plane
PLANE_RESIDUAL = 0.01
DISPARITY_SHARE = 0.35
# A plane is fitted so often, each time to what was no farther from it than so many median deviations; so much is near.
FITS, OFF_PLANE, ON_PLANE = 4, 5.0, 0.9
MAD_DEVIATION = 1.4826  # standard deviations of a normal distribution over its median deviation

RAY_WINDOW = 0.2  # of the width, of the planes that depth and distance along the ray are told apart by
RAY_SAMPLES = 32  # about so many pixels of such a window in each direction
MIN_RAY_WINDOWS = 10
# What is uneven in such a plane, at most, as a multiple of what distances along the ray would bend it by.
RAY_UNEVENNESS = 4.0
RAY_RESIDUAL_LEAST = 5e-4  # no plane counts for more than with this residual, however smooth it is
# Planes are straight in depth / |ray|^p: p = 0 is depth and p = 1 distance along the ray. Of a Kinect, an Xtion, a
# time-of-flight camera and a rendered Kinect the middle half of the planes has p within -0.25 to 0.4, and within 0.7 to
# 1.4 if their depth is multiplied by |ray|.
RAY_POWERS = (0.5, 1.6)


@dataclass(frozen=True)
class ColorOffset:
    """Where the colour image shows what the depth image has outlines of: so many pixels to the right and down.

    mirrored : the colour image has to be mirrored, left to right, for that.
    """

    right_px: int
    down_px: int
    mirrored: bool


def usual_depth_scale(depth: np.ndarray) -> float:
    """Units per metre of a depth image (H, W) of which no file says them: whole numbers are millimetres, others metres,
    or millimetres too where half of what is measured would be beyond any camera's reach."""
    measured = depth[np.isfinite(depth) & (depth > 0)]
    far = len(measured) > 0 and float(np.median(measured)) > FAR_M
    return MILLIMETRES_PER_METRE if depth.dtype == np.uint16 or far else 1.0


def color_offset(frames: Sequence[RGBDFrame]) -> ColorOffset | None:
    """How the colour lies beside the depth, by the edges of both; None where it is in its place, or nothing is sure."""
    surfaces = []
    for frame in frames:
        if frame.depth.shape != frames[0].depth.shape:
            continue
        outlines = _outlines(frame.depth_m())
        if outlines.sum() >= MIN_OUTLINE_PIXELS:
            surfaces.append(np.stack([_correlation(outlines, frame.color[:, ::step]) for step in (1, -1)]))
    if not surfaces:
        return None
    total = np.mean(surfaces, axis=0)
    size = total.shape[1]
    reach = total.shape[1] // 2
    near = max(int(np.ceil(OFF * frames[0].depth.shape[1])), 2)
    in_place = total[0, reach - near : reach + near + 1, reach - near : reach + near + 1].max()
    mirrored, row, column = (int(i) for i in np.unravel_index(total.argmax(), total.shape))
    peak = total[mirrored, row, column]
    background = total[0]
    clear = peak - np.median(background) > PEAK_DEVIATIONS * background.std()
    if peak < PEAK_RATIO * max(in_place, 0.0) or not clear:
        return None
    # Chance has its peaks elsewhere in every frame.
    own = np.array([np.unravel_index(surface.argmax(), total.shape) for surface in surfaces])
    alike = (own[:, 0] == mirrored) & (np.abs(own[:, 1:] - (row, column)).max(axis=1) <= near)
    at_border = min(row, column) == 0 or max(row, column) == size - 1
    if (len(surfaces) > 1 and 2 * alike.sum() <= len(surfaces)) or at_border:
        return None
    return ColorOffset(column - reach, row - reach, bool(mirrored))


def _outlines(depth: np.ndarray) -> np.ndarray:
    outlines = np.zeros(depth.shape, np.float64)
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        with np.errstate(invalid="ignore"):
            jump = np.abs(depth[a] - depth[b]) > OUTLINE * np.fmin(depth[a], depth[b]) + OUTLINE_M
        outlines[a][jump] = 1.0
        outlines[b][jump] = 1.0
    return outlines


def _correlation(outlines: np.ndarray, color: np.ndarray) -> np.ndarray:
    """How much stronger than on average colour's edges are on the outlines, for each shift of the colour image."""
    gray = cv2.GaussianBlur(
        cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY).astype(np.float64), (0, 0), 1.0
    )
    edges = np.hypot(cv2.Sobel(gray, cv2.CV_64F, 1, 0), cv2.Sobel(gray, cv2.CV_64F, 0, 1))
    edges = np.minimum(edges, np.percentile(edges, 95))
    spread = edges.std()
    reach = int(REACH * outlines.shape[1])
    if spread == 0:
        return np.zeros((2 * reach + 1, 2 * reach + 1))
    spectrum = np.conj(np.fft.rfft2(outlines)) * np.fft.rfft2((edges - edges.mean()) / spread)
    surface = np.roll(np.fft.irfft2(spectrum, s=outlines.shape), (reach, reach), (0, 1))
    return cv2.GaussianBlur(surface[: 2 * reach + 1, : 2 * reach + 1] / outlines.sum(), (0, 0), 1.0)


def unit_mistake(frames: Sequence[RGBDFrame]) -> float | None:
    """How many times too large the depth is, by the steps of structured light; None if right, or no such sensor."""
    levels = [np.unique(f.depth[f.depth > 0]) / f.depth_scale for f in frames if f.depth.dtype == np.uint16]
    units = [1.0 / f.depth_scale for f in frames if f.depth.dtype == np.uint16]
    factors = [_step_factor(values, unit) for values, unit in zip(levels, units, strict=True)]
    known = [factor for factor in factors if factor is not None]
    if not known or 2 * len(known) < len(factors):
        return None
    factor = float(np.median(known))
    if STEP_LOWEST <= factor <= STEP_HIGHEST:
        return None
    read = np.sqrt(STEP_LOWEST * STEP_HIGHEST) / factor  # depth k times too large has steps of 1/k times its square
    best = min(UNIT_MISTAKES, key=lambda mistake: abs(np.log(mistake / read)))
    return best if abs(np.log(best / read)) < np.log(UNIT_TOLERANCE) else None


def _step_factor(levels: np.ndarray, unit: float) -> float | None:
    """Steps over depth squared [1/m], where that is one number over all of the range."""
    if len(levels) < MIN_LEVELS:
        return None
    steps, depths = np.diff(levels), levels[:-1]
    if np.median(steps) < 1.5 * unit:  # the file's unit is all that is seen
        return None
    bands = [band for band in np.array_split(steps / depths**2, 5)[1:4] if len(band) >= 5]
    factors = [float(np.median(band)) for band in bands]
    if len(factors) < 3 or max(factors) > (1 + STEPS_ALIKE) * min(factors):
        return None
    return float(np.median(factors))


def nearer_than_cameras_see(frames: Sequence[RGBDFrame]) -> float | None:
    """The median depth [m] where it and all but a little depth are nearer than most cameras see at all, else None."""
    depths = [depth[np.isfinite(depth)] for depth in (frame.depth_m() for frame in frames)]
    depths = [depth for depth in depths if len(depth)]
    if not depths or max(float(np.median(depth)) for depth in depths) >= NEAR_M:
        return None
    everything = np.concatenate(depths)
    return float(np.median(everything)) if np.mean(everything > NOT_BEYOND_M) < BEYOND_SHARE else None


def looks_like_disparity(frames: Sequence[RGBDFrame]) -> bool:
    """Whether slanted planes are straight in the depth image itself; they are in its inverse, which disparity is."""
    preferences = [p for frame in frames for p in _preferences(frame.depth_m())]
    if len(preferences) < MIN_WINDOWS:
        return False
    straight_in_inverse = float(np.mean(np.array(preferences) > 0))
    return straight_in_inverse < DISPARITY_SHARE and float(np.median(preferences)) < 0


def _preferences(depth: np.ndarray) -> list[float]:
    """Of each window with a slanted plane: the logarithm of the residual of depth over that of inverse depth."""
    rows, columns = np.mgrid[:WINDOW:2, :WINDOW:2] - WINDOW / 2.0
    design = np.column_stack((rows.ravel(), columns.ravel(), np.ones(rows.size)))
    found = []
    for top in range(0, depth.shape[0] - WINDOW + 1, WINDOW // 2):
        for left in range(0, depth.shape[1] - WINDOW + 1, WINDOW // 2):
            values = depth[top : top + WINDOW : 2, left : left + WINDOW : 2].ravel().astype(np.float64)
            known = np.isfinite(values)
            if known.mean() < 0.9:
                continue
            values, plane = values[known], design[known]
            if _slant(values) <= SLANT_LEAST:
                continue
            fits = [_plane(plane, v) for v in (values, 1.0 / values)]
            residuals = [fit.residual for fit in fits]
            on_plane = fits[int(np.argmin(residuals))].on_plane
            if on_plane.mean() < ON_PLANE or not 0 < min(residuals) < PLANE_RESIDUAL:
                continue
            # Pixels between two surfaces, which interpolation makes, would be taken for slant.
            if SLANT_LEAST < _slant(values[on_plane]) < SLANT_MOST:
                found.append(float(np.log(residuals[0] / residuals[1])))
    return found


def looks_like_distance(frames: Sequence[RGBDFrame]) -> bool:
    """Whether planes are bowls, as they are in distances along the ray, and straight if those are divided by |ray|."""
    planes = [plane for frame in frames for plane in _ray_powers(frame)]
    if len(planes) < MIN_RAY_WINDOWS:
        return False
    powers, weights = np.array(sorted(planes)).T
    share = np.cumsum(weights) / weights.sum()
    low, high = powers[np.searchsorted(share, (0.25, 0.75))]
    least, most = RAY_POWERS
    return least < low and high < most and float(np.mean((powers > least) & (powers < most))) > 0.5


def _ray_powers(frame: RGBDFrame) -> list[tuple[float, float]]:
    """Of each window with a plane: the power of |ray| that depth has to be divided by, and how surely it tells."""
    try:
        depth, rays = frame.depth_m(), pixel_rays(frame.intrinsics)
    except InputError:  # of a distortion that folds over; whoever needs rays says so
        return []
    size = int(RAY_WINDOW * depth.shape[1])
    step = max(size // RAY_SAMPLES, 1)
    found = []
    for top in range(0, depth.shape[0] - size + 1, max(size // 3, 1)):
        for left in range(0, depth.shape[1] - size + 1, max(size // 3, 1)):
            window = np.s_[top : top + size : step, left : left + size : step]
            known = np.isfinite(depth[window])
            if known.mean() < 0.8:
                continue
            design = np.column_stack((rays[window][known], np.ones(np.count_nonzero(known))))
            lengths = np.log(np.linalg.norm(design, axis=1))
            # |ray|^p is linear in p around the power in the middle, so that neither hypothesis is favoured.
            values = np.exp(0.5 * lengths) / depth[window][known].astype(np.float64)
            values /= np.median(values)
            straight = design @ _plane(design, values).coefficients
            bent = straight * lengths
            fit = _plane(np.column_stack((design, bent)), values)
            flat = design[fit.on_plane]
            bent = bent[fit.on_plane]
            bend = float((bent - flat @ np.linalg.lstsq(flat, bent, rcond=None)[0]).std())
            if fit.on_plane.mean() < ON_PLANE or MAD_DEVIATION * fit.residual > RAY_UNEVENNESS * bend:
                continue
            power = 0.5 - float(fit.coefficients[3])
            found.append((power, (bend / max(fit.residual, RAY_RESIDUAL_LEAST)) ** 2))
    return found


def _slant(depths: np.ndarray) -> float:
    near, far = np.percentile(depths, (2, 98))
    return float(far / near)


@dataclass(frozen=True, eq=False)
class _Plane:
    """A linear fit of values that are nearly all on it.

    residual : the median deviation, as a share of the median value.    on_plane : (N,) bool, what is near it.
    """

    coefficients: np.ndarray
    residual: float
    on_plane: np.ndarray


def _plane(design: np.ndarray, values: np.ndarray) -> _Plane:
    """Fitted again and again to what is near it."""
    on_plane = np.ones(len(values), bool)
    for _ in range(FITS):
        coefficients = np.linalg.lstsq(design[on_plane], values[on_plane], rcond=None)[0]
        deviations = np.abs(values - design @ coefficients)
        median = float(np.median(deviations))
        on_plane = deviations <= OFF_PLANE * median
    return _Plane(coefficients, median / float(np.median(values)), on_plane)
