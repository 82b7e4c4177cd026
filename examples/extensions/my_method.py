"""A method of your own in the bench: common centroids, then nothing.

    [project.entry-points."adagmm_bench.methods"]
    my-methods = "my_method"

in your package's pyproject.toml is all that makes it known.
"""

import numpy as np

from adagmm_bench.methods.registry import method


@method("centroids-only", library="numpy", default=False)
def centroids_only(source, target):
    """Moves the centroid of the source onto that of the target, and turns nothing."""
    dimension = source.points.shape[1]
    T_target_source = np.eye(dimension + 1)
    T_target_source[:dimension, dimension] = target.points.mean(axis=0) - source.points.mean(axis=0)
    return T_target_source
