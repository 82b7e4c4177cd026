"""Frames at known poses fused into one coloured mesh, through a truncated signed distance in a sparse voxel grid."""

from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import replacing
from adagmm_fusion.files.ply_file import ply_bytes
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.glb_file import colored_glb
from adagmm_fusion.meshes.orientation import upright
from adagmm_fusion.meshes.pinhole_images import pinhole_images
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

BLOCK_RESOLUTION = 8  # voxels a side
BYTES_PER_VOXEL = 4 + 4 + 3 * 4
TRUNCATION_VOXELS = 8.0
# Islands of fewer triangles are noise, not surfaces.
MIN_ISLAND_TRIANGLES = 200
VOXEL_SIZES_M = (1e-4, 10.0)  # finer ones have no numbers left
MESH_SUFFIXES = (".ply", ".glb")


def check_voxels(voxel_size_m: float, max_memory_mb: float) -> None:
    """Raise InputError unless there can be such voxels."""
    for name, value in (("voxel_size", voxel_size_m), ("max_memory", max_memory_mb)):
        if not 0 < value < float("inf"):
            raise InputError(f"{name}: expected a positive number, got {value}")
    if not VOXEL_SIZES_M[0] <= voxel_size_m <= VOXEL_SIZES_M[1]:
        wanted = f"{VOXEL_SIZES_M[0]:g} to {VOXEL_SIZES_M[1]:g} m"
        raise InputError(f"voxel_size: expected {wanted}, got {voxel_size_m:g}")


class TSDFVolume:
    """The scene as fused so far. Its memory grows with the surface seen, not with the frames, up to a limit.

    voxel_size_m : edge of a voxel.    max_depth_m : measurements farther away are ignored.
    max_memory_mb : of the voxels.
    """

    def __init__(self, voxel_size_m: float, *, max_depth_m: float, max_memory_mb: float = 2000.0) -> None:
        check_voxels(voxel_size_m, max_memory_mb)
        self.voxel_size_m, self.max_depth_m, self.max_memory_mb = voxel_size_m, max_depth_m, max_memory_mb
        self.frames = 0
        float32 = o3d.core.float32
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"),
            (float32, float32, float32),
            ((1), (1), (3)),
            voxel_size_m,
            BLOCK_RESOLUTION,
            1000,
        )

    @property
    def memory_mb(self) -> float:
        return self._grid.hashmap().size() * BLOCK_RESOLUTION**3 * BYTES_PER_VOXEL / 1e6

    def integrate(self, frame: RGBDFrame, T_world_camera: np.ndarray) -> None:
        """Add a frame; depth at edges is left out, lens distortion is undone.

        Raises
        ------
        InputError  if the voxels would need more memory than allowed.
        """
        depth, color = pinhole_images(frame, self.max_depth_m)
        color = np.ascontiguousarray(color.astype(np.float32) / 255.0)
        images = [o3d.t.geometry.Image(o3d.core.Tensor(image)) for image in (depth, color)]
        matrices = (o3d.core.Tensor(m) for m in (frame.intrinsics.matrix(), se_inverse(T_world_camera)))
        K, T_camera_world = matrices
        if not (depth > 0).any():
            return
        blocks = self._grid.compute_unique_block_coordinates(
            images[0], K, T_camera_world, 1.0, self.max_depth_m, TRUNCATION_VOXELS
        )
        self._grid.integrate(blocks, *images, K, T_camera_world, 1.0, self.max_depth_m, TRUNCATION_VOXELS)
        self.frames += 1
        if self.memory_mb > self.max_memory_mb:
            raise InputError(
                f"{frame.name}: the voxels take more than {self.max_memory_mb:g} MB after {self.frames} frames; take a "
                f"larger --voxel-size than {self.voxel_size_m:g} m, or allow more with --max-memory"
            )

    def mesh(self) -> o3d.geometry.TriangleMesh:
        """The surface with normals and colours 0..1, small islands left out. Raises InputError if there is none."""
        weight = 0.5 if self.frames < 6 else 2.0
        surface = self._grid.extract_triangle_mesh(weight_threshold=weight) if self.frames else None
        mesh = o3d.geometry.TriangleMesh() if surface is None else surface.to_legacy()
        if len(mesh.triangles):
            islands, sizes, _ = mesh.cluster_connected_triangles()
            mesh.remove_triangles_by_mask(np.asarray(sizes)[np.asarray(islands)] < MIN_ISLAND_TRIANGLES)
            mesh.remove_unreferenced_vertices()
        if not len(mesh.triangles):
            raise InputError(f"the {self.frames} fused frames leave no surface; check depth scale and --max-depth")
        mesh.vertex_colors = o3d.utility.Vector3dVector(np.clip(np.asarray(mesh.vertex_colors), 0.0, 1.0))
        mesh.compute_vertex_normals()
        return mesh


def save_mesh(path: Path, mesh: o3d.geometry.TriangleMesh) -> None:
    """Write a .ply or .glb file, y up. Raises OutputError if it cannot be written, or has another ending."""
    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise OutputError(f"{path}: expected a name ending in {' or '.join(MESH_SUFFIXES)}")
    with replacing(path) as temporary:
        vertices, normals, colors, triangles = map(
            np.asarray, (mesh.vertices, mesh.vertex_normals, mesh.vertex_colors, mesh.triangles)
        )
        if path.suffix.lower() == ".glb":
            temporary.write_bytes(colored_glb(vertices, normals, colors, triangles))
        else:
            temporary.write_bytes(ply_bytes(upright(vertices), colors, upright(normals), triangles))
