"""Our reader of .mat files against SciPy's writer, and against damage of every kind."""

import zlib

import numpy as np
import pytest
import scipy.io

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.matlab_file import read_variable, variable_names

RNG = np.random.default_rng(0)
ARRAYS = {
    "depth": RNG.integers(0, 65535, (48, 64)).astype(np.uint16),
    "scalar": np.array([[3.5]]),
    "whole": np.array([[1.0, 2.0, 300.0]]),
    "single": RNG.normal(size=(2, 3, 4)).astype(np.float32),
    "signed": np.array([[-5], [7]], np.int32),
    "large": np.array([[2**40, -(2**50)]], np.int64),
    "empty": np.zeros((0, 3)),
}


@pytest.mark.parametrize("compress", [False, True])
def test_what_scipy_writes_is_read(tmp_path, compress):
    path = tmp_path / "a.mat"
    structure = {"K": np.eye(3), "translation_of_it": np.array([[0.1, 0.2, 0.3]]), "n": np.array([[7]], np.uint8)}
    scipy.io.savemat(path, ARRAYS | {"structure": structure}, do_compression=compress)
    for name, expected in ARRAYS.items():
        value = read_variable(path, name)
        assert value.dtype == expected.dtype and np.array_equal(value, expected)
    fields = read_variable(path, "structure")
    assert fields.keys() == structure.keys()
    assert all(np.array_equal(fields[key], structure[key]) for key in structure)


def test_what_is_not_there_or_of_another_kind(tmp_path):
    path = tmp_path / "a.mat"
    deep = {"a": {"b": {"c": {"d": {"e": 1.0}}}}}
    scipy.io.savemat(path, {"text": "words", "complex": np.array([1j]), "deep": deep, "x": 1.0})
    with pytest.raises(RecordingError, match="there is no variable 'y' in it"):
        read_variable(path, "y")
    for name, match in (
        ("text", "text is not a real numeric"),
        ("complex", "complex is not"),
        ("deep", "more than 4 structures are in each other"),
    ):
        with pytest.raises(RecordingError, match=match):
            read_variable(path, name)
    with pytest.raises(RecordingError, match="the file is missing"):
        read_variable(tmp_path / "b.mat", "x")
    with pytest.raises(RecordingError, match="cannot be read"):
        read_variable(tmp_path, "x")


@pytest.mark.parametrize("compress", [False, True])
def test_structures_in_structures_are_read_without_their_text(tmp_path, compress):
    path = tmp_path / "a.mat"
    values = {"camera": {"K": np.eye(3), "units": "mm"}, "name": "left", "R": np.ones((2, 2))}
    scipy.io.savemat(path, {"rig": values, "x": 1.0}, do_compression=compress)
    assert variable_names(path) == ["rig", "x"]
    fields = read_variable(path, "rig")
    assert fields.keys() == {"camera", "R"} and fields["camera"].keys() == {"K"}
    assert np.array_equal(fields["camera"]["K"], np.eye(3)) and np.array_equal(fields["R"], np.ones((2, 2)))


def element(kind: int, data: bytes) -> bytes:
    return np.array([kind, len(data)], "<u4").tobytes() + data + b"\0" * (-len(data) % 8)


@pytest.mark.parametrize("compress", [False, True])
def test_an_object_of_a_class_is_named(tmp_path, compress):
    flags = element(6, np.array([17, 0], "<u4").tobytes())
    matrix = flags + element(1, b"stereoParams") + element(1, b"MCOS") + element(1, b"stereoParameters")
    data = element(14, matrix)
    if compress:
        packed = zlib.compress(data)
        data = np.array([15, len(packed)], "<u4").tobytes() + packed
    path = tmp_path / "a.mat"
    path.write_bytes(b" " * 124 + b"\x00\x01IM" + data)
    assert variable_names(path) == ["stereoParams"]
    with pytest.raises(RecordingError, match="stereoParams is an object of a class of MATLAB's; make it a structure"):
        read_variable(path, "stereoParams")


@pytest.mark.parametrize("compress", [False, True])
def test_damage_never_does_worse_than_an_error(tmp_path, compress):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"depth": ARRAYS["depth"], "k": {"K": np.eye(3)}}, do_compression=compress)
    whole = path.read_bytes()
    errors = 0
    for _ in range(400):
        data = bytearray(whole[: RNG.integers(len(whole))] if RNG.random() < 0.3 else whole)
        # Most of the file is values, so half of the damage goes where the structure is.
        for _ in range(RNG.integers(1, 4)):
            reach = min(len(data), 260) if RNG.random() < 0.5 else len(data)
            if reach:
                data[RNG.integers(reach)] = RNG.integers(256)
        path.write_bytes(data)
        for name in ("depth", "k"):
            try:
                read_variable(path, name)
            except RecordingError as problem:
                errors += 1
                assert str(problem).startswith(str(path)) and "\n" not in str(problem)
    assert errors > 200


def test_every_byte_of_a_compressed_variable_is_guarded(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"depth": ARRAYS["depth"]}, do_compression=True)
    whole = path.read_bytes()
    for at in RNG.integers(140, len(whole), 50):
        data = bytearray(whole)
        data[at] ^= 0xFF
        path.write_bytes(data)
        with pytest.raises(RecordingError, match="damaged or cut off"):
            read_variable(path, "depth")
