"""Watch a registration in the Rerun viewer: before, after, every iteration and the curves.

Open the result with `rerun registration.rrd`. (Once: `rerun analytics disable`, if you want no telemetry.)
"""

import numpy as np
import open3d as o3d
import rerun as rr

from adagmm_fusion.rerun_log import RegistrationLogger
from adagmm_o3d import registration_adaptive_gmm

o3d.utility.random.seed(0)
target = o3d.geometry.TriangleMesh.create_torus(1.0, 0.4).sample_points_uniformly(2000)
target += o3d.geometry.TriangleMesh.create_box(0.8, 0.3, 0.5).sample_points_uniformly(1000)
source = o3d.geometry.PointCloud(target).rotate(
    o3d.geometry.get_rotation_matrix_from_xyz(np.radians((5.0, 10.0, 20.0)))
)

rec = rr.RecordingStream("my script")
rec.save("registration.rrd")
result = registration_adaptive_gmm(
    source, target, 0.05, callback_after_iteration=RegistrationLogger(rec, source, target)
)
rec.disconnect()
print(f"registration.rrd: {result.details.iterations} iterations, fitness {result.fitness:.2f}")
