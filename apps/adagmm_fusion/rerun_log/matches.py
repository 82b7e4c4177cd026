"""The features that the start was found by: in each image, and the two images side by side with lines between."""

import cv2
import numpy as np
import rerun as rr

from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDPair
from adagmm_fusion.pairs.feature_start import FeatureStart
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import JPEG_QUALITY
from adagmm_fusion.rerun_log.colors import BAD_COLOR, GOOD_COLOR
from adagmm_fusion.rerun_log.entities import SOURCE, TARGET
from adagmm_fusion.rerun_log.when import When

# A match that the end moves farther than this from where it was seen is red.
AGREES_PX = 10.0
RADIUS_PX = 2.0


def log_matches(
    rec: rr.RecordingStream, pair: RGBDPair, features: FeatureStart | None, T_end: np.ndarray, when: When
) -> None:
    """Log the matches that agreed on the start, green where the end T_target_source (4, 4) agrees too, else red.

    Selecting one tells its number and how many pixels the end is off at it.
    """
    both, beside = _side_by_side(pair)
    when.log(rec, f"{entities.MATCHES}/images", rr.Image(both).compress(jpeg_quality=JPEG_QUALITY))
    if features is None:
        for entity in (SOURCE.features, TARGET.features, f"{entities.MATCHES}/lines"):
            when.clear(rec, entity)
        return
    in_source = projected(features.points, np.eye(4), pair.source.intrinsics)
    in_target = np.asarray(features.pixels)
    off_px = np.linalg.norm(projected(features.points, T_end, pair.target.intrinsics) - in_target, axis=1)
    agrees = off_px < AGREES_PX
    colors = np.where(agrees[:, None], GOOD_COLOR, BAD_COLOR).astype(np.uint8)
    numbers = rr.AnyValues(match=np.arange(len(off_px)), end_is_off_px=np.nan_to_num(off_px, posinf=1e6))
    for entity, pixels in ((SOURCE.features, in_source), (TARGET.features, in_target)):
        when.log(rec, entity, rr.Points2D(pixels, colors=colors, radii=RADIUS_PX), numbers)
    lines = np.stack([in_source, in_target + np.array((beside, 0.0))], axis=1)
    when.log(rec, f"{entities.MATCHES}/lines", rr.LineStrips2D(lines, colors=colors, radii=0.5), numbers)


def projected(points: np.ndarray, T: np.ndarray, camera: PinholeIntrinsics) -> np.ndarray:
    """(n, 2) pixels of points (n, 3) [m] moved by T (4, 4); infinite behind the camera."""
    rotation = cv2.Rodrigues(np.ascontiguousarray(T[:3, :3]))[0]
    distortion = np.array(camera.distortion, np.float64)
    pixels = cv2.projectPoints(np.asarray(points), rotation, T[:3, 3], camera.matrix(), distortion)[0].reshape(-1, 2)
    pixels[points @ T[2, :3] + T[2, 3] <= 0] = np.inf
    return pixels


def _side_by_side(pair: RGBDPair) -> tuple[np.ndarray, int]:
    """Source and target in one image, black below the lower one, and where the target begins [px]."""
    images = pair.source.color, pair.target.color
    height = max(len(image) for image in images)
    padded = [np.pad(image, ((0, height - len(image)), (0, 0), (0, 0))) for image in images]
    return np.concatenate(padded, axis=1), images[0].shape[1]
