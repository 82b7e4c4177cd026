"""Surfaces: each sensor's depth image in one colour, to compare shapes, and both joined, with their colours."""

import numpy as np
import rerun as rr

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.depth_grid import textured_grid
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.rerun_log.clouds import lit_colors
from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.errors import InputError

TWO_SIDED = rr.components.MeshFaceRendering.DoubleSided


def surface_of(frame: RGBDFrame) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (N, 3) [m] and triangles (K, 3), or None where there is no surface."""
    try:
        return textured_grid(frame)[:2]
    except InputError:
        return None


def log_textured_mesh(rec: rr.RecordingStream, entity: str, mesh: TexturedMesh | None, when: When) -> None:
    """Log a textured surface; None is nothing to see."""
    if mesh is None:
        when.clear(rec, entity)
        return
    archetype = rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.triangles.astype(np.uint32),
        vertex_texcoords=mesh.uvs,
        albedo_texture=mesh.texture,
        face_rendering=TWO_SIDED,
    )
    when.log(rec, entity, archetype)


def log_shape_mesh(
    rec: rr.RecordingStream,
    entity: str,
    surface: tuple[np.ndarray, np.ndarray] | None,
    color: tuple[int, int, int],
    when: When,
) -> None:
    """Log a surface in one colour, lit: where two of them coincide their colours mix, where they do not one covers."""
    if surface is None:
        when.clear(rec, entity)
        return
    vertices, triangles = surface
    mesh = rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32),
        triangle_indices=triangles.astype(np.uint32),
        vertex_colors=lit_colors(vertex_normals(vertices, triangles), color),
        face_rendering=TWO_SIDED,
    )
    when.log(rec, entity, mesh)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals, the average of the triangles around each vertex, weighted by their area."""
    corners = vertices[triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(faces[:, c], 3), minlength=len(vertices)) for c in range(3)], axis=1
    )
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), np.finfo(np.float64).tiny)
