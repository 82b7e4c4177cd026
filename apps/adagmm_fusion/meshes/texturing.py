"""A surface textured with photographs of it, made alike in exposure and white balance and blended where they overlap.

The texture is an atlas of one tile for each photograph. A tile is the surface as that camera sees it, each of its
pixels mixed from all photographs that see the same point of the surface, by how well they do. A triangle's texture
coordinates are where the camera that shows it best sees it. The mixture depends on the point alone, not on the tile, so
there is no seam where triangles of different tiles meet. Triangles that only photographs without a tile show keep the
fused colour of their vertices: a flat patch each, below the tiles. Those that no photograph shows are left out: nobody
saw them, they are the back that fusion gives to every surface.
"""

import numpy as np
import open3d as o3d

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.meshes.exposure import matched_exposures
from adagmm_fusion.meshes.texture_views import TextureView, texture_view
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_o3d.errors import InputError

# Tiles at most, and a patch's edge in pixels.
MAX_TILES, PATCH = 16, 4
# A further photograph is taken where it shows this share of the surface that none before does.
NEW_SHARE = 0.02


class Texturing:
    """Collects photographs of a surface, as many as show more of it, and then makes the textured mesh.

    Only the photographs that are used are kept. `new_share` is how much of the surface a further one has to show that
    none before does; `surface` has vertex normals, and colours if some photographs may have no tile.
    """

    def __init__(self, surface: o3d.geometry.TriangleMesh, *, max_depth_m: float, new_share: float = NEW_SHARE) -> None:
        self._surface, self._max_depth_m, self._new_share = surface, max_depth_m, new_share
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(surface))
        self._vertices = np.asarray(surface.vertices, dtype=np.float32)
        self._triangles = np.asarray(surface.triangles, dtype=np.int32)
        corners = self._vertices[self._triangles]
        self._centers = corners.mean(axis=1)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        self._best = np.zeros(len(self._triangles), np.float32)
        self._seen = np.zeros(len(self._triangles), bool)
        self._tile_of = np.full(len(self._triangles), -1)
        self.views: list[TextureView] = []

    def add(self, frame: RGBDFrame, T_world_camera: np.ndarray) -> bool:
        """Use a frame if it shows enough that none before does; says whether it is used."""
        view = texture_view(frame, T_world_camera, self._scene, self._max_depth_m)
        quality = self._quality(view)
        self._seen |= quality > 0
        if len(self.views) == MAX_TILES or np.mean((quality > 0) & (self._best == 0)) < self._new_share:
            return False
        better = quality > self._best
        self._best[better] = quality[better]
        self._tile_of[better] = len(self.views)
        self.views.append(view)
        return True

    def mesh(self) -> TexturedMesh:
        """The surface with its texture. Raises InputError if no frame shows any of it."""
        if not self.views:
            raise InputError("no colour image shows the surface; are the poses those of the frames that it is made of?")
        normals = np.asarray(self._surface.vertex_normals, np.float32)
        matched = matched_exposures(self.views, self._vertices, normals)
        tiles = [_blended(view, matched) for view in matched]
        surface, tile_of = self._triangles[self._seen], self._tile_of[self._seen]
        patched = np.flatnonzero(tile_of < 0)
        atlas = _Atlas([view.size for view in self.views], len(patched))
        texture = atlas.image(tiles, self._fused_colors(surface[patched]))

        # A vertex for each tile that its triangles are in; the corners of a flat patch are its own.
        corner_tile = np.repeat(tile_of, 3)
        corner_tile[corner_tile < 0] = len(tiles) + np.repeat(np.arange(len(patched)), 3)
        keys = surface.ravel().astype(np.int64) * (len(tiles) + len(patched)) + corner_tile
        _, first, triangles = np.unique(keys, return_index=True, return_inverse=True)
        vertex, tile = surface.ravel()[first], corner_tile[first]
        pixels = np.empty((len(first), 2), np.float32)
        for i, view in enumerate(self.views):
            pixels[tile == i] = view.project(self._vertices[vertex[tile == i]])[0] + atlas.tile_origin(i)
        flat = tile >= len(tiles)
        pixels[flat] = atlas.patch_centers(tile[flat] - len(tiles))
        uvs = (pixels + 0.5) / np.array(texture.shape[1::-1], np.float32)
        return TexturedMesh(
            vertices=self._vertices[vertex],
            normals=normals[vertex],
            triangles=triangles.reshape(-1, 3).astype(np.int32),
            uvs=np.clip(uvs, 0.0, 1.0).astype(np.float32),
            texture=texture,
        )

    def _fused_colors(self, triangles: np.ndarray) -> np.ndarray:
        """(k, 3) uint8: the mean colour of each triangle's vertices."""
        if not len(triangles):
            return np.zeros((0, 3), np.uint8)
        colors = np.asarray(self._surface.vertex_colors)[triangles].mean(axis=1)
        return np.floor(255.0 * colors + 0.5).astype(np.uint8)

    def _quality(self, view: TextureView) -> np.ndarray:
        """(K,): how well a photograph shows each triangle; 0 unless all of it is inside."""
        pixels, z = view.project(self._vertices)
        width, height = view.size
        inside = (z > 0) & (pixels >= 0).all(axis=1) & (pixels[:, 0] <= width - 1) & (pixels[:, 1] <= height - 1)
        return view.quality(self._centers, self._normals) * inside[self._triangles].all(axis=1)


def _blended(tile: TextureView, views: list[TextureView]) -> np.ndarray:
    """(H, W, 3) uint8: the surface as `tile` sees it, in the colours of all views; its own where none sees it well."""
    total = np.zeros(tile.surface_z.shape, np.float32)
    mixed = np.zeros(tile.color.shape, np.float32)
    for view in views:
        weight = view.quality(tile.points, tile.normals)
        total += weight
        mixed += weight[..., None] * view.colors_at(tile.points)
    known = total > 0
    blended = tile.color.copy()
    blended[known] = np.floor(mixed[known] / total[known][:, None] + 0.5).astype(np.uint8)
    return blended


class _Atlas:
    """Where tiles and patches lie in one image: tiles in a grid, patches in rows below."""

    def __init__(self, sizes: list[tuple[int, int]], patches: int) -> None:
        self._columns = int(np.ceil(np.sqrt(len(sizes))))
        self._cell = np.max(sizes, axis=0)
        self._tile_rows = -(-len(sizes) // self._columns)
        self._width = self._columns * int(self._cell[0])
        self._per_row = self._width // PATCH
        self._patch_rows = -(-patches // self._per_row)

    def tile_origin(self, i: int) -> np.ndarray:
        return self._cell * (i % self._columns, i // self._columns)

    def patch_centers(self, i: np.ndarray) -> np.ndarray:
        """(n, 2) pixels, (x, y), of the middles of patches (n,)."""
        corners = np.stack((i % self._per_row, i // self._per_row), axis=-1) * PATCH
        return corners + (0, self._tile_rows * int(self._cell[1])) + (PATCH - 1) / 2

    def image(self, tiles: list[np.ndarray], patch_colors: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8."""
        tile_height = self._tile_rows * int(self._cell[1])
        texture = np.zeros((tile_height + self._patch_rows * PATCH, self._width, 3), np.uint8)
        for i, tile in enumerate(tiles):
            x, y = self.tile_origin(i)
            texture[y : y + tile.shape[0], x : x + tile.shape[1]] = tile
        patches = np.zeros((self._patch_rows * self._per_row, 3), np.uint8)
        patches[: len(patch_colors)] = patch_colors
        grid = patches.reshape(self._patch_rows, self._per_row, 3).repeat(PATCH, axis=0).repeat(PATCH, axis=1)
        texture[tile_height:, : grid.shape[1]] = grid
        return texture
