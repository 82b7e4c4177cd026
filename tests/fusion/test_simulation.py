"""The simulated recording: the shipped one can be made again, its rig is exact, its sensor has a Kinect's defects."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from shared_data import ROOT
from tiny_recording import small_sensor

from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import load_rig
from adagmm_fusion.simulation import kinect, textures
from adagmm_fusion.simulation.parts import Box, Ellipsoid, Lathe, Part, at, cylinder
from adagmm_fusion.simulation.raycast import Scene
from adagmm_fusion.simulation.recording import (
    DEFAULT_SEED,
    SOURCE,
    T_WORLD_CAMERA,
    TARGET,
    look_at,
    render_pair,
    simulate_recording,
    simulated_rig,
)
from adagmm_fusion.simulation.room import furnish
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

SHIPPED = ROOT / "recordings" / "two_kinects"
RIG_FILE = ROOT / "calibration" / "two_kinects.yaml"
# The camera stands at the origin of the world and looks along y; z is up.
FORWARD = look_at((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0)
CAMERA = PinholeIntrinsics(160, 120, 131.25, 131.25, 79.5, 59.5)


def wall(distance: float, turn_deg: float = 0.0, **more) -> Part:
    """A large wall at a distance along the optical axis, turned about the vertical."""
    pose = at(0.0, distance, 0.0) @ at(0.0, 0.0, 0.0, turn_deg) @ at(0.0, 0.05, 0.0)
    return Part(Box((30.0, 0.1, 30.0)), textures.plain([0.5, 0.5, 0.5]), pose, **more)


def depth_of(*parts: Part, seed: int = 0, model: kinect.KinectModel | None = None) -> np.ndarray:
    return kinect.render_depth(
        Scene(parts), FORWARD, np.random.default_rng(seed), model or kinect.KinectModel(), CAMERA
    )


@pytest.mark.slow
def test_the_shipped_pair_can_be_made_again():
    pair = open_recording(SHIPPED)[0]
    images = render_pair(DEFAULT_SEED, 0)
    for frame in (pair.target, pair.source):
        color, depth = images[frame.sensor]
        # Identical on the platform it was made on; elsewhere the ray caster may round some pixels to the next step.
        assert np.mean(depth == frame.depth) > 0.999
        assert np.abs(color.astype(int) - frame.color).mean() < 4.0  # JPEG


def test_the_shipped_rig_is_the_simulated_one():
    shipped, exact = load_rig(RIG_FILE), simulated_rig("two_kinects")
    assert list(shipped.sensors) == [TARGET, SOURCE]
    for name, sensor in exact.sensors.items():
        assert shipped.sensors[name].intrinsics == sensor.intrinsics
        np.testing.assert_allclose(shipped.sensors[name].T_rig_sensor, sensor.T_rig_sensor, rtol=0, atol=1e-12)
    angle_deg = np.rad2deg(np.arccos((np.trace(exact.T_target_source(TARGET, SOURCE)[:3, :3]) - 1.0) / 2.0))
    assert 25.0 < angle_deg < 35.0


def test_the_ground_truth_brings_the_two_frames_together():
    pair = open_recording(SHIPPED)[1]
    target, source = (_points_and_colors(frame) for frame in (pair.target, pair.source))
    moved = source[0] @ pair.T_target_source[:3, :3].T + pair.T_target_source[:3, 3]
    tree = o3d.geometry.KDTreeFlann(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(target[0])))
    nearest = [tree.search_knn_vector_3d(point, 1) for point in moved[::40]]
    distances = np.sqrt([found[2][0] for found in nearest])
    partners = distances < 0.03
    assert partners.mean() > 0.6
    assert np.median(distances[partners]) < 0.012
    differences = np.abs(source[1][::40] - target[1][[found[1][0] for found in nearest]]).mean(axis=1)
    shuffled = np.abs(source[1][::40] - np.roll(target[1][[found[1][0] for found in nearest]], 500, axis=0)).mean(
        axis=1
    )
    assert np.median(differences[partners]) < 0.35 * np.median(shuffled[partners])


def _points_and_colors(frame):
    z = frame.depth_m()
    v, u = np.nonzero(np.isfinite(z))
    k, d = frame.intrinsics, z[v, u].astype(float)
    return np.stack([(u - k.cx) / k.fx * d, (v - k.cy) / k.fy * d, d], axis=1), frame.color[v, u].astype(float)


def test_depth_is_quantised_in_disparity():
    depth_mm = depth_of(wall(2.5, 40.0))
    depth_mm = np.unique(depth_mm[depth_mm > 0])
    steps = CAMERA.fx * 0.075 / (depth_mm / 1000.0) / 0.125
    # Half a millimetre of rounding, seen in steps.
    assert np.all(np.abs(steps - np.round(steps)) < 0.0006 * steps / (depth_mm / 1000.0))
    assert len(depth_mm) > 10


@pytest.mark.parametrize("distance", [1.0, 2.5, 4.0])
def test_axial_noise_is_that_of_nguyen(distance):
    fine = kinect.KinectModel(disparity_step_px=1e-4)
    depth_m = depth_of(wall(distance), model=fine)[30:90, 30:130] / 1000.0
    expected = 0.0012 + 0.0019 * (distance - 0.4) ** 2
    assert abs(depth_m.mean() - distance) < 4.0 * expected / np.sqrt(depth_m.size) + 1e-4
    assert 0.95 < depth_m.std() / np.hypot(expected, 0.001 / np.sqrt(12.0)) < 1.05


def test_noise_formulas_at_known_points():
    np.testing.assert_allclose(
        kinect.nguyen_axial_std_m(np.array([0.4, 1.4]), np.zeros(2)), [0.0012, 0.0031], rtol=1e-12
    )
    steep = kinect.nguyen_axial_std_m(np.array([1.0]), np.array([np.pi * 75 / 180]))
    np.testing.assert_allclose(steep, 0.0012 + 0.0019 * 0.36 + 0.0001 * 25.0, rtol=1e-9)
    np.testing.assert_allclose(kinect.nguyen_lateral_std_px(np.array([0.0, np.pi / 4])), [0.8, 0.835], rtol=1e-12)


@pytest.mark.parametrize("distance", [0.3, 6.0])
def test_nothing_is_measured_out_of_range(distance):
    assert not depth_of(wall(distance)).any()


def test_nothing_is_measured_at_a_grazing_angle():
    # Turned by 70°, the wall meets the central ray at 70°, and rays on the right more obliquely.
    depth_mm = depth_of(wall(2.0, 70.0))
    u = np.arange(CAMERA.width)
    incidence_deg = np.abs(70.0 + np.rad2deg(np.arctan((u - CAMERA.cx) / CAMERA.fx)))
    visible = depth_mm[60] > 0
    assert not visible[incidence_deg > 83.0].any()
    assert visible[(incidence_deg < 76.0) & (incidence_deg > 55.0)].mean() > 0.95


def test_glass_is_seen_in_colour_and_not_in_depth():
    assert not depth_of(wall(2.0, returns_infrared=False)).any()


def test_the_projector_casts_a_shadow_on_one_side_of_a_box():
    box = Part(Box((0.4, 0.02, 0.4)), textures.plain([0.5, 0.5, 0.5]), at(0.0, 1.0, 0.0))
    depth_mm = depth_of(wall(3.0), box)[60]
    beside_left, beside_right = depth_mm[:80], depth_mm[80:]
    # The box covers 52 columns; the shadow is 131 px · 0.075 m · (1 − 1/3) = 6.6 px wide.
    assert (beside_left == 0).sum() - (beside_right == 0).sum() in range(3, 11)


def test_depth_is_missing_along_edges():
    box = Part(Box((0.4, 0.02, 0.4)), textures.plain([0.5, 0.5, 0.5]), at(0.0, 1.0, 0.0))
    column = depth_of(wall(3.0), box)[:, 80]
    top = 59.5 - 131.25 * 0.2 / 0.99
    assert (column[int(top) - 1 : int(top) + 3] == 0).any()
    assert (column[int(top) + 6 : 54] > 0).all()


def test_noise_is_seeded():
    np.testing.assert_array_equal(depth_of(wall(2.0), seed=3), depth_of(wall(2.0), seed=3))
    assert (depth_of(wall(2.0), seed=3) != depth_of(wall(2.0), seed=4)).any()


def test_what_moves_between_pairs_and_what_stays():
    first, second = furnish(DEFAULT_SEED, 0), furnish(DEFAULT_SEED, 1)
    moved = [not np.array_equal(a.T_world_part, b.T_world_part) for a, b in zip(first, second, strict=True)]
    assert 5 < sum(moved) < 0.2 * len(moved)


@pytest.mark.parametrize(
    "texture",
    [
        textures.plain([0.1, 0.2, 0.3]),
        textures.plaster([0.8, 0.8, 0.7]),
        textures.wood([0.2, 0.1, 0.1], [0.6, 0.4, 0.2]),
        textures.planks([0.2, 0.1, 0.1], [0.6, 0.4, 0.2]),
        textures.bricks([[0.6, 0.3, 0.2], [0.5, 0.2, 0.2]], [0.7, 0.7, 0.6]),
        textures.wallpaper([0.8, 0.8, 0.7], [0.7, 0.7, 0.6], [0.4, 0.5, 0.4]),
        textures.rug((2.0, 1.5), [0.6, 0.1, 0.1], [0.1, 0.1, 0.3], [0.8, 0.7, 0.4]),
        textures.fabric([0.2, 0.3, 0.4], [0.9, 0.9, 0.8]),
        textures.book([0.1, 0.2, 0.5], (0.03, 0.2, 0.3)),
        textures.beach_ball([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        textures.globe(),
        textures.carton((0.4, 0.3, 0.3)),
        textures.foliage(),
        textures.stripes([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0]], 0.1),
        textures.landscape((1.0, 0.1, 0.7)),
        textures.abstract_painting((0.6, 0.1, 0.7), [[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]),
        textures.clock_face(0.3),
    ],
)
def test_a_texture_depends_on_the_place_alone(texture):
    rng = np.random.default_rng(5)
    points, normals = rng.uniform(-0.3, 0.3, (400, 3)), rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = texture(points, normals)
    assert colors.shape == (400, 3)
    assert np.isfinite(colors).all() and colors.min() >= 0.0 and colors.max() < 1.5
    order = rng.permutation(400)
    np.testing.assert_allclose(texture(points[order][:50], normals[order][:50]), colors[order][:50], rtol=0, atol=1e-12)


def test_hashes_are_uniform_and_uncorrelated():
    cells = np.stack(np.meshgrid(np.arange(-50, 50), np.arange(-50, 50)), axis=-1).reshape(-1, 2)
    values = textures.lattice_hash(cells, seed=1)
    counts, _ = np.histogram(values, bins=10, range=(0.0, 1.0))
    assert counts.min() > 850 and counts.max() < 1150
    image = values.reshape(100, 100)
    assert abs(np.corrcoef(image[:, 1:].ravel(), image[:, :-1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(values, textures.lattice_hash(cells, seed=2))[0, 1]) < 0.05


@pytest.mark.parametrize("shape", [Box((0.4, 0.6, 0.8)), Ellipsoid((0.3, 0.4, 0.5)), cylinder(0.3, 0.8)])
def test_shapes_are_closed_and_their_normals_point_outwards(shape):
    vertices, triangles = shape.triangles()
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    mesh.remove_duplicated_vertices()
    mesh.remove_degenerate_triangles()
    assert mesh.is_watertight()
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    centers = corners.mean(axis=1)
    normals = shape.smooth_normals(centers, facets)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-9)
    assert (np.sum(normals * facets, axis=1) > 0.9).all()
    assert (np.sum(normals * centers, axis=1) > 0.0).all()


def test_a_lathe_follows_its_profile():
    vertices, _ = Lathe(((0.1, 0.0), (0.3, 0.5)), segments=8).triangles()
    np.testing.assert_allclose(np.hypot(vertices[:8, 0], vertices[:8, 1]), 0.1, rtol=1e-12)
    np.testing.assert_allclose(vertices[8:, 2], 0.5, rtol=1e-12)


def test_look_at_is_a_camera_that_looks_there():
    T_world_camera = look_at((1.0, 2.0, 3.0), (4.0, -1.0, 0.5), roll_deg=0.0)
    np.testing.assert_allclose(T_world_camera[:3, :3] @ T_world_camera[:3, :3].T, np.eye(3), rtol=0, atol=1e-12)
    assert np.linalg.det(T_world_camera[:3, :3]) > 0.0
    seen = se_inverse(T_world_camera) @ [4.0, -1.0, 0.5, 1.0]
    np.testing.assert_allclose(seen[:2], 0.0, rtol=0, atol=1e-12)
    assert seen[2] > 0.0
    assert T_world_camera[2, 1] < 0.0  # the image's down is the world's down
    rolled = look_at((1.0, 2.0, 3.0), (4.0, -1.0, 0.5), roll_deg=10.0)
    np.testing.assert_allclose((T_world_camera[:3, :3].T @ rolled[:3, :3])[0, 0], np.cos(np.deg2rad(10.0)), rtol=1e-12)


@pytest.mark.slow
def test_a_simulated_recording_opens_with_its_rig(tmp_path, monkeypatch):
    small_sensor(monkeypatch)
    names = []
    rig_path = simulate_recording(tmp_path / "room", pairs=2, seed=3, on_pair=names.append)
    recording = open_recording(tmp_path / "room")
    assert rig_path == tmp_path / "room" / "rig.yaml"
    assert names == ["000000", "000001"] and len(recording) == 2
    assert recording.sensors == (TARGET, SOURCE)
    truth = se_inverse(T_WORLD_CAMERA[TARGET]) @ T_WORLD_CAMERA[SOURCE]
    for pair in recording:
        np.testing.assert_allclose(pair.T_target_source, truth, rtol=0, atol=1e-12)
        assert pair.source.sensor == SOURCE and pair.target.sensor == TARGET
        assert 0.5 < np.mean(pair.source.depth > 0) < 1.0
    assert recording[1].source.timestamp == 2.0


@pytest.mark.slow
def test_the_rig_file_can_lie_in_the_calibration_folder(tmp_path, monkeypatch):
    small_sensor(monkeypatch)
    rig = tmp_path / "calibration" / "mine.yaml"
    assert simulate_recording(tmp_path / "recordings" / "room", pairs=1, calibration=rig) == rig
    assert open_recording(tmp_path / "recordings" / "room")[0].T_target_source is not None


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "keep.txt").write_text("mine")
    with pytest.raises(InputError, match="not an empty folder"):
        simulate_recording(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["keep.txt"]


@pytest.mark.parametrize(("wrong", "message"), [({"pairs": 0}, "pairs"), ({"seed": -1}, "seed")])
def test_wrong_numbers_are_refused(tmp_path, wrong, message):
    with pytest.raises(InputError, match=f"^{message}: expected"):
        simulate_recording(tmp_path / "room", **wrong)
    assert not (tmp_path / "room").exists()


def test_colour_is_lit_from_above():
    # A white box in the dark: its top is brighter than its front.
    box = Part(Box((1.0, 1.0, 1.0)), textures.plain([0.8, 0.8, 0.8]), at(0.0, 1.9, 0.5))
    camera = look_at((0.0, -1.0, 2.0), (0.0, 1.9, 0.7), 0.0)
    color = kinect.render_color(Scene([box]), camera, np.random.default_rng(0), CAMERA)
    hits = Scene([box]).cast(camera[:3, 3], _rays(camera))
    upward = hits.facet_normals[:, 2] > 0.9
    front = hits.facet_normals[:, 1] < -0.9
    brightness = color.reshape(-1, 3).mean(axis=1)
    assert brightness[upward].mean() > brightness[front].mean() + 15.0
    assert np.median(brightness[hits.part < 0]) < 3.0


def _rays(camera: np.ndarray) -> np.ndarray:
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    x, y = (u.ravel() - CAMERA.cx) / CAMERA.fx, (v.ravel() - CAMERA.cy) / CAMERA.fy
    return np.stack([x, y, np.ones_like(x)], axis=1) @ camera[:3, :3].T


def test_the_sensor_model_is_one_value():
    blind = replace(kinect.KinectModel(), max_depth_m=1.0)
    assert depth_of(wall(1.5)).any() and not depth_of(wall(1.5), model=blind).any()
