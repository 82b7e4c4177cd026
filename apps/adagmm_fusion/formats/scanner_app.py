"""3D Scanner App (iOS, Laan Labs), exported as "All Data": one phone with LiDAR.

    frame_00000.jpg      colour, of some frames only
    frame_00000.json     intrinsics: 9 numbers row by row, of the colour image; cameraPoseARFrame: 16 numbers row by
                         row, camera to world in ARKit's axes (x right, y up, z backward), metres; time [s]
    depth_00000.png      16 bit, 256x192, millimetres, of the same view
    conf_00000.png       optional, 8 bit: 0, 1 or 2; where it is 0 the depth is left out

Frames without colour are passed over. Depth is drawn out over the colour image, which is made smaller.
"""

from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside, read_color
from adagmm_fusion.files.json_file import json_number, json_numbers, json_object, read_json
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.phone_depth import ARKIT_FROM_RDF, MILLIMETRES_PER_METRE, confident_depth
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.recordings.frame_sequence import Recording

NAME = "scanner-app"
SUMMARY = "3D Scanner App, All Data (frame_00000.jpg, .json, depth_00000.png)"
SENSOR = "phone"


def matches(folder: Path) -> bool:
    return any(folder.glob("frame_*.json")) and any(folder.glob("depth_*.png"))


def read(folder: Path, options: ReadOptions) -> Recording:
    frames: list[ListedFrame] = []
    size = (0, 0)
    for path in sorted(folder.glob("frame_*.jpg")):
        name = path.stem.removeprefix("frame_")
        color, camera, depth, confidence = (
            inside(folder, relative, str(folder))
            for relative in (path.name, f"frame_{name}.json", f"depth_{name}.png", f"conf_{name}.png")
        )
        if not (camera.exists() and depth.exists()):
            continue
        where = str(camera)
        values = json_object(read_json(camera), where)
        K = json_numbers(values.get("intrinsics"), 9, f"{where}: intrinsics").reshape(3, 3)
        T = parse_pose(json_numbers(values.get("cameraPoseARFrame"), 16, f"{where}: cameraPoseARFrame"), where)
        if not frames:
            size = read_color(color).shape[1::-1]
        frames.append(
            ListedFrame(
                name,
                color,
                partial(confident_depth, depth, confidence),
                intrinsics_from_matrix(np.where(np.abs(K) < 1e-9, 0.0, K), size, camera),
                MILLIMETRES_PER_METRE,
                T @ ARKIT_FROM_RDF,
                json_number(values, "time", where) if "time" in values else None,
                where=depth,
            )
        )
    if not frames:
        raise RecordingError(f"{folder}: no frame has .jpg, .json and depth .png; export it as All Data")
    return recording_of_frames(folder, NAME, SENSOR, frames, options)
