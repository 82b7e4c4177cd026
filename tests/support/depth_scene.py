"""A small room seen by a perfect depth camera, and folders of it in every recording format the app reads."""

from pathlib import Path

import cv2
import numpy as np
import scipy.io
from scipy.spatial.transform import Rotation

from adagmm_fusion.frames.rgbd import PinholeIntrinsics

# Planes n . p = d in the world (z up, metres) and one ball, so that nothing about the pose is left open.
PLANES = (
    (np.array([0.0, 0.0, 1.0]), 0.0),
    (np.array([1.0, 0.0, 0.0]), 2.5),
    (np.array([0.0, 1.0, 0.0]), 1.2),
    (np.array([0.0, 1.0, 0.0]), -1.6),
)
BALL_CENTRE, BALL_RADIUS = np.array([1.6, -0.1, 0.45]), 0.45


def camera_pose(yaw_deg: float, position=(0.0, 0.0, 1.2), pitch_deg: float = 20.0) -> np.ndarray:
    """T_world_camera of a camera (x right, y down, z forward) that looks along world x, turned left and tilted down."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("zy", (yaw_deg, pitch_deg), degrees=True).as_matrix() @ level
    T[:3, 3] = position
    return T


def render(intrinsics: PinholeIntrinsics, T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 RGB and (H, W) float64 depth [m] without noise; the colour is a pattern on the world."""
    v, u = np.indices((intrinsics.height, intrinsics.width), dtype=np.float64)
    pixels = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
    criteria = {"criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)}
    undistort = getattr(cv2, "undistortPointsIter", None)
    arguments = (pixels, intrinsics.matrix(), np.array(intrinsics.distortion or (0.0,) * 4))
    if undistort:
        rays = undistort(*arguments, None, None, criteria["criteria"])
    else:
        rays = cv2.undistortPoints(*arguments, **criteria)
    rays = np.column_stack((rays.reshape(-1, 2), np.ones(len(pixels))))
    directions = rays @ T_world_camera[:3, :3].T  # z = 1 along the axis, so the parameter is the depth
    origin = T_world_camera[:3, 3]
    depth = np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for normal, offset in PLANES:
            z = (offset - normal @ origin) / (directions @ normal)
            depth = np.where((z > 0) & (z < depth), z, depth)
        to_ball = origin - BALL_CENTRE
        a, b = (directions**2).sum(axis=1), directions @ to_ball
        z = (-b - np.sqrt(b * b - a * (to_ball @ to_ball - BALL_RADIUS**2))) / a
        depth = np.where((z > 0) & (z < depth), z, depth)
    points = origin + directions * depth[:, None]
    color = (127.5 + 127.5 * np.sin(7.0 * points)).astype(np.uint8)
    return color.reshape(*v.shape, 3), depth.reshape(v.shape)


def write_images(
    color_path: Path, depth_path: Path, intrinsics, T_world_camera, depth_scale: float, *, missing: int = 0
):
    """Both images of one view; the top left 8 x 8 pixels have no depth, which the format stores as `missing`."""
    color, depth = render(intrinsics, T_world_camera)
    stored = np.rint(depth * depth_scale).astype(np.uint16)
    stored[:8, :8] = missing
    for path, image in ((color_path, color[:, :, ::-1]), (depth_path, stored)):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), image)


def write_tum(folder: Path, poses, intrinsics, *, offset=0.004):
    stamps = [100.0 + i / 3 for i in range(len(poses))]
    lists = {"rgb": "", "depth": ""}
    for stamp, pose in zip(stamps, poses, strict=True):
        color, depth = f"rgb/{stamp - offset:.6f}.png", f"depth/{stamp:.6f}.png"
        write_images(folder / color, folder / depth, intrinsics, pose, 5000)
        lists["rgb"] += f"{stamp - offset:.6f} {color}\n"
        lists["depth"] += f"{stamp:.6f} {depth}\n"
    for kind, text in lists.items():
        (folder / f"{kind}.txt").write_text(f"# {kind} maps of freiburg1\n# timestamp filename\n{text}")
    rows = []
    for stamp, pose in zip(stamps, poses, strict=True):
        # Samples before and after the image, on the path that the interpolation must follow.
        for share, seconds in ((-1.0, -0.03), (1.0, 0.03)):
            turn = Rotation.from_rotvec([0.0, 0.0, 0.02 * share]).as_matrix() @ pose[:3, :3]
            position = pose[:3, 3] + share * np.array([0.01, 0.0, 0.02])
            numbers = (*position, *Rotation.from_matrix(turn).as_quat())
            rows.append(f"{stamp + seconds:.6f} " + " ".join(f"{x:.9f}" for x in numbers))
    (folder / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows) + "\n")


def write_redwood(folder: Path, poses, intrinsics):
    log = ""
    for i, pose in enumerate(poses):
        # Redwood's colour and depth names carry different time stamps.
        write_images(
            folder / f"color/{i:05d}-{i * 33:012d}.png",
            folder / f"depth/{i:05d}-{i * 34:012d}.png",
            intrinsics,
            pose,
            1000,
        )
        log += f"{i} {i} {i + 1}\n" + "".join(" ".join(f"{x:.9f}" for x in row) + "\n" for row in pose)
    (folder / "trajectory.log").write_text(log)
    K = intrinsics.matrix().T.ravel().tolist()
    size = f'"width": {intrinsics.width}, "height": {intrinsics.height}'
    (folder / "camera_intrinsic.json").write_text(f'{{{size}, "intrinsic_matrix": {K}}}')


def write_seven_scenes(folder: Path, poses, intrinsics):
    for i, pose in enumerate(poses):
        name = f"frame-{i:06d}"
        images = (folder / f"{name}.{kind}.png" for kind in ("color", "depth"))
        write_images(*images, intrinsics, pose, 1000, missing=65535)
        (folder / f"{name}.pose.txt").write_text("\n".join("\t ".join(f"{x:.7e}" for x in row) for row in pose) + "\n")


def write_pose_file(folder: Path, poses, intrinsics):
    names = [f"{7 * i:05d}.png" for i in range(len(poses))]
    for name, pose in zip(names, poses, strict=True):
        write_images(folder / "images" / name, folder / "depth" / name, intrinsics, pose, 1000)
    np.savetxt(folder / "K.txt", intrinsics.matrix())
    np.savetxt(folder / "poses.txt", np.reshape(poses, (-1, 16)))
    (folder / "all_frame_names.txt").write_text("\n".join(names) + "\n")


def write_apc(folder: Path, poses, intrinsics):
    text = '# Environment: shelf\n# Objects: ["ball"]\n\n# Color camera intrinsic matrix\n'
    text += "".join("\t".join(f"{x: .8e}" for x in row) + "\n" for row in intrinsics.matrix())
    for i, pose in enumerate(poses):
        name = f"frame-{i:06d}"
        color, depth = (folder / f"{name}.{kind}.png" for kind in ("color", "depth"))
        write_images(color, depth, intrinsics, pose, 10000)
        stored = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).astype(np.uint32)
        assert cv2.imwrite(str(depth), ((stored << 3 | stored >> 13) & 0xFFFF).astype(np.uint16))
        text += f"\n# Camera-to-world extrinsic matrix (camera pose) for {name}\n"
        text += "".join("\t".join(f"{x: .8e}" for x in row) + "\n" for row in pose)
    (folder / "cam.info.txt").write_text(text)


def write_xtion(folder: Path, poses, color_intrinsics, depth_intrinsics, T_color_depth, *, moments=(2, 11)):
    """Two colour cameras at `poses` with the depth camera beside each, `T_color_depth` away."""
    for moment in moments:
        for sensor, pose in enumerate(poses, 1):
            color, _ = render(color_intrinsics, pose)
            _, depth = render(depth_intrinsics, pose @ T_color_depth)
            stored = np.rint(depth * 1000).astype(np.uint16)
            (folder / "images").mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(folder / f"images/rgb_image{sensor}_{moment}.png"), color[:, :, ::-1])
            scipy.io.savemat(folder / f"images/depth{sensor}_{moment}.mat", {"depth_array": stored})
    calibration = {"Kdepth": depth_intrinsics.matrix(), "Krgb": color_intrinsics.matrix()}
    calibration |= {"R": T_color_depth[:3, :3], "T": T_color_depth[:3, 3]}
    scipy.io.savemat(folder / "cameraparametersAsus.mat", {"cam_params": calibration})
    np.savetxt(folder / "images/T_cam1_to_cam2_reference.txt", np.linalg.inv(poses[1]) @ poses[0])
