"""Sensors: where they are, their pinhole frusta, and their colour and depth images."""

import numpy as np
import rerun as rr

from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.rerun_log.entities import SOURCE, TARGET, Sensor
from adagmm_fusion.rerun_log.when import When

JPEG_QUALITY = 90
FRUSTUM_DEPTH = 0.3
FRUSTUM_LINE_WIDTH = 0.012
MILLIMETRES_PER_METRE = 1000.0


def transform_archetype(T: np.ndarray) -> rr.Transform3D:
    """A (4, 4) pose of a child in its parent's frame."""
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def log_blank_images(
    rec: rr.RecordingStream, target_size: tuple[int, int], source_size: tuple[int, int], when: When
) -> None:
    """Black in all image views, of the (width, height) of the images before.

    The viewer goes on showing an encoded image after a `Clear`, and takes those of an entity for a video, whose size
    must not change.
    """
    sizes = {TARGET.rgb: target_size, TARGET.overlay: target_size, TARGET.checkerboard: target_size}
    for entity, (width, height) in (sizes | {SOURCE.rgb: source_size}).items():
        black = rr.Image(np.zeros((height, width, 3), dtype=np.uint8)).compress(jpeg_quality=JPEG_QUALITY)
        when.log(rec, entity, black)
    for sensor, (width, height) in ((TARGET, target_size), (SOURCE, source_size)):
        nothing = np.zeros((height, width), dtype=np.uint16)
        when.log(rec, sensor.depth, rr.DepthImage(nothing, meter=MILLIMETRES_PER_METRE).compress())


def log_pose(rec: rr.RecordingStream, sensor: Sensor, T: np.ndarray, when: When) -> None:
    """Put a sensor at T (4, 4), sensor to world."""
    when.log(rec, sensor.root, transform_archetype(T))


def log_frustum(
    rec: rr.RecordingStream, sensor: Sensor, intrinsics: PinholeIntrinsics, color: tuple[int, int, int], when: When
) -> None:
    """The sensor's pinhole, drawn `color`; also what ties its 2D images to the 3D scene."""
    pinhole = rr.Pinhole(
        image_from_camera=intrinsics.matrix(),
        resolution=[intrinsics.width, intrinsics.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=FRUSTUM_DEPTH,
        color=color,
        line_width=FRUSTUM_LINE_WIDTH,
    )
    when.log(rec, sensor.image, pinhole)


def log_images(rec: rr.RecordingStream, sensor: Sensor, frame: RGBDFrame, when: When) -> None:
    """The colour image as JPEG and the depth image as compressed millimetres, for the 2D views."""
    when.log(rec, sensor.rgb, rr.Image(frame.color).compress(jpeg_quality=JPEG_QUALITY))
    depth_mm = np.nan_to_num(frame.depth_m() * MILLIMETRES_PER_METRE, nan=0.0)
    depth_mm = np.clip(np.floor(depth_mm + 0.5), 0, np.iinfo(np.uint16).max).astype(np.uint16)
    when.log(rec, sensor.depth, rr.DepthImage(depth_mm, meter=MILLIMETRES_PER_METRE).compress())
