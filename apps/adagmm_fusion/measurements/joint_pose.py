"""The pose that surfaces and features agree on: one estimate from all that two frames measure."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.measurements.depth_errors import DEPTH_ERRORS, pose_effects
from adagmm_fusion.measurements.features import FeatureMeasurements
from adagmm_fusion.measurements.residuals import NormalEquations
from adagmm_fusion.measurements.surfaces import SurfaceMeasurements
from adagmm_o3d.lie import hat, se_exp
from adagmm_o3d.result import PoseUncertainty

# Pixels of either image that are looked at on the way, and at the end, and iterations at most.
SOME, MANY = 3_000, 20_000
SOME_STEPS, MANY_STEPS = 12, 30
# A pose has settled when a step is below this [rad, m].
SETTLED = 1e-5
# A direction is free when its standard deviation is this share of the radius of what is seen.
FREE_DEVIATION = 0.05
# A curvature below this share of the largest holds nothing, and gets no step.
SOFT = 1e-9


@dataclass(frozen=True, eq=False)
class Measurements:
    """All that a pair measures; features is None where the images have no matches with depth."""

    surfaces: SurfaceMeasurements
    features: FeatureMeasurements | None

    def equations(self, T_target_source: np.ndarray, most: int) -> list[NormalEquations]:
        """The normal equations of each kind of measurement that says something at this pose."""
        kinds = (self.surfaces, self.features)
        found = [kind.equations(T_target_source, most) for kind in kinds if kind is not None]
        return [equations for equations in found if equations is not None]

    def known(self, T_target_source: np.ndarray) -> "JointPose":
        """A pose, and what they hold of it."""
        return _known(T_target_source, self.equations(T_target_source, SOME))

    def scale(self, T_target_source: np.ndarray) -> float:
        """Variance of the surfaces' residuals at a pose, over what was said of it; infinite where they do not meet."""
        found = self.surfaces.equations(T_target_source, SOME)
        return np.inf if found is None else found.scale

    def evidence(self, T_target_source: np.ndarray, scale: float) -> tuple[float, float]:
        """Log-likelihood ratio of a pose against none [nats] by surfaces, whose `scale` that is, and by features."""
        by_features = 0.0 if self.features is None else self.features.evidence(T_target_source)
        return self.surfaces.evidence(T_target_source, scale, SOME), by_features

    def agreeing(self, T_target_source: np.ndarray) -> int:
        """How many matched features agree with a pose."""
        return 0 if self.features is None else self.features.agreeing(T_target_source)


@dataclass(frozen=True, eq=False)
class JointPose:
    """A pose T_target_source (4, 4) and what is known of it.

    information : (6, 6) of δ = (ω, v) in exp(δ)·T [rad, m]; zero along what no measurement holds.
    depth_pull : (6, 4) how what the depths of a camera share pulls on δ, see `depth_errors`.
    """

    T_target_source: np.ndarray
    information: np.ndarray
    depth_pull: np.ndarray

    def uncertainty(self, points: np.ndarray) -> PoseUncertainty:
        """Covariance and free directions of the pose; points (N, 3) [m], target frame, are what is seen.

        In a direction that nothing holds the standard deviation is one radius of the points. Without `depth_effects`.
        """
        outward, variances, free, directions = self._motions(points)
        return PoseUncertainty((outward * variances) @ outward.T, tuple(directions[:, free].T))

    def depth_effects(self, points: np.ndarray) -> np.ndarray:
        """(6, 4) what the errors that all depths of a camera share do to the pose, see `depth_errors.pose_effects`."""
        outward, variances, free, _ = self._motions(points)
        return pose_effects((outward * np.where(free, 0.0, variances)) @ outward.T, self.depth_pull)

    def _motions(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Independent motions (6, 6), the variance of each (6,), which of them nothing holds (6,), and the same motions
        in turns about the points' centre and shifts in radii (6, 6)."""
        centre = points.mean(axis=0)
        radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
        # From turns about the centre and shifts in radii to turns about the origin and shifts in metres.
        change = np.eye(6)
        change[3:, :3] = hat(centre)
        change[3:, 3:] *= radius
        held, directions = np.linalg.eigh(change.T @ self.information @ change)
        free = held < FREE_DEVIATION**-2
        return change @ directions, np.where(free, 1.0, 1.0 / np.where(free, 1.0, held)), free, directions


def refine(measurements: Measurements, start: np.ndarray, most: int) -> JointPose:
    """The pose nearby that all measurements together make likeliest, by `most` pixels of either image."""
    T = start
    equations: list[NormalEquations] = []
    for _ in range(SOME_STEPS if most <= SOME else MANY_STEPS):
        equations = measurements.equations(T, most)
        step = -_solved(_known(T, equations).information, sum((e.pull for e in equations), np.zeros(6)))
        T = se_exp(step) @ T
        if np.linalg.norm(step) < SETTLED:
            break
    return _known(T, equations)


def _known(T_target_source: np.ndarray, equations: list[NormalEquations]) -> JointPose:
    information = sum((e.information for e in equations), np.zeros((6, 6)))
    return JointPose(T_target_source, information, sum((e.depth_pull for e in equations), np.zeros((6, DEPTH_ERRORS))))


def _solved(information: np.ndarray, pull: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(information)
    firm = values > SOFT * values[-1]
    inverse = np.where(firm, 1.0 / np.where(firm, values, 1.0), 0.0)
    return vectors @ (inverse * (vectors.T @ pull))
