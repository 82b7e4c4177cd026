"""What rotation errors have in common by a wrong mount is told from what they have not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adagmm_bench.mounting import LEAST_PAIRS, errors_up_to_mounting


def pairs(rng, count, mount_deg, noise_deg):
    """True rotations of up to 40 degrees about all axes, and estimates by a camera turned on its mount."""
    truths = Rotation.from_rotvec(np.radians(rng.uniform(-23.0, 23.0, (count, 3))))
    mount = Rotation.from_rotvec(np.radians(mount_deg))
    noise = Rotation.from_rotvec(np.radians(noise_deg * rng.normal(size=(count, 3)) / np.sqrt(3.0)))
    return truths.as_matrix(), (mount * truths * mount.inv() * noise).as_matrix()


@pytest.mark.parametrize("mount_deg", [(2.0, -1.0, 1.5), (0.0, 0.0, 0.0)])
def test_a_mount_that_is_off_is_found_and_what_else_is_wrong_is_left(mount_deg):
    found = errors_up_to_mounting(*pairs(np.random.default_rng(0), 30, mount_deg, 0.2))
    assert found.turn_deg == pytest.approx(np.linalg.norm(mount_deg), rel=0.1, abs=0.2)
    assert np.sqrt(np.mean(found.rotation_error_deg**2)) == pytest.approx(0.2, rel=0.25, abs=0.0)


def test_a_pair_has_no_say_in_its_own_error():
    truths, estimates = pairs(np.random.default_rng(1), 12, (0.0, 0.0, 0.0), 1e-6)
    estimates[3] = estimates[3] @ Rotation.from_rotvec([0.0, 0.0, np.radians(5.0)]).as_matrix()
    found = errors_up_to_mounting(truths, estimates)
    assert found.rotation_error_deg[3] == pytest.approx(5.0, rel=1e-3, abs=0.0)
    assert np.delete(found.rotation_error_deg, 3).max() < 0.2


def test_of_few_pairs_nothing_is_said():
    assert errors_up_to_mounting(*pairs(np.random.default_rng(2), LEAST_PAIRS - 1, (1.0, 0.0, 0.0), 0.1)) is None
