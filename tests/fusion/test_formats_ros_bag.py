"""Plain ROS bags of the known room, as ROS 1 and ROS 2 record them."""

import numpy as np
import pytest
from depth_scene import camera_pose, render
from ros_bags import KINDS, write_ros_bag

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.ros_topics import find_cameras
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.lie import se_inverse

SMALL = PinholeIntrinsics(80, 60, 70.0, 70.5, 39.5, 30.0)
COLOR = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
POSES = [camera_pose(yaw) for yaw in (-6.0, 0.0, 8.0)]
COLORS = [render(SMALL, pose)[0] for pose in POSES]
METRES = [render(SMALL, pose)[1].astype(np.float32) for pose in POSES]
MILLIMETRES = [np.rint(1000 * depth).astype(np.uint16) for depth in METRES]
FRAME = "camera_color_optical_frame"


def realsense(encoding="rgb8", depth=("16UC1", MILLIMETRES), suffixes=("", "")):
    return [
        (f"/camera/color/image_raw{suffixes[0]}", FRAME, SMALL, encoding, COLORS),
        (f"/camera/aligned_depth_to_color/image_raw{suffixes[1]}", FRAME, SMALL, *depth),
        ("/camera/depth/image_rect_raw", "camera_depth_optical_frame", COLOR, "16UC1", MILLIMETRES),
        ("/camera/infra1/image_rect_raw", "camera_infra1_optical_frame", COLOR, "mono8", [c[:, :, 0] for c in COLORS]),
    ]


def is_the_room(recording, *, atol=6e-4):
    assert recording.format == "rosbag" and len(recording.entries) == 3 and len(recording) == 2
    for i, entry in enumerate(recording.entries):
        frame = entry.load()
        assert frame.intrinsics == SMALL and np.array_equal(frame.color, COLORS[i])
        np.testing.assert_allclose(frame.depth_m(), METRES[i], rtol=0, atol=atol)
        assert frame.timestamp == pytest.approx(0.033 * i, rel=0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_camera_with_registered_depth(tmp_path, kind):
    path = write_ros_bag(tmp_path / "desk", kind, realsense())
    is_the_room(open_recording(path))
    if kind != "ros1":  # the file alone, without its metadata.yaml
        is_the_room(open_recording(next(p for p in path.iterdir() if p.suffix != ".yaml")))


ENCODINGS = {
    "bgr8, metres": realsense("bgr8", ("32FC1", METRES)),
    "png, compressed millimetres": realsense(
        "jpeg", ("compressedDepth 16UC1", MILLIMETRES), ("/compressed", "/compressedDepth")
    ),
}


@pytest.mark.parametrize("name", ENCODINGS)
def test_encodings(tmp_path, name):
    is_the_room(open_recording(write_ros_bag(tmp_path / "desk", "ros1", ENCODINGS[name])))


def test_compressed_metres_are_inverse_depth(tmp_path):
    streams = realsense(depth=("compressedDepth 32FC1", METRES), suffixes=("", "/compressedDepth"))
    is_the_room(open_recording(write_ros_bag(tmp_path / "desk", "mcap", streams)), atol=0.02)


T_COLOR_DEPTH = np.array([[1.0, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
LINK = "camera_link"


def unregistered():
    colors = [render(COLOR, pose)[0] for pose in POSES]
    depths = [np.rint(1000 * render(SMALL, pose @ T_COLOR_DEPTH)[1]).astype(np.uint16) for pose in POSES]
    return [
        ("/camera/camera/color/image_raw", FRAME, COLOR, "rgb8", colors),
        ("/camera/camera/depth/image_rect_raw", "depth_frame", SMALL, "16UC1", depths),
    ]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_depth_of_its_own_camera_is_registered_by_tf_static(tmp_path, kind):
    """The tree goes from the link to each camera, as drivers publish it."""
    T_link_depth = camera_pose(30.0)
    transforms = [(LINK, FRAME, T_link_depth @ se_inverse(T_COLOR_DEPTH)), (LINK, "/depth_frame", T_link_depth)]
    frame = open_recording(write_ros_bag(tmp_path / "desk", kind, unregistered(), transforms))[0].source
    off = np.abs(frame.depth_m() - render(COLOR, POSES[1])[1])
    assert frame.intrinsics == COLOR and np.isfinite(off).mean() > 0.8 and np.nanpercentile(off, 95) < 0.02


def test_without_tf_static_it_cannot_be_registered(tmp_path):
    recording = open_recording(write_ros_bag(tmp_path / "desk", "mcap", unregistered()))
    with pytest.raises(RecordingError, match="no tf_static says where depth_frame is in camera_color_optical_frame"):
        recording.entries[0].load()


def two_cameras():
    streams = []
    for name, pose in (("left", POSES[0]), ("right", POSES[2])):
        color, depth = render(SMALL, pose)
        stored = np.rint(1000 * depth).astype(np.uint16)
        streams.append((f"/{name}/rgb/image_raw", f"{name}_rgb", SMALL, "rgb8", [color] * 2))
        streams.append((f"/{name}/depth_to_rgb/image_raw", f"{name}_rgb", SMALL, "16UC1", [stored] * 2))
    return streams


def test_several_cameras_are_a_rig_that_tf_static_knows(tmp_path):
    transforms = [("world", "left_rgb", POSES[0]), ("world", "right_rgb", POSES[2])]
    recording = open_recording(write_ros_bag(tmp_path / "desk", "mcap", two_cameras(), transforms))
    assert recording.sensors == ("left", "right") and len(recording) == 2
    np.testing.assert_allclose(recording[1].T_target_source, se_inverse(POSES[0]) @ POSES[2], rtol=0, atol=1e-9)
    apart = open_recording(write_ros_bag(tmp_path / "apart", "mcap", two_cameras()))
    assert apart[0].T_target_source is None
    sensors = {
        name: SensorCalibration(name, SMALL, 1000.0, T) for name, T in (("left", np.eye(4)), ("right", POSES[1]))
    }
    known = open_recording(tmp_path / "apart", rig=Rig("two", sensors))
    np.testing.assert_allclose(known[0].T_target_source, POSES[1], rtol=0, atol=1e-12)


def test_what_no_calibration_is_in_needs_a_rig(tmp_path):
    streams = [(topic, frame, None, encoding, images) for topic, frame, _, encoding, images in realsense()]
    path = write_ros_bag(tmp_path / "desk", "mcap", streams)
    with pytest.raises(RecordingError, match="the intrinsics of camera are not known here"):
        open_recording(path)
    one = Rig("one", {"camera": SensorCalibration("camera", SMALL, 1000.0, None)})
    is_the_room(open_recording(path, rig=one))


def test_a_bag_without_depth(tmp_path):
    path = write_ros_bag(tmp_path / "desk", "ros1", realsense()[:1])
    with pytest.raises(
        RecordingError, match="expected topics of a camera's colour and depth images, got /camera/color"
    ):
        open_recording(path)


def test_fisheye_lenses_are_refused(tmp_path):
    bent = PinholeIntrinsics(80, 60, 70.0, 70.5, 39.5, 30.0, (0.1, 0.0, 0.0, 0.0))
    streams = [(topic, frame, bent, encoding, images) for topic, frame, _, encoding, images in realsense()[:2]]
    path = write_ros_bag(tmp_path / "desk", "ros1", streams)
    assert open_recording(path)[0].source.intrinsics == bent
    data = path.read_bytes()
    assert b"plumb_bob" in data
    (tmp_path / "fish.bag").write_bytes(data.replace(b"plumb_bob", b"fish_eyes"))
    with pytest.raises(RecordingError, match="expected the distortion model plumb_bob or rational_polynomial"):
        open_recording(tmp_path / "fish.bag")


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_an_error_of_ours(tmp_path, kind):
    path = write_ros_bag(tmp_path / "desk", kind, realsense())
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    data, rng = file.read_bytes(), np.random.default_rng(1)
    for number in range(40):
        damaged = bytearray(data[: rng.integers(len(data))] if number % 2 else data)
        for at in rng.integers(0, max(len(damaged), 1), 20):
            damaged[at : at + 1] = bytes([rng.integers(256)])
        other = tmp_path / f"damaged{number}{file.suffix}"
        other.write_bytes(damaged)
        try:
            for entry in open_recording(other).entries:
                entry.load()
        except AdaGMMError as problem:
            assert "\n" not in str(problem)


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        (["/camera/rgb/image_color", "/camera/depth/image"], [("camera", 0, 1)]),
        (["/kinect2/hd/image_color", "/kinect2/hd/image_depth_rect"], [("kinect2", 0, 1)]),
        (["/k4a/rgb/image_raw", "/k4a/depth/image_raw", "/k4a/depth_to_rgb/image_raw"], [("k4a", 0, 2)]),
        (["/zed/zed_node/rgb/image_rect_color", "/zed/zed_node/depth/depth_registered"], [("zed_zed_node", 0, 1)]),
        (["/a/color/image_raw", "/a/depth/image", "/b/color/image_raw", "/b/depth/image"], [("a", 0, 1), ("b", 2, 3)]),
        (["/color/image_raw/compressed", "/color/image_raw", "/depth/image_raw"], [("camera", 1, 2)]),
        (["/camera/color/image_raw"], []),
    ],
)
def test_which_topics_are_a_camera(topics, expected):
    found = find_cameras((topic, "sensor_msgs/msg/Image") for topic in topics)
    assert [(camera.name, topics.index(camera.color), topics.index(camera.depth)) for camera in found] == expected
