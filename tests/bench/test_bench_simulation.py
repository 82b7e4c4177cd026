"""The simulation protocol of the paper's Section 4.1, and that any trial can be made alone."""

import numpy as np
import pytest

from adagmm_bench.models import default_data_folder, find_models, load_models
from adagmm_bench.simulation import (
    COVARIANCE_EXPONENT,
    FACTOR_RANGES,
    OUTLIER_COVARIANCE,
    SWEEPS,
    TrialId,
    degrade,
    random_rotation,
    rotation_matrix,
    simulate,
    trial_ids,
    unit_radius,
)
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import rotation_error_deg


@pytest.fixture(params=[2, 3])
def dimension(request):
    return request.param


@pytest.fixture
def models(dimension):
    return load_models(dimension, None).models


def test_the_four_sweeps_are_the_paper_s_282_trials(dimension):
    ids = list(trial_ids(dimension))
    assert len(ids) == len(set(ids)) == 282
    assert SWEEPS["rotation"][0] == -60 and SWEEPS["rotation"][-1] == 60 and len(SWEEPS["rotation"]) == 16
    assert SWEEPS["noise"][:2] == (0.01, 0.07) and len(SWEEPS["noise"]) == 10
    assert SWEEPS["outliers"][0] == 0.1 and SWEEPS["outliers"][-1] == 1.9 and len(SWEEPS["outliers"]) == 10
    assert SWEEPS["occlusion"][0] == 0.0 and SWEEPS["occlusion"][-1] == 0.3 and len(SWEEPS["occlusion"]) == 11


def test_a_trial_made_alone_has_the_bits_it_has_in_the_sweep(dimension, models):
    in_sweep = {i: simulate(i, models) for i in trial_ids(dimension, sweeps=("noise",), repetitions=2)}
    alone = simulate(TrialId(dimension, "noise", 0.19, 1), models)
    other = in_sweep[TrialId(dimension, "noise", 0.19, 1)]
    np.testing.assert_array_equal(alone.source.points, other.source.points)
    np.testing.assert_array_equal(alone.target.covariances, other.target.covariances)
    again = simulate(TrialId(dimension, "noise", 0.19, 1, seed=1), models)
    assert len(again.source) != len(alone.source) or not np.array_equal(again.source.points, alone.source.points)


def test_the_truth_brings_an_undisturbed_source_onto_its_target(dimension):
    # A model dense enough for both samples to hold nearly the same points.
    rng = np.random.default_rng(5)
    models = {"grid": np.round(rng.uniform(-1, 1, (400, dimension)), 2)}
    trial = simulate(TrialId(dimension, "outliers", 0.1, 0), models)
    source, target = (cloud.points[~cloud.flagged()] for cloud in (trial.source, trial.target))
    D = dimension
    moved = source @ trial.T_target_source[:D, :D].T + trial.T_target_source[:D, D]
    nearest = np.linalg.norm(moved[:, None] - target[None], axis=2).min(axis=1)
    assert np.median(nearest) < 3 * FACTOR_RANGES[D].noise
    assert np.mean(nearest < 0.1) > 0.8


def test_sampling_occlusion_and_outliers_leave_the_counts_the_protocol_says():
    model = unit_radius(np.random.default_rng(0).normal(size=(200, 2)))
    cloud = degrade(model, np.random.default_rng(1), sampling=0.9, noise=0.0, outliers=0.5, occlusion=0.1)
    assert len(cloud) == round(0.9 * 180) + 100
    assert cloud.flagged().sum() == 100
    np.testing.assert_array_equal(cloud.covariances[-1], OUTLIER_COVARIANCE * np.eye(2))
    # Without noise the inliers are points of the model, and the 20 missing ones are one patch: a disc around one point.
    kept = cloud.points[:-100]
    distances = np.linalg.norm(model[:, None] - kept[None], axis=2).min(axis=1)
    assert np.count_nonzero(distances < 1e-12) == len(kept)


def test_occlusion_removes_the_points_nearest_to_one_of_them():
    model = unit_radius(np.random.default_rng(0).normal(size=(150, 3)))
    cloud = degrade(model, np.random.default_rng(1), sampling=1.0, noise=0.0, outliers=0.0, occlusion=0.2)
    gone = np.linalg.norm(model[:, None] - cloud.points[None], axis=2).min(axis=1) > 1e-12
    assert gone.sum() == 30
    spans = [np.sort(np.linalg.norm(model - centre, axis=1))[:30].max() for centre in model]
    patches = [set(np.flatnonzero(np.linalg.norm(model - c, axis=1) <= s)) for c, s in zip(model, spans, strict=True)]
    assert set(np.flatnonzero(gone)) in patches


def test_noise_has_the_deviation_that_the_covariance_tells():
    model = unit_radius(np.random.default_rng(0).normal(size=(20000, 2)))
    cloud = degrade(model, np.random.default_rng(1), sampling=1.0, noise=0.2, outliers=0.0, occlusion=0.0)
    deviation = np.log(cloud.covariances[:, [0, 1], [0, 1]]) / COVARIANCE_EXPONENT
    residual = (cloud.points - model) / deviation
    # 40 000 standard normals: the variance estimate is within 0.0071 times five.
    np.testing.assert_allclose(np.mean(residual**2), 1.0, rtol=0, atol=0.036)
    np.testing.assert_allclose(np.mean(deviation), 0.2 * np.sqrt(2 / np.pi), rtol=0.02, atol=0)


def test_the_source_s_covariances_turn_with_it():
    models = load_models(3, None).models
    trial = simulate(TrialId(3, "noise", 0.55, 0), models)
    R = trial.T_target_source[:3, :3].T
    inliers = trial.source.covariances[~trial.source.flagged()]
    in_model_frame = R.T @ inliers @ R
    off_diagonal = in_model_frame - np.einsum("nii->ni", in_model_frame)[:, :, None] * np.eye(3)
    np.testing.assert_allclose(off_diagonal / np.abs(inliers).max(axis=(1, 2))[:, None, None], 0.0, rtol=0, atol=1e-12)


def test_rotation_sweep_turns_each_axis_by_nothing_or_by_the_setting():
    for trial in range(8):
        T = simulate(TrialId(3, "rotation", -44.0, trial), load_models(3, None).models).T_target_source
        candidates = [rotation_matrix(-44.0 * np.array([x, y, z])).T for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        assert min(np.abs(T[:3, :3] - R).max() for R in candidates) < 1e-12


def test_any_rotation_means_uniform_over_so3():
    rng = np.random.default_rng(3)
    angles = [rotation_error_deg(np.eye(4), _pose(random_rotation(rng))) for _ in range(2000)]
    # Uniform over SO(3): the angle's mean is 90° + 180°/π² · 2 = 126.5°; here its standard error is 0.85°.
    np.testing.assert_allclose(np.mean(angles), 90 + 360 / np.pi**2, rtol=0, atol=4.3)
    trial = simulate(TrialId(3, "noise", 0.01, 2, rotation_range_deg=180.0), load_models(3, None).models)
    assert rotation_error_deg(trial.T_target_source, np.eye(4)) > 15 * np.sqrt(3)


def _pose(R):
    T = np.eye(4)
    T[:3, :3] = R
    return T


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((4, "noise", 0.01, 0), "dimension"),
        ((2, "weather", 0.01, 0), "sweep"),
        ((2, "noise", 0.02, 0), "setting"),
        ((2, "noise", 0.01, -1), "trial"),
        ((2, "noise", 0.01, 0, 0, 200.0), "rotation_range_deg"),
    ],
)
def test_a_trial_that_does_not_exist_is_refused_by_name(arguments, named):
    with pytest.raises(InputError, match=f"^{named}: "):
        TrialId(*arguments)


def test_shapes_are_made_where_no_models_are(dimension, tmp_path):
    assert find_models(dimension, None) is None and find_models(dimension, tmp_path) is None
    made = load_models(dimension, None)
    assert made.origin == "made shapes" and len(made.models) == 100
    first, second = list(made.models.values())[:2]
    assert first.shape == ({2: 100, 3: 1000}[dimension], dimension) and not np.allclose(first, second, rtol=0, atol=0.1)


def test_a_model_file_that_is_none_is_named(tmp_path, dimension):
    bad = tmp_path / "models.npz"
    bad.write_bytes(b"not an archive")
    with pytest.raises(InputError, match=r"models\.npz"):
        load_models(dimension, bad)
    np.savez(bad, a=np.zeros((20, 5)))
    with pytest.raises(InputError, match=r"models\.npz: model a: .*got \(20, 5\)"):
        load_models.__wrapped__(dimension, bad)


def test_the_data_folder_can_be_named_by_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("ADAGMM_SHARED_DATA", str(tmp_path))
    assert default_data_folder() == tmp_path
