"""The static transforms of a ROS bag: which frame is where in which."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.frames.rgbd import checked_rigid_transformation
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

MAX_FRAMES = 10_000


class StaticTransforms:
    """A tree of frames, made of tf2_msgs/TFMessage; the last word about a frame counts."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}

    def add(self, message: Any) -> None:
        """Take a message in. Raises InputError for a transformation that is not rigid."""
        for stamped in message.transforms[:MAX_FRAMES]:
            q, t = stamped.transform.rotation, stamped.transform.translation
            T = np.eye(4)
            try:
                T[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
            except ValueError as problem:
                raise InputError(f"{stamped.child_frame_id}: expected a rotation: {problem}") from problem
            T[:3, 3] = t.x, t.y, t.z
            name = plain_frame(stamped.child_frame_id)
            self._parents[name] = plain_frame(stamped.header.frame_id), checked_rigid_transformation(T, name)

    def between(self, target: str, source: str) -> np.ndarray | None:
        """T_target_source (4, 4), or None if nothing connects the two."""
        (root, T_root_target), (other, T_other_source) = self._to_root(target), self._to_root(source)
        return se_inverse(T_root_target) @ T_other_source if root == other else None

    def _to_root(self, frame: str) -> tuple[str, np.ndarray]:
        name, T = plain_frame(frame), np.eye(4)
        for _ in range(len(self._parents)):  # a circle has no root
            if name not in self._parents:
                break
            name, T_parent_child = self._parents[name]
            T = T_parent_child @ T
        return name, T


def plain_frame(name: str) -> str:
    """ROS 1 lets a frame's name begin with a slash."""
    return name.lstrip("/")
