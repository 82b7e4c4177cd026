"""A whole recording, fused: its mesh, and where each frame was taken."""

import numpy as np
import open3d as o3d
import rerun as rr
import rerun.blueprint as rrb

from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import FRUSTUM_LINE_WIDTH
from adagmm_fusion.rerun_log.colors import SOURCE_COLOR
from adagmm_fusion.rerun_log.meshes import TWO_SIDED, log_textured_mesh
from adagmm_fusion.rerun_log.views import Eye, scene
from adagmm_fusion.rerun_log.when import When

# The view is fitted to this share of the mesh: a few surfaces far away would make the rest small.
SHOWN_PERCENT = 90


def fused_blueprint(vertices: np.ndarray) -> rrb.Blueprint:
    """One view of the mesh with vertices (N, 3) and of the sensors' ways."""
    points = np.asarray(vertices)
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    most = points[distance <= np.percentile(distance, SHOWN_PERCENT)]
    view = scene("Fused", dict.fromkeys((entities.FUSED, f"{entities.WAYS}/**")), Eye.around(most))
    return rrb.Blueprint(view, collapse_panels=True, auto_layout=False, auto_views=False)


def log_fused_recording(
    rec: rr.RecordingStream, mesh: TexturedMesh | o3d.geometry.TriangleMesh, ways: dict[str, np.ndarray]
) -> None:
    """Log the mesh, textured or coloured, and each sensor's places (N, 3) in the world, in order."""
    rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
    if isinstance(mesh, TexturedMesh):
        log_textured_mesh(rec, entities.FUSED, mesh, When())
    else:
        colors = np.floor(255.0 * np.asarray(mesh.vertex_colors) + 0.5).astype(np.uint8)
        archetype = rr.Mesh3D(
            vertex_positions=np.asarray(mesh.vertices, np.float32),
            triangle_indices=np.asarray(mesh.triangles, np.uint32),
            vertex_colors=colors,
            face_rendering=TWO_SIDED,
        )
        rec.log(entities.FUSED, archetype, static=True)
    for sensor, places in ways.items():
        entity = f"{entities.WAYS}/{sensor}"
        rec.log(entity, rr.LineStrips3D([places], colors=SOURCE_COLOR, radii=FRUSTUM_LINE_WIDTH), static=True)
        rec.log(entity, rr.Points3D(places, colors=SOURCE_COLOR, radii=2 * FRUSTUM_LINE_WIDTH), static=True)
