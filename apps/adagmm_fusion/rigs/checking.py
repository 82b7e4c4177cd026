"""Is a rig's calibration still true? The clouds of its sensors registered again, starting from what it says."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from adagmm_fusion.clouds.building import clouds_from_pair
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.pose_readings import AS_GIVEN, READINGS
from adagmm_fusion.pairs.fusion import mean_pose
from adagmm_fusion.pairs.partners import partner_distance
from adagmm_fusion.pairs.pose_deviations import pose_deviations
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.rigs.rig import Rig
from adagmm_o3d import registration_adaptive_gmm
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.evaluation import pose_errors

UNCHANGED, MOVED, UNDECIDED = "unchanged", "moved", "undecided"
# The true mean is taken to lie within this many standard errors of the mean over frames.
STANDARD_ERRORS = 2.0
MIN_FRAMES = 2
# Moments of each two sensors at which a recording's own rig is looked at.
LOOKED_AT = 5
# A rig's pose looks like its inverse, say, where that is no further from what is registered, and so many times nearer
# than the pose itself.
ALIKE_DEG, ALIKE_M, CLEARLY = 5.0, 0.15, 3.0

Sensors = tuple[str, str]  # source, target


@dataclass(frozen=True, eq=False)
class FrameCheck:
    """One frame: how far the registered pose is from the rig's, or why it says nothing.

    rotation_sigma_deg, translation_sigma_mm : standard deviations of the sensor's rotation and place by the pose's own
        covariance, which knows of noise that is independent from point to point alone.
    """

    frame: str
    rotation_deg: float | None = None
    translation_mm: float | None = None
    T_target_source: np.ndarray | None = None
    reason: str = ""
    rotation_sigma_deg: float | None = None
    translation_sigma_mm: float | None = None


@dataclass(frozen=True, eq=False)
class SensorCheck:
    """One sensor against the target over all frames.

    rotation_deg, translation_mm : how far the mean of the registered poses is from the rig's.
    rotation_spread_deg, translation_spread_mm : root mean square distance of the frames' poses from their mean.
    looks_like : of a sensor that moved, what the rig's pose would have to be for it to be where it is registered: its
        inverse, in millimetres ...; empty if it is nothing of the kind.
    T_target_source : that mean, None if fewer than two frames could be used or they have none; so are the numbers then.
    """

    source: str
    target: str
    verdict: str
    frames: tuple[FrameCheck, ...]
    rotation_deg: float | None = None
    translation_mm: float | None = None
    rotation_spread_deg: float | None = None
    translation_spread_mm: float | None = None
    T_target_source: np.ndarray | None = None
    looks_like: str = ""


def check_rig(
    rig: Rig,
    recording: Recording,
    settings: Settings,
    *,
    max_rotation_deg: float,
    max_translation_mm: float,
    max_frames: int,
    on_frame: Callable[[int, int], None] | None = None,
) -> list[SensorCheck]:
    """Register up to max_frames moments of each pair of sensors, spread over the recording, from the rig's own pose.

    Raises
    ------
    RigError  if the rig lacks a sensor or does not know where it is.
    RecordingError  if the recording has no pair of two sensors at one moment.
    """
    by_sensors = _at_one_moment(recording)
    if not by_sensors:
        raise RecordingError(f"{recording.path}: expected frames of two sensors at one moment, got none; see --help")
    poses = {sensors: rig.T_target_source(sensors[1], sensors[0]) for sensors in by_sensors}
    checked = _checked_frames(recording, poses, by_sensors, settings, max_frames, on_frame)
    return [
        judged(*sensors, frames, poses[sensors], max_rotation_deg, max_translation_mm) for sensors, frames in checked
    ]


def rig_notes(
    recording: Recording, settings: Settings, on_frame: Callable[[int, int], None] | None = None
) -> Iterator[str]:
    """A line for every two sensors that, registered, are elsewhere than the recording says, beyond the settings' limits
    of success: no sensor's pose is to be taken for known then."""
    by_sensors = _at_one_moment(recording)
    told = {sensors: recording.pairs[indices[0]].T_target_source for sensors, indices in by_sensors.items()}
    poses = {sensors: pose for sensors, pose in told.items() if pose is not None}
    limits = settings.max_rotation_error_deg, settings.max_translation_error_mm
    for sensors, frames in _checked_frames(recording, poses, by_sensors, settings, LOOKED_AT, on_frame):
        check, (source, target) = judged(*sensors, frames, poses[sensors], *limits), sensors
        if check.verdict == MOVED:
            off = f"{check.rotation_deg:.1f}° and {check.translation_mm:.0f} mm"
            like = f"; it looks like {check.looks_like}" if check.looks_like else ""
            yield f"the rig's pose of {source} to {target} does not fit: registered it is {off} off{like}; see verify"


def _checked_frames(
    recording: Recording,
    poses: Mapping[Sensors, np.ndarray],
    by_sensors: Mapping[Sensors, list[int]],
    settings: Settings,
    max_frames: int,
    on_frame: Callable[[int, int], None] | None,
) -> Iterator[tuple[Sensors, list[FrameCheck]]]:
    """Of each two sensors, some of their pairs registered from the pose that is given for them."""
    chosen = {sensors: spread_over(by_sensors[sensors], max_frames) for sensors in poses}
    total, done = sum(map(len, chosen.values())), 0
    for sensors, indices in chosen.items():
        frames = []
        for index in indices:
            frames.append(_check_frame(recording, index, poses[sensors], settings))
            done += 1
            if on_frame is not None:
                on_frame(done, total)
        yield sensors, frames


def _at_one_moment(recording: Recording) -> dict[Sensors, list[int]]:
    """The pairs of each two sensors (source, target) at one moment, as indices into recording.pairs."""
    by_sensors: dict[Sensors, list[int]] = {}
    for i, pair in enumerate(recording.pairs):
        source, target = recording.entries[pair.source], recording.entries[pair.target]
        if source.sensor != target.sensor and source.name == target.name:
            by_sensors.setdefault((source.sensor, target.sensor), []).append(i)
    return by_sensors


def spread_over(indices: list[int], count: int) -> list[int]:
    """`count` of them at most, evenly from first to last."""
    if count >= len(indices):
        return indices
    return [indices[i] for i in np.unique(np.linspace(0, len(indices) - 1, count).round().astype(int))]


def judged(
    source: str,
    target: str,
    frames: Iterable[FrameCheck],
    T_rig: np.ndarray,
    max_rotation_deg: float,
    max_translation_mm: float,
) -> SensorCheck:
    """The verdict: unchanged, or moved, only if the mean's uncertainty leaves no doubt about it."""
    frames = tuple(frames)
    poses = [frame.T_target_source for frame in frames if frame.T_target_source is not None]
    T_mean = mean_pose(poses)
    if len(poses) < MIN_FRAMES or T_mean is None:
        return SensorCheck(source, target, UNDECIDED, frames)
    moved = pose_errors(T_rig, T_mean)
    apart = [pose_errors(T_mean, T) for T in poses]
    spread_deg = float(np.sqrt(np.mean([e.rotation_deg**2 for e in apart])))
    spread_mm = 1000.0 * float(np.sqrt(np.mean([e.translation**2 for e in apart])))
    doubt = STANDARD_ERRORS / np.sqrt(len(poses) - 1)
    translation_mm = 1000.0 * moved.translation
    if moved.rotation_deg + doubt * spread_deg <= max_rotation_deg and (
        translation_mm + doubt * spread_mm <= max_translation_mm
    ):
        verdict = UNCHANGED
    elif moved.rotation_deg - doubt * spread_deg > max_rotation_deg or (
        translation_mm - doubt * spread_mm > max_translation_mm
    ):
        verdict = MOVED
    else:
        verdict = UNDECIDED
    return SensorCheck(
        source,
        target,
        verdict,
        frames,
        moved.rotation_deg,
        translation_mm,
        spread_deg,
        spread_mm,
        T_mean,
        _looks_like(T_rig, T_mean) if verdict == MOVED else "",
    )


def _looks_like(T_rig: np.ndarray, T_mean: np.ndarray) -> str:
    """The reading of a rig's pose that is where the sensor is registered, while the pose itself is clearly not."""

    def off(T: np.ndarray) -> float:
        errors = pose_errors(T, T_mean)
        return max(errors.rotation_deg / ALIKE_DEG, errors.translation / ALIKE_M)

    readings = {name: off(read(T_rig)) for name, read in READINGS.items()}
    name = min(readings, key=lambda name: readings[name])
    return name if readings[name] <= min(1.0, readings[AS_GIVEN] / CLEARLY) else ""


def _check_frame(recording: Recording, index: int, T_rig: np.ndarray, settings: Settings) -> FrameCheck:
    frame = recording.entries[recording.pairs[index].source].name
    try:
        source, target = clouds_from_pair(
            recording[index],
            voxel_size=settings.voxel_size_m,
            target_points=settings.target_points,
            sensor_model=settings.sensor_model,
            max_depth=settings.max_depth_m,
        )
        distance = partner_distance(target, settings.partner_distance_m)
        # The clouds are in their cameras' frames.
        at = np.zeros(3)
        result = registration_adaptive_gmm(
            source, target, distance, T_rig, device=settings.device, source_viewpoint=at, target_viewpoint=at
        ).details
    except AdaGMMError as problem:
        return FrameCheck(frame, reason=" ".join(str(problem).split()))
    if not result.trustworthy:
        return FrameCheck(frame, reason="; ".join(result.warnings))
    T = np.asarray(result.transformation)
    moved, (sigma_deg, sigma_mm) = pose_errors(T_rig, T), pose_deviations(result.pose_covariance, T)
    return FrameCheck(
        frame,
        moved.rotation_deg,
        1000.0 * moved.translation,
        T,
        rotation_sigma_deg=sigma_deg,
        translation_sigma_mm=sigma_mm,
    )
