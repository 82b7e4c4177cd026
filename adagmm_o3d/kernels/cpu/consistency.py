"""Which correspondences could belong to one rigid motion: pairs of them that keep their distance, and how many third
ones agree with both.

Source
------
Z. Chen, K. Sun, F. Yang, W. Tao: SC²-PCR: A Second Order Spatial Compatibility for Efficient and Robust Point Cloud
Registration, CVPR 2022.
"""

import math

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import FLAGS, SERIAL_KERNEL_FLAGS, source_stamp

WORD = 64


@njit(**FLAGS)
def bits_set(word):
    """How many bits of a uint64 are set."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def shared_support(source, target, source_normals, target_normals, tolerance, cosine_tolerance, support):
        """`support` (n, n) receives for each two of n correspondences that are compatible how many others are with
        both.

        Two are compatible when the distance between their points (n, 3) is the same in both clouds to `tolerance`, and
        the absolute cosine between their normals (n, 3) to `cosine_tolerance`.
        """
        _ = stamp
        n = len(source)
        compatible = np.zeros((n, (n + WORD - 1) // WORD), np.uint64)
        one = np.uint64(1)
        for i in range(n):
            for j in range(i + 1, n):
                a, b, c, d = 0.0, 0.0, 0.0, 0.0
                for k in range(3):
                    a += (source[i, k] - source[j, k]) ** 2
                    b += (target[i, k] - target[j, k]) ** 2
                    c += source_normals[i, k] * source_normals[j, k]
                    d += target_normals[i, k] * target_normals[j, k]
                if abs(math.sqrt(a) - math.sqrt(b)) < tolerance and abs(abs(c) - abs(d)) < cosine_tolerance:
                    compatible[i, j // WORD] |= one << np.uint64(j % WORD)
                    compatible[j, i // WORD] |= one << np.uint64(i % WORD)
        for i in range(n):
            support[i, i] = 0
            for j in range(i + 1, n):
                count = np.uint64(0)
                if (compatible[i, j // WORD] >> np.uint64(j % WORD)) & one:
                    for word in range(compatible.shape[1]):
                        count += bits_set(compatible[i, word] & compatible[j, word])
                support[i, j], support[j, i] = count, count

    return shared_support


shared_support = _build(source_stamp())
