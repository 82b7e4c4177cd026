# %% [markdown]
# # Swap Open3D's ICP, and read what ICP cannot say
#
# A script that calls `registration_icp` or `registration_generalized_icp` needs another name, and nothing else.

# %%
import numpy as np
import open3d as o3d

from adagmm_o3d import registration_adaptive_gmm

reg = o3d.pipelines.registration
o3d.utility.random.seed(0)

# %% [markdown]
# ## Two views of a desk corner
#
# The second one is turned by 35 degrees, noisy, and lacks a part.

# %%
corner = o3d.geometry.TriangleMesh.create_box(1.0, 0.6, 0.05)
corner += o3d.geometry.TriangleMesh.create_box(0.3, 0.2, 0.4).translate((0.5, 0.3, 0.05))
corner += o3d.geometry.TriangleMesh.create_sphere(0.12).translate((0.25, 0.2, 0.17))
target = corner.sample_points_uniformly(3000)
source = corner.sample_points_uniformly(3000).crop(o3d.geometry.AxisAlignedBoundingBox((-1, -1, -1), (0.75, 1, 1)))
source.points = o3d.utility.Vector3dVector(
    np.asarray(source.points) + np.random.default_rng(0).normal(scale=0.005, size=(len(source.points), 3))
)
T_target_source = np.eye(4)
T_target_source[:3, :3] = o3d.geometry.get_rotation_matrix_from_xyz(np.radians((0.0, 0.0, 35.0)))
T_target_source[:3, 3] = (0.2, -0.1, 0.1)
source.transform(np.linalg.inv(T_target_source))

# %% [markdown]
# ## The same arguments

# %%
gicp = reg.registration_generalized_icp(source, target, 0.05, np.eye(4))
ours = registration_adaptive_gmm(source, target, 0.05, np.eye(4))
for name, result in (("GICP", gicp), ("adagmm", ours)):
    turned = result.transformation[:3, :3].T @ T_target_source[:3, :3]
    degrees = np.degrees(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1)))
    print(f"{name}: {degrees:.1f} degrees off, fitness {result.fitness:.2f}")

# %% [markdown]
# ## What ICP cannot say
#
# The estimated overlap, the pose's covariance, and every reason not to trust it; here there is none.

# %%
print(f"overlap {ours.details.overlap:.2f}, warnings {ours.details.warnings}")

# %% [markdown]
# A bare wall: any pose along it fits, and the result says so.

# %%
wall = o3d.geometry.TriangleMesh.create_box(2.0, 1.0, 1e-6)
seen, seen_again = (wall.sample_points_uniformly(2000) for _ in range(2))
slid = registration_adaptive_gmm(seen, seen_again, 0.05)
print(f"a wall: {slid.details.warnings}")
