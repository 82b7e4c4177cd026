"""Points known to be wrong keep their place and lose their say."""

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, bool_array, float_array, real_number
from adagmm_o3d.errors import InputError


def mark_outliers(covariances: ArrayLike, mask: ArrayLike, *, scale: float = 1e6) -> Array:
    """The covariances with those of outliers enlarged: nothing is deleted, so points and indices stay as they are.

    Parameters
    ----------
    covariances : (N, D, D), D = 2 or 3; not changed. Non-finite entries pass through.
    mask : (N,) bool, True for outliers.
    scale : factor on an outlier's covariance, ≥ 1.

    Returns
    -------
    (N, D, D) float64, a new array.

    Raises
    ------
    InputTypeError  if the covariances are not real numbers, the mask is not boolean or the scale is not a number.
    InputError      if shapes disagree or the scale is not finite and ≥ 1.

    Source
    ------
    Pu, Li, Fisher, Robust Rigid Point Registration based on Convolution of Adaptive GMMs, Section 4.1: "very big"
    covariances for outliers; their data has 1e6.
    """
    c = float_array("covariances", covariances, ("N", (2, 3), (2, 3)), finite=False)
    if c.shape[1] != c.shape[2]:
        raise InputError(f"covariances: expected (N, 2, 2) or (N, 3, 3), got {c.shape}")
    outlier = bool_array("mask", mask, (len(c),))
    factor = np.where(outlier, real_number("scale", scale, minimum=1.0), 1.0)
    return c * factor[:, None, None]
