"""Arrows only go down: which room imports which, read from the source without running it; see CONTRIBUTING.md."""

import ast
import itertools
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# From top to bottom. A module imports from rows below its own, and from its own room.
ROWS = (
    ("__init__",),
    ("batch", "multi_scale", "preparing", "warm_up"),
    ("registration",),
    ("tensor_registration",),
    ("array_registration", "evaluation", "open3d_results"),
    ("prepared",),
    ("search",),
    ("trust",),
    ("em",),
    ("pairs",),
    ("mixtures",),
    ("uncertainty",),
    ("grouping", "neighbors", "principal"),
    ("kernels",),
    ("lie", "options", "result", "sampling"),
    ("arguments", "entry_points", "lazy_open3d"),
    ("errors", "version"),
)
# All may import these.
VOCABULARY = {"lie", "options", "result", "arguments", "errors"}
# What has not come down yet. An arrow that is gone is taken off this list.
STILL_UPWARD: set[tuple[str, str]] = set()
THIRD_PARTIES = {"numpy", "numba", "llvmlite", "cuda", "open3d"}  # llvmlite comes with Numba, cuda with numba-cuda


def modules(package: Path) -> Iterator[tuple[str, Path]]:
    """The dotted names of a package's modules, without the package's own, and their files."""
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).with_suffix("").parts
        yield ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts), path


def imports(path: Path) -> Iterator[str]:
    """Every module that a file imports, wherever in it, for type checkers too: whole dotted names."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            for name in node.names:  # a name of a package may be a module of it
                whole = f"{node.module}.{name.name}"
                file = ROOT.joinpath(*whole.split("."))
                yield whole if file.with_suffix(".py").is_file() or file.is_dir() else node.module


def arrows() -> Iterator[tuple[str, str]]:
    """(importing module, imported module) within the plugin, without the package's name."""
    for name, path in modules(ROOT / "adagmm_o3d"):
        for imported in imports(path):
            package, _, rest = imported.partition(".")
            if package == "adagmm_o3d":
                yield name, rest or "__init__"


def room(module: str) -> str:
    return module.partition(".")[0]


def row(module: str) -> int:
    if (
        module == "kernels.limits"
    ):  # numbers alone, which stand with the kernels because Numba's cache is keyed on these
        return len(ROWS)
    (found,) = [i for i, rooms in enumerate(ROWS) if room(module) in rooms]
    return found


def test_every_module_has_its_row():
    assert {room(name) for name, _ in modules(ROOT / "adagmm_o3d")} == {name for rooms in ROWS for name in rooms}


@pytest.mark.parametrize("package", ["adagmm_o3d", "apps/adagmm_fusion", "apps/adagmm_bench", "tests"])
def test_the_tree_in_contributing_is_the_real_one(package):
    """A name of the tree is a room, with a slash, or a module; what stands behind two spaces and has some is prose."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    lines = text.partition(f"\n    {package}/\n")[2].splitlines()
    tree = itertools.takewhile(lambda line: line.startswith("      "), lines)
    named = [word for line in tree for word in re.split(r"  +", line.strip()) if re.fullmatch(r"[\w/]+", word)]
    folder = ROOT / package
    rooms = [path for path in folder.rglob("*") if path.is_dir() and "__pycache__" not in path.parts]
    real = [f"{path.relative_to(folder).as_posix()}/" for path in rooms if any(path.iterdir())]
    if package != "tests":
        real += [path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")]
    assert sorted(named) == sorted(real)


def test_the_way_to_the_kernels_is_as_contributing_says():
    """Each file of the way imports the next one, or the protocol that the next one answers."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    way = text.partition("From `registration_adaptive_gmm` to the kernels:**")[2].partition("\n- **")[0]
    files = [name.replace("/", ".") for name in re.findall(r"`([a-z_/]+)`", way)]
    assert files[0] == "registration" and files[-1].startswith("kernels.") and len(files) <= 8
    all_arrows = set(arrows())
    for a, b in itertools.pairwise(files):
        assert (a, b) in all_arrows or {(a, "pairs.protocol"), (b, "pairs.protocol")} <= all_arrows, (a, b)


def test_no_arrow_goes_up():
    upward = {(a, b) for a, b in arrows() if room(a) != room(b) and row(a) >= row(b)}
    assert upward <= STILL_UPWARD, "\n".join(f"{a} imports {b}" for a, b in sorted(upward - STILL_UPWARD))


def test_kernels_import_the_vocabulary_alone():
    outside = {(a, b) for a, b in arrows() if room(a) == "kernels" and room(b) not in {"kernels", *VOCABULARY}}
    assert outside == set()


def test_cpu_kernels_know_nothing_of_cuda():
    assert {(a, b) for a, b in arrows() if a.startswith("kernels.cpu") and b.startswith("kernels.cuda")} == set()


@pytest.mark.parametrize("package", ["adagmm_o3d", "apps/adagmm_fusion", "apps/adagmm_bench"])
def test_packages_import_what_they_may(package):
    """The plugin needs neither Rerun nor OpenCV nor the apps, and of the apps one room alone knows Rerun."""
    ours = {
        "adagmm_o3d": set(),
        "apps/adagmm_fusion": {"adagmm_o3d"},
        "apps/adagmm_bench": {"adagmm_o3d", "adagmm_fusion"},
    }
    packages = {"adagmm_o3d", "adagmm_fusion", "adagmm_bench"}
    for name, path in modules(ROOT / package):
        imported = {whole.partition(".")[0] for whole in imports(path)}
        assert imported & packages <= ours[package] | {Path(package).name}, name
        if package == "adagmm_o3d":
            assert imported - packages - set(sys.stdlib_module_names) <= THIRD_PARTIES, name
        if "rerun" in imported:
            assert (package, room(name)) in {("apps/adagmm_fusion", "rerun_log"), ("apps/adagmm_bench", "replay_log")}


def test_only_the_command_line_imports_commands():
    importing = {
        room(name)
        for name, path in modules(ROOT / "apps" / "adagmm_fusion")
        if any(whole.startswith("adagmm_fusion.commands") for whole in imports(path))
    }
    assert importing == {"cli", "commands"}


def test_places_that_docstrings_name_are_there():
    """`kernels.cpu.tiles.morton_order` is a name in a module; of what only looks like a place nothing is asked."""
    package = ROOT / "adagmm_o3d"
    rooms = {path.name for path in package.iterdir() if path.is_dir()}
    missing = []
    for name, path in modules(package):
        for place in re.findall(r"`([a-z_]+(?:\.\w+)+)`", path.read_text(encoding="utf-8")):
            parts = place.split(".")
            if parts[0] not in rooms:
                continue
            for k in range(len(parts), 0, -1):
                file = package.joinpath(*parts[:k])
                if file.is_dir() or file.with_suffix(".py").is_file():
                    break
            rest, source = parts[k:], file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
            if rest and not (source.is_file() and re.search(rf"\b{rest[0]}\b", source.read_text(encoding="utf-8"))):
                missing.append(f"{name} names {place}")
    assert missing == []
