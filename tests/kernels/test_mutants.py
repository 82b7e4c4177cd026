"""The list of mutants is up to date: every text that is made wrong is once in its kernel."""

from pathlib import Path

import pytest
from kernel_mutants import CPU, CUDA, TESTS_OF

import adagmm_o3d

KERNELS = Path(adagmm_o3d.__file__).parent / "kernels"


@pytest.mark.parametrize("file", [*CPU, *CUDA])
def test_every_mutant_is_once_in_its_kernel(file):
    source = (KERNELS / file).read_text(encoding="utf-8")
    for *function, text, replacement in (CPU | CUDA)[file]:
        place = source
        if function:
            place = source.partition(f"\ndef {function[0]}(")[2].partition("\n\n\n")[0]
        assert place.count(text) == 1, (function, text)
        assert replacement != text


def test_every_file_has_tests():
    assert {mode: set(tests) for mode, tests in TESTS_OF.items()} == {"cpu": set(CPU), "cuda": set(CUDA)}
