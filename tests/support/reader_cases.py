"""A tiny recording in every folder format, as bytes by file name, and how to read all that is in one."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from depth_scene import (
    camera_pose,
    write_apc,
    write_images,
    write_pose_file,
    write_redwood,
    write_seven_scenes,
    write_tum,
    write_xtion,
)
from folder_layouts import (
    write_bop,
    write_folder,
    write_icl_nuim,
    write_nerfstudio,
    write_polycam,
    write_record3d,
    write_replica,
    write_scanner_app,
    write_scannet,
    write_sens,
    write_stray,
)

from adagmm_fusion.clouds.building import dense_cloud
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_o3d.errors import AdaGMMError

INTRINSICS = PinholeIntrinsics(16, 12, 14.0, 14.0, 7.5, 5.5)
POSES = [camera_pose(-4.0), camera_pose(6.0, (0.05, 0.1, 1.2))]


def rig_of(format: str) -> Rig:
    """The intrinsics and depth scale of every format's images here."""
    depth_scale = {"tum": 5000.0, "icl-nuim": 5000.0, "apc": 10000.0, "bop": 10000.0, "replica": 6553.5}.get(
        format, 1000.0
    )
    return Rig("one", {"sensor": SensorCalibration("sensor", INTRINSICS, depth_scale, None)})


# The others know their own.
NEEDS_RIG = ("tum", "7scenes", "icl-nuim")


def write_own(folder: Path, poses, intrinsics) -> None:
    sensors = {
        name: SensorCalibration(name, intrinsics, 1000.0, pose)
        for name, pose in zip(("left", "right"), poses, strict=True)
    }
    for name, pose in zip(sensors, poses, strict=True):
        write_images(*(folder / name / kind / "000000.png" for kind in ("color", "depth")), intrinsics, pose, 1000)
    save_rig(folder / "rig.yaml", Rig("room", sensors, "of a test"))
    (folder / "recording.yaml").write_text(
        "format: adagmm-recording\nversion: 1\nname: two in a room\nrig: rig.yaml\nmotion: moving\n"
        'sensors: [left, right]\nframes:\n  - name: "000000"\n    timestamps: {left: 1.5, right: 1.25}\n'
        "    T_world_rig: [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
        "pairs: [{source: right/000000, target: left/000000}]\n"
    )


def write_small_xtion(folder: Path, poses, intrinsics) -> None:
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = 0.02
    write_xtion(folder, poses, intrinsics, intrinsics, T_color_depth, moments=(2,))


def of_phone(write):
    """Colour of four times the size, so that the depth is as large as in the other formats."""
    fine = PinholeIntrinsics(64, 48, 56.0, 56.0, 31.5, 23.5)
    return lambda folder, poses, intrinsics: write(folder, poses, fine)


WRITERS = {
    "adagmm": write_own,
    "tum": write_tum,
    "redwood": write_redwood,
    "7scenes": write_seven_scenes,
    "posefile": write_pose_file,
    "apc": write_apc,
    "xtion": write_small_xtion,
    "scannet": write_scannet,
    "sens": write_sens,
    "icl-nuim": write_icl_nuim,
    "bop": write_bop,
    "replica": write_replica,
    "nerfstudio": write_nerfstudio,
    "folder": write_folder,
    "stray": of_phone(write_stray),
    "polycam": of_phone(write_polycam),
    "scanner-app": of_phone(write_scanner_app),
    "record3d": of_phone(write_record3d),
}


@cache
def files_of(format: str) -> dict[str, bytes]:
    """The files of a tiny recording that can be read."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "recording"
        WRITERS[format](folder, POSES, INTRINSICS)
        return {
            str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
        }


def write_files(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def read_everything(folder: Path, format: str | None = None, rig: Rig | None = None) -> list[AdaGMMError]:
    """Open a recording and read every frame and pair; the errors of ours, all others are raised."""
    problems = []

    def attempt(read):
        try:
            return read()
        except AdaGMMError as problem:
            problems.append(problem)

    recording = attempt(lambda: open_recording(folder, format=format, rig=rig))
    if recording is None:
        return problems
    for entry in recording.entries:
        frame = attempt(entry.load)
        if frame is not None:
            assert frame.color.shape[:2] == frame.depth.shape == (frame.intrinsics.height, frame.intrinsics.width)
            attempt(lambda frame=frame: dense_cloud(frame))
    for index in range(len(recording)):
        # What becomes of names: files, lines of a report, entities in the viewer.
        assert recording.pair_name(index).isprintable() and "/" not in recording.pair_name(index)
        pair = attempt(lambda index=index: recording[index])
        if pair is not None and pair.T_target_source is not None:
            assert np.isfinite(pair.T_target_source).all()
    assert recording.name.isprintable() and all(sensor.isprintable() for sensor in recording.sensors)
    return problems
