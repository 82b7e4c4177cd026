"""The one orientation of all clouds and meshes that are written: x right, y up, z backward, as glTF has it.

Inside, and in every pose, it is the camera's: x right, y down, z forward. Half a turn about x leads from one to the
other, and back.
"""

import numpy as np

HALF_TURN_ABOUT_X = np.array((1.0, -1.0, -1.0))


def upright(vectors: np.ndarray) -> np.ndarray:
    """(N, 3) points or normals of a camera's frame as they are written; the same turns them back."""
    return np.asarray(vectors) * HALF_TURN_ABOUT_X
