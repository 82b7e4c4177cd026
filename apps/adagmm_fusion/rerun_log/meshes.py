"""Each sensor's depth image as a surface with its colour image as texture."""

import numpy as np
import rerun as rr

from adagmm_fusion.frames import RGBDFrame
from adagmm_fusion.mesh import textured_grid
from adagmm_fusion.rerun_log.when import When


def log_textured_mesh(rec: rr.RecordingStream, entity: str, frame: RGBDFrame, when: When) -> None:
    """Log the frame's surface in the sensor's frame."""
    vertices, triangles, uvs = textured_grid(frame)
    mesh = rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32),
        triangle_indices=triangles.astype(np.uint32),
        vertex_texcoords=uvs,
        albedo_texture=frame.color,
        face_rendering=rr.components.MeshFaceRendering.DoubleSided,
    )
    when.log(rec, entity, mesh)
