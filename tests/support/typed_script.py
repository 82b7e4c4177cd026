"""A user's script under strict type checks; what `reveal_type` says of each line is in tests/package/test_typing.py."""

from typing import TYPE_CHECKING

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from adagmm_o3d import (
    KinectUncertainty,
    TransformationEstimationForAdaptiveGMM,
    mark_outliers,
    prepare,
    register_batch,
    register_points,
    registration_adaptive_gmm,
)

if TYPE_CHECKING:
    from typing import reveal_type


def on_iteration(values: dict[str, object]) -> None:
    print(values["sigma"])


def arrays(points: NDArray[np.float32]) -> float:
    options = TransformationEstimationForAdaptiveGMM(sigma_rule="posterior", search=False)
    result = register_points(points, points, estimation_method=options, device="cpu")
    reveal_type(result)
    reveal_type(result.transformation)
    reveal_type(result.pose_covariance)
    return result.overlap


def clouds(legacy: o3d.geometry.PointCloud, tensor: o3d.t.geometry.PointCloud) -> tuple[str, ...]:
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria()
    result = registration_adaptive_gmm(legacy, legacy, 0.05, np.eye(4), criteria=criteria, device="auto")
    reveal_type(result.details)
    reveal_type(result.fitness)
    of_tensors = registration_adaptive_gmm(tensor, tensor, 0.05, callback_after_iteration=on_iteration)
    reveal_type(of_tensors.details)
    prepared = registration_adaptive_gmm(legacy, prepare(legacy), 0.05)
    reveal_type(prepared.details)
    prepared_tensors = registration_adaptive_gmm(tensor, prepare(tensor, voxel_size=0.1), 0.05)
    reveal_type(prepared_tensors.num_iterations)
    return result.details.warnings + of_tensors.details.warnings


def many(points: NDArray[np.float32]) -> list[str]:
    target = prepare(points)
    results = register_batch([(points, target), {"source": points, "target": target}], init="global")
    return [str(result) if isinstance(result, Exception) else str(result.transformation) for result in results]


def others() -> None:
    print(KinectUncertainty(), mark_outliers(np.ones((3, 3, 3)), np.array([True, False, False])))
