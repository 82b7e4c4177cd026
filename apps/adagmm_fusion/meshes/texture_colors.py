"""Colours of points beside a textured surface, out of its texture."""

import numpy as np
import open3d as o3d

from adagmm_fusion.meshes.texture_views import sampled
from adagmm_fusion.meshes.textured_mesh import TexturedMesh


def texture_colors(mesh: TexturedMesh, points: np.ndarray, *, within_m: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) colours 0..1 of points (n, 3) where the surface is nearest, and (n,) whether it is that near."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    found = scene.compute_closest_points(np.asarray(points, np.float32))
    triangles = mesh.triangles[found["primitive_ids"].numpy()]
    u, v = found["primitive_uvs"].numpy().T
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    uvs = np.einsum("nk,nkc->nc", weights, mesh.uvs[triangles])
    pixels = uvs * np.array(mesh.texture.shape[1::-1]) - 0.5
    near = np.linalg.norm(found["points"].numpy() - points, axis=1) <= within_m
    return sampled(mesh.texture, pixels.astype(np.float32)) / 255.0, near
