"""A cloud made ready once: what a registration works out of one cloud alone, kept for the next one."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Generic, Literal, TypeVar

from adagmm_o3d.errors import InputError
from adagmm_o3d.lazy_open3d import o3d
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.normalisation import GOOD_SHARE
from adagmm_o3d.result import Deferred
from adagmm_o3d.sampling import quantile

Cloud = TypeVar("Cloud")
# Covariances whose sizes differ by less are as large as each other.
ALIKE = 0.1
Kind = Literal["array", "legacy", "tensor"]


class PreparedCloud(Generic[Cloud]):
    """A cloud that takes the place of one that is registered; made by `prepare`.

    Every registration keeps here what it has worked out of this cloud, for the next one: the checked mixture, and what
    was made of it at the scale of the last registration (see `Mixture.kept_for`).

    Parameters
    ----------
    kind : the door it is for.   cloud : what evaluates the pose, thinned already.   arrays : points (n, D) and
    covariances (n, D, D) or None, worked out when they are first asked for.   voxel_size, epsilon : what it was thinned
    and thickened with, see `prepare`.   given : whether the covariances came with the cloud.
    """

    def __init__(
        self,
        kind: Kind,
        cloud: Cloud,
        arrays: Deferred[tuple[Any, Any]],
        voxel_size: float,
        epsilon: float,
        *,
        given: bool,
    ) -> None:
        self.kind, self.voxel_size, self.epsilon, self.given = kind, voxel_size, epsilon, given
        self.cloud: Any = cloud
        self._arrays = arrays
        self._mixtures: dict[Hashable, Mixture] = {}

    @property
    def points(self) -> Any:
        """(n, D) the points."""
        return self._arrays()[0]

    def mixture(self, name: str, make: Callable[..., Mixture]) -> Mixture:
        """What `make` makes of the points and covariances, once; `name` is what an error calls the cloud."""
        return self.kept_mixture(make, lambda: make(name, *self._arrays()))

    def mixture_as_vague_as(self, name: str, make: Callable[..., Mixture], other: Mixture) -> Mixture:
        """The same with covariances as large as those of another mixture: what stands in for them has no unit."""
        points, covariances = self._arrays()
        own = self.mixture(name, make)
        factor = float(quantile(other.variances, GOOD_SHARE) / quantile(own.variances, GOOD_SHARE))
        if covariances is None or abs(factor - 1.0) < ALIKE:
            return own
        return make(name, points, factor * covariances)

    def kept_mixture(self, key: Hashable, make: Callable[[], Mixture]) -> Mixture:
        """What `make` makes, once for each `key`; of what two threads make at once, which is the same, one is kept."""
        mixture = self._mixtures.get(key)
        return self._mixtures.setdefault(key, make()) if mixture is None else mixture

    def __getstate__(self) -> dict[str, Any]:
        """Copied and pickled as it was before the first registration; Open3D does not pickle its legacy clouds."""
        return self.__dict__ | {"_mixtures": {}} | ({"cloud": None} if self.kind == "legacy" else {})

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self.kind == "legacy":
            self.cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.points))

    def check_made_with(self, name: str, voxel_size: float, epsilon: float | None) -> None:
        """Raise where a registration asks for another thinning, or another thickness of surfaces (None for any)."""
        if voxel_size > 0.0 and voxel_size != self.voxel_size:
            raise InputError(
                f"voxel_size: {name} was prepared with voxel_size={self.voxel_size:g}, got {voxel_size:g}; "
                "prepare it with the same"
            )
        if epsilon is not None and epsilon != self.epsilon:
            raise InputError(
                f"estimation_method.epsilon: {name} was prepared with epsilon={self.epsilon:g}, got {epsilon:g}; "
                "prepare it with the same"
            )
