"""Where the 3D views look from: an eye for each pair, so that a source that flew off is in the picture as well.

An eye is a pinhole that the views track; it is drawn nowhere.
"""

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log.cameras import transform_archetype
from adagmm_fusion.rerun_log.when import When

FIELD_OF_VIEW = np.radians(50.0)
# Width by height of the views that an eye has to suit: of most, and of narrow ones side by side.
ASPECT, NARROW = 1.15, 1.0
# Above, to the right and behind the target's camera, which looks along z.
DIRECTION = np.array((0.4, -0.6, -1.0)) / np.linalg.norm((0.4, -0.6, -1.0))
# Of each cloud so much is in the picture, on each side of the middle: a few points far away would make the rest small.
SHOWN_PERCENT = (2.0, 98.0)
MARGIN = 0.85
LEAST_DISTANCE_M = 0.1


def log_eye(
    rec: rr.RecordingStream, entity: str, clouds: list[np.ndarray], when: When, *, aspect: float = ASPECT
) -> None:
    """Log an eye that sees clouds (n, 3) [m] of the target's frame."""
    when.log(rec, entity, transform_archetype(eye_pose(clouds, aspect)))
    unseen = {"color": (0, 0, 0, 0), "line_width": 0.0, "image_plane_distance": 1e-6}
    camera = rr.Pinhole(fov_y=FIELD_OF_VIEW, aspect_ratio=aspect, camera_xyz=rr.ViewCoordinates.RDF, **unseen)
    when.log(rec, entity, camera)


def eye_pose(clouds: list[np.ndarray], aspect: float = ASPECT) -> np.ndarray:
    """(4, 4) T_world_eye, x right, y down, z forward, from where the clouds (n, 3) fill the picture."""
    forward = -DIRECTION
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    kept = []
    for cloud in clouds:
        low, high = np.percentile(cloud, SHOWN_PERCENT, axis=0)
        kept.append(cloud[((cloud >= low) & (cloud <= high)).all(axis=1)] if len(cloud) > 20 else cloud)
    points = np.concatenate(kept) @ T[:3, :3]
    # Both sides of the picture touch the points, or its top and its bottom, whichever needs the eye farther back.
    z = points[:, 2]
    slope = np.tan(0.5 * FIELD_OF_VIEW) * MARGIN * np.array((aspect, 1.0))
    above, below = ((side * points[:, :2] - slope * z[:, None]).max(axis=0) for side in (1.0, -1.0))
    back = float(np.max(0.5 * (above + below) / slope))
    T[:3, 3] = T[:3, :3] @ (*(0.5 * (above - below)), min(-back, z.min() - LEAST_DISTANCE_M))
    return T
