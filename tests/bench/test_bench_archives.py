"""Files of models, scenes and pairs that are not what they should be end in one line that names them."""

import numpy as np
import pytest

from adagmm_bench.models import load_models
from adagmm_bench.pairs.public import PublicPair
from adagmm_bench.scenes import SCENE_ARRAYS, KinectScene
from adagmm_o3d.errors import InputError

READERS = {
    "models": (lambda path: load_models(3, path), {"m0": np.zeros((20, 3)), "names": np.array(["one"])}),
    "scene": (lambda path: KinectScene(path).arrays(), dict.fromkeys(SCENE_ARRAYS, np.zeros((20, 3)))),
    "pair": (
        lambda path: PublicPair(path).load(),
        {"source": np.zeros((20, 3)), "target": np.zeros((20, 3)), "T": np.eye(4)},
    ),
}


@pytest.fixture(params=READERS)
def reader(request):
    return READERS[request.param]


def test_a_good_file_is_read(reader, tmp_path):
    read, arrays = reader
    np.savez(tmp_path / "good.npz", **arrays)
    read(tmp_path / "good.npz")


@pytest.mark.parametrize("damage", ["empty", "torn", "flipped", "text", "array", "absent"])
def test_a_damaged_file_is_named_in_one_line(damage, reader, tmp_path):
    read, arrays = reader
    path = tmp_path / f"{damage}.npz"
    np.savez(path, **arrays)
    content = path.read_bytes()
    if damage == "empty":
        path.write_bytes(b"")
    elif damage == "torn":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        path.write_bytes(content[:200] + b"\xff" * 50 + content[250:])
    elif damage == "text":
        path.write_text("not an archive\n")
    elif damage == "array":
        with open(path, "wb") as file:
            np.save(file, np.zeros((20, 3)))
    else:
        path.unlink()
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: expected ") and "\n" not in str(caught.value)


def test_a_missing_or_wordy_array_is_named(reader, tmp_path):
    read, arrays = reader
    first = next(iter(arrays))
    np.savez(tmp_path / "less.npz", **{name: array for name, array in arrays.items() if name != first})
    with pytest.raises(InputError, match=first):
        read(tmp_path / "less.npz")
    np.savez(tmp_path / "words.npz", **(arrays | {first: np.full((20, 3), "a")}))
    with pytest.raises(InputError, match=f"{first}: expected numbers, got <U1"):
        read(tmp_path / "words.npz")
