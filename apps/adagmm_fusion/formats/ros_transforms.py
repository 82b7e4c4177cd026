"""The transforms of a ROS bag that do not change: which frame is where in which.

Old bags have them in /tf among those of what moves, published again and again.
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.frames.rgbd import checked_rigid_transformation
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

MAX_FRAMES = 10_000
# What differs by less from one message to the next stands still: rounding, nothing that a rig could move by.
STILL = 1e-6


class StaticTransforms:
    """A tree of frames, made of tf2_msgs/TFMessage; the last word about a frame counts."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}
        self._repeated: dict[str, tuple[str, np.ndarray]] = {}
        self._moving: set[str] = set()

    def add(self, message: Any) -> None:
        """Take a message of /tf_static in. Raises InputError for a transformation that is not rigid."""
        self._parents |= _transforms(message)

    def add_repeated(self, message: Any) -> None:
        """Take a message of /tf in: of its frames those count, from `settle` on, that never move."""
        for name, (parent, T) in _transforms(message).items():
            first_parent, first = self._repeated.setdefault(name, (parent, T))
            if parent != first_parent or not np.allclose(T, first, rtol=0.0, atol=STILL):
                self._moving.add(name)

    def settle(self) -> None:
        """All messages are in. What /tf_static says of a frame comes first."""
        still = {name: known for name, known in self._repeated.items() if name not in self._moving}
        self._parents = still | self._parents

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


def _transforms(message: Any) -> dict[str, tuple[str, np.ndarray]]:
    """Of each child frame its parent and T_parent_child (4, 4)."""
    found = {}
    for stamped in message.transforms[:MAX_FRAMES]:
        q, t = stamped.transform.rotation, stamped.transform.translation
        T = np.eye(4)
        try:
            T[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
        except ValueError as problem:
            raise InputError(f"{stamped.child_frame_id}: expected a rotation: {problem}") from problem
        T[:3, 3] = t.x, t.y, t.z
        name = plain_frame(stamped.child_frame_id)
        found[name] = plain_frame(stamped.header.frame_id), checked_rigid_transformation(T, name)
    return found


def plain_frame(name: str) -> str:
    """ROS 1 lets a frame's name begin with a slash."""
    return name.lstrip("/")
