"""The source's colours as the target camera would see them, over what it does see."""

import numpy as np
import rerun as rr

from adagmm_fusion.frames.depth_geometry import back_project
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.rerun_log.cameras import JPEG_QUALITY
from adagmm_fusion.rerun_log.entities import TARGET
from adagmm_fusion.rerun_log.when import When

TILE = 40
BEHIND_MARGIN = 0.05
DIMMED = 0.35


def log_overlay(
    rec: rr.RecordingStream, source: RGBDFrame, target: RGBDFrame, T_target_source: np.ndarray, when: When
) -> None:
    """Log two composites: source over dimmed target, and a checkerboard, whose edges meet if the pose is right."""
    colors, seen = project_colors(source, target, T_target_source)
    over = (DIMMED * target.color).astype(np.uint8)
    over[seen] = colors[seen]
    when.log(rec, TARGET.overlay, rr.Image(over).compress(jpeg_quality=JPEG_QUALITY))
    rows, columns = np.indices(seen.shape)
    mixed = target.color.copy()
    from_source = seen & ((rows // TILE + columns // TILE) % 2 == 1)
    mixed[from_source] = colors[from_source]
    when.log(rec, TARGET.checkerboard, rr.Image(mixed).compress(jpeg_quality=JPEG_QUALITY))


def project_colors(source: RGBDFrame, target: RGBDFrame, T_target_source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The source's pixels in the target's image.

    Returns
    -------
    colors : (H, W, 3) uint8, of the target's size.
    seen : (H, W) bool, where a source pixel lands that the target's depth does not hide.
    """
    valid = np.isfinite(source.depth_m())
    points, pixels = back_project(source.depth_m(), source.intrinsics)[valid], source.color[valid]
    points = points @ T_target_source[:3, :3].T + T_target_source[:3, 3]
    camera = target.intrinsics
    ahead = points[:, 2] > 0
    points, pixels = points[ahead], pixels[ahead]
    u = camera.fx * points[:, 0] / points[:, 2] + camera.cx
    v = camera.fy * points[:, 1] / points[:, 2] + camera.cy
    inside = (u > -1) & (u < camera.width) & (v > -1) & (v < camera.height)
    order = np.flatnonzero(inside)[np.argsort(-points[inside, 2], kind="stable")]  # the nearest is written last
    u, v, z, pixels = u[order], v[order], points[order, 2], pixels[order]
    depth = np.full((camera.height, camera.width), np.inf)
    colors = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)
    # Each pixel is drawn on the four that it falls between, so no holes show where the target is nearer.
    for dv in (0, 1):
        for du in (0, 1):
            i, j = np.floor(v).astype(int) + dv, np.floor(u).astype(int) + du
            kept = (i >= 0) & (i < camera.height) & (j >= 0) & (j < camera.width)
            i, j, zk, ck = i[kept], j[kept], z[kept], pixels[kept]
            nearer = zk <= depth[i, j]
            depth[i[nearer], j[nearer]] = zk[nearer]
            colors[i[nearer], j[nearer]] = ck[nearer]
    measured = target.depth_m()
    hidden = np.isfinite(measured) & (depth > measured + BEHIND_MARGIN)
    return colors, np.isfinite(depth) & ~hidden
