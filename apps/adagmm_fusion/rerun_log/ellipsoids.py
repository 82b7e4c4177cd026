"""Covariances at their true scale σ·Σ, as ellipsoids of three standard deviations on a subset of the points."""

import numpy as np
import open3d as o3d
import rerun as rr
from scipy.spatial.transform import Rotation

from adagmm_fusion.rerun_log.when import When

MOST_ELLIPSOIDS = 250
VAGUE = 10.0
STANDARD_DEVIATIONS = 3.0


def chosen_points(cloud: o3d.geometry.PointCloud, count: int = MOST_ELLIPSOIDS) -> np.ndarray:
    """Indices of at most `count` points, spread over the cloud, without those flagged by a huge covariance."""
    sizes = np.cbrt(np.abs(np.linalg.det(np.asarray(cloud.covariances))))
    usable = np.flatnonzero(np.isfinite(sizes) & (sizes <= VAGUE * np.nanmedian(sizes)))
    return usable[np.linspace(0, len(usable) - 1, min(count, len(usable))).astype(int)]


def log_covariances(
    rec: rr.RecordingStream,
    entity: str,
    cloud: o3d.geometry.PointCloud,
    sigmas: np.ndarray,
    color: tuple[int, int, int],
    when: When,
) -> None:
    """Log the ellipsoids, which shrink with σ from one EM iteration to the next.

    cloud : with covariances (N, 3, 3), Σ in the sensor's frame.    sigmas : (K,) [m² per unit of Σ].
    """
    chosen = chosen_points(cloud)
    variances, axes = np.linalg.eigh(np.asarray(cloud.covariances)[chosen])
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    ellipsoids = rr.Ellipsoids3D.from_fields(
        centers=np.asarray(cloud.points, dtype=np.float32)[chosen],
        quaternions=Rotation.from_matrix(axes).as_quat().astype(np.float32),
        colors=[color],
        fill_mode=rr.components.FillMode.Solid,
    )
    when.log(rec, entity, ellipsoids)
    sigmas = np.asarray(sigmas, dtype=np.float64)
    sizes = (STANDARD_DEVIATIONS * np.sqrt(sigmas[:, None, None] * variances[None])).astype(np.float32)

    def columns_of(rows):
        kept = sizes[rows]
        return rr.Ellipsoids3D.columns(half_sizes=kept.reshape(-1, 3)).partition([len(chosen)] * len(kept))

    when.send_rows(rec, entity, np.arange(1, len(sigmas) + 1), columns_of)
