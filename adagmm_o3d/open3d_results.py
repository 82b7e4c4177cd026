"""Open3D's results with the EM's own record; they are copied and pickled with it, which Open3D's are not."""

from __future__ import annotations

import copy
from typing import Any, Self, TypeAlias

import numpy as np
import open3d as o3d

from adagmm_o3d.arguments import Array
from adagmm_o3d.result import PointRegistrationResult

LegacyResult: TypeAlias = o3d.pipelines.registration.RegistrationResult
TensorResult: TypeAlias = o3d.t.pipelines.registration.RegistrationResult


class RegistrationResult(LegacyResult):
    """Open3D's `RegistrationResult`, with the EM's own record in `details`."""

    details: PointRegistrationResult

    def __copy__(self) -> Self:
        return type(self)._made_of(*self._parts())

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return type(self)._made_of(*copy.deepcopy(self._parts(), memo))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self)._made_of, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        correspondences = np.array(self.correspondence_set)
        return np.array(self.transformation), self.fitness, self.inlier_rmse, correspondences, self.details

    @classmethod
    def _made_of(
        cls,
        transformation: Array,
        fitness: float,
        inlier_rmse: float,
        correspondences: Array,
        details: PointRegistrationResult,
    ) -> Self:
        result = cls()
        result.transformation = transformation
        result.fitness, result.inlier_rmse = fitness, inlier_rmse
        result.correspondence_set = o3d.utility.Vector2iVector(correspondences.reshape(-1, 2))
        result.details = details
        return result


class TensorRegistrationResult(TensorResult):
    """Open3D's tensor `RegistrationResult`, with the EM's own record in `details`."""

    details: PointRegistrationResult

    def __copy__(self) -> Self:
        return type(self)._made_of(*self._parts())

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return type(self)._made_of(*copy.deepcopy(self._parts(), memo))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self)._made_of, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        numbers = self.fitness, self.inlier_rmse, self.converged, self.num_iterations
        return self.transformation, self.correspondence_set, *numbers, self.details

    @classmethod
    def _made_of(
        cls,
        transformation: o3d.core.Tensor,
        correspondences: o3d.core.Tensor,
        fitness: float,
        inlier_rmse: float,
        converged: bool,
        num_iterations: int,
        details: PointRegistrationResult,
    ) -> Self:
        result = cls()
        result.transformation, result.correspondence_set = transformation, correspondences
        result.fitness, result.inlier_rmse = fitness, inlier_rmse
        result.converged, result.num_iterations = converged, num_iterations
        result.details = details
        return result
