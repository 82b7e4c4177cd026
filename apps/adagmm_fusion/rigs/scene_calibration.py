"""Where fixed sensors stand, from what they see: every two of them registered at every moment, all poses at once.

Each registration is an edge with its covariance; the sensors' poses are those that all edges together make likeliest,
with weights that let an edge go which contradicts the rest. What a camera's depth has wrong at all moments alike does
not average out, and goes into the covariances as it is; of what else they have in common, such as a wrong focal length,
nothing shows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from adagmm_fusion.errors import RigError
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.lie import se_adjoint, se_exp, se_inverse, se_log

# Residuals of edges have the tails of a t distribution of so many degrees of freedom; the median of chi squared with 6.
FREEDOM, CHI_SQ_MEDIAN = 4.0, 5.35
# An edge disagrees when its squared residual is above that (one in a thousand of those that agree), in variances.
DISAGREES_SQ = 22.5
ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class SceneEdge:
    """Two sensors registered at a moment. T_target_source (4, 4); information (6, 6) of δ = (ω, v) in exp(δ)·T.

    depth_effects : (6, 4) see `depth_errors.pose_effects`; not in the information.
    """

    moment: str
    target: str
    source: str
    T_target_source: np.ndarray
    information: np.ndarray
    depth_effects: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.moment}_{self.source}_to_{self.target}"


@dataclass(frozen=True, eq=False)
class SceneCalibration:
    """The rig, whose frame is its first sensor's camera frame.

    covariances : (6, 6) for each sensor, of ε = (ω, v) in T_rig_sensor·exp(ε) [rad, m]; zero of the first.
    edges : what it is made of.   disagreeing : names of those that contradict the rest.
    failed : of pairs that could not be registered, the name and why.
    """

    rig: Rig
    covariances: dict[str, np.ndarray]
    edges: list[SceneEdge]
    disagreeing: list[str]
    failed: dict[str, str]


def calibrate_from_scene(
    recording: Recording, settings: Settings, *, name: str, on_pair: Callable[[str, int, int], None]
) -> SceneCalibration:
    """The extrinsics of a recording's fixed sensors; `on_pair` is told what is done, how much of it, and of how many.

    Raises
    ------
    RigError  if there are fewer than two sensors, they move, or registrations do not hold all of them together.
    """
    if len(recording.sensors) < 2 or recording.moving:
        raise RigError(f"{recording.path}: expected two or more sensors that stand still, got {_what(recording)}")
    edges: list[SceneEdge] = []
    failed: dict[str, str] = {}
    frames: dict[str, RGBDFrame] = {}
    pairs = list(_pairs(recording))
    for done, (moment, target, source) in enumerate(pairs):
        on_pair("registering sensors", done, len(pairs))
        a, b = (recording.entries[index].load() for index in (target, source))
        frames |= {a.sensor: a, b.sensor: b}
        edge_name = f"{moment}_{b.sensor}_to_{a.sensor}"
        outcome = register_pair(RGBDPair(edge_name, b, a, None, 0), settings)
        if outcome.status != "ok" or outcome.estimate.pose_covariance is None:
            failed[edge_name] = outcome.reason
            continue
        effects = np.asarray(outcome.depth_effects)
        information = np.linalg.inv(outcome.estimate.pose_covariance - effects @ effects.T)
        edges.append(SceneEdge(moment, a.sensor, b.sensor, np.asarray(outcome.T_estimate), information, effects))
    poses, covariances, disagreeing = solve_poses(edges, recording.sensors)
    missing = [sensor for sensor in recording.sensors if sensor not in poses]
    if missing:
        why = "".join(f"; {pair}: {reason}" for pair, reason in list(failed.items())[:1])
        raise RigError(f"{recording.path}: no registration leads from {recording.sensors[0]} to {missing[0]}{why}")
    return SceneCalibration(_rig(name, frames, poses), covariances, edges, disagreeing, failed)


def solve_poses(
    edges: list[SceneEdge], sensors: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], list[str]]:
    """T_first_sensor (4, 4) of the sensors that edges lead to, covariances (6, 6), and the edges that disagree."""
    poses = _chained(edges, sensors[0])
    used = [edge for edge in edges if edge.target in poses]
    free = [sensor for sensor in poses if sensor != sensors[0]]
    place = {sensor: 6 * row for row, sensor in enumerate(free)}
    covariance: np.ndarray = np.zeros((6 * len(free), 6 * len(free)))
    squares, scale = np.zeros(len(used)), 1.0
    # What each sensor's scale and shift of depth do to the poses.
    effects: dict[str, np.ndarray] = {}
    for _ in range(ITERATIONS if free else 0):
        hessian, gradient = np.zeros_like(covariance), np.zeros(len(covariance))
        effects = {sensor: np.zeros((len(covariance), 2)) for sensor in poses}
        off = [se_log(_between(poses, e) @ se_inverse(e.T_target_source)) for e in used]
        squares = np.array([d @ e.information @ d for d, e in zip(off, used, strict=True)])
        scale = max(1.0, float(np.median(squares)) / CHI_SQ_MEDIAN)
        for edge, residual, square in zip(used, off, squares, strict=True):
            weight = 1.0 / (scale * (1.0 + square / scale / (6.0 * FREEDOM)))
            rows = np.zeros((6, len(covariance)))
            if edge.target in place:
                rows[:, place[edge.target] : place[edge.target] + 6] = -np.eye(6)
            if edge.source in place:
                rows[:, place[edge.source] : place[edge.source] + 6] = se_adjoint(_between(poses, edge))
            hessian += weight * rows.T @ edge.information @ rows
            gradient += weight * rows.T @ edge.information @ residual
            pulled = weight * rows.T @ edge.information @ edge.depth_effects
            effects[edge.source] += pulled[:, :2]
            effects[edge.target] += pulled[:, 2:]
        covariance = np.linalg.inv(hessian)
        step = -covariance @ gradient
        for sensor, first in place.items():
            poses[sensor] = poses[sensor] @ se_exp(step[first : first + 6])
        if np.abs(step).max() < 1e-9:
            break
    shared = [covariance @ pull for pull in effects.values()]
    covariance = covariance + sum(of_sensor @ of_sensor.T for of_sensor in shared)
    covariances = {sensor: np.zeros((6, 6)) for sensor in poses}
    covariances |= {s: covariance[first : first + 6, first : first + 6] for s, first in place.items()}
    disagreeing = [edge.name for edge, square in zip(used, squares, strict=True) if square > scale * DISAGREES_SQ]
    return poses, covariances, disagreeing


def _pairs(recording: Recording) -> Iterator[tuple[str, int, int]]:
    """Each moment's name and two entries of different sensors, the earlier sensor first."""
    moments: dict[str, dict[str, int]] = {}
    for index, entry in enumerate(recording.entries):
        moments.setdefault(entry.name, {})[entry.sensor] = index
    for moment, seen in moments.items():
        for target, source in combinations([s for s in recording.sensors if s in seen], 2):
            yield moment, seen[target], seen[source]


def _chained(edges: list[SceneEdge], first: str) -> dict[str, np.ndarray]:
    """T_first_sensor of what edges lead to: over the fewest sensors, by the parallel edge nearest to the others."""
    poses, reached = {first: np.eye(4)}, [first]
    while reached:
        proposed: dict[str, list[np.ndarray]] = {}
        for edge in edges:
            if edge.target in reached and edge.source not in poses:
                proposed.setdefault(edge.source, []).append(poses[edge.target] @ edge.T_target_source)
            elif edge.source in reached and edge.target not in poses:
                proposed.setdefault(edge.target, []).append(poses[edge.source] @ se_inverse(edge.T_target_source))
        for sensor, several in proposed.items():
            apart = [np.median([np.linalg.norm(se_log(se_inverse(a) @ b)) for b in several]) for a in several]
            poses[sensor] = several[int(np.argmin(apart))]
        reached = list(proposed)
    return poses


def _between(poses: dict[str, np.ndarray], edge: SceneEdge) -> np.ndarray:
    return se_inverse(poses[edge.target]) @ poses[edge.source]


def _rig(name: str, frames: dict[str, RGBDFrame], poses: dict[str, np.ndarray]) -> Rig:
    calibrations = {
        sensor: SensorCalibration(sensor, frames[sensor].intrinsics, frames[sensor].depth_scale, pose)
        for sensor, pose in poses.items()
    }
    return Rig(name, calibrations, "extrinsics from what the sensors see")


def _what(recording: Recording) -> str:
    return "one" if len(recording.sensors) < 2 else "a rig that moves"
