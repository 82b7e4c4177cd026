"""`multi_scale_registration_adaptive_gmm` in place of `o3d.t.pipelines.registration.multi_scale_icp`."""

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from test_bad_input_registration import check
from test_registration import CALLBACK_KEYS, Pair, bits
from test_registration_tensor import TensorPair

from adagmm_o3d import (
    DegenerateError,
    InputError,
    InputTypeError,
    multi_scale_registration_adaptive_gmm,
    registration_adaptive_gmm,
)
from adagmm_o3d.evaluation import pose_errors

core, treg = o3d.core, o3d.t.pipelines.registration
SIZES = [0.3, 0.15, 0.08]
DISTANCES = [0.6, 0.3, 0.15]
CRITERIA = [treg.ICPConvergenceCriteria(10.0**-k, 10.0**-k, most) for k, most in ((4, 20), (5, 15), (6, 10))]


@pytest.fixture(params=[Pair, lambda: TensorPair(core.float32), lambda: TensorPair(core.float64)])
def pair(request):
    return request.param()


def as_array(transformation):
    return transformation.numpy() if isinstance(transformation, core.Tensor) else transformation


def test_each_size_starts_where_the_last_one_ended(pair):
    result = multi_scale_registration_adaptive_gmm(pair.source, pair.target, SIZES, CRITERIA, DISTANCES)
    pose = None
    for size, criteria, distance in zip(SIZES, CRITERIA, DISTANCES, strict=True):
        expected = registration_adaptive_gmm(
            pair.source, pair.target, distance, pose, criteria=criteria, voxel_size=size
        )
        pose = expected.transformation
    if isinstance(pair, TensorPair):  # Open3D's grid of a tensor cloud does not add up in the same order every time
        np.testing.assert_allclose(
            as_array(result.transformation), as_array(expected.transformation), rtol=0, atol=1e-6
        )
    else:
        assert bits(result) == bits(expected)
    assert (result.fitness, len(result.correspondence_set)) == (expected.fitness, len(expected.correspondence_set))
    errors = pose_errors(pair.T, as_array(result.transformation))
    assert errors.rotation_deg < 1.0 and errors.translation < 0.02


def test_the_last_size_may_be_all_points(pair):
    result = multi_scale_registration_adaptive_gmm(pair.source, pair.target, [0.2, -1.0], [None, None], [0.3, 0.1])
    assert len(result.details.row_weights) == 500
    errors = pose_errors(pair.T, as_array(result.transformation))
    assert errors.rotation_deg < 1.0 and errors.translation < 0.01


def test_init_is_where_the_first_size_starts(pair):
    init = random_pose(np.random.default_rng(3), 3, angle=0.05, distance=0.02) @ pair.T
    stay = [treg.ICPConvergenceCriteria(1e-6, 1e-6, 0)] * 2
    result = multi_scale_registration_adaptive_gmm(pair.source, pair.target, SIZES[:2], stay, DISTANCES[:2], init)
    np.testing.assert_array_equal(as_array(result.transformation), init)


def test_the_callback_counts_through(pair):
    seen = []
    result = multi_scale_registration_adaptive_gmm(
        pair.source, pair.target, SIZES, CRITERIA, DISTANCES, callback_after_iteration=seen.append
    )
    assert all(set(s) == CALLBACK_KEYS for s in seen)
    names = ("iteration_index", "scale_index", "scale_iteration_index")
    rows = [tuple(int(as_array(s[name])) for name in names) for s in seen]
    assert [row[0] for row in rows] == list(range(len(rows)))
    assert sorted({row[1] for row in rows}) == [0, 1, 2]
    for level, criteria in enumerate(CRITERIA):
        inside = [row[2] for row in rows if row[1] == level]
        assert inside == list(range(len(inside))) and 0 < len(inside) <= criteria.max_iteration
    if isinstance(result, treg.RegistrationResult):
        assert result.num_iterations == len(rows)
        assert {(s["scale_index"].dtype, tuple(s["scale_index"].shape)) for s in seen} == {(core.int64, ())}


def registered(cloud, voxel_sizes, criteria_list, distances):
    return multi_scale_registration_adaptive_gmm(cloud, cloud, voxel_sizes, criteria_list, distances)


@pytest.mark.parametrize(
    ("lists", "error", "message"),
    [
        (([], [], []), InputError, "voxel_sizes: expected at least one, got none"),
        ((0.1, [None], [0.1]), InputTypeError, "voxel_sizes: expected a list, one entry for each voxel size, got"),
        (([0.1], None, [0.1]), InputTypeError, "criteria_list: expected a list, one entry for each voxel size, got"),
        (([0.2, 0.1], [None], [0.2, 0.1]), InputError, "criteria_list: expected one for each of the 2 voxel sizes"),
        (
            ([0.2, 0.1], [None, None], [0.2]),
            InputError,
            "max_correspondence_distances: expected one for each of the 2 voxel sizes, got 1",
        ),
        (([0.1, 0.2], [None] * 2, [0.2] * 2), InputError, "voxel_sizes[1]: expected less than 0.1 before it, got 0.2"),
        (([-1.0, -2.0], [None] * 2, [0.2] * 2), InputError, "voxel_sizes[0]: expected a number > 0 but for the last"),
        (([0.2, np.nan], [None] * 2, [0.2] * 2), InputError, "voxel_sizes[1]: expected a finite number, got nan"),
        (([0.2, "0.1"], [None] * 2, [0.2] * 2), InputTypeError, "voxel_sizes[1]: expected a real number, got str"),
        (([0.1], [30], [0.2]), InputTypeError, "criteria_list[0]: expected Open3D's ICPConvergenceCriteria, got int"),
        (([0.1], [None], [0.0]), InputError, "max_correspondence_distances[0]: expected a finite number > 0, got 0"),
        (([100.0], [None], [0.1]), DegenerateError, "source.points: 1 point cannot fix a pose; at least 3 are needed"),
    ],
)
def test_lists_that_cannot_be_meant(lists, error, message):
    cloud = Pair().source
    cloud.translate([3.0, 3.0, 3.0])
    check(lambda: registered(cloud, *lists), error, message)
