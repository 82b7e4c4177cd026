"""Any folder of colour and depth images with a calibration.

    color/, rgb/, images/ ...        .png, .jpg; or colour and depth side by side, the names of depth saying depth
    depth/ ...                       .png, .tiff, .exr, .npy, .pgm; partners by equal names, numbers or times
    intrinsics.txt, K.txt ...        also .json and .yaml, here or in a folder of such a name; see camera_files.py. With
                                     depth in its name it is the depth camera's, with color or rgb the colour camera's;
                                     of several the one for the images' size; see folder_cameras.py
    depth_to_color.txt               optional, 4x4, metres: from the depth to the colour camera (or color_to_depth)
    poses/, trajectory.txt ...       optional; see pose_lists.py

Whole numbers of depth are millimetres and others metres, or millimetres too where metres would be beyond any camera's
reach, unless a calibration says depth_scale or depth_units. Depth of another size, or of another camera whose
calibration is there, is brought onto the colour image. Poses are camera to world or world to camera, as their file's
name says, else as the depth images agree better. A rig file replaces the intrinsics; one with the sensors `color` and
`depth` calibrates both cameras.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import first_readable, inside, read_color, read_depth
from adagmm_fusion.formats.folder_cameras import FolderCameras, find_cameras
from adagmm_fusion.formats.image_lists import ImageLists, constant_lag, find_images, pair_images
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import PRIMESENSE, ReadOptions, unpaired_notes
from adagmm_fusion.formats.pose_lists import PoseList, find_poses
from adagmm_fusion.formats.redwood import takes_primesense
from adagmm_fusion.frames.depth_checks import usual_depth_scale
from adagmm_fusion.frames.pose_readings import AS_GIVEN, READINGS, PosedPair, best_reading
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.errors import AdaGMMError

NAME = "folder"
SUMMARY = "any folder of colour and depth images with intrinsics"
SENSOR = "camera"
# Pairs that are looked at to find which way round the poses are, and the share of points that agree below which none
# may be right.
PAIRS, DOUBTFUL = 3, 0.5


def matches(folder: Path) -> bool:
    """Whether there are both kinds of images: true of most formats' folders too, so it is asked last."""
    try:
        return folder.is_dir() and find_images(folder) is not None
    except OSError:  # a folder in it that may not be listed
        return False


def read(folder: Path, options: ReadOptions) -> Recording:
    lists = find_images(folder)
    if lists is None:
        raise RecordingError(f"{folder}: expected colour and depth images, in folders such as color/ and depth/")
    images = pair_images(lists)
    for path in (path for _, *paths in images for path in paths):
        inside(folder, str(path.relative_to(folder)), str(folder))
    notes = list(_unpaired(folder, lists, images))
    color_size, depth_size, usual = _first_sizes(images)
    found = FolderCameras() if options.rig is not None else find_cameras(folder, color_size, depth_size)
    color, of_depth = found.color, found.depth
    notes += found.notes
    if color is None and options.rig is None:
        k = PRIMESENSE
        or_else = (
            f"; --format redwood takes PrimeSense's {k.fx:g} {k.fy:g} {k.cx:g} {k.cy:g}, for a Kinect v1 or an Xtion"
            if takes_primesense(folder, depth_size)
            else ""
        )
        raise RecordingError(
            f"{folder}: not a recording of a known format, but nearly: {len(images)} frames, colour in "
            f"{_place(images[0][1], folder)}, depth in {_place(images[0][2], folder)}, and no intrinsics"
            f"{found.not_understood}; add intrinsics.json with width, height, fx, fy, cx, cy, or give a rig file"
            f"{or_else}"
        )
    said = found.depth_scale
    depth_scale = said or usual
    if said is None and options.rig is None:
        notes.append(f"depth is taken for {'metres' if usual == 1.0 else 'millimetres'}, no file says so")
    frames = [
        ListedFrame(
            name,
            color_path,
            depth_path,
            None if color is None else color.intrinsics((color_size, depth_size)),
            depth_scale,
            depth_intrinsics=None if of_depth is None else of_depth.intrinsics((depth_size,)),
            T_color_depth=found.T_color_depth,
        )
        for name, color_path, depth_path in images
    ]
    poses = find_poses(folder, [path for *_, path in images], notes)
    if poses is not None:
        frames, note = _posed(folder, frames, poses, options)
        notes.append(note)
    return recording_of_frames(folder, NAME, SENSOR, frames, options, notes)


def _unpaired(folder: Path, lists: ImageLists, images: list[tuple[str, Path, Path]]) -> tuple[str, ...]:
    names = {path: name for name, *paths in images for path in paths}
    colors, depths = (
        {names.get(path, f"{path.parent.name}/{path.name}") for path in paths} for paths in (lists.colors, lists.depths)
    )
    notes = unpaired_notes(colors, depths, folder)
    lag = constant_lag(lists) if notes else None
    if lag is None:
        return notes
    alike = (
        f"there are as many colour as depth images, and in order the depth's numbers all are {abs(lag):.4g} "
        f"{'higher' if lag > 0 else 'lower'}: images of equal numbers are taken for partners, others may be"
    )
    return (*notes, alike)


def _place(path: Path, folder: Path) -> str:
    return f"{path.parent.name}/" if path.parent != folder else "the folder itself"


def _first_sizes(images: list[tuple[str, Path, Path]]) -> tuple[tuple[int, int], tuple[int, int], float]:
    """(width, height) of colour and of depth, and the depth's usual units per metre, of the first frame that can be
    read.

    Raises
    ------
    RecordingError  of the first frame, if none can be read.
    """

    def sizes(image: tuple[str, Path, Path]) -> tuple[tuple[int, int], tuple[int, int], float]:
        color, depth = read_color(image[1]), read_depth(image[2])
        return color.shape[1::-1], depth.shape[::-1], usual_depth_scale(depth)

    return first_readable(images, sizes)


def _posed(
    folder: Path, frames: list[ListedFrame], poses: PoseList, options: ReadOptions
) -> tuple[list[ListedFrame], str]:
    """The frames with their T_world_camera, and how the poses were read."""
    given = [replace(frame, T_world_camera=T) for frame, T in zip(frames, poses.by_frame, strict=True)]
    file = poses.path.relative_to(folder)
    if poses.to_world is not None:
        reading, why = (AS_GIVEN if poses.to_world else "the inverse"), "by their name"
    else:
        recording = recording_of_frames(folder, NAME, SENSOR, given, options)
        best = best_reading(_pairs(recording))
        reading = best.name
        why = f"so {100 * best.share:.0f} % of the points agree between depth images"
        if reading != AS_GIVEN:
            why += f", as camera to world {100 * best.share_as_given:.0f} %"
        if best.share < DOUBTFUL:
            why += ", which is few: they may be of other frames, or meant in another way"
    read_as = "camera to world" if reading == AS_GIVEN else f"{reading} of camera to world"
    posed = [
        replace(f, T_world_camera=None if f.T_world_camera is None else READINGS[reading](f.T_world_camera))
        for f in given
    ]
    return posed, f"poses of {file} are read as {read_as}: {why}"


def _pairs(recording: Recording) -> list[PosedPair]:
    entries = recording.entries
    known = [i for i, entry in enumerate(entries) if entry.T_world_camera is not None]
    pairs = []
    for start in np.unique(np.linspace(0, max(len(known) - 2, 0), PAIRS).astype(int)):
        two = known[start : start + 2]
        if len(two) < 2:
            continue
        target, source = (entries[i] for i in two)
        try:
            pairs.append(PosedPair(source.load(), target.load(), source.T_world_camera, target.T_world_camera))
        except AdaGMMError:
            continue  # the frame says so when it is asked for
    return pairs
