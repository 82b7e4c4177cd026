"""Is one of two sensors mirrored? Then the features of their images match only if one image is mirrored back."""

from dataclasses import replace

import cv2
import numpy as np

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.pairs.feature_start import RATIO, color_features

FEATURES = 1500
EPIPOLAR_PX = 2.0
# So many matches on one epipolar geometry, and so many times those of the images as they are.
MIN_MATCHES, CLEARLY = 50, 2.5


def looks_mirrored(source: RGBDFrame, target: RGBDFrame) -> bool:
    """Whether the features of the two images agree far better if one of them is mirrored, left to right."""
    mirrored = replace(source, color=np.ascontiguousarray(source.color[:, ::-1]))
    as_they_are, other = (agreeing_matches(frame, target) for frame in (source, mirrored))
    return other >= MIN_MATCHES and other > CLEARLY * as_they_are


def agreeing_matches(source: RGBDFrame, target: RGBDFrame) -> int:
    """How many feature matches agree on one epipolar geometry (OpenCV's RANSAC, whose random numbers are fixed)."""
    (a, of_a), (b, of_b) = (color_features(frame, FEATURES) for frame in (source, target))
    if min(len(a), len(b)) < 10:
        return 0
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(of_a, of_b, k=2)
    matches = [best for best, second in pairs if best.distance < RATIO * second.distance]
    if len(matches) < 8:
        return 0
    points = np.array([a[m.queryIdx] for m in matches]), np.array([b[m.trainIdx] for m in matches])
    _, inliers = cv2.findFundamentalMat(*points, cv2.FM_RANSAC, EPIPOLAR_PX, 0.999, 2000)
    return 0 if inliers is None else int(inliers.sum())
