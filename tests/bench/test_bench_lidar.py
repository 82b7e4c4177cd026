"""`adagmm-bench pairs --only lidar`: scans with their truth, whole and thinned, and the drift over a drive."""

import math

import numpy as np
import pytest

from adagmm_bench.pairs.lidar import (
    LIDAR,
    SCANS,
    SENSORS,
    DrivenScans,
    SimulatedScans,
    Thinning,
    find_lidar_pairs,
    lidar_tables,
)
from adagmm_bench.pairs.lidar_scene import drive
from adagmm_bench.pairs.sections import SECTIONS, methods_for
from adagmm_bench.pairs.tables import short_name
from adagmm_o3d import estimate_surface_covariances
from adagmm_o3d.lie import se_exp, se_inverse
from adagmm_o3d.neighbors import NeighborIndex


def points_of(cloud):
    return np.asarray(cloud.points)


@pytest.mark.parametrize(
    "pair", [SimulatedScans(0, 0), SimulatedScans(0, 0, "simulated, 64 wide beams"), DrivenScans(3, 0)]
)
def test_the_truth_puts_one_scan_on_the_other(pair):
    clouds = pair.load()
    assert clouds.unit == 1.0 and len(clouds.source.points) > 20_000
    assert off_the_surface(clouds, clouds.T_target_source) < 0.5 * off_the_surface(clouds, np.eye(4))


def off_the_surface(clouds, T):
    """Root mean square distance of the source to the planes of the target [m]; of the points, rings lie on rings."""
    source, target = points_of(clouds.source), points_of(clouds.target)
    moved = source @ T[:3, :3].T + T[:3, 3]
    planes = estimate_surface_covariances(target)
    nearest = NeighborIndex(target).query(moved, 1)[0][:, 0]
    normals = np.linalg.eigh(planes[nearest])[1][:, :, 0]
    off = np.abs(((moved - target[nearest]) * normals).sum(axis=1))
    return float(np.sqrt(np.mean(off[off < 0.3] ** 2)))


def test_a_pair_is_known_whole_and_thinned():
    whole, thinned = (Thinning(SimulatedScans(1, 0), yes) for yes in (False, True))
    assert whole.key != thinned.key
    assert [pair.facts()["group"] for pair in (whole, thinned)] == ["simulated, whole", "simulated, voxels of 0.25 m"]
    many, few = whole.load(), thinned.load()
    assert len(few.source.points) < len(many.source.points) / 2
    assert few.peers_source is few.source
    np.testing.assert_array_equal(few.T_target_source, many.T_target_source)


def test_scans_are_for_those_that_are_set_for_them():
    pair = Thinning(SimulatedScans(0, 0), False)
    names = ["adagmm", "adagmm-global", "open3d-gicp", "small-gicp", "kiss-matcher-gicp"]
    assert methods_for(pair, names) == ["adagmm", "open3d-gicp-lidar", "small-gicp-lidar"]
    assert short_name("small-gicp-lidar") == "small-gicp"


def test_what_is_missing_is_said(tmp_path):
    pairs, skipped = find_lidar_pairs(tmp_path, trials=2, seed=0)
    assert len(pairs) == 2 * (len(SENSORS) + 1) + SCANS - 1
    assert skipped[0].startswith("lidar, recorded: data: expected") and len(skipped) == 3


def records_of_a_drive(error):
    """Each scan put at the one before, with the same error each time."""
    poses = drive(SCANS, seed=0)
    for index in range(1, SCANS):
        facts = DrivenScans(index, 0).facts() | {"group": "odometry, whole"}
        T = se_inverse(poses[index - 1]) @ poses[index] @ error
        yield {
            "method": "adagmm",
            "problem": facts,
            "rotation_error_deg": 0.1 * index,
            "translation_error": 0.001 * index,
            "cpu_seconds": 1.0,
            "pose_cpu_seconds": 0.75,
            "T_target_source": T.tolist(),
        }


def test_drift_is_how_far_the_last_scan_is_off():
    (_, columns, rows), (_, _, drifts) = SECTIONS[LIDAR].tables(list(records_of_a_drive(np.eye(4))), [])
    assert rows == [["odometry, whole, 49", "adagmm", "2.500", "25.0", "4.900", "49.0", "1.00", "0.75"]]
    assert len(columns) == len(rows[0]) and drifts == [["adagmm", "0.000", "0.0", "0.000"]]
    turned = se_exp(np.array([0.0, 0.0, math.radians(0.01), 0.0, 0.0, 0.0]))
    _, _, _, (drift,) = lidar_tables(list(records_of_a_drive(turned)), short_name)
    assert float(drift[1]) == pytest.approx(0.49, abs=0.02) and float(drift[2]) > 50.0


def test_no_drift_is_told_of_a_part_of_the_drive():
    _, _, _, drifts = lidar_tables(list(records_of_a_drive(np.eye(4)))[:-1], short_name)
    assert drifts == []
