"""Surfaces with their photographs as texture, of a room whose colours are known at every point."""

import json
import struct
from dataclasses import replace

import cv2
import numpy as np
import open3d as o3d
import pytest
from depth_scene import camera_pose, render
from scipy.ndimage import map_coordinates

import adagmm_fusion.meshes.texturing as texturing_module
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.stale_results import is_marked
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.meshes.exposure import exposure_gains, matched_exposures
from adagmm_fusion.meshes.joined_grids import joined_surface, textured_moment
from adagmm_fusion.meshes.orientation import upright
from adagmm_fusion.meshes.texture_colors import texture_colors
from adagmm_fusion.meshes.textured_mesh import save_textured_mesh
from adagmm_fusion.meshes.texturing import Texturing
from adagmm_fusion.meshes.tsdf import TSDFVolume
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

INTRINSICS = PinholeIntrinsics(320, 240, 280.0, 280.0, 159.5, 119.5)
POSES = [camera_pose(-14.0, (0.0, 0.5, 1.2)), camera_pose(14.0, (0.1, -0.6, 1.3))]


def frame_at(pose, intrinsics=INTRINSICS, brightness: float = 1.0):
    color, depth = render(intrinsics, pose)
    color = (brightness * color).astype(np.uint8)
    return RGBDFrame("room", color, np.rint(1000.0 * depth).astype(np.uint16), intrinsics, 1000.0, "camera")


def true_colors(points):
    """(N, 3) 0..255, as depth_scene.render paints the world."""
    return 127.5 + 127.5 * np.sin(7.0 * points)


def texture_at(mesh, uvs):
    """(N, 3) colours 0..255 of the texture at (N, 2) coordinates, between pixels."""
    return sampled(mesh.texture, uvs)


def sampled(image, uvs):
    x, y = (uvs * image.shape[1::-1] - 0.5).T
    channels = np.moveaxis(image.astype(float), 2, 0)
    return np.stack([map_coordinates(channel, (y, x), order=1, mode="nearest") for channel in channels], axis=1)


def centers(mesh):
    """Middle of each triangle (K, 3), and the texture there (K, 3)."""
    return mesh.vertices[mesh.triangles].mean(axis=1), texture_at(mesh, mesh.uvs[mesh.triangles].mean(axis=1))


@pytest.fixture(scope="module")
def moment():
    return textured_moment([(frame_at(pose), pose) for pose in POSES], max_depth_m=5.0)


def test_every_triangle_has_the_colors_of_its_place(moment):
    points, colors = centers(moment)
    off = np.abs(colors - true_colors(points)).max(axis=1)
    assert len(points) > 20_000
    assert np.median(off) < 4.0 and np.percentile(off, 98) < 25.0


def test_lens_distortion_is_undone():
    bent = PinholeIntrinsics(320, 240, 280.0, 280.0, 159.5, 119.5, (0.15, -0.1, 0.001, -0.002))
    mesh = textured_moment([(frame_at(pose, bent), pose) for pose in POSES], max_depth_m=5.0)
    points, colors = centers(mesh)
    assert np.median(np.abs(colors - true_colors(points)).max(axis=1)) < 6.0


def test_where_sensors_overlap_there_is_no_seam():
    placed = [(frame_at(POSES[0]), POSES[0]), (frame_at(POSES[1], brightness=0.6), POSES[1])]
    mesh = textured_moment(placed, max_depth_m=5.0)
    # Vertices that are there once for each tile: the same place through the one and through the other photograph.
    _, place, times = np.unique(mesh.vertices, axis=0, return_inverse=True, return_counts=True)
    twice = np.flatnonzero(times[place] == 2)
    twice = twice[np.argsort(place[twice], kind="stable")].reshape(-1, 2)
    assert len(twice) > 50
    here, there = (texture_at(mesh, mesh.uvs[vertex]) for vertex in twice.T)
    bright = true_colors(mesh.vertices[twice[:, 0]]).mean(axis=1) > 100
    seam = np.abs(here - there).max(axis=1)[bright]
    assert np.median(seam) < 4.0 and np.percentile(seam, 90) < 20.0  # the photographs themselves differ by 40 % there


def test_overlapping_surface_is_there_once():
    placed = [(frame_at(pose), pose) for pose in POSES]
    area = joined_surface(placed, max_depth_m=5.0).get_surface_area()
    apart = sum(joined_surface([one], max_depth_m=5.0).get_surface_area() for one in placed)
    again = joined_surface([placed[0], placed[0]], max_depth_m=5.0).get_surface_area()
    assert area < 0.8 * apart
    assert again == pytest.approx(joined_surface(placed[:1], max_depth_m=5.0).get_surface_area(), rel=0.02)


def test_what_has_no_tile_keeps_the_fused_color_and_what_nobody_saw_is_left_out(monkeypatch):
    frames = [frame_at(pose) for pose in POSES]
    volume = TSDFVolume(0.03, max_depth_m=5.0)
    for frame, pose in zip(frames, POSES, strict=True):
        volume.integrate(frame, pose)
    surface = volume.mesh()
    hidden = o3d.geometry.TriangleMesh.create_box(0.2, 0.2, 0.2).translate((1.0, 0.0, -1.0))  # below the floor
    hidden.paint_uniform_color((1.0, 0.0, 1.0)).compute_vertex_normals()
    monkeypatch.setattr(texturing_module, "MAX_TILES", 1)
    texturing = Texturing(surface + hidden, max_depth_m=5.0)
    assert texturing.add(frames[0], POSES[0]) and not texturing.add(frames[1], POSES[1])
    mesh = texturing.mesh()
    assert mesh.texture.shape[0] > INTRINSICS.height  # patches below the one tile
    assert mesh.vertices[:, 2].min() > -0.5
    points, colors = centers(mesh)
    off = np.abs(colors - true_colors(points)).max(axis=1)
    patched = mesh.uvs[mesh.triangles][:, :, 1].min(axis=1) > INTRINSICS.height / mesh.texture.shape[0]
    assert np.count_nonzero(patched) > 300
    assert np.median(off[patched]) < 25.0 and np.median(off[~patched]) < 10.0


def test_the_same_view_is_not_taken_twice():
    surface = joined_surface([(frame_at(POSES[0]), POSES[0])], max_depth_m=5.0)
    texturing = Texturing(surface, max_depth_m=5.0)
    assert texturing.add(frame_at(POSES[0]), POSES[0]) and not texturing.add(frame_at(POSES[0]), POSES[0])


def test_a_surface_that_no_image_shows():
    surface = joined_surface([(frame_at(POSES[0]), POSES[0])], max_depth_m=5.0)
    away = POSES[0] @ np.diag((-1.0, 1.0, -1.0, 1.0))
    texturing = Texturing(surface, max_depth_m=5.0)
    assert not texturing.add(frame_at(POSES[0]), away)
    with pytest.raises(InputError, match="no colour image shows the surface"):
        texturing.mesh()


def test_glb_has_the_texture_in_it(moment, tmp_path):
    assert save_textured_mesh(tmp_path / "m.glb", moment) == [tmp_path / "m.glb"]
    data = (tmp_path / "m.glb").read_bytes()
    magic, version, length, json_length, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    scene, binary = json.loads(data[20 : 20 + json_length]), data[20 + json_length + 8 :]

    def view(number):
        where = scene["bufferViews"][number]
        return binary[where["byteOffset"] : where["byteOffset"] + where["byteLength"]]

    (primitive,) = scene["meshes"][0]["primitives"]
    uvs = scene["accessors"][primitive["attributes"]["TEXCOORD_0"]]
    np.testing.assert_array_equal(np.frombuffer(view(uvs["bufferView"]), "<f4").reshape(-1, 2), moment.uvs)
    image = cv2.imdecode(np.frombuffer(view(scene["images"][0]["bufferView"]), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(image[:, :, ::-1], moment.texture)
    assert all(where["byteOffset"] % 4 == 0 for where in scene["bufferViews"])
    read = o3d.io.read_triangle_mesh(str(tmp_path / "m.glb"))
    assert len(read.triangles) == len(moment.triangles) and read.has_triangle_uvs()


def test_obj_reads_back_with_its_texture(moment, tmp_path):
    paths = save_textured_mesh(tmp_path / "new" / "m.obj", moment)
    assert {path.suffix for path in paths} == {".obj", ".mtl", ".png"} and paths[-1].suffix == ".obj"
    assert set(paths) == set((tmp_path / "new").iterdir())
    assert [is_marked(path) for path in paths] == [True, False, True]
    read = o3d.io.read_triangle_mesh(str(paths[-1]), enable_post_processing=False)
    points = upright(np.asarray(read.vertices)[np.asarray(read.triangles)].mean(axis=1))
    uvs = np.asarray(read.triangle_uvs).reshape(-1, 3, 2).mean(axis=1)
    (texture,) = (np.asarray(image) for image in read.textures if not image.is_empty())
    colors = sampled(texture, uvs)
    assert len(points) == len(moment.triangles)
    assert np.median(np.abs(colors - true_colors(points)).max(axis=1)) < 5.0


def test_files_that_cannot_be_written(moment, tmp_path):
    with pytest.raises(OutputError, match=r"expected a name ending in \.glb or \.obj"):
        save_textured_mesh(tmp_path / "m.stl", moment)
    (tmp_path / "file").write_text("")
    for name in ("m.glb", "m.obj"):
        with pytest.raises(OutputError, match="cannot be written"):
            save_textured_mesh(tmp_path / "file" / name, moment)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_too_many_frames_and_none():
    for placed in ([], [(frame_at(POSES[0]), POSES[0])] * 17):
        with pytest.raises(InputError, match="expected 1 to 16 frames"):
            textured_moment(placed, max_depth_m=5.0)


def test_the_world_may_be_any(moment):
    moved = [(frame_at(pose), se_inverse(POSES[0]) @ pose) for pose in POSES]
    mesh = textured_moment(moved, max_depth_m=5.0)
    points, colors = centers(mesh)
    points = points @ POSES[0][:3, :3].T + POSES[0][:3, 3]
    assert np.median(np.abs(colors - true_colors(points)).max(axis=1)) < 4.0


def test_two_exposures_become_one(moment):
    """A camera with twice the light and another white balance than the other leaves no step where they meet."""
    gain = np.array((2.0, 1.6, 1.3)) ** (1.0 / 2.2)
    darkened = []
    for pose, factor in zip(POSES[:2], (1.0 / gain, 1.0), strict=True):
        frame = frame_at(pose)
        darkened.append((replace(frame, color=np.floor(frame.color * factor + 0.5).astype(np.uint8)), pose))
    surface = joined_surface(darkened, max_depth_m=5.0)
    texturing = Texturing(surface, max_depth_m=5.0, new_share=0.0)
    for frame, pose in darkened:
        texturing.add(frame, pose)
    points, normals = (np.asarray(a, np.float32) for a in (surface.vertices, surface.vertex_normals))
    gains = exposure_gains(texturing.views, points, normals)
    np.testing.assert_allclose(gains[0] / gains[1], (2.0, 1.6, 1.3), rtol=0.12, atol=0.0)
    np.testing.assert_allclose(gains[0] * gains[1], 1.0, rtol=1e-6, atol=0.0)
    first, second = (view.colors_at(points) for view in matched_exposures(texturing.views, points, normals))
    before = [view.colors_at(points) for view in texturing.views]
    both = np.all([view.quality(points, normals) > 0 for view in texturing.views], axis=0)
    assert np.median(np.abs(first - second)[both]) < 0.35 * np.median(np.abs(before[0] - before[1])[both])


def test_one_exposure_stays_as_it_is(moment):
    placed = [(frame_at(pose), pose) for pose in POSES[:2]]
    surface = joined_surface(placed, max_depth_m=5.0)
    texturing = Texturing(surface, max_depth_m=5.0, new_share=0.0)
    for frame, pose in placed:
        texturing.add(frame, pose)
    points, normals = (np.asarray(a, np.float32) for a in (surface.vertices, surface.vertex_normals))
    np.testing.assert_allclose(exposure_gains(texturing.views, points, normals), 1.0, rtol=0.05, atol=0.0)


def test_a_cloud_takes_its_colors_from_the_texture(moment):
    points, colors = centers(moment)
    found, near = texture_colors(moment, points, within_m=0.01)
    assert near.all() and np.median(np.abs(255.0 * found - colors).max(axis=1)) < 1.0
    assert not texture_colors(moment, points[:5] + 50.0, within_m=0.01)[1].any()
