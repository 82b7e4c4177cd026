"""What the two colour images say of the pose: matched SIFT features, and the poses that many of them agree on."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import back_project, depth_in_range
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.measurements.features import FeatureMatches

# Lowe's ratio: a match must be this much nearer than the second best.
RATIO = 0.8
REPROJECTION_ERROR_PX = 4.0
ITERATIONS = 5000
# With fewer agreeing matches a pose may be a coincidence; with fewer than the second it is none.
MIN_INLIERS, LEAST_INLIERS = 15, 8
# Matches that agree on a pose may be fixed to the camera, or of one thing that moved. So what the others agree on
# is asked for as well.
HYPOTHESES = 3
# Two depths agree if they differ by less than this, the error of depth cameras at the range of a room.
DEPTH_M, DEPTH_SHARE = 0.05, 0.03
# A pose of which fewer features are at the target's depths is none; fewer than that many with depth say nothing.
LEAST_SHARE, MIN_WITH_DEPTH = 0.6, 8
# Of so many that agree on a start all but less than this share are left behind only where depth says otherwise: at
# recorded right ends a third of their number agrees and more, at wrong ones of swapped depths 1 of 288.
MANY_INLIERS, LEFT_SHARE = 30, 0.2


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


def match_features(pair: RGBDPair, *, min_depth_m: float, max_depth_m: float) -> FeatureMatches:
    """Features that the two colour images have in common, the source's lifted by its depth; maybe none.

    Source
    ------
    D. Lowe, Distinctive Image Features from Scale-Invariant Keypoints, IJCV 60(2), 2004.
    """
    source_pixels, source_descriptors = color_features(pair.source)
    target_pixels, target_descriptors = color_features(pair.target)
    if len(source_pixels) < 2 or len(target_pixels) < 2:
        return FeatureMatches(np.empty((0, 3)), np.empty((0, 2)))
    depth = depth_in_range(pair.source, min_depth_m, max_depth_m)
    points = back_project(depth, pair.source.intrinsics)
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(source_descriptors, target_descriptors, k=2)
    chosen = [best for best, second in pairs if best.distance < RATIO * second.distance]
    lifted = np.array([points[_pixel(source_pixels[m.queryIdx], depth.shape)] for m in chosen]).reshape(-1, 3)
    seen = np.array([target_pixels[m.trainIdx] for m in chosen], np.float64).reshape(-1, 2)
    return FeatureMatches(lifted, seen).take(np.isfinite(lifted).all(axis=1))


def feature_starts(matches: FeatureMatches, target: RGBDFrame, *, max_depth_m: float) -> list[FeatureStart]:
    """The poses that matches agree on, from the most of them first: what many agree on, then what others do.

    Each follows from perspective-n-point with RANSAC (OpenCV, whose random numbers are fixed). One that puts the
    cameras farther apart than both can see, or whose features are not at the target's own depths, is left out.
    """
    found: list[FeatureStart] = []
    left = np.arange(len(matches))
    for _ in range(HYPOTHESES):
        some = matches.take(left)
        solved = _perspective_pose(some, target)
        if solved is None:
            break
        T, inliers = solved
        start = FeatureStart(T, len(inliers), len(matches), some.points[inliers], some.pixels[inliers])
        share = depth_share(start, target, max_depth_m)
        if np.linalg.norm(T[:3, 3]) <= 2.0 * max_depth_m and (share is None or share >= LEAST_SHARE):
            found.append(start)
        left = np.delete(left, inliers)
    return found


def left_behind(inliers: int, agreeing: int) -> str:
    """What is to be said where `inliers` features agreed on the start, and so few with the end; else empty.

    Of all matches, as those of the start may be fixed to the camera: what the others agree on is enough.
    """
    if inliers < MANY_INLIERS or agreeing >= min(MIN_INLIERS, LEFT_SHARE * inliers):
        return ""
    agreed = f"{inliers} image features agreed at the start, {agreeing} at the end"
    return f"{agreed}: colour and depth contradict each other"


def depth_share(features: FeatureStart, target: RGBDFrame, max_depth_m: float) -> float | None:
    """The share of the features that are as far from the target camera as its depth image says; None of too few.

    Perspective-n-point finds a pose for matches of repeated patterns as well, but hardly one at the right distances.
    """
    T = features.T_target_source
    z = features.points @ T[2, :3] + T[2, 3]
    depth = depth_in_range(target, 0.1, max_depth_m)
    column, row = np.floor(features.pixels.T + 0.5).astype(int)
    measured = depth[np.clip(row, 0, depth.shape[0] - 1), np.clip(column, 0, depth.shape[1] - 1)]
    known = np.isfinite(measured)
    if np.count_nonzero(known) < MIN_WITH_DEPTH:
        return None
    return float(np.mean(np.abs(z - measured)[known] < DEPTH_M + DEPTH_SHARE * measured[known]))


@lru_cache(maxsize=4)  # a sequence's frames come in several pairs in a row
def color_features(frame: RGBDFrame, strongest: int = 0) -> tuple[list[tuple[float, float]], np.ndarray | None]:
    """Pixels (x, y) and (n, 128) descriptors of a colour image's SIFT features; so many, or all of them (0)."""
    gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    keypoints, descriptors = cv2.SIFT_create(nfeatures=strongest).detectAndCompute(gray, None)
    return [k.pt for k in keypoints], descriptors


def _perspective_pose(matches: FeatureMatches, target: RGBDFrame) -> tuple[np.ndarray, np.ndarray] | None:
    """(4, 4) the pose and the rows that agree with it, or None where fewer than LEAST_INLIERS do."""
    if len(matches) < LEAST_INLIERS:
        return None
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        matches.points,
        matches.pixels,
        target.intrinsics.matrix(),
        np.array(target.intrinsics.distortion, np.float64),
        iterationsCount=ITERATIONS,
        reprojectionError=REPROJECTION_ERROR_PX,
        confidence=0.9999,
    )
    if not found or inliers is None or len(inliers) < LEAST_INLIERS:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(rotation)[0]
    T[:3, 3] = translation.ravel()
    return (T, inliers.ravel()) if np.isfinite(T).all() else None


def _pixel(point: tuple[float, float], shape: tuple[int, ...]) -> tuple[int, int]:
    """(row, column) of the pixel that holds an image point (x, y)."""
    column = min(max(int(np.floor(point[0] + 0.5)), 0), shape[1] - 1)
    row = min(max(int(np.floor(point[1] + 0.5)), 0), shape[0] - 1)
    return row, column
