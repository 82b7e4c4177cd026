"""Open3D's tensors as the kernels take them: the same memory, by DLPack."""

from __future__ import annotations

from typing import Any

import open3d as o3d

from adagmm_o3d.kernels.cuda.front_end import cuda


class _Readable:
    """A tensor as cuda.core reads it: it wants the device's kind as a number, and offers a version Open3D knows not."""

    def __init__(self, tensor: o3d.core.Tensor) -> None:
        self._tensor = tensor

    def __dlpack_device__(self) -> tuple[int, int]:
        kind, number = self._tensor.__dlpack_device__()
        return int(kind.value), int(number)

    def __dlpack__(self, *, stream: int | None = None, **_: Any) -> Any:
        return self._tensor.__dlpack__(stream=stream)


class Shared:
    """A tensor's memory, kept alive; `__cuda_array_interface__` tells where it is."""

    def __init__(self, tensor: o3d.core.Tensor) -> None:
        from cuda.core.utils import StridedMemoryView

        # -1: nothing is waited for; `on_the_device` has waited for all that Open3D had to do
        self._view = StridedMemoryView.from_dlpack(_Readable(tensor), -1)
        self.__cuda_array_interface__ = {
            "shape": tuple(self._view.shape),
            "typestr": self._view.dtype.str,
            "data": (int(self._view.ptr), False),
            "strides": None,
            "version": 3,
        }


def on_the_device(tensor: o3d.core.Tensor) -> Any:
    """A tensor of a CUDA device as an array for kernels, nothing copied unless its memory has gaps."""
    tensor = tensor.contiguous()
    o3d.core.cuda.synchronize(tensor.device)
    return cuda.as_cuda_array(Shared(tensor))


def current_device(tensor: o3d.core.Tensor) -> Any:
    """A context in which kernels run on the device of a tensor."""
    return cuda.gpus[tensor.device.get_id()]
