"""Images and depth of a flat calibration board, rendered through a lens with known distortion from known poses."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.frames.depth_geometry import pixel_rays
from adagmm_fusion.frames.rgbd import PinholeIntrinsics

SUB = 2  # rays per pixel, a side
TEXELS = 60  # of the pattern in a square
BLUR_TEXELS = 1.5  # a lens is not perfectly sharp, and edges without blur would be lost between the rays
BACKGROUND, WALL_M = 90.0, 3.0


def chessboard_pattern(columns: int, rows: int) -> np.ndarray:
    """Squares of a board with `columns` x `rows` inner corners and a white rim as wide as a square; the square between
    its first four corners is dark."""
    y, x = np.indices((rows + 3, columns + 3))
    board = np.where((x + y) % 2 == 0, 20.0, 230.0)
    board[[0, -1], :] = board[:, [0, -1]] = 230.0
    return np.kron(board, np.ones((TEXELS, TEXELS)))


def charuco_pattern(columns: int, rows: int, marker_texels: int, dictionary: str) -> np.ndarray:
    """A ChArUco board as OpenCV prints it, with the same white rim."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    board = cv2.aruco.CharucoBoard((columns, rows), TEXELS, marker_texels, markers)
    size = ((columns + 2) * TEXELS, (rows + 2) * TEXELS)
    return 20.0 + board.generateImage(size, marginSize=TEXELS).astype(float) * (210.0 / 255.0)


def board_pose(turn_deg, position) -> np.ndarray:
    """T_world_board; with no turn, its x and y go along the world's and its front looks at the world's origin."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    T[:3, 3] = position
    return T


def render_board(pattern, square_m: float, intrinsics: PinholeIntrinsics, T_camera_board: np.ndarray):
    """(H, W) uint8 image and (H, W) float64 depth [m]; the board's first corner is two squares into the pattern."""
    k = intrinsics
    fine = PinholeIntrinsics(
        *(SUB * k.width, SUB * k.height, SUB * k.fx, SUB * k.fy),
        *(SUB * k.cx + (SUB - 1) / 2, SUB * k.cy + (SUB - 1) / 2, k.distortion),
    )
    rays = np.concatenate((pixel_rays(fine), np.ones((fine.height, fine.width, 1))), axis=-1)
    normal, origin = T_camera_board[:3, 2], T_camera_board[:3, 3]
    with np.errstate(divide="ignore"):
        z = (normal @ origin) / (rays @ normal)
    points = (rays * z[..., None] - origin) @ T_camera_board[:3, :3]
    u, v = points[..., 0] / square_m * TEXELS + 2 * TEXELS, points[..., 1] / square_m * TEXELS + 2 * TEXELS
    on_board = (z > 0) & (u >= 0) & (v >= 0) & (u < pattern.shape[1]) & (v < pattern.shape[0])
    soft = cv2.GaussianBlur(pattern, (0, 0), BLUR_TEXELS)
    texel = (np.where(on_board, c, 0).astype(np.float32) - np.float32(0.5) for c in (u, v))
    image = np.where(on_board, cv2.remap(soft, *texel, cv2.INTER_LINEAR), BACKGROUND)
    image = image.reshape(k.height, SUB, k.width, SUB).mean(axis=(1, 3))
    depth = np.where(on_board, z, WALL_M).reshape(k.height, SUB, k.width, SUB).mean(axis=(1, 3))
    return np.rint(image).astype(np.uint8), depth


def turns(count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Board poses in front of cameras at the world's origin, tilted to all sides, near and far."""
    poses = []
    for i in range(count):
        tilt = 2 * np.pi * i / count
        turn = (28 * np.cos(tilt), 28 * np.sin(tilt), rng.uniform(-25, 25))
        poses.append(board_pose(turn, rng.uniform((-0.36, -0.24, 0.85), (-0.05, 0.0, 1.15))))
    return poses


def write_view(folder, view: str, color: np.ndarray, depth: np.ndarray | None = None, depth_scale: float = 1000.0):
    """<folder>/color/<view>.png, and <folder>/depth/<view>.png."""
    images = [("color", color)]
    if depth is not None:
        images.append(("depth", np.rint(depth * depth_scale).astype(np.uint16)))
    for kind, image in images:
        (folder / kind).mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / kind / f"{view}.png"), image)
