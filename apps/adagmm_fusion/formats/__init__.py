"""The recording formats, one file each.

A format is a module with `NAME` (what --format takes), `SUMMARY` (one line), `matches(path) -> bool` (cheap, looks
at names only) and `read(path, options) -> Recording` (strict; images are loaded later). It is listed in FORMATS, and
that is all.
"""

from adagmm_fusion.formats import (
    apc,
    bop,
    folder,
    icl_nuim,
    nerfstudio,
    own,
    polycam,
    pose_file,
    record3d,
    redwood,
    replica,
    ros_bag,
    scanner_app,
    scannet,
    scannet_sens,
    seven_scenes,
    stray_scanner,
    tum,
    video,
    xtion,
)

_RGBD_SETS = (
    tum, redwood, seven_scenes, pose_file, apc, xtion,
    scannet, scannet_sens, icl_nuim, bop, replica, nerfstudio,
)  # fmt: skip
_PHONES = (stray_scanner, polycam, scanner_app, record3d)
FORMATS = {module.NAME: module for module in (own, *_RGBD_SETS, *_PHONES, video, ros_bag, folder)}
# What takes any folder is asked only where no other format knows it.
FALLBACK = folder.NAME
