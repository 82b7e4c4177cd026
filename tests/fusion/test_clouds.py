"""Clouds and textured grids from depth images whose geometry is known."""

import numpy as np
import pytest
from depth_scene import BALL_CENTRE, BALL_RADIUS, PLANES, camera_pose, render

from adagmm_fusion.clouds.building import (
    cloud_from_frame,
    clouds_from_pair,
    dense_cloud,
    find_voxel_size,
)
from adagmm_fusion.clouds.sensor_models import sensor_models
from adagmm_fusion.frames.depth_geometry import depth_edges, depth_noise, grid_normals, pixel_rays
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.meshes.depth_grid import textured_grid
from adagmm_o3d.errors import InputError
from adagmm_o3d.uncertainty import estimate_kinect_covariances

INTRINSICS = PinholeIntrinsics(320, 240, 280.0, 282.0, 158.0, 121.0)
DISTORTED = PinholeIntrinsics(320, 240, 260.0, 258.0, 159.0, 127.0, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
POSE = camera_pose(10.0)


def room_frame(intrinsics=INTRINSICS, pose=POSE, noise=0.0):
    color, depth = render(intrinsics, pose)
    depth = depth + noise * np.random.default_rng(0).normal(size=depth.shape)
    return RGBDFrame("frame 0", color, depth, intrinsics, 1.0, "left")


def plain_frame(depth, depth_scale=1.0):
    color = np.zeros((*depth.shape, 3), np.uint8)
    return RGBDFrame("frame 0", color, depth, INTRINSICS, depth_scale, "left")


def distance_to_room(points, pose=POSE):
    """[m], of camera frame points to the nearest surface of the room."""
    world = points @ pose[:3, :3].T + pose[:3, 3]
    distances = [np.abs(world @ normal - offset) for normal, offset in PLANES]
    distances.append(np.abs(np.linalg.norm(world - BALL_CENTRE, axis=1) - BALL_RADIUS))
    return np.min(distances, axis=0)


@pytest.mark.parametrize("intrinsics", [INTRINSICS, DISTORTED])
def test_dense_points_lie_on_the_room_and_keep_their_colour(intrinsics):
    frame = room_frame(intrinsics)
    cloud = dense_cloud(frame)
    points = np.asarray(cloud.points)
    assert len(points) > 0.9 * 320 * 240
    # float32 metres at a few metres' distance
    np.testing.assert_allclose(distance_to_room(points), 0.0, rtol=0, atol=2e-6)
    world = points @ POSE[:3, :3].T + POSE[:3, 3]
    expected = (127.5 + 127.5 * np.sin(7.0 * world)) / 255.0
    np.testing.assert_allclose(np.asarray(cloud.colors), expected, rtol=0, atol=1.01 / 255.0)


def test_rays_undo_distortion_everywhere():
    import cv2

    rays = pixel_rays(DISTORTED).reshape(-1, 2)
    homogeneous = np.column_stack((rays, np.ones(len(rays))))
    pixels, _ = cv2.projectPoints(
        homogeneous, np.zeros(3), np.zeros(3), DISTORTED.matrix(), np.array(DISTORTED.distortion)
    )
    v, u = np.indices((240, 320))
    np.testing.assert_allclose(pixels.reshape(240, 320, 2), np.stack((u, v), axis=-1), rtol=0, atol=1e-5)


def test_distortion_that_folds_over_is_refused():
    folded = PinholeIntrinsics(40, 30, 35.0, 35.0, 20.0, 15.0, (-3.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="distortion: cannot be undone"):
        pixel_rays(folded)


def test_normals_are_the_planes_normals_towards_the_camera():
    frame = room_frame()
    depth = frame.depth_m()
    normals = grid_normals(depth, INTRINSICS).reshape(-1, 3)
    rays = pixel_rays(INTRINSICS).reshape(-1, 2)
    points = np.column_stack((rays, np.ones(len(rays)))) * depth.reshape(-1, 1)
    usable = np.isfinite(normals[:, 0])
    assert usable.mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(normals[usable], axis=1), 1.0, rtol=0, atol=1e-12)
    assert ((normals * points).sum(axis=1)[usable] < 0).all()
    # The floor away from the ball and the walls: its normal is up, in the camera's frame.
    world = points @ POSE[:3, :3].T + POSE[:3, 3]
    floor = usable & (world[:, 2] < 1e-4) & (world[:, 0] < 2.0) & (np.abs(world[:, 1]) < 0.9)
    floor &= np.linalg.norm(world - BALL_CENTRE, axis=1) > 0.8
    assert floor.sum() > 1000
    up = np.broadcast_to(POSE[:3, :3].T @ (0.0, 0.0, 1.0), (floor.sum(), 3))
    np.testing.assert_allclose(normals[floor], up, rtol=0, atol=2e-3)


def test_normals_stay_sharp_at_a_crease_under_noise():
    frame = room_frame(noise=0.001)
    depth = frame.depth_m()
    normals = grid_normals(depth, INTRINSICS)
    rays = pixel_rays(INTRINSICS)
    world = (np.dstack((rays, np.ones(depth.shape))) * depth[..., None]) @ POSE[:3, :3].T + POSE[:3, 3]
    # Within two window widths of the crease between floor and back wall, away from everything else.
    floor_gap, wall_gap = np.abs(world[..., 2]), np.abs(world[..., 0] - 2.5)
    near = (np.minimum(floor_gap, wall_gap) < 0.01) & (np.maximum(floor_gap, wall_gap) < 0.15)
    near &= (np.abs(world[..., 1] + 0.2) < 1.0) & (np.linalg.norm(world - BALL_CENTRE, axis=-1) > 0.7)
    assert near.sum() > 500
    true = np.where((floor_gap < wall_gap)[..., None], (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)) @ POSE[:3, :3]
    angle = np.degrees(np.arccos(np.clip((normals * true).sum(axis=-1), -1, 1)))
    assert np.nanpercentile(angle[near], 90) < 3.0


def test_pixels_at_depth_edges_are_left_out():
    depth = np.full((240, 320), 2.0)
    depth[100:140, 150:170] = 1.0
    depth[99, 150:170] = 1.5  # a row of points in mid-air
    edges = depth_edges(depth.astype(np.float32), INTRINSICS)
    assert edges[98:101, 150:170].all() and edges[120, 149] and edges[120, 150]
    assert not edges[120, 152:168].any() and not edges[:95].any()
    z = np.asarray(dense_cloud(plain_frame(depth)).points)[:, 2]
    assert set(np.unique(z)) == {1.0, 2.0}


def test_steep_surfaces_and_holes_are_no_edges():
    ray = pixel_rays(INTRINSICS)[..., 0]
    steep = (2.0 / (1.0 + np.tan(np.radians(80.0)) * (ray - ray.min()))).astype(np.float32)  # seen at up to 80 degrees
    assert not depth_edges(steep, INTRINSICS).any()
    holes = np.full((240, 320), 2.0, np.float32)
    holes[::7, ::5] = np.nan
    assert not depth_edges(holes, INTRINSICS).any()


@pytest.mark.parametrize("target_points", [300, 1000, 3500])
def test_voxels_leave_about_the_points_asked_for(target_points):
    cloud = cloud_from_frame(room_frame(), target_points=target_points)
    assert abs(len(cloud.points) / target_points - 1) < 0.05
    np.testing.assert_allclose(distance_to_room(np.asarray(cloud.points)), 0.0, rtol=0, atol=0.03)


def test_a_voxel_size_is_used_as_given():
    frame = room_frame()
    cloud = cloud_from_frame(frame, voxel_size=0.1)
    assert len(cloud.points) == len(dense_cloud(frame).voxel_down_sample(0.1).points)


def test_a_pair_shares_one_voxel_size():
    a, b = room_frame(), room_frame(pose=camera_pose(-20.0, (0.9, 0.1, 1.0)))
    source, target = clouds_from_pair(RGBDPair("b-a", b, a, None, 0), target_points=1000)
    assert abs((len(source.points) + len(target.points)) / 2000 - 1) < 0.05
    size = find_voxel_size([dense_cloud(b), dense_cloud(a)], 1000)
    assert len(source.points) == len(dense_cloud(b).voxel_down_sample(size).points)


def test_a_small_cloud_stays_whole():
    depth = np.zeros((240, 320))
    depth[100:120, 100:120] = 1.0
    frame = plain_frame(depth)
    assert len(cloud_from_frame(frame).points) == len(dense_cloud(frame).points)


@pytest.mark.parametrize("sensor_model", sensor_models())
def test_covariances_come_from_the_sensor_model(sensor_model):
    cloud = cloud_from_frame(room_frame(), sensor_model=sensor_model)
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    assert ((points * normals).sum(axis=1) < 0).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-9)
    assert cloud.has_covariances() == (sensor_model != "none")
    if sensor_model == "none":
        return
    covariances = np.asarray(cloud.covariances)
    assert (np.linalg.eigvalsh(covariances) > 0).all()
    if sensor_model == "kinect":
        expected = estimate_kinect_covariances(points, normals)
        np.testing.assert_allclose(covariances, expected, rtol=1e-12, atol=0)
    if sensor_model == "nguyen":  # metric: millimetres to centimetres in a room
        assert 1e-3 < np.sqrt(np.median(np.linalg.eigvalsh(covariances)[:, 2])) < 1e-1
    if sensor_model == "kinect-surface":
        across = np.einsum("ni,nij,nj->n", normals, covariances, normals)
        assert 1e-3 < np.sqrt(np.median(across)) < 1e-2
        along = (np.trace(covariances, axis1=1, axis2=2) - across) / 2
        assert np.sqrt(np.median(along)) > np.median(cloud.compute_nearest_neighbor_distance())
    if sensor_model == "surface":
        across = np.einsum("ni,nij,nj->n", normals, covariances, normals)
        np.testing.assert_allclose(across, 1e-3, rtol=1e-6, atol=0)


def test_depth_limits_are_kept():
    z = np.asarray(dense_cloud(room_frame(), min_depth=1.5, max_depth=2.0).points)[:, 2]
    assert z.min() >= 1.5 and z.max() <= 2.0 and np.ptp(z) > 0.4


@pytest.mark.parametrize(
    "depth, depth_scale, match",
    [
        (np.zeros((240, 320), np.uint16), 1000.0, "the image has no depth at all"),
        (
            np.full((240, 320), 2000, np.uint16),
            1.0,
            "depth from 2e.03 to 2e.03 m; check depth_scale .1 units per metre",
        ),
        (np.eye(240, 320), 1.0, "the cloud is empty"),
    ],
)
def test_an_empty_cloud_says_why(depth, depth_scale, match):
    with pytest.raises(InputError, match=match) as caught:
        cloud_from_frame(plain_frame(depth, depth_scale))
    assert str(caught.value).startswith("frame 0: left: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options, match",
    [
        ({"voxel_size": 0.0}, "voxel_size"),
        ({"voxel_size": float("nan")}, "voxel_size"),
        ({"target_points": 0}, "target_points"),
        (
            {"sensor_model": "sonar"},
            "sensor_model: expected one of kinect-surface, kinect, nguyen, surface, none, got 'sonar'",
        ),
        ({"min_depth": 2.0, "max_depth": 1.0}, "min_depth, max_depth"),
        ({"max_depth": float("nan")}, "min_depth, max_depth"),
    ],
)
def test_bad_options_are_named(options, match):
    with pytest.raises(InputError, match=match):
        cloud_from_frame(room_frame(), **options)


@pytest.mark.parametrize("intrinsics", [INTRINSICS, DISTORTED])
@pytest.mark.parametrize("step", [1, 2, 5])
def test_grid_lies_on_the_room_faces_the_camera_and_shows_its_colours(intrinsics, step):
    frame = room_frame(intrinsics)
    vertices, triangles, uvs = textured_grid(frame, step=step)
    assert vertices.dtype == np.float64 and triangles.dtype == np.int32 and uvs.dtype == np.float32
    assert len(vertices) == len(uvs) and set(np.unique(triangles)) == set(range(len(vertices)))
    np.testing.assert_allclose(distance_to_room(vertices), 0.0, rtol=0, atol=2e-6 if step == 1 else 0.02 * step)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    assert ((np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0).all()
    # The texture at a vertex is the colour of the world there.
    u, v = np.floor(uvs * (320, 240)).astype(int).T
    world = vertices @ POSE[:3, :3].T + POSE[:3, 3]
    expected = 127.5 + 127.5 * np.sin(7.0 * world)
    assert np.median(np.abs(frame.color[v, u] - expected)) < 4 * step


def test_no_triangle_crosses_a_depth_edge():
    depth = np.full((240, 320), 2.0)
    depth[100:140, 150:170] = 1.0
    vertices, triangles, _ = textured_grid(plain_frame(depth), step=2)
    corners = vertices[triangles][..., 2]
    assert (np.ptp(corners, axis=1) == 0).all() and {1.0, 2.0} == set(np.unique(corners))


def test_a_whole_image_is_covered():
    vertices, triangles, uvs = textured_grid(plain_frame(np.full((240, 320), 2.0)), step=4)
    assert len(vertices) == 60 * 80 and len(triangles) == 2 * 59 * 79
    np.testing.assert_allclose(uvs[[0, -1]], [[2 / 320, 2 / 240], [318 / 320, 238 / 240]], rtol=1e-6, atol=0)


@pytest.mark.parametrize("step", [0, 121, 2.0, True])
def test_grid_step_is_checked(step):
    with pytest.raises(InputError, match="step: expected 1 to 120 pixels"):
        textured_grid(plain_frame(np.full((240, 320), 2.0)), step=step)


def test_grid_without_surface_is_an_error():
    with pytest.raises(InputError, match="frame 0: left: no surface"):
        textured_grid(plain_frame(np.zeros((240, 320))))


def test_a_noisy_sensor_keeps_its_surfaces_and_loses_its_edges():
    """Noise of 12 cm at 2 m looks like edges everywhere."""
    intrinsics = PinholeIntrinsics(160, 120, 131.0, 131.0, 79.5, 59.5)
    color, depth = render(intrinsics, camera_pose(0.0))
    noise = 0.03 * depth**2
    noisy = depth + np.random.default_rng(0).normal(size=depth.shape) * noise
    frame = RGBDFrame("noisy", color, noisy, intrinsics, 1.0, "sensor")
    np.testing.assert_allclose(np.nanmedian(depth_noise(frame.depth_m()) / noise), 1.0, rtol=0.1, atol=0)
    assert depth_edges(frame.depth_m(), intrinsics).mean() > 0.5
    assert len(dense_cloud(frame).points) > 0.7 * depth.size
