"""`register_points` on clouds whose motion is known: 2D and 3D, isotropic and not, noise, outliers, partial overlap."""

from typing import get_args

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move, turn
from shared_data import shared_data

from adagmm_o3d import StopReason, TransformationEstimationForAdaptiveGMM, mark_outliers, register_points
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.options import SigmaRuleName

SIZE = {2: 150, 3: 600}
# What two different samplings of the same shape, this far apart, allow [deg].
ROTATION_DEG = {2: 1.5, 3: 4.5}
dimensions = pytest.mark.parametrize("dimension", [2, 3])
rules = pytest.mark.parametrize("rule", get_args(SigmaRuleName))


class Motion:
    """Two noisy samplings of one shape, the second one moved; optionally with covariances that say nothing special."""

    def __init__(self, dimension, *, seed=0, angle_deg=25.0, noise=0.01, isotropic=True):
        rng = np.random.default_rng([seed, dimension])
        n = SIZE[dimension]
        points = bumpy(rng, 2 * n, dimension) + noise * rng.normal(size=(2 * n, dimension))
        self.rng, self.dimension = rng, dimension
        self.T = random_pose(rng, dimension, angle=np.radians(angle_deg), distance=0.3)
        self.source, self.target = points[:n], move(points[n:], self.T)
        if isotropic:
            covariances = rng.uniform(1.0, 4.0, 2 * n)[:, None, None] * np.eye(dimension)
        else:
            factors = rng.normal(size=(2 * n, dimension, dimension))
            covariances = 0.3 * (factors @ factors.transpose(0, 2, 1) + np.eye(dimension))
        self.source_covariances, self.target_covariances = covariances[:n], turn(covariances[n:], self.T)

    def register(self, **kwargs):
        return register_points(self.source, self.target, self.source_covariances, self.target_covariances, **kwargs)

    def assert_found(self, result, *, rotation_deg=None, translation=0.025):
        errors = pose_errors(self.T, result.transformation)
        assert errors.rotation_deg < (rotation_deg or ROTATION_DEG[self.dimension])
        assert errors.translation < translation


@dimensions
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "anisotropic"])
@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 40.0, 60.0])
def test_known_motions_are_found(dimension, isotropic, angle_deg):
    for seed in range(3):
        motion = Motion(dimension, seed=seed, angle_deg=angle_deg or 1e-9, isotropic=isotropic)
        result = motion.register()
        assert result.converged and result.transformation.shape == (dimension + 1, dimension + 1)
        motion.assert_found(result)


@dimensions
@rules
def test_every_sigma_rule_finds_a_motion_without_noise(dimension, rule):
    motion = Motion(dimension, noise=0.0, angle_deg=15.0)
    motion.target, motion.target_covariances = move(motion.source, motion.T), motion.source_covariances
    result = motion.register(estimation_method=TransformationEstimationForAdaptiveGMM(sigma_rule=rule))
    assert result.stop_reason is StopReason.CONVERGED
    # Figure 2 to the letter keeps the target's Gaussians as wide as the cloud: a wide basin and a poor end.
    loose = rule == "figure2"
    errors = pose_errors(motion.T, result.transformation)
    assert errors.rotation_deg < (15.0 if loose else 0.05)
    assert errors.translation < (0.3 if loose else 1e-3)


@dimensions
@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_points_flagged_as_outliers_do_not_disturb(dimension, share):
    for seed in range(3):
        motion = Motion(dimension, seed=seed)
        n = len(motion.source)
        extra = int(share * n)
        flags = np.arange(n + extra) >= n
        covariances = mark_outliers(np.tile(np.eye(dimension), (n + extra, 1, 1)), flags)
        source = np.vstack([motion.source, motion.rng.normal(size=(extra, dimension))])
        target = np.vstack([motion.target, move(motion.rng.normal(size=(extra, dimension)), motion.T)])
        result = register_points(source, target, covariances, covariances)
        motion.assert_found(result)
        clean = register_points(motion.source, motion.target).transformation
        np.testing.assert_allclose(result.transformation, clean, rtol=0, atol=0.05)
        assert result.row_weights[flags].max() < 0.1 < result.row_weights[~flags].mean()


@dimensions
def test_points_without_a_partner_are_outvoted(dimension):
    for seed in range(3):
        motion = Motion(dimension, seed=seed)
        extra = len(motion.source) // 4
        source = np.vstack([motion.source, motion.rng.normal(size=(extra, dimension))])
        target = np.vstack([motion.target, move(motion.rng.normal(size=(extra, dimension)), motion.T)])
        motion.assert_found(register_points(source, target))


@dimensions
@pytest.mark.parametrize("cut", [0.1, 0.15])
def test_each_cloud_may_lack_what_only_the_other_shows(dimension, cut):
    for seed in range(3):
        motion = Motion(dimension, seed=seed, angle_deg=20.0, noise=0.005)
        before = move(motion.target, np.linalg.inv(motion.T))
        source = motion.source[motion.source[:, 0] < np.quantile(motion.source[:, 0], 1.0 - cut)]
        target = motion.target[before[:, 0] > np.quantile(before[:, 0], cut)]
        result = register_points(source, target)
        motion.assert_found(result, translation=0.06)
        true_overlap = np.mean(source[:, 0] > np.quantile(before[:, 0], cut))
        assert result.overlap == pytest.approx(true_overlap, abs=0.12)


@dimensions
@rules
def test_the_history_is_consistent(dimension, rule):
    motion = Motion(dimension)
    result = motion.register(estimation_method=TransformationEstimationForAdaptiveGMM(sigma_rule=rule))
    k = result.iterations
    assert result.transformations.shape == (k + 1, dimension + 1, dimension + 1)
    assert result.sigmas.shape == result.energies.shape == (k,)
    np.testing.assert_array_equal(result.transformations[-1], result.transformation)
    assert (result.sigmas > 0).all() and (result.energies > 0).all() and result.sigma == result.sigmas[-1]
    rotations = result.transformations[:, :dimension, :dimension]
    gram = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(dimension), gram.shape), rtol=0, atol=1e-9)
    assert (np.linalg.det(rotations) > 0).all()
    bottom = np.broadcast_to(np.eye(dimension + 1)[-1], (k + 1, dimension + 1))
    np.testing.assert_array_equal(result.transformations[:, -1], bottom)
    assert result.converged is (result.stop_reason is StopReason.CONVERGED) is True
    assert result.row_weights.shape == (len(motion.source),)
    steps = np.linalg.norm(np.diff(result.transformations, axis=0), axis=(1, 2))
    assert steps[-1] < steps.max() or steps.max() < 1e-3


@dimensions
@rules
def test_the_first_pose_is_the_init(dimension, rule):
    motion = Motion(dimension)
    init = random_pose(motion.rng, dimension, angle=0.1, distance=0.05) @ motion.T
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule, search=False)
    result = motion.register(init=init, estimation_method=method)
    np.testing.assert_allclose(result.transformations[0], init, rtol=0, atol=1e-12)


@dimensions
@rules
def test_an_init_of_three_digits_is_made_exact(dimension, rule):
    motion = Motion(dimension)
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    result = motion.register(init=np.round(motion.T, 3), estimation_method=method)
    first = result.transformations[0]
    np.testing.assert_allclose(first[:-1, :-1] @ first[:-1, :-1].T, np.eye(dimension), rtol=0, atol=1e-12)
    np.testing.assert_allclose(first, motion.T, rtol=0, atol=1e-3)


@dimensions
@rules
@pytest.mark.parametrize("given", [True, False])
def test_no_iterations_leave_the_start_as_it_is(dimension, rule, given):
    motion = Motion(dimension)
    init = motion.T if given else None
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule, start="centroids")
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=0)
    seen = []
    result = motion.register(
        init=init, estimation_method=method, criteria=criteria, callback_after_iteration=seen.append
    )
    np.testing.assert_array_equal(result.transformation, motion.T if given else np.eye(dimension + 1))
    np.testing.assert_array_equal(result.transformations, result.transformation[None])
    assert (result.iterations, result.stop_reason, result.sigma, seen) == (0, StopReason.MAX_ITERATION, 0.0, [])
    assert result.row_weights.shape == (SIZE[dimension],) and (result.overlap > 0.8) == given
    assert result.pose_covariance is None and not result.trustworthy


def test_a_far_start_is_left_where_it_is_as_well():
    motion = Motion(3)
    init = np.eye(4)
    init[:3, 3] = 1e9
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=0)
    result = motion.register(init=init, criteria=criteria)
    np.testing.assert_array_equal(result.transformation, init)
    assert result.overlap == 0.0


@dimensions
def test_too_few_iterations_are_admitted(dimension):
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=1)
    result = Motion(dimension).register(criteria=criteria)
    assert result.stop_reason is StopReason.MAX_ITERATION and not result.converged
    assert not result.trustworthy and any("max_iteration" in warning for warning in result.warnings)


@dimensions
def test_points_with_a_covariance_that_is_not_finite_are_left_out_and_counted(dimension):
    motion = Motion(dimension)
    motion.source_covariances[3, 0, 0] = np.nan
    motion.target_covariances[5] = np.inf
    result = motion.register()
    assert (result.dropped_source, result.dropped_target) == (1, 1)
    without = register_points(
        np.delete(motion.source, 3, axis=0),
        np.delete(motion.target, 5, axis=0),
        np.delete(motion.source_covariances, 3, axis=0),
        np.delete(motion.target_covariances, 5, axis=0),
    )
    np.testing.assert_array_equal(result.transformation, without.transformation)


@dimensions
def test_singular_covariances_are_given_the_thickness_of_a_surface_and_counted(dimension):
    motion = Motion(dimension, isotropic=False)
    rng = np.random.default_rng(8)
    given, thick = [], []
    for n in (len(motion.source), len(motion.target)):
        axes = np.linalg.qr(rng.normal(size=(n, dimension, dimension)))[0]
        variances = np.ones((n, dimension))
        variances[:20, 0], variances[20:30, 0] = 0.0, -1e-6
        given.append((axes * variances[:, None, :]) @ axes.transpose(0, 2, 1))
        thick.append((axes * np.maximum(variances, 1e-3)[:, None, :]) @ axes.transpose(0, 2, 1))
    result = register_points(motion.source, motion.target, *given)
    expected = register_points(motion.source, motion.target, *thick)
    assert (result.regularised_source, result.regularised_target) == (30, 30)
    assert (expected.regularised_source, expected.regularised_target) == (0, 0)
    np.testing.assert_allclose(result.transformation, expected.transformation, rtol=0, atol=1e-6)


@dimensions
@pytest.mark.parametrize("isotropic", [True, False])
def test_a_covariance_that_is_zero_becomes_as_large_as_most_are(dimension, isotropic):
    motion = Motion(dimension, isotropic=isotropic)
    filled = motion.source_covariances.copy()
    largest = np.linalg.eigvalsh(filled)[:, -1]
    filled[:3] = np.median(largest[3:]) * np.eye(dimension)
    motion.source_covariances[:3] = 0.0
    result = motion.register()
    motion.source_covariances = filled
    assert (result.regularised_source, result.regularised_target) == (3, 0)
    np.testing.assert_allclose(result.transformation, motion.register().transformation, rtol=0, atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, ">f8", np.int64])
def test_any_real_dtype_is_taken(dtype):
    motion = Motion(3)
    points = [np.round(200.0 * p).astype(dtype) for p in (motion.source, motion.target)]
    expected = register_points(points[0].astype(float), points[1].astype(float))
    np.testing.assert_array_equal(register_points(*points).transformation, expected.transformation)
    strided = register_points(np.asfortranarray(points[0]), np.repeat(points[1], 2, axis=0)[::2])
    np.testing.assert_array_equal(strided.transformation, expected.transformation)


def test_the_arrays_are_not_modified():
    motion = Motion(3, isotropic=False)
    arrays = motion.source, motion.target, motion.source_covariances, motion.target_covariances
    for array in arrays:
        array.flags.writeable = False
    before = [array.tobytes() for array in arrays]
    motion.register()
    assert [array.tobytes() for array in arrays] == before


@dimensions
@rules
def test_what_is_asked_for_later_is_that_of_the_clouds_as_they_were(dimension, rule):
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    motion = Motion(dimension, isotropic=False)
    expected, result = motion.register(estimation_method=method), motion.register(estimation_method=method)
    asked = expected.overlap, expected.row_weights.tobytes(), expected.warnings
    for array in (motion.source, motion.target, motion.source_covariances, motion.target_covariances):
        array[:] = 0.0
    assert (result.overlap, result.row_weights.tobytes(), result.warnings) == asked
    assert result.row_weights is result.row_weights  # found once


@pytest.mark.slow
def test_kinect_scenes():
    errors = []
    for path in sorted(shared_data("kinect_pairs").glob("scene_*.npz")):
        scene = np.load(path)
        result = register_points(
            scene["source"], scene["target"], scene["source_covariances"], scene["target_covariances"]
        )
        error = pose_errors(scene["T_target_source"], result.transformation)
        errors.append((error.rotation_frobenius, error.rotation_deg, error.translation))
    frobenius, angle_deg, translation = np.array(errors).T
    assert len(errors) == 20
    assert ((angle_deg < 10.0) & (translation < 0.2)).sum() >= 19
    assert np.median(frobenius) <= 0.040
    assert np.median(translation) <= 0.030
