"""Whether the colour images confirm a pose between two frames."""

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import depth_in_range
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.pairs.feature_start import FeatureStart

# A match agrees with a pose if the pose brings its two points this near. Registered poses are not fitted to matches.
AGREEMENT_PX = 10.0
# Two depths agree if they differ by less than this, the error of depth cameras at the range of a room.
DEPTH_M, DEPTH_SHARE = 0.05, 0.03
LEAST_SHARE = 0.6
# Fewer matches than this with depth on both sides confirm nothing.
MIN_WITH_DEPTH = 8


def depth_confirms(features: FeatureStart, target: RGBDFrame, max_depth_m: float) -> bool:
    """Whether the matched features are as far from the target camera as its depth image says, at their own pose.

    Perspective-n-point finds a pose for matches of repeated patterns as well, but hardly one at the right distances.
    """
    T = features.T_target_source
    z = features.points @ T[2, :3] + T[2, 3]
    depth = depth_in_range(target, 0.1, max_depth_m)
    column, row = np.floor(features.pixels.T + 0.5).astype(int)
    measured = depth[np.clip(row, 0, depth.shape[0] - 1), np.clip(column, 0, depth.shape[1] - 1)]
    known = np.isfinite(measured)
    if np.count_nonzero(known) < MIN_WITH_DEPTH:
        return False
    return bool(np.mean(np.abs(z - measured)[known] < DEPTH_M + DEPTH_SHARE * measured[known]) >= LEAST_SHARE)


def features_confirm(features: FeatureStart, target: RGBDFrame, T_target_source: np.ndarray) -> bool:
    """Whether the matched features still fall on each other at another pose than their own."""
    k = target.intrinsics
    rotation = cv2.Rodrigues(T_target_source[:3, :3])[0]
    pixels = cv2.projectPoints(
        features.points, rotation, T_target_source[:3, 3], k.matrix(), np.array(k.distortion, np.float64)
    )[0].reshape(-1, 2)
    ahead = features.points @ T_target_source[2, :3] + T_target_source[2, 3] > 0
    return bool(np.mean(ahead & (np.linalg.norm(pixels - features.pixels, axis=1) < AGREEMENT_PX)) >= LEAST_SHARE)
