"""What a frame is, in a few digits: two frames with the same ones are registered to the same pose."""

import hashlib

import numpy as np

from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.recordings.frame_sequence import FrameEntry
from adagmm_o3d.errors import AdaGMMError


def entry_digest(entry: FrameEntry) -> str:
    """As frame_digest, of a frame that is loaded for it; of one that cannot be, a digest of why."""
    try:
        return frame_digest(entry.load())
    except AdaGMMError as problem:
        return _digits(hashlib.sha256(str(problem).encode(errors="surrogateescape")))


def frame_digest(frame: RGBDFrame) -> str:
    """Twelve digits that change with the images' pixels, the intrinsics and the depth scale."""
    digest = hashlib.sha256(repr((frame.intrinsics, frame.depth_scale)).encode())
    for image in (frame.color, frame.depth):
        digest.update(f"{image.shape} {image.dtype.str}".encode())
        digest.update(np.ascontiguousarray(image).data)
    return _digits(digest)


def pair_digest(pair: RGBDPair) -> str:
    """Twelve digits that change with both frames and the true pose between them."""
    digest = hashlib.sha256((frame_digest(pair.source) + frame_digest(pair.target)).encode())
    if pair.T_target_source is not None:
        digest.update(np.ascontiguousarray(pair.T_target_source, np.float64).data)
    return _digits(digest)


def _digits(digest: "hashlib._Hash") -> str:
    return digest.hexdigest()[:12]
