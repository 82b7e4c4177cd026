"""The depth images of a few sensors at one moment joined into one surface, textured with their colour images.

A few depth images leave most of a voxel grid seen once or never, so the surface keeps the images' own grids: of each
the part that no other shows better.
"""

from collections.abc import Sequence

import numpy as np
import open3d as o3d

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.depth_grid import textured_grid
from adagmm_fusion.meshes.texture_views import texture_view
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.meshes.texturing import MAX_TILES, Texturing
from adagmm_o3d.errors import InputError

# Vertices across the image's width.
GRID_COLUMNS = 160
# Surfaces this near each other are one, seen twice: so large are the errors of sensors and poses.
SAME_SURFACE_M, SAME_SURFACE_SHARE = 0.03, 0.02


def textured_moment(placed: Sequence[tuple[RGBDFrame, np.ndarray]], *, max_depth_m: float) -> TexturedMesh:
    """The surface that frames show, each given with its T_world_camera (4, 4), in the world, their colours blended.

    Raises
    ------
    InputError  if there are more frames than a texture has room for, or one shows no surface up to max_depth_m.
    """
    if not 1 <= len(placed) <= MAX_TILES:
        raise InputError(f"placed: expected 1 to {MAX_TILES} frames, got {len(placed)}")
    texturing = Texturing(joined_surface(placed, max_depth_m=max_depth_m), max_depth_m=max_depth_m, new_share=0.0)
    for frame, T_world_camera in placed:
        texturing.add(frame, T_world_camera)
    return texturing.mesh()


def joined_surface(placed: Sequence[tuple[RGBDFrame, np.ndarray]], *, max_depth_m: float) -> o3d.geometry.TriangleMesh:
    """The grids of all frames in the world, without what another frame shows better; with normals."""
    grids = [_grid(frame, T_world_camera, max_depth_m) for frame, T_world_camera in placed]
    views = [texture_view(*at, _scene(grid), max_depth_m) for at, grid in zip(placed, grids, strict=True)]
    joined = o3d.geometry.TriangleMesh()
    for i, grid in enumerate(grids):
        vertices, normals = (np.asarray(a, np.float32) for a in (grid.vertices, grid.vertex_normals))
        own = views[i].quality(vertices, normals)
        better_elsewhere = np.zeros(len(vertices), bool)
        for j, view in enumerate(views):
            if j != i:
                z = view.project(vertices)[1]
                same = np.abs(view.surface_at(vertices) - z) < SAME_SURFACE_M + SAME_SURFACE_SHARE * z
                theirs = view.quality(vertices, normals)
                better_elsewhere |= same & ((theirs > own) | ((theirs == own) & (j < i)))
        # A triangle on the border stays, so that the parts overlap and no crack shows.
        grid.remove_triangles_by_mask(better_elsewhere[np.asarray(grid.triangles)].all(axis=1))
        # Later frames are compared with what is left of this one: else each of two might leave a place to the other.
        views[i] = texture_view(*placed[i], _scene(grid), max_depth_m)
        joined += grid
    return joined.remove_unreferenced_vertices()


def _grid(frame: RGBDFrame, T_world_camera: np.ndarray, max_depth_m: float) -> o3d.geometry.TriangleMesh:
    step = max(1, frame.intrinsics.width // GRID_COLUMNS)
    vertices, triangles, _ = textured_grid(frame, step=step, max_depth=max_depth_m)
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    return mesh.compute_vertex_normals().transform(T_world_camera)


def _scene(mesh: o3d.geometry.TriangleMesh) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    return scene
