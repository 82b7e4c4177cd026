"""The known room in folders as programs, phones and data sets lay them out."""

import json
from pathlib import Path

import cv2
import numpy as np
from depth_scene import render, write_images

from adagmm_fusion.frames.rgbd import PinholeIntrinsics

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_folder(folder: Path, poses, intrinsics: PinholeIntrinsics):
    """A folder that no program has a name for: world-to-camera poses, and a name that does not say so."""
    for i, pose in enumerate(poses):
        write_images(folder / f"rgb/img_{i}.png", folder / f"depth/{i:04d}.png", intrinsics, pose, 1000)
        (folder / "extrinsics").mkdir(exist_ok=True)
        np.savetxt(folder / f"extrinsics/{i:04d}.txt", np.linalg.inv(pose))
    np.savetxt(folder / "intrinsics.txt", intrinsics.matrix())


def write_color(path: Path, intrinsics: PinholeIntrinsics, pose) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), render(intrinsics, pose)[0][:, :, ::-1])


def depth_of(intrinsics: PinholeIntrinsics, pose, depth_scale: float) -> np.ndarray:
    """(H, W) uint16, with the top left 8 x 8 pixels missing."""
    stored = np.rint(render(intrinsics, pose)[1] * depth_scale).astype(np.uint16)
    stored[:8, :8] = 0
    return stored


def write_depth(path: Path, intrinsics: PinholeIntrinsics, pose, depth_scale: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), depth_of(intrinsics, pose, depth_scale))


def write_json(path: Path, content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
