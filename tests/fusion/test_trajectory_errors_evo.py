"""ATE and RPE against the evo package, on walks made up and on real ones with noise."""

import numpy as np
import pytest
from shared_data import shared_data

from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.sequence.trajectory_errors import trajectory_errors
from adagmm_o3d import lie

evo = pytest.importorskip("evo", reason="the extra [dev] brings evo")
from evo.core import metrics, trajectory  # noqa: E402


def evos_errors(true, estimated) -> tuple[float, float, float]:
    """ATE [m], RPE [m] and RPE [°], root mean squares, as evo_ape --align and evo_rpe --delta 1 --delta_unit f do."""
    reference, path = (trajectory.PosePath3D(poses_se3=list(poses)) for poses in (true, estimated))
    relations = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg
    measures = [metrics.RPE(relation, 1, metrics.Unit.frames) for relation in relations]
    for measure in measures:
        measure.process_data((reference, path))
    aligned = trajectory.PosePath3D(poses_se3=list(estimated))
    aligned.align(reference, correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    return tuple(m.get_statistic(metrics.StatisticsType.rmse) for m in (ape, *measures))


def shaken(true, rng, size: float):
    """The poses with noise, in another world."""
    world = lie.se_exp((0.3, -0.2, 1.0, 4.0, 5.0, 6.0))
    return np.array([world @ pose @ lie.se_exp(rng.normal(0.0, size, 6)) for pose in true])


def assert_same(true, estimated):
    errors = trajectory_errors(true, estimated)
    found = errors.ate_m, errors.rpe_m, errors.rpe_deg
    np.testing.assert_allclose(found, evos_errors(true, estimated), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size", [1e-4, 0.02, 0.5])
@pytest.mark.parametrize("count", [3, 40])
def test_a_random_walk(count, size):
    rng = np.random.default_rng(count)
    true = [np.eye(4)]
    for _ in range(count - 1):
        true.append(true[-1] @ lie.se_exp(np.concatenate((rng.normal(0, 0.1, 3), rng.normal(0.1, 0.05, 3)))))
    assert_same(np.array(true), shaken(true, rng, size))


@pytest.mark.parametrize("name", ["hololens_tof", "tum_fr1_rpy_kinect_v1"])
def test_a_real_walk_with_noise(name):
    entries = open_recording(shared_data("recordings", name)).entries
    true = np.array([entry.T_world_camera for entry in entries if entry.T_world_camera is not None])
    assert len(true) >= 20
    assert_same(true, shaken(true, np.random.default_rng(1), 0.01))
