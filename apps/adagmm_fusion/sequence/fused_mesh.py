"""Frames at known poses as one mesh: coloured, or textured with their images."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_fusion.meshes.joined_grids import textured_moment
from adagmm_fusion.meshes.textured_mesh import TexturedMesh, save_textured_mesh
from adagmm_fusion.meshes.texturing import Texturing
from adagmm_fusion.meshes.tsdf import TSDFVolume, save_mesh
from adagmm_fusion.recordings.frame_sequence import Recording

# For up to this many frames the surface is made of the images' own grids. A voxel grid is better where each place has
# several views.
MAX_JOINED = 4


def fuse_frames(
    recording: Recording,
    placed: dict[int, np.ndarray],
    *,
    textured: bool,
    voxel_size_m: float,
    max_depth_m: float,
    max_memory_mb: float,
    progress: Callable[[str, int, int], None],
) -> tuple[TexturedMesh | o3d.geometry.TriangleMesh, str]:
    """The mesh of frames with their T_world_camera (4, 4), loaded one at a time, and a few words on how it was made.

    Raises
    ------
    InputError  if there is no surface, or the voxels need more memory than allowed.    RecordingError  as loading does.
    """
    if textured and 0 < len(placed) <= MAX_JOINED:
        frames = [(recording.entries[index].load(), pose) for index, pose in placed.items()]
        return textured_moment(frames, max_depth_m=max_depth_m), "joined from the depth images"
    volume = TSDFVolume(voxel_size_m, max_depth_m=max_depth_m, max_memory_mb=max_memory_mb)
    for done, (index, pose) in enumerate(placed.items()):
        progress("fusing", done, len(placed))
        volume.integrate(recording.entries[index].load(), pose)
    surface, note = volume.mesh(), f"{volume.memory_mb:.0f} MB of voxels"
    del volume
    if not textured:
        return surface, note
    texturing = Texturing(surface, max_depth_m=max_depth_m)
    for done, (index, pose) in enumerate(placed.items()):
        progress("texturing", done, len(placed))
        texturing.add(recording.entries[index].load(), pose)
    return texturing.mesh(), f"{len(texturing.views)} images as texture, {note}"


def save_fused_mesh(path: Path, mesh: TexturedMesh | o3d.geometry.TriangleMesh) -> list[Path]:
    """Write a mesh in its ending's format; returns the files. Raises OutputError if it cannot be written."""
    if isinstance(mesh, TexturedMesh):
        return save_textured_mesh(path, mesh)
    save_mesh(path, mesh)
    return [path]
