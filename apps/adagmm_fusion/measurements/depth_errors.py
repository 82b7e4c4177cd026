"""What all depths of a camera share: they are too long or too short by a share, and by a length.

Pixels and frames do not average it out, so it is most of what a pose between two depth cameras is off by. The pose is
found as if there were none, and its covariance is widened by what such errors do to it (the consider parameters of a
Schmidt filter). How large they are is not asked of the clouds: what both cameras have alike these cannot tell, and
surfaces that hide each other feign some.

Source
------
S. F. Schmidt: Application of state-space methods to navigation problems, 1966.
"""

import numpy as np

# Of the source's depth its scale and its shift, of the target's the same.
DEPTH_ERRORS = 4
# Standard deviations of a camera's scale and of its shift [m]: uncalibrated Kinects are off by so much, and what makers
# of later cameras promise is of that order.
SCALE, SHIFT_M = 0.01, 0.005


def by_depth(moved: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """(n, 3, 2) derivatives of points by the scale and the shift of the depth that they were measured by.

    moved : (n, 3) from the camera to the point, in any frame [m].   depths : (n,) [m].
    """
    return np.stack([moved, moved / depths[:, None]], axis=2)


def pose_effects(inverse: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """(6, 4) what one standard deviation of each error does to a pose of least squares.

    δ = (ω, v) in exp(δ)·T [rad, m]. The sum over their products E Eᵀ is what they add to the pose's covariance.

    inverse : (6, 6) of the sum's hessian by the pose, zero along what is left free.   cross : (6, 4) derivatives of the
    sum by the pose and the depths' errors.
    """
    return inverse @ cross * np.array([SCALE, SHIFT_M, SCALE, SHIFT_M])
