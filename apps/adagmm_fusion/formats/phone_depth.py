"""What the recordings of phones have in common: ARKit's axes, and depth with a confidence."""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import read_color, read_depth
from adagmm_fusion.files.input_file import is_given

# ARKit's cameras look along -z with y up; ours along z with y down.
ARKIT_FROM_RDF = np.diag([1.0, -1.0, -1.0, 1.0])
MILLIMETRES_PER_METRE = 1000.0


def confident_depth(depth_path: Path, confidence_path: Path | None) -> np.ndarray:
    """(H, W) depth, 0 where the confidence image, if there is one, says 0: guessed, not measured.

    Raises
    ------
    RecordingError  naming the file, if an image cannot be used, or the two have different sizes.
    """
    depth = read_depth(depth_path)
    if confidence_path is None or not is_given(confidence_path):
        return depth
    return kept_where_confident(depth, read_color(confidence_path)[:, :, 0], confidence_path)


def kept_where_confident(depth: np.ndarray, confidence: np.ndarray, where: Path) -> np.ndarray:
    """The depth (H, W), and 0 where the confidence (H, W) is 0."""
    if confidence.shape != depth.shape:
        raise RecordingError(
            f"{where}: expected {depth.shape} pixels of confidence, as of depth, got {confidence.shape}"
        )
    return np.where(confidence > 0, depth, np.zeros(1, depth.dtype)).astype(depth.dtype)
