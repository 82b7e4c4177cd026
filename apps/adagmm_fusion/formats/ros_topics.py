"""Which topics of a ROS bag are one camera's colour and depth, by their names."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# Where a camera's own name ends: /camera | /aligned_depth_to_color/image_raw.
PART_OF_CAMERA = re.compile(r"depth|colou?r|rgb|aligned|image|^(hd|qhd|sd|stereo|ir|infra\d?)$", re.IGNORECASE)
NO_IMAGE = re.compile(r"infra|/ir/|mask|confidence|theora|disparity|[^/]/right/|mono", re.IGNORECASE)
# The better ones first: registered to the colour image, then the sensor's own.
DEPTHS = ("aligned_depth_to_color", "depth_to_rgb", "depth_registered", "image_depth", "registered", "depth")
COLORS = ("image_raw", "image_color", "color", "rgb", "image")
TRANSPORTS = ("/compressedDepth", "/compressed")


@dataclass(frozen=True)
class CameraTopics:
    """One camera: its name, the topics of its images, and of their camera_info."""

    name: str
    color: str
    depth: str

    @property
    def color_info(self) -> str:
        return info_topic(self.color)

    @property
    def depth_info(self) -> str:
        return info_topic(self.depth)


def info_topic(topic: str) -> str:
    """The camera_info beside an image topic, whatever its transport."""
    return f"{raw_topic(topic).rpartition('/')[0]}/camera_info"


def raw_topic(topic: str) -> str:
    """A topic without the transport at its end."""
    for transport in TRANSPORTS:
        topic = topic.removesuffix(transport)
    return topic


def find_cameras(topics: Iterable[tuple[str, str]]) -> list[CameraTopics]:
    """The cameras that have both images, by name, of (topic, message type)."""
    cameras: dict[str, list[str]] = {}
    for topic, kind in topics:
        if kind in IMAGE_TYPES and not NO_IMAGE.search(topic) and topic.startswith("/"):
            cameras.setdefault(_camera_of(topic), []).append(topic)
    found = []
    for name, listed in sorted(cameras.items()):
        depths = [topic for topic in listed if "depth" in topic.lower()]
        colors = [topic for topic in listed if "depth" not in topic.lower()]
        if depths and colors:
            found.append(CameraTopics(name, min(colors, key=_color_rank), min(depths, key=_depth_rank)))
    return found


def _camera_of(topic: str) -> str:
    parts = topic.strip("/").split("/")
    kept = []
    for part in parts[:-1]:
        if PART_OF_CAMERA.search(part):
            break
        kept.append(part)
    return "_".join(kept) or "camera"


def _depth_rank(topic: str) -> tuple[int, bool, int]:
    name = topic.lower()
    rank = next((i for i, word in enumerate(DEPTHS) if word in name), len(DEPTHS))
    # Without loss before JPEG, which is none for depth.
    return rank, topic.endswith("/compressed"), len(topic)


def _color_rank(topic: str) -> tuple[bool, int, int]:
    name = topic.lower()
    rank = next((i for i, word in enumerate(COLORS) if word in name), len(COLORS))
    return topic != raw_topic(topic), rank, len(topic)
