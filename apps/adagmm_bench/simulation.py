"""The paper's simulation protocol (Pu, Li and Fisher, Section 4.1, Tables 1 and 3): four sweeps, 282 trials, in 2D
and in 3D.

A trial takes one model, centred and scaled to unit RMS radius, and makes two clouds from it. Each cloud on its own
loses a patch (occlusion: the points nearest to a random one), is sampled (0.90 of the target, 0.85 of the source),
gets anisotropic Gaussian noise, then outliers. The source is moved by a random rotation and translation last.

What a method is told about the noise: per point and axis the standard deviation is s = |level · N(0, 1)| radii, the
covariance diag(exp(3.4657 · s)) along the axes on which the noise was drawn, so it turns with the source. Outliers
have covariance 1e6 · I.

One of rotation, noise, outliers and occlusion is swept; the other three are uniform in `FACTOR_RANGES`. In the 3D
rotation sweep each axis turns by 0 or by the swept angle, at random. Every trial has a generator of its own, so any
one can be made alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from adagmm_bench.problem import Cloud, Problem
from adagmm_o3d.errors import InputError

SAMPLING = {"target": 0.90, "source": 0.85}
COVARIANCE_EXPONENT = 3.4657  # the variance factor doubles with every 0.2 radii of noise
OUTLIER_COVARIANCE = 1e6
TRANSLATION_LIMIT = 0.5  # radii, per axis, either sign
REPETITIONS = 6

SWEEPS: Mapping[str, tuple[float, ...]] = {
    "rotation": tuple(float(angle_deg) for angle_deg in range(-60, 61, 8)),
    "noise": tuple(round(0.01 + 0.06 * i, 2) for i in range(10)),
    "outliers": tuple(round(0.10 + 0.20 * i, 2) for i in range(10)),
    "occlusion": tuple(round(0.03 * i, 2) for i in range(11)),
}


@dataclass(frozen=True)
class FactorRanges:
    """Ends of the uniform ranges of the factors that are not swept (rotation about each axis: either sign)."""

    noise: float  # radii
    rotation_deg: float = 15.0
    outliers: float = 0.50  # of the model's number of points
    occlusion: float = 0.05  # of the model's points


FACTOR_RANGES = {2: FactorRanges(noise=0.05), 3: FactorRanges(noise=0.01)}


@dataclass(frozen=True)
class TrialId:
    """What names and seeds a trial. `rotation_range_deg` replaces the 15 degrees of the sweeps other than rotation."""

    dimension: int
    sweep: str
    setting: float
    trial: int
    seed: int = 0
    rotation_range_deg: float | None = None

    def __post_init__(self) -> None:
        if self.dimension not in FACTOR_RANGES:
            raise InputError(f"dimension: expected 2 or 3, got {self.dimension}")
        if self.sweep not in SWEEPS:
            raise InputError(f"sweep: expected one of {', '.join(SWEEPS)}, got {self.sweep!r}")
        if self.setting not in SWEEPS[self.sweep]:
            wanted = ", ".join(f"{value:g}" for value in SWEEPS[self.sweep])
            raise InputError(f"setting: expected one of {wanted} for the {self.sweep} sweep, got {self.setting:g}")
        for name in ("trial", "seed"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: expected 0 or more, got {getattr(self, name)}")
        if self.rotation_range_deg is not None and not 0.0 <= self.rotation_range_deg <= 180.0:
            raise InputError(f"rotation_range_deg: expected 0 to 180, got {self.rotation_range_deg:g}")

    def __str__(self) -> str:
        spread = "" if self.rotation_range_deg is None else f" within {self.rotation_range_deg:g} deg"
        return f"{self.dimension}D {self.sweep} {self.setting:g} #{self.trial} seed {self.seed}{spread}"

    def generator(self) -> np.random.Generator:
        sweep_index = list(SWEEPS).index(self.sweep)
        setting_index = SWEEPS[self.sweep].index(self.setting)
        return np.random.default_rng([self.seed, self.dimension, sweep_index, setting_index, self.trial])

    def as_dict(self) -> dict:
        return asdict(self)


def trial_ids(
    dimension: int,
    *,
    sweeps: tuple[str, ...] = tuple(SWEEPS),
    repetitions: int = REPETITIONS,
    seed: int = 0,
    rotation_range_deg: float | None = None,
) -> Iterator[TrialId]:
    """Every trial of the chosen sweeps in order; all four sweeps of six repetitions make 282."""
    for sweep in sweeps:
        for setting in SWEEPS.get(sweep, (0.0,)):  # an unknown sweep is named by TrialId's own check
            for trial in range(repetitions):
                yield TrialId(dimension, sweep, setting, trial, seed, rotation_range_deg)


def simulate(trial_id: TrialId, models: Mapping[str, np.ndarray]) -> Problem:
    """The two clouds of one trial, lengths in RMS radii of its model; `models` maps names to (n, D) points."""
    rng = trial_id.generator()
    dimension = trial_id.dimension
    names = list(models)
    name = names[rng.integers(len(names))]
    factors, angles_deg = _draw_factors(trial_id, rng)
    if trial_id.sweep != "rotation" and dimension == 3 and (trial_id.rotation_range_deg or 0.0) >= 180.0:
        rotation = random_rotation(rng)
    else:
        rotation = rotation_matrix(angles_deg)
    translation = rng.uniform(-TRANSLATION_LIMIT, TRANSLATION_LIMIT, dimension)

    model = unit_radius(models[name])
    target = degrade(model, rng, sampling=SAMPLING["target"], **factors)
    source = degrade(model, rng, sampling=SAMPLING["source"], **factors)
    T_target_source = np.eye(dimension + 1)
    T_target_source[:dimension, :dimension] = rotation.T
    T_target_source[:dimension, dimension] = -rotation.T @ translation
    moved = Cloud(source.points @ rotation.T + translation, rotation @ source.covariances @ rotation.T)
    return Problem(f"{trial_id} ({name})", source=moved, target=target, T_target_source=T_target_source)


def _draw_factors(trial_id: TrialId, rng: np.random.Generator) -> tuple[dict[str, float], np.ndarray]:
    """Levels of noise, outliers and occlusion, and the angle about each axis; the swept one at its setting."""
    ranges = FACTOR_RANGES[trial_id.dimension]
    axes = 1 if trial_id.dimension == 2 else 3
    limit_deg = ranges.rotation_deg if trial_id.rotation_range_deg is None else trial_id.rotation_range_deg
    angles_deg = rng.uniform(-limit_deg, limit_deg, axes)
    factors = {
        "noise": rng.uniform(0.0, ranges.noise),
        "outliers": rng.uniform(0.0, ranges.outliers),
        "occlusion": rng.uniform(0.0, ranges.occlusion),
    }
    if trial_id.sweep == "rotation":
        turned = rng.integers(0, 2, axes) if axes == 3 else np.ones(1)
        return factors, trial_id.setting * turned
    return factors | {trial_id.sweep: trial_id.setting}, angles_deg


def degrade(
    model: np.ndarray, rng: np.random.Generator, *, sampling: float, noise: float, outliers: float, occlusion: float
) -> Cloud:
    """One sensor's view of a unit-radius model (n, D): occluded, sampled, noisy, with outliers appended last."""
    n, dimension = model.shape
    seen = model
    if removed := round(occlusion * n):
        patch_centre = model[rng.integers(n)]
        nearest_first = np.argsort(np.sum((model - patch_centre) ** 2, axis=1), kind="stable")
        seen = model[np.sort(nearest_first[removed:])]
    clean = seen[np.sort(rng.permutation(len(seen))[: round(sampling * len(seen))])]

    deviation = np.abs(noise * rng.standard_normal(clean.shape))
    points = clean + deviation * rng.standard_normal(clean.shape)
    covariances = np.exp(COVARIANCE_EXPONENT * deviation)[:, :, None] * np.eye(dimension)

    count = round(outliers * n)
    strays = clean.mean(axis=0) + rng.standard_normal((count, dimension))
    stray_covariances = np.broadcast_to(OUTLIER_COVARIANCE * np.eye(dimension), (count, dimension, dimension))
    return Cloud(np.concatenate([points, strays]), np.concatenate([covariances, stray_covariances]))


def unit_radius(points: np.ndarray) -> np.ndarray:
    """(n, D) moved to zero mean and scaled to unit RMS radius."""
    centred = np.asarray(points, dtype=float) - np.mean(points, axis=0, dtype=float)
    return centred / np.sqrt(np.mean(np.sum(centred**2, axis=1)))


def rotation_matrix(angles_deg: np.ndarray) -> np.ndarray:
    """(1,) -> (2, 2); (3,) angles about x, y, z -> (3, 3), Rz Ry Rx."""
    angles = np.radians(angles_deg)
    cos, sin = np.cos(angles), np.sin(angles)
    if len(angles) == 1:
        return np.array([[cos[0], -sin[0]], [sin[0], cos[0]]])
    Rx = np.array([[1, 0, 0], [0, cos[0], -sin[0]], [0, sin[0], cos[0]]])
    Ry = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    Rz = np.array([[cos[2], -sin[2], 0], [sin[2], cos[2], 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """(3, 3), uniform over SO(3): a normalised Gaussian quaternion."""
    quaternion = rng.standard_normal(4)
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
