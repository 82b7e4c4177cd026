"""The recording formats, one file each.

A format is a module with `NAME` (what --format takes), `SUMMARY` (one line), `matches(path) -> bool` (cheap, looks
at names only) and `read(path, options) -> Recording` (strict; images are loaded later). It is listed in FORMATS, and
that is all.
"""

from adagmm_fusion.formats import apc, folder, own, pose_file, redwood, ros_bag, seven_scenes, tum, video, xtion

FORMATS = {
    module.NAME: module for module in (own, tum, redwood, seven_scenes, pose_file, apc, xtion, video, ros_bag, folder)
}
# What takes any folder is asked only where no other format knows it.
FALLBACK = folder.NAME
