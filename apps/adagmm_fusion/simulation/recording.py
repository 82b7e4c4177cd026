"""A simulated recording in our own layout: two fixed Kinects look at one room, and its rig is known exactly."""

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import replacing, write_text
from adagmm_fusion.files.output_folder import check_new_folder
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_fusion.simulation.kinect import INTRINSICS, KinectModel, render_color, render_depth
from adagmm_fusion.simulation.raycast import Scene
from adagmm_fusion.simulation.room import furnish
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

TARGET, SOURCE = "left", "right"
DEFAULT_SEED = 7
DEPTH_SCALE = 1000.0
SECONDS_BETWEEN_PAIRS = 2.0
JPEG_QUALITY = 92
MAX_PAIRS = 100_000


def look_at(eye: ArrayLike, point: ArrayLike, roll_deg: float) -> np.ndarray:
    """(4, 4) T_world_camera of an RDF camera at `eye` whose optical axis goes through `point`; the world's z is up."""
    forward = np.subtract(point, eye) / np.linalg.norm(np.subtract(point, eye))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    c, s = np.cos(np.deg2rad(roll_deg)), np.sin(np.deg2rad(roll_deg))
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = level @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    T_world_camera[:3, 3] = eye
    return T_world_camera


T_WORLD_CAMERA = {
    TARGET: look_at((-0.37, 0.10, 1.35), (-0.50, 3.00, 0.75), roll_deg=-1.5),
    SOURCE: look_at((1.10, 0.58, 1.50), (-0.50, 3.00, 0.75), roll_deg=2.0),
}


def simulated_rig(name: str) -> Rig:
    """The exact rig; its frame is the target's camera frame."""
    T_rig_world = se_inverse(T_WORLD_CAMERA[TARGET])
    T_rig_sensor = {TARGET: np.eye(4), SOURCE: T_rig_world @ T_WORLD_CAMERA[SOURCE]}
    sensors = {key: SensorCalibration(key, INTRINSICS, DEPTH_SCALE, T) for key, T in T_rig_sensor.items()}
    return Rig(name, sensors, "two simulated Kinects, some 30 degrees apart; exact")


def render_pair(seed: int, index: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Colour (H, W, 3) uint8 RGB and depth (H, W) uint16 [mm] of each sensor, at one moment of the room."""
    scene, images = Scene(furnish(seed, index)), {}
    for number, (sensor, T_world_camera) in enumerate(T_WORLD_CAMERA.items()):
        depth_noise, color_noise = (np.random.default_rng([seed, 2, index, number, kind]) for kind in (0, 1))
        depth = render_depth(scene, T_world_camera, depth_noise, KinectModel())
        images[sensor] = render_color(scene, T_world_camera, color_noise), depth
    return images


def simulate_recording(
    folder: str | Path,
    *,
    pairs: int = 3,
    seed: int = DEFAULT_SEED,
    calibration: str | Path | None = None,
    on_pair: Callable[[str], None] | None = None,
) -> Path:
    """Render a recording into a new folder and write its rig file.

    Parameters
    ----------
    folder : where to; it must not exist, or be empty.
    pairs : moments of the room, each seen by both sensors; chair, ball and cartons stand elsewhere in each.
    calibration : the rig file's path; None writes rig.yaml into the folder. A recording finds its rig in its own
        folder or in ../../calibration; anywhere else it has to be given with --calibration.
    on_pair : called with each pair's name when its files are there.

    Returns
    -------
    The rig file's path.

    Raises
    ------
    InputError  if the folder holds something, or pairs or seed is out of range.
    OutputError  if a file cannot be written.
    """
    folder = Path(folder)
    if not 1 <= pairs <= MAX_PAIRS:
        raise InputError(f"pairs: expected 1 to {MAX_PAIRS}, got {pairs}")
    if seed < 0:
        raise InputError(f"seed: expected 0 or more, got {seed}")
    check_new_folder(folder, InputError)
    rig_path = folder / "rig.yaml" if calibration is None else Path(calibration)
    whole = Path(os.path.realpath(folder))
    if Path(os.path.realpath(rig_path)) in (whole, *whole.parents):
        raise InputError(f"calibration: expected the name of a rig file, got a folder of the recording, {rig_path}")
    name = folder.resolve().name
    save_rig(rig_path, simulated_rig(name))
    for index in range(pairs):
        for sensor, (color, depth) in render_pair(seed, index).items():
            frame = f"{index:06d}"
            color_path = folder / sensor / "color" / f"{frame}.jpg"
            _write_image(color_path, color[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            _write_image(folder / sensor / "depth" / f"{frame}.png", depth, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if on_pair is not None:
            on_pair(frame)
    write_text(folder / "recording.yaml", _manifest(name, rig_path.name, pairs))
    return rig_path


def _manifest(name: str, rig: str, pairs: int) -> str:
    lines = ["format: adagmm-recording", "version: 1", f'name: "{name}"', f'rig: "{rig}"', "motion: fixed"]
    lines += [f"sensors: [{TARGET}, {SOURCE}]  # the first one is the target", "frames:"]
    for index in range(pairs):
        stamp = index * SECONDS_BETWEEN_PAIRS
        lines += [f'  - name: "{index:06d}"', f"    timestamps: {{{TARGET}: {stamp}, {SOURCE}: {stamp}}}"]
    return "\n".join(lines) + "\n"


def _write_image(path: Path, image: np.ndarray, options: list[int]) -> None:
    complete, data = cv2.imencode(path.suffix, image, options)
    if not complete:
        raise OutputError(f"{path}: the image could not be encoded")
    with replacing(path) as temporary:
        temporary.write_bytes(data.tobytes())
