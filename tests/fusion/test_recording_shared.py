"""The readers on real recordings: at the ground truth the clouds lie on each other, which settles the conventions."""

import numpy as np
import open3d as o3d
import pytest
from shared_data import shared_data

from adagmm_fusion.clouds.building import cloud_from_frame, dense_cloud
from adagmm_fusion.formats.options import PRIMESENSE
from adagmm_fusion.formats.tum import INTRINSICS as TUM_INTRINSICS
from adagmm_fusion.meshes.depth_grid import textured_grid
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration

pytestmark = pytest.mark.slow

# format, frames, pairs, sensors, and the largest distance [m] that the nearer quarter of the points may have at the
# ground truth: the median over the pairs; the quarter, because some pairs overlap by a third only.
RECORDINGS = {
    "redwood_open3d_5frames": ("redwood", 5, 4, ("camera",), 0.006),
    "tum_fr1_rpy_kinect_v1": ("tum", 22, 15, ("kinect",), 0.012),
    "hololens_tof": ("posefile", 33, 17, ("camera",), 0.010),
    "apc_shelf_f200": ("apc", 15, 14, ("camera",), 0.006),
    "two_xtion_rig": ("xtion", 4, 2, ("camera1", "camera2"), 0.04),
}


def nearer_quarter(source, target, T):
    moved = o3d.geometry.PointCloud(source).transform(T)
    return np.percentile(moved.compute_point_cloud_distance(target), 25)


@pytest.mark.parametrize("name", RECORDINGS)
def test_what_is_in_it(name):
    format, frames, pairs, sensors, _ = RECORDINGS[name]
    recording = open_recording(shared_data("recordings", name))
    assert (recording.format, len(recording.frames()), len(recording)) == (format, frames, pairs)
    assert recording.sensors == sensors and recording.name == name
    frame = recording.frames().frame(0)
    assert frame.color.std() > 20 and 0.2 < np.isfinite(frame.depth_m()).mean() <= 1
    assert 0.2 < np.nanmedian(frame.depth_m()) < 5.0


@pytest.mark.parametrize("name", RECORDINGS)
def test_clouds_lie_on_each_other_at_the_ground_truth(name):
    limit = RECORDINGS[name][-1]
    true, inverse = [], []
    for pair in open_recording(shared_data("recordings", name)):
        source = dense_cloud(pair.source, max_depth=4.0).voxel_down_sample(0.05)
        target = dense_cloud(pair.target, max_depth=5.0).voxel_down_sample(0.01)
        true.append(nearer_quarter(source, target, pair.T_target_source))
        inverse.append(nearer_quarter(source, target, np.linalg.inv(pair.T_target_source)))
    assert np.median(true) < limit
    assert np.median(inverse) > 1.3 * np.median(true)  # redwood's frames are only 1 to 3 degrees apart


@pytest.mark.parametrize("name", RECORDINGS)
def test_clouds_and_grids_for_registration_and_display(name):
    pair = open_recording(shared_data("recordings", name))[0]
    for frame in (pair.source, pair.target):
        cloud = cloud_from_frame(frame)
        assert 3000 < len(cloud.points) < 4000 and cloud.has_covariances()
        vertices, triangles, uvs = textured_grid(frame)
        assert len(triangles) > 3000 and len(vertices) == len(uvs)


# Intrinsics and depth scale, which no file says, and how far [m, and entries of the rotation] the poses may be: the
# nearest in time are taken, not interpolated.
AS_FOLDERS = {
    "redwood_open3d_5frames": (PRIMESENSE, 1000.0, 1e-9),
    "tum_fr1_rpy_kinect_v1": (TUM_INTRINSICS["1"], 5000.0, 0.02),
}


@pytest.mark.parametrize("name", AS_FOLDERS)
def test_the_generic_reader_finds_the_same(name):
    """Images, partners, and which way round the poses are, without knowing the format."""
    folder = shared_data("recordings", name)
    intrinsics, depth_scale, atol = AS_FOLDERS[name]
    rig = Rig("one", {"camera": SensorCalibration("camera", intrinsics, depth_scale, None)})
    found, known = open_recording(folder, format="folder", rig=rig), open_recording(folder)
    assert len(found.entries) == len(known.entries)
    assert "are read as camera to world" in found.notes[-1]
    for ours, theirs in zip(found.entries, known.entries, strict=True):
        if theirs.T_world_camera is not None:
            np.testing.assert_allclose(ours.T_world_camera, theirs.T_world_camera, rtol=0, atol=atol)
    frames = found.entries[0].load(), known.entries[0].load()
    assert frames[0].intrinsics.matrix().tolist() == frames[1].intrinsics.matrix().tolist()
    assert np.array_equal(frames[0].depth, frames[1].depth)
