"""Generated pairs of kinds that people bring and that mislead, to fit belief on; none is of the table of trust."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adagmm_bench.belief.shapes import body, clutter, nearly_symmetric, part, repeated, room, seen_from
from adagmm_bench.pairs.motions import moved, rigid, turn
from adagmm_bench.pairs.overlap import NEAR_DEG, NEAR_SHIFT, cut
from adagmm_bench.pairs.problem import FOUND_DEG, rms_radius
from adagmm_o3d import lie

POINTS = {2: (80, 400), 3: (800, 3000)}
# Within so many degrees and radii of the truth a pose is right; of sensors that bend what they see, less is known.
FOUND, FOUND_BENT = (FOUND_DEG, 0.1), (8.0, 0.12)
OUTLIER_COVARIANCE = 1e6
# How a start is: within a few degrees, anywhere (and looked for anywhere), or misleading.
HOWS, HOW_OFTEN, WRONG_DEG = ("near", "anywhere", "wrong"), (0.45, 0.35, 0.2), (40.0, 180.0)


@dataclass(frozen=True)
class Pair:
    """source, target : (M, D), (N, D), each with (n, D, D) covariances or None.   T_target_source : (D+1, D+1); None
    where no pose is right.   limits : what is within so many degrees and radii of it is found.   anywhere : whether the
    start may be anywhere."""

    source: np.ndarray
    target: np.ndarray
    T_target_source: np.ndarray | None
    covariances: tuple[np.ndarray, np.ndarray] | None = None
    limits: tuple[float, float] = FOUND
    anywhere: bool = False


@dataclass(frozen=True)
class BeliefPair:
    """A trial of one of KINDS; kind, trial and seed alone say what it is."""

    kind: str
    trial: int
    seed: int

    @property
    def key(self) -> str:
        return f"{self.kind} #{self.trial} seed {self.seed}"

    def content(self) -> str:
        return "made points"

    def facts(self) -> dict:
        return {"section": "belief", "group": self.kind, "pair": f"#{self.trial}"}

    def load(self) -> Pair:
        return KINDS[self.kind](np.random.default_rng([self.seed, list(KINDS).index(self.kind), self.trial]))


def _count(rng: np.random.Generator, dimension: int) -> int:
    """Of points, small ones and large ones alike often."""
    return round(np.exp(rng.uniform(*np.log(POINTS[dimension]))))


def _shape(rng: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    makers: list[Callable[[], np.ndarray]] = [lambda: body(rng, n, dimension), lambda: part(rng, n, dimension)]
    if dimension == 3:
        makers += [lambda: room(rng, n), lambda: clutter(rng, n)]
    shape = makers[rng.integers(len(makers))]()
    return (shape - shape.mean(axis=0)) / rms_radius(shape)


def _as_measured(rng: np.random.Generator, points: np.ndarray, bent: float, noise: float) -> np.ndarray:
    """What a sensor that bends by `bent` radii makes of (n, D) points of about unit radius."""
    dimension = points.shape[1]
    waves = rng.normal(0.0, 1.2, (dimension, dimension))
    wavy = bent * np.sin(points @ waves + rng.uniform(0.0, 6.0, dimension))
    return points + wavy + rng.normal(0.0, noise, points.shape)


def _sensor(rng: np.random.Generator) -> tuple[float, float]:
    """How much it bends and how noisy it is, in radii; every second is straight."""
    return rng.choice([0.0, rng.uniform(0.0, 0.03)]), np.exp(rng.uniform(*np.log((0.002, 0.02))))


def _covariances(rng: np.random.Generator, *clouds: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Of points of which some are said to be noisier than others, as often as nothing is said."""
    if rng.random() < 0.5:
        return None
    first, second = (
        np.exp(rng.uniform(0.0, 1.8, len(cloud)))[:, None, None] * np.eye(cloud.shape[1]) for cloud in clouds
    )
    return first, second


def _motion(rng: np.random.Generator, dimension: int, angle_deg: float | None, shift: float) -> np.ndarray:
    """(D+1, D+1): a turn by an angle, for None by any."""
    if dimension == 3:
        return rigid(turn(rng, angle_deg), shift * rng.standard_normal(3))
    angle = rng.uniform(-np.pi, np.pi) if angle_deg is None else np.radians(rng.choice([-1.0, 1.0]) * angle_deg)
    T = lie.se_exp(np.array([0.0, 0.0, angle, 0.0, 0.0, 0.0]))[np.ix_((0, 1, 3), (0, 1, 3))]
    T[:2, 2] = shift * rng.standard_normal(2)
    return T


def _started(
    rng: np.random.Generator,
    source: np.ndarray,
    target: np.ndarray,
    *,
    related: bool = True,
    limits: tuple[float, float] = FOUND,
) -> Pair:
    """Two clouds of one frame, the source moved a little, anywhere, or by so much that the start misleads."""
    dimension, how = source.shape[1], rng.choice(HOWS, p=HOW_OFTEN)
    anywhere = bool(how == "anywhere")
    angle = {"near": rng.uniform(0.0, NEAR_DEG), "anywhere": None, "wrong": rng.uniform(*WRONG_DEG)}[str(how)]
    motion = _motion(rng, dimension, angle, (NEAR_SHIFT if how == "near" else 1.0) / np.sqrt(dimension))
    return Pair(
        moved(source, motion),
        target,
        lie.se_inverse(motion) if related else None,
        _covariances(rng, source, target),
        limits,
        anywhere,
    )


def _pieces(rng: np.random.Generator, dimension: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Two pieces of a shape, sampled and measured by themselves."""
    n = _count(rng, dimension)
    shape = _shape(rng, 2 * n, dimension)
    shape = shape[rng.permutation(len(shape))]
    sensor = _sensor(rng)
    one, other = cut(shape[::2], shape[1::2], rng.standard_normal(dimension), share)
    return _as_measured(rng, one, *sensor), _as_measured(rng, other, *sensor)


def pieces(rng: np.random.Generator, dimension: int) -> Pair:
    """That share from a fifth to everything."""
    return _started(rng, *_pieces(rng, dimension, rng.uniform(0.2, 1.0)), limits=FOUND_BENT)


def halves(rng: np.random.Generator, dimension: int) -> Pair:
    return _started(rng, *_pieces(rng, dimension, 0.0), related=False)


def strangers(rng: np.random.Generator, dimension: int) -> Pair:
    """Two shapes that are alike: of one kind, and as long and wide as each other."""
    n = _count(rng, dimension)
    makers = [body, part] if dimension == 2 else [body, part, lambda rng, n, _: room(rng, n)]
    make = makers[rng.integers(len(makers))]
    one, other = make(rng, n, dimension), make(rng, n, dimension)
    one, other = (cloud - cloud.mean(axis=0) for cloud in (one, other))
    if rng.random() < 0.5:
        one *= other.std(axis=0) / one.std(axis=0)
    bent, noise = _sensor(rng)
    one, other = (_as_measured(rng, cloud / rms_radius(cloud), bent, noise) for cloud in (one, other))
    return _started(rng, one, other, related=False)


def half_a_turn(rng: np.random.Generator, dimension: int) -> Pair:
    """What only something small tells from itself half a turn on, from there or from nearby."""
    n = _count(rng, dimension)
    shape = nearly_symmetric(rng, 2 * n, dimension)
    shape = (shape - shape.mean(axis=0)) / rms_radius(shape)
    shape = shape[rng.permutation(len(shape))]
    bent, noise = _sensor(rng)
    one, other = (_as_measured(rng, cloud, bent, noise) for cloud in (shape[::2], shape[1::2]))
    motion = _motion(rng, dimension, rng.uniform(0.0, NEAR_DEG), 0.03)
    if rng.random() < 0.7:
        flip = -np.eye(dimension + 1)
        flip[2:, 2:] *= -1.0  # about the axis of symmetry, which is the third or, in the plane, the only one
        motion = motion @ flip
    return Pair(moved(one, motion), other, lie.se_inverse(motion), _covariances(rng, one, other), FOUND)


def mirrored(rng: np.random.Generator, dimension: int) -> Pair:
    """Of which one has an axis the other way round."""
    n = _count(rng, dimension)
    shape = _shape(rng, 2 * n, dimension)
    shape = shape[rng.permutation(len(shape))]
    bent, noise = _sensor(rng)
    one, other = (_as_measured(rng, cloud, bent, noise) for cloud in (shape[::2], shape[1::2]))
    return _started(rng, one * [-1.0, 1.0, 1.0][:dimension], other, related=False)


def own_image(rng: np.random.Generator, dimension: int) -> Pair:
    """Of which the mirror image is the same, so that it says nothing."""
    n = _count(rng, dimension)
    shape = _shape(rng, 2 * n, dimension)
    shape = shape[rng.permutation(len(shape))]
    shape[::2] *= [-1.0, 1.0, 1.0][:dimension]
    shape = shape[rng.permutation(len(shape))]
    bent, noise = _sensor(rng)
    share, direction = rng.uniform(0.4, 1.0), rng.standard_normal(dimension)
    one, other = (_as_measured(rng, cloud, bent, noise) for cloud in cut(shape[::2], shape[1::2], direction, share))
    return _started(rng, one, other, limits=FOUND_BENT)


def noisy(rng: np.random.Generator, dimension: int) -> Pair:
    """Of noise that is said for each point, and outliers that are said to be some or are not."""
    n = _count(rng, dimension)
    shape = _shape(rng, 2 * n, dimension)
    shape = shape[rng.permutation(len(shape))]
    level, outliers, said = rng.uniform(0.005, 0.12), rng.choice([0.0, rng.uniform(0.0, 0.5)]), rng.random() < 0.7
    clouds, covariances = [], []
    for points in (shape[::2], shape[1::2]):
        deviations = np.abs(level * rng.standard_normal(points.shape))
        far = rng.standard_normal((round(outliers * len(points)), dimension))
        clouds.append(np.concatenate([points + deviations * rng.standard_normal(points.shape), far]))
        variances = np.exp(3.5 * deviations)[:, :, None] * np.eye(dimension)
        marked = OUTLIER_COVARIANCE if said else 1.0
        covariances.append(np.concatenate([variances, np.tile(marked * np.eye(dimension), (len(far), 1, 1))]))
    started = _started(rng, *clouds, limits=FOUND_BENT)
    motion = lie.se_inverse(started.T_target_source)[:-1, :-1]
    covariances[0] = motion @ covariances[0] @ motion.T
    return Pair(**(vars(started) | {"covariances": tuple(covariances)}))


def views(rng: np.random.Generator, dimension: int) -> Pair:
    """Of clutter or a room, seen by a depth camera from two places; one in four of two scenes."""
    n = 12_000
    make = clutter if rng.random() < 0.6 else room
    scene, alone = make(rng, n), rng.random() < 0.25
    others = make(rng, n) if alone else scene
    middle, apart = rng.uniform(-0.5, 0.5), np.radians(rng.uniform(5.0, 75.0))
    bias, raised, distance = rng.uniform(0.0, 4.0), rng.uniform(0.2, 0.7), rng.uniform(2.0, 3.2)
    clouds = []
    for points, azimuth in ((scene, middle - apart / 2), (others, middle + apart / 2)):
        height, far = raised * rng.uniform(0.8, 1.2), distance * rng.uniform(0.9, 1.1)
        towards = np.array([np.sin(azimuth) * np.cos(height), -np.cos(azimuth) * np.cos(height), np.sin(height)])
        seen = seen_from(rng, points, far * towards + (0.0, 0.0, 0.3), bias)
        clouds.append(seen[rng.permutation(len(seen))[:4000]])
    return _started(rng, *clouds, related=not alone, limits=FOUND_BENT)


def slipped(rng: np.random.Generator, dimension: int) -> Pair:
    """Of what repeats itself, from about a period off; from none as well."""
    n = _count(rng, dimension)
    shape, period = repeated(rng, 2 * n)
    radius, shape = rms_radius(shape), shape[rng.permutation(len(shape))]
    bent, noise = _sensor(rng)
    one, other = cut(shape[::2], shape[1::2], rng.standard_normal(3), rng.uniform(0.5, 1.0))
    one, other = (_as_measured(rng, cloud / radius, bent, noise) for cloud in (one, other))
    motion = _motion(rng, 3, rng.uniform(0.0, 5.0), 0.02)
    motion[:3, 3] += rng.integers(-1, 2) * period / radius
    return Pair(moved(one, motion), other, lie.se_inverse(motion), _covariances(rng, one, other), FOUND)


IN_SPACE: dict[str, Callable[[np.random.Generator, int], Pair]] = {"two views": views, "slipped": slipped}
ANYWHERE_DIMENSION: dict[str, Callable[[np.random.Generator, int], Pair]] = {
    "pieces": pieces,
    "halves": halves,
    "strangers": strangers,
    "half a turn": half_a_turn,
    "mirrored": mirrored,
    "its own image": own_image,
    "noisy": noisy,
}


def _of(make: Callable[[np.random.Generator, int], Pair], dimension: int) -> Callable[[np.random.Generator], Pair]:
    return lambda rng: make(rng, dimension)


KINDS: dict[str, Callable[[np.random.Generator], Pair]] = {
    **{name: _of(make, 3) for name, make in (ANYWHERE_DIMENSION | IN_SPACE).items()},
    **{f"{name}, in the plane": _of(make, 2) for name, make in ANYWHERE_DIMENSION.items()},
}
