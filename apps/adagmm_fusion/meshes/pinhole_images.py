"""A frame's images as a camera without lens distortion would have taken them."""

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import depth_edges, depth_in_range
from adagmm_fusion.frames.rgbd import RGBDFrame

MIN_DEPTH_M = 0.1


def pinhole_images(frame: RGBDFrame, max_depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 depth [m], 0 for none, at depth edges and beyond max_depth_m, and (H, W, 3) uint8 colour; both of
    the frame's camera matrix, with its distortion undone."""
    depth = depth_in_range(frame, MIN_DEPTH_M, max_depth_m)
    depth[depth_edges(depth, frame.intrinsics)] = np.nan
    depth = np.nan_to_num(depth).astype(np.float32)
    k = frame.intrinsics
    if not k.distorted:
        return depth, np.ascontiguousarray(frame.color)
    size = (k.width, k.height)
    maps = cv2.initUndistortRectifyMap(k.matrix(), np.array(k.distortion), None, k.matrix(), size, cv2.CV_32FC1)
    return cv2.remap(depth, *maps, cv2.INTER_NEAREST), cv2.remap(frame.color, *maps, cv2.INTER_LINEAR)
