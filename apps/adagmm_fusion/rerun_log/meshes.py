"""Each sensor's depth image as a surface: with its colour image as texture, and in one colour to compare shapes."""

import numpy as np
import rerun as rr

from adagmm_fusion.frames import RGBDFrame
from adagmm_fusion.mesh import textured_grid
from adagmm_fusion.rerun_log.clouds import lit_colors
from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.errors import InputError

TWO_SIDED = rr.components.MeshFaceRendering.DoubleSided


def surface_of(frame: RGBDFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Vertices (N, 3) [m], triangles (K, 3) and texture coordinates (N, 2), or None where there is no surface."""
    try:
        return textured_grid(frame)
    except InputError:
        return None


def log_textured_mesh(rec: rr.RecordingStream, entity: str, frame: RGBDFrame, surface, when: When) -> None:
    """Log a frame's surface with its colour image."""
    if surface is None:
        when.clear(rec, entity)
        return
    vertices, triangles, uvs = surface
    mesh = rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32),
        triangle_indices=triangles.astype(np.uint32),
        vertex_texcoords=uvs,
        albedo_texture=frame.color,
        face_rendering=TWO_SIDED,
    )
    when.log(rec, entity, mesh)


def log_shape_mesh(rec: rr.RecordingStream, entity: str, surface, color, when: When) -> None:
    """Log a surface in one colour, lit: where two of them coincide their colours mix, where they do not one covers."""
    if surface is None:
        when.clear(rec, entity)
        return
    vertices, triangles, _ = surface
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
