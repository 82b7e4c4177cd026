"""Rig files: what is written is read back exactly, and a file that is not right is refused with its line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import OutputError, RigError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, load_rig, save_rig

GOOD = """\
format: adagmm-rig
version: 1
name: two
units: metre
frame: RDF
sensors:
  left:
    intrinsics: {width: 640, height: 480, fx: 525, fy: 525.5, cx: 319.5, cy: 2.395e2}
    distortion: [0.1, -0.2, 0.0, 0.0]
    depth_scale: 1000
    T_rig_sensor:
      - [1, 0, 0, 0]
      - [0, 1, 0, 0]
      - [0, 0, 1, 0]
      - [0, 0, 0, 1]
  right:
    intrinsics: {width: 640, height: 480, fx: 525, fy: 525, cx: 319.5, cy: 239.5}
    depth_scale: 5000
    T_rig_sensor:
      - [0, 0, 1, 1.5]
      - [0, 1, 0, 0]
      - [-1, 0, 0, 0.25]
      - [0, 0, 0, 1]
"""


def random_rig(seed):
    rng = np.random.default_rng(seed)
    sensors = {}
    for name in ("left", "right_2", "top.3"):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        T[:3, 3] = rng.normal(size=3)
        intrinsics = PinholeIntrinsics(512, 424, *rng.uniform(200, 400, size=4), distortion=rng.normal(size=5))
        sensors[name] = SensorCalibration(name, intrinsics, rng.uniform(1, 5000), T)
    sensors["lost"] = SensorCalibration("lost", intrinsics, 1000.0, None)
    return Rig('Küche "2": #1', sensors, "made by a test\nwith two lines")


@pytest.mark.parametrize("seed", range(5))
def test_what_is_saved_is_loaded_to_the_last_bit(tmp_path, seed):
    rig = random_rig(seed)
    save_rig(tmp_path / "rig.yaml", rig)
    loaded = load_rig(tmp_path / "rig.yaml")
    assert (loaded.name, loaded.description, list(loaded.sensors)) == (rig.name, rig.description, list(rig.sensors))
    for name, sensor in rig.sensors.items():
        assert loaded.sensors[name].intrinsics == sensor.intrinsics
        assert loaded.sensors[name].depth_scale == sensor.depth_scale
        if sensor.T_rig_sensor is None:
            assert loaded.sensors[name].T_rig_sensor is None
        else:
            assert np.array_equal(loaded.sensors[name].T_rig_sensor, sensor.T_rig_sensor)


def test_hand_written_file(tmp_path):
    (tmp_path / "rig.yaml").write_text(GOOD)
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.sensors["left"].intrinsics == PinholeIntrinsics(640, 480, 525, 525.5, 319.5, 239.5, (0.1, -0.2, 0, 0))
    assert rig.sensors["right"].depth_scale == 5000
    # A point 2 m in front of the right sensor, whose z axis is the rig's x axis.
    np.testing.assert_allclose(
        rig.T_target_source("left", "right") @ (0, 0, 2, 1), (3.5, 0, 0.25, 1), rtol=0, atol=1e-15
    )
    both = rig.T_target_source("left", "right") @ rig.T_target_source("right", "left")
    np.testing.assert_allclose(both, np.eye(4), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "old, new, line, word",
    [
        ("units: metre", "units: millimetre", 4, "expected metre"),
        ("frame: RDF", "frame: RUB", 5, "expected RDF"),
        ("version: 1", "version: 2", 2, "expected 1"),
        ("units: metre\n", "", 1, "'units' is missing"),
        ("name: two", "name: two\ncolour: red", 4, "unknown key 'colour'"),
        ("name: two", "name: two\nname: three", 4, "given twice, first in line 3"),
        ("  right:", "  left:", 16, "given twice"),
        ("  left:", "  left: &anchor", 7, "anchors"),
        ("depth_scale: 5000", "depth_scale: *anchor", 18, "aliases"),
        ("depth_scale: 5000", "depth_scale: !!python/name:os.system x", 18, "tags"),
        ("depth_scale: 5000", "depth_scale: 0", 18, "positive"),
        ("depth_scale: 5000", "depth_scale: .nan", 18, "finite number"),
        ("depth_scale: 5000", "depth_scale: 1e999", 18, "too large"),
        ("depth_scale: 5000", 'depth_scale: "5000"', 18, "finite number"),
        ("depth_scale: 5000", "depth_scale: [5000]", 18, "a list"),
        ("{width: 640, height: 480, fx: 525, fy: 525,", "{width: 640.5, height: 480, fx: 525, fy: 525,", 17, "integer"),
        ("{width: 640, height: 480, fx: 525, fy: 525,", "{width: 640, height: 480, fx: -1, fy: 525,", 17, "positive"),
        ("{width: 640, height: 480, fx: 525, fy: 525,", "{width: 640, height: 480, fy: 525,", 17, "'fx' is missing"),
        ("distortion: [0.1, -0.2, 0.0, 0.0]", "distortion: [0.1]", 8, "coefficients"),
        ("      - [0, 0, 1, 1.5]\n", "", 20, "expected 4 rows"),
        ("- [0, 0, 1, 1.5]", "- [0, 0, 1]", 20, "expected 4 numbers"),
        ("- [0, 0, 1, 1.5]", "- [0, 0, 2, 1.5]", 20, "not a rotation"),
        ("- [0, 0, 1, 1.5]", "- [0, 0, -1, 1.5]", 20, "not a rotation"),
        ("  right:", "  ../right:", 17, "expected a name"),
        ("name: two", "name: [two", 4, "not valid YAML"),
        ("name: two", "---\nname: two", 3, "second one"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(tmp_path, old, new, line, word):
    path = tmp_path / "rig.yaml"
    assert GOOD.count(old) == 1
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(RigError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: ") and word in message and "\n" not in message


@pytest.mark.parametrize("content", [b"", b"# nothing\n", b"\xff\xfe", b"[" * 5000, b"just text", b"\x00"])
def test_what_is_no_rig_at_all_is_refused(tmp_path, content):
    path = tmp_path / "rig.yaml"
    path.write_bytes(content)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(RigError, match=r"absent\.yaml: cannot be read"):
        load_rig(tmp_path / "absent.yaml")


def test_sensors_that_are_not_there_or_not_placed(tmp_path):
    rig = random_rig(0)
    save_rig(tmp_path / "rig.yaml", rig)
    with pytest.raises(RigError, match=r"no sensor 'middle'; this rig has left, right_2"):
        rig.T_target_source("left", "middle")
    with pytest.raises(RigError, match=r"rig\.yaml: T_rig_sensor of sensor 'lost' is unknown"):
        load_rig(tmp_path / "rig.yaml").T_target_source("left", "lost")


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "rig.yaml"
    save_rig(path, random_rig(0))
    before = path.read_bytes()

    def refuse(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", refuse)
    with pytest.raises(OutputError, match=r"rig\.yaml: cannot be written: No space left"):
        save_rig(path, random_rig(1))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["rig.yaml"]


def test_rig_must_be_consistent():
    with pytest.raises(RigError, match="at least one sensor"):
        Rig("empty", {})
    sensor = random_rig(0).sensors["left"]
    with pytest.raises(RigError, match="listed under"):
        Rig("mixed", {"right": sensor})
    with pytest.raises(RigError, match="depth_scale"):
        SensorCalibration("a", sensor.intrinsics, -1.0, None)
    with pytest.raises(RigError, match="not a rotation"):
        SensorCalibration("a", sensor.intrinsics, 1.0, np.diag([1, 1, 2, 1]))
