"""Coherent point drift and its relatives, from pycpd, cycpd and probreg. All take 2D clouds as they are."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud

OUTLIER_WEIGHT = 0.7  # the share of points that the uniform component may explain; best of 0.1 to 0.7 in 2D and in 3D
FILTERREG_OUTLIER_WEIGHT = 0.3  # likewise
ITERATIONS = 100


def rigid(
    rotation: np.ndarray, translation: np.ndarray, scale: float = 1.0, source_centre: np.ndarray | None = None
) -> np.ndarray:
    """A pose of column vectors; a similarity's scale is dropped so that the source's centre lands where it did."""
    D = len(rotation)
    T = np.eye(D + 1)
    T[:D, :D] = rotation
    T[:D, D] = np.ravel(translation)
    if source_centre is not None:
        T[:D, D] += (scale - 1.0) * rotation @ source_centre
    return T


@method("pycpd", library="pycpd", default=False)
def pycpd_rigid(source: Cloud, target: Cloud) -> np.ndarray:
    """pycpd rigid coherent point drift. Outlier weight 0.7, at most 100 iterations, tolerance 1e-3; this library
    always fits a scale, which is dropped.
    """
    from pycpd import RigidRegistration

    drift = RigidRegistration(
        X=target.points, Y=source.points, w=OUTLIER_WEIGHT, max_iterations=ITERATIONS, tolerance=1e-3
    )
    drift.register()
    # pycpd multiplies row vectors: X = s Y R + t.
    return rigid(drift.R.T, drift.t, float(drift.s), source.points.mean(axis=0))


@method("cycpd", library="cycpd")
def cycpd_rigid(source: Cloud, target: Cloud) -> np.ndarray:
    """cycpd rigid coherent point drift without scale. Outlier weight 0.7, at most 100 iterations, tolerance 1e-5."""
    from cycpd import rigid_registration

    class ScalarVariance(rigid_registration):
        """cycpd 0.28 keeps its variance as a (1, 1) array, which numpy 2.4 no longer converts to a number."""

        def update_variance(self):
            super().update_variance()
            self.sigma2 = float(np.squeeze(self.sigma2))

    drift = ScalarVariance(
        X=np.ascontiguousarray(target.points),
        Y=np.ascontiguousarray(source.points),
        w=OUTLIER_WEIGHT,
        scale=False,
        max_iterations=ITERATIONS,
        tolerance=1e-5,
        verbose=False,
        print_reg_params=False,
    )
    drift.register()
    return rigid(drift.R.T, drift.t)


@method("probreg-cpd", library="probreg", dimensions=(3,), default=False)
def probreg_cpd(source: Cloud, target: Cloud) -> np.ndarray:
    """probreg rigid coherent point drift. Outlier weight 0.7, at most 100 iterations, tolerance 1e-6. It fits a scale,
    which is dropped: told not to, this library's variance stops shrinking at once.
    """
    from probreg import cpd

    found = cpd.registration_cpd(
        source.points, target.points, w=OUTLIER_WEIGHT, maxiter=ITERATIONS, tol=1e-6
    ).transformation
    return rigid(found.rot, found.t, float(found.scale), source.points.mean(axis=0))


@method("probreg-filterreg", library="probreg")
def probreg_filterreg(source: Cloud, target: Cloud) -> np.ndarray:
    """probreg FilterReg, point to point, sigma updated from the data. Outlier weight 0.3, at most 100 iterations."""
    from probreg import filterreg

    D = source.points.shape[1]
    found = filterreg.registration_filterreg(
        source.points,
        target.points,
        w=FILTERREG_OUTLIER_WEIGHT,
        update_sigma2=True,
        maxiter=ITERATIONS,
        tol=1e-3,
        tf_init_params={"rot": np.eye(D), "t": np.zeros(D)},
    ).transformation
    return rigid(found.rot, found.t)
