"""Open3D's results are copied; ours are with everything that `details` tells, and pickled too."""

import copy
import multiprocessing
import pickle

import numpy as np
import open3d as o3d
import pytest
from shapes import bumpy_ellipsoid

from adagmm_o3d import register_points, registration_adaptive_gmm

POINTS, _ = bumpy_ellipsoid(np.random.default_rng(5), 300)


def legacy():
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    return registration_adaptive_gmm(cloud, cloud, 0.1)


def tensor():
    cloud = o3d.t.geometry.PointCloud(POINTS)
    return registration_adaptive_gmm(cloud, cloud, 0.1)


def as_arrays(result):
    """Everything that a result says, by name."""
    details = result.details
    if isinstance(result, o3d.pipelines.registration.RegistrationResult):
        own = {"transformation": result.transformation, "correspondences": np.asarray(result.correspondence_set)}
    else:
        own = {"transformation": result.transformation.numpy(), "correspondences": result.correspondence_set.numpy()}
        own |= {"converged": result.converged, "iterations": result.num_iterations}
    own |= {"fitness": result.fitness, "inlier_rmse": result.inlier_rmse}
    return own | {
        "overlap": details.overlap,
        "row_weights": details.row_weights,
        "pose_covariance": details.pose_covariance,
        "evidence": details.evidence,
        "transformations": details.transformations,
        "warnings": details.warnings,
    }


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(
    "duplicate",
    [copy.copy, copy.deepcopy, lambda result: pickle.loads(pickle.dumps(result))],
    ids=["copy", "deep", "pickle"],
)
def test_a_copy_has_all_of_it(make, duplicate):
    result = make()
    again = duplicate(duplicate(result))
    assert type(again) is type(result)
    theirs, ours = as_arrays(result), as_arrays(again)
    for name, value in theirs.items():
        np.testing.assert_array_equal(ours[name], value, err_msg=name)


def test_a_deep_copy_shares_no_arrays():
    result = legacy()
    again = copy.deepcopy(result)
    again.details.row_weights[:] = -1.0
    again.details.transformations[:] = 7.0
    assert result.details.row_weights.min() >= 0.0
    assert not (result.details.transformations == 7.0).any()


def _register(count):
    return register_points(POINTS[:count], POINTS[:count])


@pytest.mark.slow
def test_results_come_back_from_another_process():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (result,) = pool.map(_register, [200])
    here = _register(200)
    assert result.overlap == here.overlap
    np.testing.assert_array_equal(result.pose_covariance, here.pose_covariance)
