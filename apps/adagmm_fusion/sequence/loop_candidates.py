"""Frames that may show one place though they do not follow each other: near by pose, or alike by their features."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from scipy.cluster.vq import kmeans2, vq

from adagmm_fusion.pairs.feature_start import color_features
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.errors import AdaGMMError

# A long recording is cut into this many segments. Gaps are counted in segments, and two segments need one loop only.
# In a shorter recording each moment is a segment.
SEGMENTS = 200
# Two frames are near if they differ by less than this; of each frame the nearest are taken, if at least so many
# segments lie between.
NEAR_ROTATION_DEG, NEAR_TRANSLATION_M, NEAR_PER_FRAME = 25.0, 0.5, 2
NEAR_MIN_GAP = 3
# Of each frame this many of the most alike are taken, with at least so many segments between.
ALIKE_PER_FRAME, ALIKE_MIN_GAP = 6, 2
# Pairs of frames that are looked at to join parts, at most.
EVENLY = 1000
# The vocabulary: its words, the features taken of a frame, and the frames along the recording that they come from.
WORDS, FEATURES_PER_FRAME, VOCABULARY_FRAMES = 48, 400, 64


def segment_length(moments: Iterable[int]) -> int:
    """How many moments make a segment."""
    return 1 + len(set(moments)) // SEGMENTS


def near_frames(
    poses: dict[int, np.ndarray], moments: dict[int, int], sensors: dict[int, str]
) -> Iterator[tuple[int, int]]:
    """(source, target) of frames near each other by their poses T_world_camera; between sensors at any other moment."""
    frames = sorted(poses)
    T = np.array([poses[frame] for frame in frames])
    moment = np.array([moments[frame] for frame in frames])
    sensor = np.array([sensors[frame] for frame in frames])
    length = segment_length(moments.values())
    for i, source in enumerate(frames):
        cosines = (np.einsum("nab,ab->n", T[:i, :3, :3], T[i, :3, :3]) - 1.0) / 2.0
        rotation = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
        translation = np.linalg.norm(T[:i, :3, 3] - T[i, :3, 3], axis=1)
        far_along = np.abs(moment[:i] - moment[i]) >= np.where(sensor[:i] == sensor[i], NEAR_MIN_GAP * length, 1)
        near = np.flatnonzero(far_along & (rotation <= NEAR_ROTATION_DEG) & (translation <= NEAR_TRANSLATION_M))
        distance = rotation[near] / NEAR_ROTATION_DEG + translation[near] / NEAR_TRANSLATION_M
        nearest_first = near[np.argsort(distance, kind="stable")]
        yield from ((source, frames[k]) for k in _apart(nearest_first, moment, length, NEAR_PER_FRAME))


def alike_frames(
    recording: Recording, frames: tuple[int, ...], moments: dict[int, int], progress: Callable[[int, int], None]
) -> list[tuple[int, int]]:
    """(source, target), the later frame first, of frames whose colour images have like features.

    Each image becomes one vector of how its features differ from the words of a vocabulary of the recording's own
    (VLAD); images are compared by these, so what is kept of a frame is small, and every frame is read twice at most.

    Source
    ------
    H. Jegou, M. Douze, C. Schmid, P. Perez, Aggregating local descriptors into a compact image representation, CVPR
    2010; R. Arandjelovic, A. Zisserman, Three things everyone should know to improve object retrieval, CVPR 2012.
    """
    sample = np.array(frames)[np.unique(np.linspace(0, len(frames) - 1, VOCABULARY_FRAMES).astype(int))]
    known = np.concatenate([_descriptors(recording, int(frame)) for frame in sample])
    if len(known) < 10 * WORDS:
        return []
    words = kmeans2(known, WORDS, minit="++", seed=0)[0]
    vectors = np.zeros((len(frames), words.size), np.float32)
    for i, frame in enumerate(frames):
        progress(i, len(frames))
        vectors[i] = _vlad(_descriptors(recording, frame), words)
    moment, length = np.array([moments[frame] for frame in frames]), segment_length(moments.values())
    chosen: dict[tuple[int, int], None] = {}
    for i in range(len(frames)):
        likeness = vectors @ vectors[i]
        likeness[np.abs(moment - moment[i]) < ALIKE_MIN_GAP * length] = 0.0
        likest_first = [k for k in np.argsort(-likeness, kind="stable") if likeness[k] > 0]
        for k in _apart(likest_first, moment, length, ALIKE_PER_FRAME):
            chosen[frames[max(i, k)], frames[min(i, k)]] = None
    return sorted(chosen)


def evenly(frames: tuple[int, ...], moments: dict[int, int]) -> list[tuple[int, int]]:
    """(source, target), the later frame first, of any two frames at different moments, the nearest in time first; of
    more than EVENLY so many, evenly."""
    order = sorted(frames, key=lambda frame: (moments[frame], frame))
    count, total = len(order), len(order) * (len(order) - 1) // 2
    places = np.unique(np.linspace(0, total - 1, min(total, EVENLY)).astype(np.int64))
    # Pairs are numbered by gap: count - 1 of the first, count - 2 of the second, and so on.
    begins = np.concatenate([[0], np.cumsum(np.arange(count - 1, 0, -1))])
    gaps = np.searchsorted(begins, places, side="right")
    firsts = places - begins[gaps - 1]
    pairs = [(order[first + gap], order[first]) for first, gap in zip(firsts, gaps, strict=True)]
    return [pair for pair in pairs if moments[pair[0]] != moments[pair[1]]]


def thinned(pairs: Iterable[tuple[int, int]], moments: dict[int, int]) -> list[tuple[int, int]]:
    """Of the pairs between two segments of a long recording the first: loops side by side say much the same."""
    length = segment_length(moments.values())
    if length == 1:
        return list(pairs)
    first: dict[tuple[int, int], tuple[int, int]] = {}
    for source, target in pairs:
        first.setdefault((moments[source] // length, moments[target] // length), (source, target))
    return list(first.values())


def _apart(best_first: Iterable[int], moment: np.ndarray, length: int, count: int) -> list[int]:
    """The first `count` that are not of one segment."""
    chosen: list[int] = []
    for k in best_first:
        if length == 1 or all(abs(moment[k] - moment[other]) >= length for other in chosen):
            chosen.append(int(k))
            if len(chosen) == count:
                break
    return chosen


def _descriptors(recording: Recording, frame: int) -> np.ndarray:
    """(n, 128) float32 root-SIFT of a frame's strongest features; none of one that cannot be read."""
    try:
        descriptors = color_features(recording.entries[frame].load(), FEATURES_PER_FRAME)[1]
    except AdaGMMError:
        descriptors = None
    if descriptors is None:
        return np.zeros((0, 128), np.float32)
    return np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))


def _vlad(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    """(words * 128,) of unit length; zero without features."""
    vector = np.zeros_like(words)
    if len(descriptors):
        word = vq(descriptors, words)[0]
        np.add.at(vector, word, descriptors - words[word])
    vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-12)  # a frequent word counts no more
    return (vector / max(np.linalg.norm(vector), 1e-12)).ravel()
