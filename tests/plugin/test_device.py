"""Which device a registration runs on, and what is said where there is none."""

import logging
import subprocess
import sys

import numpy as np
import open3d as o3d
import pytest

from adagmm_o3d import registration_adaptive_gmm, tensor_registration
from adagmm_o3d.errors import DeviceError
from adagmm_o3d.kernels.cuda import availability
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.pairs import device as devices
from adagmm_o3d.pairs.cpu_pairs import PairLoop

no_gpu = pytest.mark.skipif(availability.obstacle() is None, reason="there is a GPU")


@pytest.fixture
def mixture():
    return make_mixture("source", np.random.default_rng(0).normal(size=(20, 3)), None)


@pytest.mark.parametrize("device", ["gpu", "CUDA:0", ""])
def test_an_unknown_device_is_named(device):
    with pytest.raises(DeviceError, match="device: expected one of 'auto', 'cpu', 'cuda', got"):
        devices.check_device(device)


@no_gpu
def test_asking_for_a_gpu_where_there_is_none_is_one_clear_line(mixture):
    with pytest.raises(DeviceError) as caught:
        devices.make_pair_loop(mixture, mixture, "cuda")
    message = str(caught.value)
    assert message.startswith("device: 'cuda' cannot be used here: ")
    assert "\n" not in message
    assert "numba-cuda is not installed" in message or "no CUDA GPU" in message


def test_without_numba_cuda_the_reason_says_what_to_install(monkeypatch):
    monkeypatch.setattr(availability.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(availability, "simulated", lambda: False)
    assert availability.missing_front_end() == "numba-cuda is not installed; pip install 'adagmm-o3d[cuda]'"


def test_auto_stays_on_the_cpu_for_small_clouds_without_looking_for_a_gpu(mixture, monkeypatch):
    def looked():
        raise AssertionError("looked for a GPU")

    monkeypatch.setattr(devices, "obstacle", looked)
    assert isinstance(devices.make_pair_loop(mixture, mixture, "auto"), PairLoop)
    assert isinstance(devices.make_pair_loop(mixture, mixture, "cpu"), PairLoop)


def test_auto_says_once_what_it_picked(mixture, monkeypatch, caplog):
    monkeypatch.setattr(devices, "CROSSING_PAIRS", 1)
    monkeypatch.setattr(devices, "obstacle", lambda: "no CUDA GPU or no driver for it was found")
    devices._say_once.cache_clear()
    with caplog.at_level(logging.INFO, logger="adagmm_o3d"):
        loops = [devices.make_pair_loop(mixture, mixture, "auto") for _ in range(3)]
    devices._say_once.cache_clear()
    assert all(isinstance(loop, PairLoop) for loop in loops)
    assert [record.getMessage() for record in caplog.records] == [
        "device: 'auto' picked the CPU, as no CUDA GPU or no driver for it was found for 1 pairs and more"
    ]


def test_clouds_on_a_gpu_that_cannot_be_used_go_by_way_of_the_host(monkeypatch, caplog):
    rng = np.random.default_rng(0)
    clouds = [o3d.t.geometry.PointCloud(o3d.core.Tensor(rng.normal(size=(40, 3)))) for _ in range(2)]
    expected = registration_adaptive_gmm(*clouds, 1.0, device="cpu")
    monkeypatch.setattr(tensor_registration, "lies_on_gpu", lambda cloud: True)
    monkeypatch.setattr(tensor_registration, "obstacle", lambda: "the driver is missing")
    with caplog.at_level(logging.INFO, logger="adagmm_o3d"):
        result = registration_adaptive_gmm(*clouds, 1.0)
    np.testing.assert_array_equal(result.transformation.numpy(), expected.transformation.numpy())
    assert [record.getMessage() for record in caplog.records] == [
        "the clouds on CPU:0 are registered by way of the host: the driver is missing"
    ]


@pytest.mark.skipif(
    availability.missing_front_end() is not None or availability.simulated(), reason="numba-cuda is not installed"
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_tensor_is_read_where_it_lies(dtype):
    from adagmm_o3d.kernels.cuda.clouds.tensors import Shared

    values = np.arange(12, dtype=dtype).reshape(4, 3)
    tensor = o3d.core.Tensor(values)
    described = Shared(tensor).__cuda_array_interface__
    assert (described["shape"], described["typestr"], described["strides"]) == ((4, 3), values.dtype.str, None)
    assert described["data"] == (tensor.numpy().ctypes.data, False)


@pytest.mark.slow
def test_a_registration_on_the_cpu_imports_nothing_of_cuda():
    script = (
        "import sys, numpy as np, adagmm_o3d\n"
        "p = np.random.default_rng(0).normal(size=(50, 3))\n"
        "adagmm_o3d.register_points(p, p, device='cpu')\n"
        "loaded = [m for m in sys.modules if m.split('.')[:2] == ['numba', 'cuda'] or m.startswith('numba_cuda')]\n"
        "loaded += [m for m in sys.modules if m.startswith('adagmm_o3d.kernels.cuda.')]\n"
        "print(sorted(set(loaded) - {'adagmm_o3d.kernels.cuda.availability'}))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
