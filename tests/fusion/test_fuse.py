"""`adagmm-fusion fuse`: trajectories, pose graphs, resumed runs, and meshes of a room that is known exactly."""

import json
import struct
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from depth_scene import BALL_CENTRE, BALL_RADIUS, PLANES, camera_pose, render, write_pose_file
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation
from shared_data import ROOT, shared_data

import adagmm_fusion.sequence.edges as edges_module
import adagmm_fusion.sequence.registration as registration
from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError, RecordingError
from adagmm_fusion.files.stale_results import MARKS
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.meshes.glb_file import colored_glb
from adagmm_fusion.meshes.orientation import upright
from adagmm_fusion.meshes.tsdf import TSDFVolume, save_mesh
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rerun_log.fused_recording import FusedRecording, edge_residuals, fused_report
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.edges import Edge
from adagmm_fusion.sequence.loop_candidates import near_frames
from adagmm_fusion.sequence.pose_graph import chained_poses, connected_sets, optimized_poses
from adagmm_fusion.sequence.scene import scene_of
from adagmm_fusion.sequence.trajectory_errors import align_rigid, trajectory_errors
from adagmm_o3d import lie
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse
from adagmm_o3d.result import Deferred, Verdict

INTRINSICS = PinholeIntrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)
POSES = [camera_pose(5.0 * i - 10.0, (0.03 * i, 0.05 * i, 1.2)) for i in range(5)]


def frame_at(pose, intrinsics=INTRINSICS):
    color, depth = render(intrinsics, pose)
    return RGBDFrame("room", color, np.rint(1000.0 * depth).astype(np.uint16), intrinsics, 1000.0, "camera")


def distances_from_the_room(points):
    """(N,) [m] to the nearest of the true surfaces."""
    planes = [np.abs(points @ normal - offset) for normal, offset in PLANES]
    ball = np.abs(np.linalg.norm(points - BALL_CENTRE, axis=1) - BALL_RADIUS)
    return np.min([*planes, ball], axis=0)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "room"
    write_pose_file(folder, POSES, INTRINSICS)
    return folder


FAST = ("--device", "cpu", "--mesh", "ply")


def fuse(walk, folder, *more) -> int:
    return main(
        ["fuse", str(walk), "--output", str(folder), "--voxel-size", "0.03", "--device", "cpu", "--mesh", "ply", *more]
    )


@pytest.mark.slow
def test_a_walk_is_fused_and_its_trajectory_is_right(walk, tmp_path, capsys):
    assert fuse(walk, tmp_path / "out") == 0
    out = capsys.readouterr().out
    assert "5 frames" in out and "left out" not in out
    ate_mm = float(out.split("ATE ")[1].split(" mm")[0])
    assert ate_mm < 15.0
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "out" / "mesh.ply"))
    mesh.vertices = o3d.utility.Vector3dVector(upright(mesh.vertices))
    points = np.asarray(mesh.transform(POSES[0]).vertices)  # the first camera's frame is the mesh's, turned upright
    assert len(points) > 3000 and np.percentile(distances_from_the_room(points), 90) < 0.045
    rows = np.loadtxt(tmp_path / "out" / "trajectory.txt")
    assert rows.shape == (5, 8)
    np.testing.assert_allclose(rows[0], (0, 0, 0, 0, 0, 0, 0, 1), rtol=0, atol=1e-9)
    T_0_4 = se_inverse(POSES[0]) @ POSES[4]
    np.testing.assert_allclose(rows[4, 1:4], T_0_4[:3, 3], rtol=0, atol=0.03)
    turn = Rotation.from_matrix(T_0_4[:3, :3]).inv() * Rotation.from_quat(rows[4, 4:])
    assert np.degrees(turn.magnitude()) < 1.0


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_was(walk, tmp_path, monkeypatch, capsys):
    register_pair, registered = edges_module.register_pair, []

    def interrupted(pair, settings, **seen):
        if len(registered) == 2:
            raise KeyboardInterrupt
        registered.append(pair.name)
        return register_pair(pair, settings, **seen)

    def noted(pair, settings, **seen):
        registered.append(pair.name)
        return register_pair(pair, settings, **seen)

    monkeypatch.setattr(edges_module, "register_pair", interrupted)
    assert fuse(walk, tmp_path) == 130
    monkeypatch.setattr(edges_module, "register_pair", noted)
    kept = f"kept: 2 registrations in {tmp_path / 'registrations.jsonl'}; the same command goes on\n"
    assert capsys.readouterr().out.endswith(kept)
    assert fuse(walk, tmp_path) == 0
    assert capsys.readouterr().out.startswith("resumed: 2 registrations are there\n")
    assert len(registered) == len(set(registered)) >= 4  # none twice

    def never(*_):
        raise AssertionError("everything was registered already")

    monkeypatch.setattr(edges_module, "register_pair", never)
    first = (tmp_path / "mesh.ply").read_bytes()
    assert fuse(walk, tmp_path) == 0
    assert len((tmp_path / "mesh.ply").read_bytes()) == len(first)


def test_other_settings_do_not_mix(walk, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(registration, "register_scene", None)
    EdgeFile(tmp_path / "registrations.jsonl", {"recording": "another"}, 5)
    assert fuse(walk, tmp_path) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "registrations.jsonl: holds registrations of another recording" in err


def test_true_poses_need_no_registration(walk, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(edges_module, "register_pair", None)
    log = tmp_path / "fused.rrd"
    assert fuse(walk, tmp_path, "--poses", "truth", "--mesh", "glb", "--save", str(log)) == 0
    assert capsys.readouterr().out.startswith(f"mesh: {tmp_path / 'mesh.glb'}, 5 frames, ")
    logged = {str(column) for column in RrdReader(log).store().schema().component_columns()}
    assert any("/world/fused" in column and "vertex_texcoords" in column for column in logged)
    assert any("/world/ways/" in column for column in logged)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.glb"))
    points = np.asarray(mesh.vertices)
    points = points * (1.0, -1.0, -1.0) if points[:, 1].mean() > 0 > points[:, 2].mean() else points
    assert len(points) > 3000


def test_the_moment_of_several_sensors(tmp_path, capsys):
    recording = open_recording(ROOT / "recordings" / "two_kinects")
    scene = scene_of(recording)
    assert [recording.entries[i].name for i in scene.frames] == ["000000"] * 2 and not scene.paths
    assert [recording.entries[i].name for i in scene_of(recording, "000002").frames] == ["000002"] * 2
    assert main(["fuse", str(recording.path), "--moment", "7", "--output", str(tmp_path)]) == 1
    assert capsys.readouterr().err.endswith("there is no pair of sensors at moment '7'\n")


def test_a_path_has_no_moment(walk):
    with pytest.raises(RecordingError, match="leave out --moment"):
        scene_of(open_recording(walk), "00000")


def random_walk(rng, count):
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ lie.se_exp(np.concatenate((rng.normal(0, 0.1, 3), rng.normal(0.1, 0.05, 3)))))
    return np.array(poses)


def test_trajectory_errors_are_evos():
    rng = np.random.default_rng(2)
    true = random_walk(rng, 20)
    world = lie.se_exp((0.3, -0.2, 1.0, 4.0, 5.0, 6.0))
    moved = np.array([world @ T for T in true])
    errors = trajectory_errors(true, moved)
    np.testing.assert_allclose((errors.ate_m, errors.rpe_m, errors.rpe_deg), 0.0, rtol=0, atol=1e-5)
    assert errors.poses == 20

    step = lie.se_exp((0.0, 0.0, np.radians(2.0), 0.03, 0.0, 0.0))
    drifting = [true[0]]
    for a, b in pairwise(true):
        drifting.append(drifting[-1] @ se_inverse(a) @ b @ step)
    errors = trajectory_errors(true, np.array(drifting))
    assert errors.rpe_deg == pytest.approx(2.0, rel=1e-6)
    assert errors.rpe_m == pytest.approx(np.linalg.norm(step[:3, 3]), rel=1e-6)

    shaken = true.copy()
    shaken[:, :3, 3] += rng.normal(0, 0.01, (20, 3))
    T = align_rigid(shaken[:, :3, 3], true[:, :3, 3])
    residuals = shaken[:, :3, 3] @ T[:3, :3].T + T[:3, 3] - true[:, :3, 3]
    assert trajectory_errors(true, shaken).ate_m == pytest.approx(np.sqrt((residuals**2).sum(axis=1).mean()), rel=1e-9)
    assert trajectory_errors(true, shaken).ate_m <= np.sqrt(((shaken - true)[:, :3, 3] ** 2).sum(axis=1).mean())


def test_alignment_never_mirrors():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 1, 0]])
    T = align_rigid(flat, flat * (1, 1, -1) + (0, 0, 3))
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shapes", [((2, 4, 4), (2, 4, 4)), ((4, 4, 4), (5, 4, 4)), ((4, 3, 4), (4, 3, 4))])
def test_trajectories_that_cannot_be_compared(shapes):
    with pytest.raises(InputError, match="of one N >= 3"):
        trajectory_errors(*(np.zeros(shape) for shape in shapes))


def edge(true, source, target, *, off=(0.0,) * 6, loop=False, reason=""):
    T = lie.se_exp(off) @ se_inverse(true[target]) @ true[source]
    return Edge(source, target, T, 1000.0 * np.eye(6), loop, reason)


def test_a_loop_closure_takes_drift_out_and_a_wrong_one_is_dropped():
    angles = np.linspace(0, 2 * np.pi, 25)[:-1]
    true = []
    for angle in angles:
        T = lie.se_exp((0.0, 0.0, angle, 0.0, 0.0, 0.0))
        T[:3, 3] = np.cos(angle), np.sin(angle), 0.0
        true.append(T)
    true = np.array([se_inverse(true[0]) @ T for T in true])
    edges = [edge(true, i + 1, i, off=(0, 0, 0.01, 0.005, 0, 0)) for i in range(23)]
    ends = [edge(true, 23, 0, loop=True), edge(true, 22, 0, loop=True), edge(true, 23, 1, loop=True)]
    wrong = edge(true, 12, 0, off=(0, 0, 1.5, 1.0, 0, 0), loop=True)
    chained = chained_poses(edges)
    poses, dropped = optimized_poses([*edges, *ends, wrong])
    before = trajectory_errors(true, np.array([chained[i] for i in range(24)])).ate_m
    after = trajectory_errors(true, np.array([poses[i] for i in range(24)])).ate_m
    assert dropped == [wrong] and after < 0.5 * before
    np.testing.assert_allclose(poses[0], np.eye(4), rtol=0, atol=1e-12)


def test_frames_that_nothing_holds_together_are_left_out():
    true = random_walk(np.random.default_rng(4), 7)
    edges = [edge(true, 1, 0), edge(true, 2, 1, reason="overlap 0.02 is below 0.3")]
    edges += [edge(true, 3, 2), edge(true, 4, 3), edge(true, 2, 4, loop=True), edge(true, 6, 5)]
    assert sorted(chained_poses(edges)) == [0, 1]
    assert connected_sets(edges, range(7)) == [[2, 3, 4], [0, 1], [5, 6]]
    poses, _ = optimized_poses(edges, first=2)
    assert sorted(poses) == [2, 3, 4]
    for i in (2, 3, 4):
        np.testing.assert_allclose(poses[i], se_inverse(true[2]) @ true[i], rtol=0, atol=1e-5)


@pytest.fixture(scope="module")
def registered_step():
    """A pair of frames, and what became of it."""
    pair = RGBDPair("1_to_0", frame_at(POSES[1]), frame_at(POSES[0]), None, 0)
    return pair, register_pair(pair, Settings(start="features", device="cpu", voxel_size_m=0.05))


@pytest.mark.parametrize(
    ("agreeing", "overlap", "becomes"),
    [
        (15, 0.16, "sure"),
        (15, 0.14, "overlap 0.14 is below 0.15"),
        (14, 0.41, "doubtful"),
        (5, 0.41, "doubtful"),
        (5, 0.39, "overlap 0.39 is below 0.4 and the colours do not confirm it"),
        (4, 0.59, "overlap 0.59 is below 0.6 and the colours do not confirm it"),
        (0, 0.61, "sure"),
    ],
)
def test_the_fewer_features_agree_the_more_has_to_overlap(registered_step, monkeypatch, agreeing, overlap, becomes):
    pair, outcome = registered_step
    judged = replace(outcome, agreeing_features=agreeing)
    monkeypatch.setattr(edges_module, "register_pair", lambda *_, **__: judged)
    monkeypatch.setattr(edges_module, "overlap_ratio", lambda *_: overlap)
    found = edges_module.registered_edge(pair, 1, 0, Settings(device="cpu", voxel_size_m=0.05), loop_closure=False)
    assert becomes == (found.reason or ("doubtful" if found.loop_closure else "sure"))


@pytest.mark.parametrize(("agreeing", "doubtful"), [(0, True), (4, True), (5, False), (15, False)])
def test_shape_alone_joins_no_parts_by_itself(registered_step, monkeypatch, agreeing, doubtful):
    pair, outcome = registered_step
    judged = replace(outcome, agreeing_features=agreeing)
    monkeypatch.setattr(edges_module, "register_pair", lambda *_, **__: judged)
    monkeypatch.setattr(edges_module, "overlap_ratio", lambda *_: 0.9)
    settings = Settings(device="cpu", voxel_size_m=0.05)
    found = edges_module.registered_edge(pair, 1, 0, settings, loop_closure=True, joining=True)
    assert found.doubtful == doubtful and found.usable != doubtful


@pytest.mark.parametrize(
    ("said", "confirmable"),
    [
        ({}, True),
        ({"belief": 0.3}, True),
        ({"evidence": 0.1}, True),
        ({"belief": 0.3, "margin": -0.1}, False),
        ({"mirrored": True}, False),
        ({"repeats": True}, False),
        ({"scale": 1.1}, False),
    ],
)
@pytest.mark.parametrize("overlap", [0.25, 0.15])
def test_others_may_confirm_what_only_agrees_too_little(registered_step, monkeypatch, said, confirmable, overlap):
    pair, outcome = registered_step
    verdict = Verdict(**({"evidence": 1.0, "belief": 0.9, "margin": 0.5} | said))
    estimate = replace(outcome.estimate, weigh=Deferred(lambda: verdict))
    judged = replace(outcome, agreeing_features=0, estimate=estimate)
    monkeypatch.setattr(edges_module, "register_pair", lambda *_, **__: judged)
    monkeypatch.setattr(edges_module, "overlap_ratio", lambda *_: overlap)
    found = edges_module.registered_edge(pair, 1, 0, Settings(device="cpu", voxel_size_m=0.05), loop_closure=True)
    assert not found.usable and found.doubtful == (confirmable and overlap > 0.2)


def test_loops_are_sought_near_by_and_far_along_the_path():
    turned = {i: camera_pose(10.0 * i) for i in range(6)} | {6: camera_pose(1.0), 7: camera_pose(2.0, (3.0, 0, 1.2))}
    moments = {i: i for i in turned}
    assert list(near_frames(turned, moments, dict.fromkeys(turned, "camera"))) == [(6, 0), (6, 1)]
    # Two sensors of one rig: never at one moment, otherwise at any.
    moments, sensors = {0: 0, 1: 0, 2: 1, 3: 1}, {0: "left", 1: "right", 2: "left", 3: "right"}
    together = {i: camera_pose(5.0 * i) for i in range(4)}
    assert list(near_frames(together, moments, sensors)) == [(2, 1), (3, 0)]


def test_finished_registrations_are_found_again_without_a_line_cut_off(tmp_path):
    path, of = tmp_path / "edges.jsonl", {"recording": "a"}
    file = EdgeFile(path, of, 4)
    T = lie.se_exp((0.1, 0.2, 0.3, 1.0, 2.0, 3.0))
    file.add(Edge(1, 0, T, np.diag(np.arange(1.0, 7.0)), False))
    file.add(Edge(2, 1, None, None, True, "overlap 0.02 is below 0.3"))
    whole = path.read_text()
    path.write_text(whole + '{"source": 3, "tar')
    again = EdgeFile(path, of, 4)
    assert path.read_text() == whole
    np.testing.assert_array_equal(again.find(1, 0).transformation, T)
    assert again.find(1, 0).usable and not again.find(2, 1).usable and again.find(2, 1).loop_closure
    assert again.find(3, 2) is None
    with pytest.raises(OutputError, match="another recording"):
        EdgeFile(path, {"recording": "b"}, 4)
    path.write_text(whole + "nonsense\n")
    with pytest.raises(OutputError, match="is damaged"):
        EdgeFile(path, of, 4)


@pytest.mark.parametrize("distortion", [(), (0.15, -0.1, 0.001, -0.002)])
def test_the_fused_surface_is_where_the_room_is(distortion):
    volume = TSDFVolume(0.02, max_depth_m=4.0)
    intrinsics = PinholeIntrinsics(160, 120, 140.0, 140.0, 79.5, 59.5, distortion)
    for pose in POSES:
        volume.integrate(frame_at(pose, intrinsics), pose)
    mesh = volume.mesh()
    points, colors = np.asarray(mesh.vertices), np.asarray(mesh.vertex_colors)
    off = distances_from_the_room(points)
    assert np.percentile(off, 95) < 0.015 and np.median(off) < 0.005
    assert np.median(np.abs(colors - (0.5 + 0.5 * np.sin(7.0 * points)))) < 0.05


def test_memory_is_bounded_and_the_way_out_is_told():
    volume = TSDFVolume(0.005, max_depth_m=4.0, max_memory_mb=5.0)
    with pytest.raises(InputError, match=r"more than 5 MB after 1 frames; take a larger --voxel-size than 0\.005 m"):
        volume.integrate(frame_at(POSES[0]), POSES[0])


def test_the_same_view_again_takes_no_more_memory():
    volume = TSDFVolume(0.03, max_depth_m=4.0)
    volume.integrate(frame_at(POSES[0]), POSES[0])
    once = volume.memory_mb
    for _ in range(5):
        volume.integrate(frame_at(POSES[0]), POSES[0])
    assert volume.memory_mb == once > 0


def test_no_depth_is_no_surface():
    volume = TSDFVolume(0.03, max_depth_m=0.2)
    volume.integrate(frame_at(POSES[0]), POSES[0])
    with pytest.raises(InputError, match="leave no surface"):
        volume.mesh()


@pytest.mark.parametrize("name", ["voxel_size", "max_memory"])
def test_sizes_are_positive(name):
    values = {"voxel_size": 0.01, "max_memory": 100.0} | {name: -1.0}
    with pytest.raises(InputError, match=f"^{name}: expected a positive number"):
        TSDFVolume(values["voxel_size"], max_depth_m=4.0, max_memory_mb=values["max_memory"])


def test_a_glb_file_is_what_the_standard_says(tmp_path):
    vertices = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 2]])
    normals = np.tile((0.0, 0.0, -1.0), (4, 1))
    colors = np.array([[1.0, 0.5, 0.0]] * 4)
    triangles = np.array([[0, 2, 1], [1, 2, 3]])
    data = colored_glb(vertices, normals, colors, triangles)
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    json_length, kind = struct.unpack("<I4s", data[12:20])
    scene = json.loads(data[20 : 20 + json_length])
    assert kind == b"JSON" and json_length % 4 == 0 and scene["asset"]["version"] == "2.0"
    binary = data[20 + json_length + 8 :]
    color_view = scene["bufferViews"][scene["accessors"][2]["bufferView"]]
    rgba = np.frombuffer(binary, np.uint8, color_view["byteLength"], color_view["byteOffset"]).reshape(4, 4)
    np.testing.assert_array_equal(rgba[0], (255, 55, 0, 255))  # half of sRGB is 21 % of the light
    (tmp_path / "mesh.glb").write_bytes(data)
    read = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.glb"))
    assert len(read.vertices) == 4 and len(read.triangles) == 2 and read.has_vertex_colors()


def test_a_mesh_needs_a_known_ending(tmp_path):
    with pytest.raises(OutputError, match=r"expected a name ending in \.ply or \.glb"):
        save_mesh(tmp_path / "mesh.step", o3d.geometry.TriangleMesh.create_box())


@pytest.mark.slow
def test_a_real_walk(tmp_path, capsys):
    walk = shared_data("recordings", "redwood_open3d_5frames")
    assert main(["fuse", str(walk), "--output", str(tmp_path), "--device", "cpu"]) == 0
    out = capsys.readouterr().out
    assert "5 frames" in out
    assert float(out.split("ATE ")[1].split(" mm")[0]) < 10.0


@pytest.mark.slow
def test_what_became_of_the_frames_is_saved_by_default(walk, tmp_path):
    ours = ("mesh.obj", "mesh.mtl")
    for name in ours:
        (tmp_path / name).write_bytes(MARKS[Path(name).suffix])
    (tmp_path / "mesh_0.png").write_text("of the same run")
    (tmp_path / "mesh.glb").write_text("somebody else's")
    assert fuse(walk, tmp_path) == 0
    assert not [name for name in (*ours, "mesh_0.png") if (tmp_path / name).exists()]
    assert (tmp_path / "mesh.glb").exists()
    reader = RrdReader(tmp_path / f"{walk.name}.rrd")
    logged = {str(column) for column in reader.store().schema().component_columns()}
    for entity in ("world/camera/image/rgb", "world/loops/kept", "log10/translation_error_mm", "report", "guide"):
        assert any(f"/{entity}:" in column for column in logged), entity
    for root in ("/world/ways/", "/world/true_ways/"):
        assert any(root in column and "LineStrips3D" in column for column in logged), root
    assert fuse(walk, tmp_path / "without", "--no-rerun") == 0
    assert list((tmp_path / "without").glob("*.rrd")) == []


def test_what_the_graph_dropped_counts_as_dropped_however_far_it_is():
    poses = {i: np.eye(4) for i in range(3)}
    poses[1][0, 3], poses[2][0, 3] = 0.1, 0.2
    far = np.eye(4)
    far[0, 3] = 0.9
    edges = [
        Edge(1, 0, poses[1], np.eye(6), False),
        Edge(2, 0, far, np.eye(6), True),
        Edge(2, 0, poses[2], np.eye(6), True),
        Edge(2, 1, None, None, True, "no overlap"),
    ]
    truth = {i: pose.copy() for i, pose in poses.items()}
    truth[2][1, 3] = 0.03
    fused = FusedRecording(poses, dict.fromkeys(poses, "camera"), truth, edges, edges[2:3], ends=poses, left_out=[7])
    residuals = edge_residuals(fused)
    assert [residual.kept for residual in residuals] == [True, True, False]
    np.testing.assert_allclose([residual.off_mm for residual in residuals], [0.0, 700.0, 0.0], rtol=1e-9, atol=1e-9)
    text = fused_report(fused, residuals, {0: 3.0, 1: 4.0})
    assert (
        text.startswith("### 3 of 4 frames fused")
        and "**ATE 3.5 mm**" in text
        and "| 2 | 0 | 0 | × dropped |\n| 2 | 0 | 700 |  |" in text
    )
    assert "2 registrations used, 1 dropped, 1 refused." in text


def test_the_report_says_which_registrations_are_believed_only_together():
    poses = {i: np.eye(4) for i in range(3)}
    edges = [
        Edge(1, 0, poses[1], np.eye(6), False),
        Edge(2, 0, poses[2], np.eye(6), True, only_together=True),
        Edge(2, 1, poses[2], np.eye(6), True, only_together=True),
    ]
    fused = FusedRecording(poses, dict.fromkeys(poses, "camera"), {}, edges, edges[2:], ends=poses)
    residuals = edge_residuals(fused)
    assert [residual.name for residual in residuals] == ["kept", "together", "dropped"]
    text = fused_report(fused, residuals, {})
    assert "Of those used 1 are believed only because several say the same" in text
    assert "| 2 | 0 | 0 | only together |" in text and "| 2 | 1 | 0 | × dropped |" in text
    plain = FusedRecording(poses, dict.fromkeys(poses, "camera"), {}, edges[:1], ends=poses)
    assert "say the same" not in fused_report(plain, edge_residuals(plain), {})
