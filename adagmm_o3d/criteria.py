"""When the EM loop has done enough."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """When an EM iteration has changed nothing worth another one; the words and numbers are Open3D's.

    The residual is flat at its minimum: a step of ε standard deviations changes it by about ε². So a pose has settled
    when a step is below √relative_rmse standard deviations of the mixtures. max_iteration bounds the EM iterations.
    """

    relative_rmse: float
    max_iteration: int
