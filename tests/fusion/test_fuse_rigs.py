"""`adagmm-fusion fuse` with several sensors, standing still or on one moving rig, and with long recordings."""

import re
import weakref

import numpy as np
import pytest
from depth_scene import camera_pose, write_images, write_pose_file
from scipy.spatial.transform import Rotation
from shared_data import ROOT

import adagmm_fusion.sequence.loop_candidates as loop_candidates
import adagmm_fusion.sequence.pose_graph as pose_graph
import adagmm_fusion.sequence.registration as registration
from adagmm_fusion.cli import main
from adagmm_fusion.files import image_files
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.edges import Edge
from adagmm_fusion.sequence.loop_candidates import alike_frames, near_frames, thinned
from adagmm_fusion.sequence.pose_graph import optimized_poses
from adagmm_fusion.sequence.scene import fixed_voxel_size, placed_edges, scene_of
from adagmm_o3d import lie
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_inverse

INTRINSICS = PinholeIntrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)
# Two cameras that look past each other's views by half.
T_RIG_SENSOR = {"left": np.eye(4), "right": se_inverse(camera_pose(0.0)) @ camera_pose(-25.0, (0.0, -0.2, 1.25))}
T_WORLD_RIG = [camera_pose(6.0 * i, (0.03 * i, 0.05 * i, 1.2)) for i in range(3)]


def write_rig_recording(folder, poses, *, motion, known=True, off=(0.0,) * 6):
    """off : a twist by which the rig file has the right camera elsewhere."""
    said = T_RIG_SENSOR | {"right": lie.se_exp(off) @ T_RIG_SENSOR["right"]}
    sensors = {
        name: SensorCalibration(name, INTRINSICS, 1000.0, T if known or name == "left" else None)
        for name, T in said.items()
    }
    save_rig(folder / "rig.yaml", Rig("rig", sensors, "two cameras"))
    lines = ["format: adagmm-recording", "version: 1", 'name: "rig"', "rig: rig.yaml", f"motion: {motion}"]
    lines += ["sensors: [left, right]", "frames:"]
    for i, T_world_rig in enumerate(poses):
        lines.append(f'  - name: "{i:03d}"')
        if motion == "moving":
            lines.append(f"    T_world_rig: {T_world_rig.tolist()}")
        for name, T in T_RIG_SENSOR.items():
            images = (folder / name / kind / f"{i:03d}.png" for kind in ("color", "depth"))
            write_images(*images, INTRINSICS, T_world_rig @ T, 1000)
    (folder / "recording.yaml").write_text("\n".join(lines) + "\n")
    return folder


def trajectory(path):
    """(N, 4, 4) of a file of TUM's format."""
    poses = []
    for _, x, y, z, *quaternion in np.loadtxt(path):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        T[:3, 3] = x, y, z
        poses.append(T)
    return np.array(poses)


@pytest.mark.slow
def test_a_moving_rig_is_fused_as_a_whole(tmp_path, capsys):
    folder = write_rig_recording(tmp_path / "rig", T_WORLD_RIG, motion="moving")
    out = tmp_path / "out"
    arguments = ["--output", str(out), "--voxel-size", "0.03", "--device", "cpu", "--mesh", "ply"]
    assert main(["fuse", str(folder), *arguments]) == 0
    said = capsys.readouterr().out
    assert "known from the rig: 3 poses" in said and ", 6 frames, " in said and "left out" not in said
    assert "does not fit" not in said
    left, right = (trajectory(out / f"trajectory_{name}.txt") for name in ("left", "right"))
    assert len(left) == len(right) == 3
    for i in range(3):
        between = pose_errors(T_RIG_SENSOR["right"], se_inverse(left[i]) @ right[i])
        assert between.rotation_deg < 0.1 and between.translation < 0.005  # the rig holds
        moved = pose_errors(se_inverse(T_WORLD_RIG[0]) @ T_WORLD_RIG[i], se_inverse(left[0]) @ left[i])
        assert moved.rotation_deg < 1.5 and moved.translation < 0.06


@pytest.mark.slow
def test_a_moving_rig_whose_file_is_wrong_is_said_to_be(tmp_path, capsys):
    way = [camera_pose(3.0 * i, (0.03 * i, 0.02 * i, 1.2)) for i in range(5)]
    folder = write_rig_recording(tmp_path / "rig", way, motion="moving", off=(0.0, 0.12, 0.0, 0.0, 0.0, 0.0))
    arguments = ["--output", str(tmp_path / "out"), "--voxel-size", "0.03", "--device", "cpu", "--mesh", "ply"]
    assert main(["fuse", str(folder), *arguments, "--no-rerun"]) == 0
    said = re.findall(
        r"note: the rig's pose of (\w+ to \w+) does not fit: registered it is ([\d.]+)°", capsys.readouterr().out
    )
    assert [sensors for sensors, _ in said] == ["right to left"] and 5.0 < float(said[0][1]) < 9.0


def test_a_moving_rig_with_unknown_extrinsics_registers_its_sensors(tmp_path):
    folder = write_rig_recording(tmp_path / "rig", T_WORLD_RIG, motion="moving", known=False)
    scene = scene_of(open_recording(folder))
    assert scene.rig == () and scene.paths == ((0, 2, 4), (1, 3, 5))
    assert {(1, 0), (3, 2), (5, 4)} <= set(scene.pairs) and {(2, 0), (5, 3)} <= set(scene.pairs)


def test_sensors_that_stand_still_have_one_pose_from_all_moments(tmp_path):
    folder = write_rig_recording(tmp_path / "rig", [T_WORLD_RIG[0]] * 3, motion="fixed")
    recording = open_recording(folder)
    scene = scene_of(recording)
    assert scene.frames == (0, 1) and scene.pairs == ((1, 0), (3, 2), (5, 4)) and scene.places == (0, 1)
    assert scene_of(recording, "all").frames == (0, 1, 2, 3, 4, 5)
    T = T_RIG_SENSOR["right"]
    offs = ((0.0, 0.01, 0.0, 0.01, 0.0, 0.0), (0.0, -0.01, 0.0, -0.01, 0.0, 0.0), (0.0, 0.6, 0.0, 1.0, 0.0, 0.0))
    edges = [
        Edge(source, target, lie.se_exp(off) @ T, 1000.0 * np.eye(6), True)
        for (source, target), off in zip(scene.pairs, offs, strict=True)
    ]
    poses, dropped = optimized_poses(placed_edges(scene, edges))
    assert sorted(poses) == [0, 1]
    assert [(edge.source, edge.target) for edge in dropped] == [(1, 0)]
    np.testing.assert_array_equal(dropped[0].transformation, edges[2].transformation)
    apart = pose_errors(T, poses[1])
    assert apart.rotation_deg < 0.1 and apart.translation < 0.002


def loop_edges(true, noise, rng):
    def edge(source, target, loop):
        T = lie.se_exp(rng.normal(0.0, noise, 6)) @ se_inverse(true[target]) @ true[source]
        return Edge(source, target, T, 1000.0 * np.eye(6), loop)

    n = len(true)
    return [edge(i + 1, i, False) for i in range(n - 1)] + [edge(i, i - n // 2, True) for i in range(n // 2, n, 2)]


def test_a_large_graph_in_fragments_loses_its_drift_too(monkeypatch):
    angles = np.linspace(0.0, 4.0 * np.pi, 81)[:-1]
    true = [lie.se_exp((0.0, 0.0, a, 0.0, 0.0, 0.0)) for a in angles]
    for T, a in zip(true, angles, strict=True):
        T[:3, 3] = np.cos(a), np.sin(a), 0.0
    edges = loop_edges(true, 0.005, np.random.default_rng(5))
    whole, _ = optimized_poses(edges)
    chained = pose_graph.chained_poses([edge for edge in edges if not edge.loop_closure])
    monkeypatch.setattr(pose_graph, "MAX_NODES", 20)
    monkeypatch.setattr(pose_graph, "FRAGMENT_FRAMES", 10)
    fragments, dropped = optimized_poses(edges)
    assert sorted(fragments) == list(range(80)) and dropped == []
    np.testing.assert_allclose(fragments[0], np.eye(4), rtol=0, atol=1e-12)

    def off(poses):
        errors = [pose_errors(se_inverse(true[0]) @ true[i], pose) for i, pose in poses.items()]
        return np.sqrt(np.mean([error.translation**2 for error in errors]))

    assert off(whole) < off(fragments) < 0.6 * off(chained)


@pytest.mark.parametrize("most_nodes", [200, 20])
def test_wrong_loops_are_named_within_fragments_and_between_them(monkeypatch, most_nodes):
    true = [lie.se_exp((0.0, 0.0, 0.1 * i, 0.0, 0.0, 0.0)) for i in range(80)]
    for T, a in zip(true, 0.1 * np.arange(80), strict=True):
        T[:3, 3] = np.cos(a), np.sin(a), 0.0
    edges = loop_edges(true, 0.002, np.random.default_rng(6))
    far = lie.se_exp((0.0, 0.0, 1.5, 1.0, 0.0, 0.0))
    wrong = [
        Edge(s, t, far @ se_inverse(true[t]) @ true[s], 1000.0 * np.eye(6), True)
        for s, t in ((8, 1), (70, 25), (78, 71))
    ]
    monkeypatch.setattr(pose_graph, "MAX_NODES", most_nodes)
    monkeypatch.setattr(pose_graph, "FRAGMENT_FRAMES", 10)
    _, dropped = optimized_poses([wrong[0], *edges[:90], wrong[1], *edges[90:], wrong[2]])
    assert set(dropped) == set(wrong) and len(dropped) == 3


@pytest.mark.slow
def test_images_that_are_alike_are_found(monkeypatch):
    monkeypatch.setattr(loop_candidates, "ALIKE_PER_FRAME", 1)
    recording = open_recording(ROOT / "recordings" / "two_kinects")
    frames = tuple(range(len(recording.entries)))
    pairs = alike_frames(recording, frames, {i: 2 * i for i in frames}, lambda done, total: None)
    sensors = {i: recording.entries[i].sensor for i in frames}
    assert {frame for pair in pairs for frame in pair} == set(frames)
    assert all(source > target and sensors[source] == sensors[target] for source, target in pairs)
    assert pairs == alike_frames(recording, frames, {i: 2 * i for i in frames}, lambda done, total: None)


def test_a_long_recording_has_few_loops_far_apart():
    moments = {i: i for i in range(1000)}
    poses = {i: camera_pose(20.0 * np.sin(2.0 * np.pi * i / 250.0)) for i in moments}
    pairs = thinned(near_frames(poses, moments, dict.fromkeys(moments, "camera")), moments)
    gaps = np.array([source - target for source, target in pairs])
    assert gaps.min() >= 18 and 100 < len(pairs) < 700
    assert np.mean(gaps > 100) > 0.3  # revisits, not neighbours


def test_memory_does_not_grow_with_the_recording(tmp_path, monkeypatch):
    count = 12
    poses = [camera_pose(15.0 * np.sin(0.5 * i), (0.0, 0.02 * i, 1.2)) for i in range(count)]
    write_pose_file(tmp_path / "walk", poses, INTRINSICS)
    recording = open_recording(tmp_path / "walk")
    alive, most = weakref.WeakSet(), []
    checked_frame = image_files.checked_frame

    def counted(*values):
        frame = checked_frame(*values)
        alive.add(frame)
        most.append(len(alive))
        return frame

    def registered(pair, source, target, settings, *, loop_closure, confirmed_only=False, joining=False):
        T = se_inverse(poses[target]) @ poses[source]
        return Edge(source, target, T, 1000.0 * np.eye(6), loop_closure)

    monkeypatch.setattr(image_files, "checked_frame", counted)
    monkeypatch.setattr(registration, "registered_edge", registered)
    scene = scene_of(recording)
    settings = fixed_voxel_size(recording.entries[0].load(), Settings(device="cpu"))
    file = EdgeFile(tmp_path / "edges.jsonl", {}, count)
    registration.register_scene(recording, scene, settings, file, lambda *progress: None)
    assert len(file.edges) > count and len(most) > 2 * count
    assert max(most) <= 9
