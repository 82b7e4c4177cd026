"""A recording format of your own: N.jpg and N.png in one folder, from a sensor whose calibration a rig file has.

    [project.entry-points."adagmm_fusion.formats"]
    numbered = "my_format"

in your package's pyproject.toml is all that makes it known.
"""

from functools import partial

from adagmm_fusion.files.image_files import load_frame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording, sequential_pairs

NAME, SUMMARY, SENSOR = "numbered", "folder with 0.jpg, 0.png, 1.jpg, 1.png, ...", "camera"


def matches(folder):
    return (folder / "0.jpg").is_file() and (folder / "0.png").is_file()


def read(folder, options):
    intrinsics, depth_scale = options.calibration(SENSOR, None, 1000.0, folder)
    images = sorted(folder.glob("*.png"), key=lambda path: int(path.stem))
    load = partial(load_frame, intrinsics=intrinsics, depth_scale=depth_scale)
    frames = [FrameEntry(p.stem, SENSOR, partial(load, p.stem, SENSOR, p.with_suffix(".jpg"), p)) for p in images]
    return Recording(folder.name, folder, NAME, tuple(frames), sequential_pairs(len(frames), options.step))
