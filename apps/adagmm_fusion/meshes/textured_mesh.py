"""A triangle mesh with one image as its texture, and the files it is saved as."""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, replacing
from adagmm_fusion.files.stale_results import MARKS
from adagmm_fusion.meshes.glb_file import textured_glb
from adagmm_fusion.meshes.orientation import upright


@dataclass(frozen=True, eq=False)
class TexturedMesh:
    """A surface in metres, x right, y down, z forward.

    vertices, normals : (N, 3) float32, a vertex where charts of the texture meet once for each of them.
    triangles : (K, 3) int32.    uvs : (N, 2) float32 in 0..1 from the texture's top left corner, u right, v down.
    texture : (H, W, 3) uint8 RGB.
    """

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    uvs: np.ndarray
    texture: np.ndarray


def save_textured_mesh(path: Path, mesh: TexturedMesh) -> list[Path]:
    """Write a .glb file with the texture in it, or .obj with .mtl and .png beside it, y up; returns what there is.

    Raises
    ------
    OutputError  if it cannot be written, or has another ending.
    """
    path = Path(path)
    if path.suffix.lower() == ".glb":
        with replacing(path) as temporary:
            temporary.write_bytes(textured_glb(mesh.vertices, mesh.normals, mesh.uvs, mesh.triangles, mesh.texture))
        return [path]
    if path.suffix.lower() != ".obj":
        raise OutputError(f"{path}: expected a name ending in .glb or .obj")
    return _save_obj(path, mesh)


def _save_obj(path: Path, mesh: TexturedMesh) -> list[Path]:
    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(upright(mesh.vertices)), o3d.utility.Vector3iVector(mesh.triangles)
    )
    legacy.vertex_normals = o3d.utility.Vector3dVector(upright(mesh.normals))
    legacy.triangle_uvs = o3d.utility.Vector2dVector(mesh.uvs[mesh.triangles.ravel()])
    legacy.triangle_material_ids = o3d.utility.IntVector(np.zeros(len(mesh.triangles), dtype=np.int32))
    legacy.textures = [o3d.geometry.Image(np.ascontiguousarray(mesh.texture))]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=path.parent) as folder:
            if not o3d.io.write_triangle_mesh(str(Path(folder) / path.name), legacy):
                raise OutputError(f"{path}: cannot be written")
            # What the .obj file names is there before it is, and the image after the .mtl file that says whose it is.
            written = sorted(Path(folder).iterdir(), key=lambda file: (".mtl", ".png", ".obj").index(file.suffix))
            for file in written:
                check_output_file(path.parent / file.name)
                if file.suffix in MARKS:
                    file.write_bytes(MARKS[file.suffix] + file.read_bytes())
            for file in written:
                os.replace(file, path.parent / file.name)
    except OutputError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    return [path.parent / file.name for file in written]
