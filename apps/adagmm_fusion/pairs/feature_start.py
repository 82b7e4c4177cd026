"""Where to start from, by what the two colour images show: SIFT features, the source's lifted by its depth."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import back_project, depth_in_range
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair

# Lowe's ratio: a match must be this much nearer than the second best.
RATIO = 0.8
REPROJECTION_ERROR_PX = 4.0
ITERATIONS = 5000
# With fewer agreeing matches a pose may be a coincidence.
MIN_INLIERS = 15


@dataclass(frozen=True, eq=False)
class FeatureStart:
    """A pose T_target_source, (4, 4) [m], and how many of how many feature matches agree with it.

    points : (inliers, 3) [m], source frame, of the agreeing matches.    pixels : (inliers, 2), in the target's image.
    """

    T_target_source: np.ndarray
    inliers: int
    matches: int
    points: np.ndarray
    pixels: np.ndarray


def find_feature_start(pair: RGBDPair, *, min_depth_m: float, max_depth_m: float) -> FeatureStart | None:
    """The pose that most feature matches of the colour images agree on, or None where too few do.

    Features of the source are lifted to 3D by its depth, so its colour and depth have to be registered; in the target
    they are pixels, and the pose follows from perspective-n-point with RANSAC (OpenCV, whose random numbers are fixed).

    Source
    ------
    D. Lowe, Distinctive Image Features from Scale-Invariant Keypoints, IJCV 60(2), 2004.
    """
    source_pixels, source_descriptors = color_features(pair.source)
    target_pixels, target_descriptors = color_features(pair.target)
    if len(source_pixels) < MIN_INLIERS or len(target_pixels) < MIN_INLIERS:
        return None
    depth = depth_in_range(pair.source, min_depth_m, max_depth_m)
    points = back_project(depth, pair.source.intrinsics)
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(source_descriptors, target_descriptors, k=2)
    chosen = [best for best, second in pairs if best.distance < RATIO * second.distance]
    lifted = np.array([points[_pixel(source_pixels[m.queryIdx], depth.shape)] for m in chosen]).reshape(-1, 3)
    seen = np.array([target_pixels[m.trainIdx] for m in chosen], np.float64).reshape(-1, 2)
    known = np.isfinite(lifted).all(axis=1)
    lifted, seen = lifted[known], seen[known]
    if len(lifted) < MIN_INLIERS:
        return None
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        lifted,
        seen,
        pair.target.intrinsics.matrix(),
        np.array(pair.target.intrinsics.distortion, np.float64),
        iterationsCount=ITERATIONS,
        reprojectionError=REPROJECTION_ERROR_PX,
        confidence=0.9999,
    )
    if not found or inliers is None or len(inliers) < MIN_INLIERS:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rotation)[0]
    T[:3, 3] = translation.ravel()
    inliers = inliers.ravel()
    return FeatureStart(T, len(inliers), len(lifted), lifted[inliers], seen[inliers])


@lru_cache(maxsize=4)  # a sequence's frames come in several pairs in a row
def color_features(frame: RGBDFrame, strongest: int = 0) -> tuple[list[tuple[float, float]], np.ndarray | None]:
    """Pixels (x, y) and (n, 128) descriptors of a colour image's SIFT features; so many, or all of them (0)."""
    gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    keypoints, descriptors = cv2.SIFT_create(nfeatures=strongest).detectAndCompute(gray, None)
    return [k.pt for k in keypoints], descriptors


def _pixel(point: tuple[float, float], shape: tuple[int, ...]) -> tuple[int, int]:
    """(row, column) of the pixel that holds an image point (x, y)."""
    column = min(max(int(np.floor(point[0] + 0.5)), 0), shape[1] - 1)
    row = min(max(int(np.floor(point[1] + 0.5)), 0), shape[0] - 1)
    return row, column
