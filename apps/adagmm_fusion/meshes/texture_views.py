"""Photographs of a surface: what each sees of it, and how well."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import open3d as o3d

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.pinhole_images import pinhole_images
from adagmm_o3d.lie import se_inverse

# A surface up to this far before a point does not hide it: where sensors disagree, the mesh lies between them.
HIDDEN_BY_M, HIDDEN_BY_SHARE = 0.03, 0.02
# A photograph fades out towards its border, and where something hides what is behind it.
# It never vanishes: where there is no better one it still counts.
FADE_BORDER_PX, FADE_EDGE_PX, LEAST_FADE = 60.0, 8.0, 1e-3
# How much the better of two photographs is preferred.
CONTRAST = 2.0


@dataclass(frozen=True, eq=False)
class TextureView:
    """One photograph of a surface.

    color : (H, W, 3) uint8, without lens distortion.    K : (3, 3).    T_camera_world : (4, 4).
    surface_z : (H, W) float32 [m], depth of the surface along the optical axis, infinite where there is none.
    normals, points : (H, W, 3) float32, of that surface, in the world; 0 for none and the camera's place.
    fade : (H, W) float32, near 0 at the photograph's border and where the surface jumps, 1 inside.
    """

    color: np.ndarray
    K: np.ndarray
    T_camera_world: np.ndarray
    surface_z: np.ndarray
    normals: np.ndarray
    points: np.ndarray
    fade: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)"""
        return self.color.shape[1], self.color.shape[0]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., 2) float32 pixels and (...) float32 depth [m] of (..., 3) points in the world."""
        camera = points @ self.T_camera_world[:3, :3].T.astype(np.float32) + self.T_camera_world[:3, 3].astype(
            np.float32
        )
        z = camera[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = camera[..., :2] / z[..., None] * self.K[[0, 1], [0, 1]] + self.K[:2, 2]
        pixels[~(z > 0)] = -1e6
        return pixels.astype(np.float32), z

    def quality(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(...) float32: how well the photograph shows points of the surface; 0 where it does not."""
        pixels, z = self.project(points)
        seen = z < _sampled(self.surface_z, pixels, cv2.INTER_NEAREST, 0.0) + HIDDEN_BY_M + HIDDEN_BY_SHARE * z
        towards = -(self.T_camera_world[:3, :3].T @ self.T_camera_world[:3, 3]).astype(np.float32) - points
        distance = np.maximum(np.linalg.norm(towards, axis=-1), 1e-6)
        cosine = np.einsum("...i,...i->...", towards, normals) / distance
        sharpness = np.where(seen & (cosine > 0), cosine / distance**2, 0.0)
        return (_sampled(self.fade, pixels, cv2.INTER_LINEAR, 0.0) * sharpness**CONTRAST).astype(np.float32)

    def surface_at(self, points: np.ndarray) -> np.ndarray:
        """(...) float32 [m]: depth of the surface where points are seen, infinite where there is none."""
        return _sampled(self.surface_z, self.project(points)[0], cv2.INTER_NEAREST, np.inf)

    def colors_at(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) float32 colours 0..255 of points in the world, those outside the photograph black."""
        return _sampled(self.color, self.project(points)[0], cv2.INTER_LINEAR, (0, 0, 0)).astype(np.float32)


def texture_view(
    frame: RGBDFrame, T_world_camera: np.ndarray, scene: o3d.t.geometry.RaycastingScene, max_depth_m: float
) -> TextureView:
    """A frame as a photograph of the surface in `scene`, with rays cast through its pixels."""
    measured, color = pinhole_images(frame, max_depth_m)
    T_camera_world, K = se_inverse(T_world_camera), frame.intrinsics.matrix()
    height, width = measured.shape
    rays = scene.create_rays_pinhole(o3d.core.Tensor(K), o3d.core.Tensor(T_camera_world), width, height)
    hits = scene.cast_rays(rays)
    rays = rays.numpy()
    distance = hits["t_hit"].numpy()
    hit = np.isfinite(distance)
    points = rays[..., :3] + np.where(hit, distance, 0.0)[..., None] * rays[..., 3:]
    surface_z = np.where(
        hit, points @ T_camera_world[2, :3].astype(np.float32) + np.float32(T_camera_world[2, 3]), np.inf
    )
    # The sensor may have seen something thin in front that the mesh lacks; its colour belongs to nothing behind it.
    uncovered = (measured > 0) & (measured < surface_z - HIDDEN_BY_M - HIDDEN_BY_SHARE * measured)
    surface_z[uncovered] = measured[uncovered]
    return TextureView(
        color=color,
        K=K,
        T_camera_world=T_camera_world,
        surface_z=surface_z.astype(np.float32),
        normals=hits["primitive_normals"].numpy(),
        points=points.astype(np.float32),
        fade=_fade(surface_z),
    )


def sampled(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(n, 3) float32 colours 0..255 of an image (H, W, 3) between its pixels, at (n, 2) places (x, y) within it."""
    inside = np.clip(pixels, 0.0, np.array(image.shape[1::-1]) - 1.0).astype(np.float32)
    return _sampled(image, inside, cv2.INTER_LINEAR, (0, 0, 0)).astype(np.float32)


def _fade(surface_z: np.ndarray) -> np.ndarray:
    """Rises smoothly from the border, and from where the surface jumps, whichever is nearer."""
    height, width = surface_z.shape
    nearest = np.where(np.isfinite(surface_z), surface_z, 1e3).astype(np.float32)
    window = np.ones((3, 3), np.uint8)
    jumps = cv2.dilate(nearest, window) - cv2.erode(nearest, window) > 0.06 * nearest
    to_jump = cv2.distanceTransform((~jumps).astype(np.uint8), cv2.DIST_L2, 3)
    v, u = np.indices((height, width), dtype=np.float32)
    to_border = np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))
    share = np.clip(np.minimum(to_border / FADE_BORDER_PX, to_jump / FADE_EDGE_PX), 0.0, 1.0)
    return np.maximum(share * share * (3.0 - 2.0 * share), LEAST_FADE).astype(np.float32)


def _sampled(image: np.ndarray, pixels: np.ndarray, interpolation: int, outside: Any) -> np.ndarray:
    flat = pixels.reshape(-1, 1, 2)
    # OpenCV's remap takes images of up to 32767 pixels a side: long lists go in as a square.
    side = max(1, int(np.ceil(np.sqrt(len(flat)))))
    padded = np.full((side * side, 2), -1e6, np.float32)
    padded[: len(flat)] = flat[:, 0]
    grid = padded.reshape(side, side, 2)
    values = cv2.remap(image, grid, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    return values.reshape(side * side, *image.shape[2:])[: len(flat)].reshape(*pixels.shape[:-1], *image.shape[2:])
