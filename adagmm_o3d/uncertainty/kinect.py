"""The paper's Kinect model, Eq. 6: uncertainty grows with depth and with the angle of incidence."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, real_number
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.uncertainty.viewing import depth_and_incidence


@dataclass(frozen=True)
class KinectUncertainty:
    """U(α, d) = exp(w1 (1 − cos α) + w2 d), 1 for a point at the camera seen head-on.

    Parameters
    ----------
    w1 : weight of the angle, ≥ 0, unitless.
    w2 : weight of the depth, ≥ 0 [1/m].

    Raises
    ------
    InputTypeError, InputError  if a weight is not a finite number ≥ 0.

    Source
    ------
    Pu, Li, Fisher, Robust Rigid Point Registration based on Convolution of Adaptive GMMs, Eq. 6. The defaults are the
    constants it prints. They belong to U(π/3, 0) = U(0, 3) = 2.3; for the 2.2 that its text gives beside them, take
    `KinectUncertainty.from_reference(2.2)`.
    """

    w1: float = 1.6658
    w2: float = 0.2776

    def __post_init__(self) -> None:
        for name in ("w1", "w2"):
            object.__setattr__(self, name, real_number(name, getattr(self, name), minimum=0.0))

    @classmethod
    def from_reference(cls, reference: float) -> Self:
        """The model with U(π/3, 0) = U(0, 3 m) = reference.

        Parameters
        ----------
        reference : the uncertainty of a point at 60° or at 3 m, ≥ 1; the paper reports that [1, 10] works well.

        Returns
        -------
        KinectUncertainty with w1 = 2 ln(reference), w2 = ln(reference) / 3.

        Raises
        ------
        InputTypeError, InputError  if it is not a finite number ≥ 1.
        """
        logarithm = math.log(real_number("reference", reference, minimum=1.0))
        return cls(w1=2.0 * logarithm, w2=logarithm / 3.0)

    def uncertainty(self, cos_angle: ArrayLike, depth: ArrayLike) -> Array:
        """U of Eq. 6, elementwise.

        Parameters
        ----------
        cos_angle : cosine of the angle between normal and ray to the camera, in [0, 1].
        depth : [m], broadcast against it.

        Returns
        -------
        float64 array of the common shape, ≥ 1.
        """
        return np.exp(self.w1 * (1.0 - np.asarray(cos_angle, float)) + self.w2 * np.asarray(depth, float))


PAPER = KinectUncertainty()
"""The constants printed in the paper."""

LARGEST_EXPONENT = 200.0
"""Up to here [unitless] U, and its cube in a determinant, stay finite in float64."""


def estimate_kinect_covariances(points: ArrayLike, normals: ArrayLike, *, model: KinectUncertainty = PAPER) -> Array:
    """Covariance of each Kinect point: isotropic, growing with depth and angle of incidence.

    Parameters
    ----------
    points : (N, 3) [m], camera frame (x right, y down, z forward).
    normals : (N, 3), any non-zero length and either sign: the angle uses |cos|.
    model : the two weights of Eq. 6.

    Returns
    -------
    (N, 3, 3) float64, U · I: relative and unitless, for a registration that finds the scale σ itself.

    Raises
    ------
    InputTypeError  if an argument is not an array of real numbers, or `model` not a KinectUncertainty.
    InputError      if shapes disagree, a number is not finite, a normal has length 0, a point is not in front of the
                    camera or more than 100 m from it (millimetres in place of metres), or U would overflow.

    Source
    ------
    Pu, Li, Fisher, Robust Rigid Point Registration based on Convolution of Adaptive GMMs, Section 4.2, Eq. 6.
    """
    if not isinstance(model, KinectUncertainty):
        raise InputTypeError(f"model: expected a KinectUncertainty, got {type(model).__name__}")
    _, depth, cosine = depth_and_incidence(points, normals)
    exponent = model.w1 + model.w2 * depth.max(initial=0.0)
    if exponent > LARGEST_EXPONENT:
        raise InputError(f"model: expected w1 + w2 z up to {LARGEST_EXPONENT:g}, got {exponent:g}; use smaller weights")
    return model.uncertainty(cosine, depth)[:, None, None] * np.eye(3)
