"""The known room in folders as programs, phones and data sets lay them out."""

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from depth_scene import render, write_images
from scipy.spatial.transform import Rotation

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


# Phones: depth is of the colour image's view, and coarser.


def coarser(k: PinholeIntrinsics, times: int) -> PinholeIntrinsics:
    """The same view in an image of fewer pixels."""
    return PinholeIntrinsics(
        k.width // times,
        k.height // times,
        k.fx / times,
        k.fy / times,
        (k.cx + 0.5) / times - 0.5,
        (k.cy + 0.5) / times - 0.5,
    )


def write_confidence(path: Path, size: tuple[int, int]) -> None:
    """The bottom right 4 x 4 pixels are guessed."""
    confidence = np.full(size[::-1], 2, np.uint8)
    confidence[-4:, -4:] = 0
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), confidence)


def write_stray(folder: Path, poses, intrinsics: PinholeIntrinsics, *, video: bool = False):
    k, rows = coarser(intrinsics, 4), ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    folder.mkdir(parents=True, exist_ok=True)
    size = (intrinsics.width, intrinsics.height)
    writer = cv2.VideoWriter(str(folder / "rgb.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 60, size) if video else None
    for i, pose in enumerate(poses):
        if writer is None:
            write_color(folder / f"rgb/{i:06d}.png", intrinsics, pose)
        else:
            writer.write(render(intrinsics, pose)[0][:, :, ::-1])
        write_depth(folder / f"depth/{i:06d}.png", k, pose, 1000)
        write_confidence(folder / f"confidence/{i:06d}.png", (k.width, k.height))
        rows.append(f"{10.0 + i / 60:.6f}, {i:06d}, " + ", ".join(f"{x:.9f}" for x in quaternion_pose(pose)))
    if writer is not None:
        writer.release()
    (folder / "odometry.csv").write_text("\n".join(rows) + "\n")
    (folder / "camera_matrix.csv").write_text("\n".join(", ".join(map(str, row)) for row in intrinsics.matrix()))


def quaternion_pose(T) -> list[float]:
    """x y z qx qy qz qw."""
    return [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]


def write_polycam(folder: Path, poses, intrinsics: PinholeIntrinsics):
    k = coarser(intrinsics, 4)
    for i, pose in enumerate(poses):
        name = f"{10_000_000 + i * 500_000}"
        write_color(folder / f"keyframes/images/{name}.png", intrinsics, pose)
        write_depth(folder / f"keyframes/depth/{name}.png", k, pose, 1000)
        write_confidence(folder / f"keyframes/confidence/{name}.png", (k.width, k.height))
        arkit = pose @ OPENGL
        camera = {f"t_{row}{column}": arkit[row, column] for row in range(3) for column in range(4)}
        camera |= {"fx": intrinsics.fx, "fy": intrinsics.fy, "cx": intrinsics.cx, "cy": intrinsics.cy}
        camera |= {"width": intrinsics.width, "height": intrinsics.height, "timestamp": int(name), "blur_score": 80.0}
        write_json(folder / f"keyframes/cameras/{name}.json", camera)


def write_scanner_app(folder: Path, poses, intrinsics: PinholeIntrinsics):
    k = coarser(intrinsics, 4)
    for i, pose in enumerate(poses):
        color = render(intrinsics, pose)[0]
        folder.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / f"frame_{i:05d}.jpg"), color[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])
        write_depth(folder / f"depth_{i:05d}.png", k, pose, 1000)
        write_confidence(folder / f"conf_{i:05d}.png", (k.width, k.height))
        values = {
            "cameraPoseARFrame": (pose @ OPENGL).ravel().tolist(),
            "intrinsics": intrinsics.matrix().ravel().tolist(),
        }
        write_json(folder / f"frame_{i:05d}.json", values | {"time": 5.0 + i / 3, "frame_index": i, "motionQuality": 1})
    # Most frames have no colour image.
    write_json(folder / f"frame_{len(poses):05d}.json", values)
    write_json(folder / "info.json", {"device": "a phone"})


def write_record3d(folder: Path, poses, intrinsics: PinholeIntrinsics):
    """What a .r3d archive holds; LZFSE as it stores what does not become smaller."""
    k = coarser(intrinsics, 4)
    (folder / "rgbd").mkdir(parents=True, exist_ok=True)
    for i, pose in enumerate(poses):
        color = render(intrinsics, pose)[0]
        assert cv2.imwrite(str(folder / f"rgbd/{i}.jpg"), color[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])
        depth = render(k, pose)[1].astype("<f4")
        depth[:8, :8] = np.nan
        confidence = np.full(depth.shape, 2, np.uint8)
        confidence[-4:, -4:] = 0
        for suffix, array in (("depth", depth), ("conf", confidence)):
            stored = b"bvx-" + struct.pack("<I", array.nbytes) + array.tobytes() + b"bvx$"
            (folder / f"rgbd/{i}.{suffix}").write_bytes(stored)
    arkit = [np.asarray(pose) @ OPENGL for pose in poses]
    metadata = {"w": intrinsics.width, "h": intrinsics.height, "dw": k.width, "dh": k.height, "fps": 60}
    metadata |= {"K": intrinsics.matrix().T.ravel().tolist(), "frameTimestamps": [i / 60 for i in range(len(poses))]}
    metadata["poses"] = [[*quaternion_pose(T)[3:], *quaternion_pose(T)[:3]] for T in arkit]
    write_json(folder / "metadata", metadata)


# Data sets


def write_scannet(folder: Path, poses, intrinsics: PinholeIntrinsics):
    for i, pose in enumerate(poses):
        write_color(folder / f"color/{i}.png", intrinsics, pose)
        write_depth(folder / f"depth/{i}.png", intrinsics, pose, 1000)
        (folder / "pose").mkdir(exist_ok=True)
        np.savetxt(folder / f"pose/{i}.txt", pose)
    (folder / "intrinsic").mkdir()
    K = np.eye(4)
    K[:3, :3] = intrinsics.matrix()
    for name, matrix in (("intrinsic", K), ("extrinsic", np.eye(4))):
        for kind in ("color", "depth"):
            np.savetxt(folder / f"intrinsic/{name}_{kind}.txt", matrix)


def write_sens(folder: Path, poses, intrinsics: PinholeIntrinsics, depth_intrinsics=None, T_color_depth=None):
    """A .sens file as ScanNet's SensorData writes it, with PNG for colour."""
    depth_intrinsics = depth_intrinsics or intrinsics
    T = np.eye(4) if T_color_depth is None else T_color_depth
    folder.mkdir(parents=True, exist_ok=True)
    data = struct.pack("<IQ", 4, 9) + b"Structure"
    for k, extrinsics in ((intrinsics, np.eye(4)), (depth_intrinsics, T)):
        K = np.eye(4)
        K[:3, :3] = k.matrix()
        data += K.astype("<f4").tobytes() + extrinsics.astype("<f4").tobytes()
    sizes = (intrinsics.width, intrinsics.height, depth_intrinsics.width, depth_intrinsics.height)
    data += struct.pack("<2i4IfQ", 1, 1, *sizes, 1000.0, len(poses))
    for i, pose in enumerate(poses):
        color = cv2.imencode(".png", render(intrinsics, pose)[0][:, :, ::-1])[1].tobytes()
        depth = zlib.compress(depth_of(depth_intrinsics, pose @ T, 1000).tobytes())
        data += np.asarray(pose).astype("<f4").tobytes()
        data += struct.pack("<4Q", 33333 * i, 33333 * i, len(color), len(depth)) + color + depth
    (folder / "scene.sens").write_bytes(data)


def write_icl_nuim(folder: Path, poses, intrinsics: PinholeIntrinsics):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    associations = truth = ""
    for i, pose in enumerate(poses, 1):
        write_color(folder / f"rgb/{i}.png", intrinsics, pose)
        write_depth(folder / f"depth/{i}.png", intrinsics, pose, 5000)
        associations += f"{i} depth/{i}.png {i} rgb/{i}.png\n"
        truth += f"{i} " + " ".join(f"{x:.9f}" for x in quaternion_pose(mirror @ pose @ mirror)) + "\n"
    (folder / "associations.txt").write_text(associations)
    (folder / "livingRoom2.gt.freiburg").write_text(truth)


def write_bop(folder: Path, poses, intrinsics: PinholeIntrinsics):
    cameras = {}
    for i, pose in enumerate(poses):
        write_color(folder / f"rgb/{i:06d}.png", intrinsics, pose)
        write_depth(folder / f"depth/{i:06d}.png", intrinsics, pose, 10000)
        T = np.linalg.inv(pose)
        cameras[str(i)] = {
            "cam_K": intrinsics.matrix().ravel().tolist(),
            "depth_scale": 0.1,
            "cam_R_w2c": T[:3, :3].ravel().tolist(),
            "cam_t_w2c": (1000 * T[:3, 3]).tolist(),
        }
    write_json(folder / "scene_camera.json", cameras)


def write_replica(folder: Path, poses, intrinsics: PinholeIntrinsics):
    for i, pose in enumerate(poses):
        write_color(folder / f"results/frame{i:06d}.png", intrinsics, pose)
        write_depth(folder / f"results/depth{i:06d}.png", intrinsics, pose, 6553.5)
    np.savetxt(folder / "traj.txt", np.reshape(poses, (-1, 16)))
    values = {"w": intrinsics.width, "h": intrinsics.height, "fx": intrinsics.fx, "fy": intrinsics.fy}
    values |= {"cx": intrinsics.cx, "cy": intrinsics.cy, "scale": 6553.5}
    write_json(folder / "cam_params.json", {"camera": values})


def write_nerfstudio(folder: Path, poses, intrinsics: PinholeIntrinsics):
    frames = []
    for i, pose in enumerate(poses):
        color, depth = f"images/frame_{i:05d}.png", f"depths/frame_{i:05d}.png"
        write_color(folder / color, intrinsics, pose)
        write_depth(folder / depth, intrinsics, pose, 1000)
        matrix = (np.asarray(pose) @ OPENGL).tolist()
        frames.append({"file_path": color, "depth_file_path": depth, "transform_matrix": matrix})
    values = {"camera_model": "OPENCV", "fl_x": intrinsics.fx, "fl_y": intrinsics.fy, "cx": intrinsics.cx}
    values |= {"cy": intrinsics.cy, "w": intrinsics.width, "h": intrinsics.height, "k1": 0.0, "k2": 0.0}
    write_json(folder / "transforms.json", values | {"p1": 0.0, "p2": 0.0, "frames": frames})
