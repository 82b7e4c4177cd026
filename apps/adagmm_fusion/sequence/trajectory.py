"""An estimated trajectory as a file, and beside the true one."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.recordings.frame_sequence import Recording


def save_trajectory(path: Path, recording: Recording, poses: dict[int, np.ndarray]) -> None:
    """Write TUM's format, which evo reads: "timestamp tx ty tz qx qy qz qw", T_world_camera [m] of one sensor's frames;
    without timestamps the frame's number stands for it. Raises OutputError if it cannot be written."""
    lines = ["# timestamp tx ty tz qx qy qz qw, camera to world, metres"]
    timed = all(recording.entries[index].timestamp is not None for index in poses)
    for index in sorted(poses):
        stamp = f"{recording.entries[index].timestamp:.6f}" if timed else str(index)
        numbers = (*poses[index][:3, 3], *Rotation.from_matrix(poses[index][:3, :3]).as_quat())
        lines.append(" ".join([stamp, *(f"{x:.9f}" for x in numbers)]))
    write_text(path, "\n".join(lines) + "\n")


def true_and_estimated(recording: Recording, poses: dict[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4, 4) twice: T_world_camera of the frames that have both poses, in order."""
    both = [i for i in sorted(poses) if recording.entries[i].T_world_camera is not None]
    true = [recording.entries[i].T_world_camera for i in both]
    return np.reshape(true, (-1, 4, 4)), np.reshape([poses[i] for i in both], (-1, 4, 4))
