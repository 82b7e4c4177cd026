"""The documentation is true: examples and snippets run, links lead somewhere, options exist, the reference builds."""

import argparse
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from shared_data import ROOT

import adagmm_bench.cli
import adagmm_fusion.cli

EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.py") if path.stem != "make_notebooks")
# What each example prints last.
LAST = {
    "register_arrays": r"standard deviation 0\.\d\d degrees",
    "sensor_noise": r"told both: 0\.\d\d degrees and \d+ mm off",
    "swap_icp": r"a wall: \(.*'the shape leaves 3 directions of the pose free'.*\)",
    "two_kinects": r"right against left: moved, 4\.\d\d° .*",
    "watch_in_rerun": r"registration\.rrd: \d+ iterations, fitness 1\.00",
}
PAGES = [path for path in ROOT.rglob("*.md") if not {".venv", "site", "output", "shared"} & set(path.parts)]
PROGRAMS = {"adagmm-fusion": adagmm_fusion.cli.parser(), "adagmm-bench": adagmm_bench.cli.build_parser()}


def python(code_or_file, folder):
    arguments = ["-c", code_or_file] if isinstance(code_or_file, str) else [str(code_or_file)]
    path = os.pathsep.join([str(ROOT), str(ROOT / "apps"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *arguments], env=os.environ | {"PYTHONPATH": path}, cwd=folder, capture_output=True, text=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name, tmp_path):
    done = python(ROOT / "examples" / f"{name}.py", tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.match(LAST[name], done.stdout.strip().splitlines()[-1]), done.stdout


@pytest.mark.slow
def test_what_an_example_compares_comes_out_as_it_is_told(tmp_path):
    swapped = python(ROOT / "examples" / "swap_icp.py", tmp_path).stdout
    gicp, ours = (float(off) for off in re.findall(r": ([\d.]+) degrees off", swapped))
    assert ours < 1.0 < gicp
    told = python(ROOT / "examples" / "sensor_noise.py", tmp_path).stdout
    off = dict(re.findall(r"told (.*): ([\d.]+) degrees", told))
    assert float(off["the wrong points"]) < float(off["nothing"])


def test_a_notebook_is_its_script(tmp_path):
    made = runpy.run_path(str(ROOT / "examples" / "make_notebooks.py"))
    for name in made["SCRIPTS"]:
        file = ROOT / "examples" / f"{name}.ipynb"
        script = (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
        assert file.read_text(encoding="utf-8") == made["notebook"](script), "run examples/make_notebooks.py"
        book = nbformat.read(file, as_version=4)
        nbformat.validate(book)
        code = "\n".join(cell.source for cell in book.cells if cell.cell_type == "code")
        kept = [line for line in script.splitlines() if line and not line.startswith("#")]
        assert [line for line in code.splitlines() if line and not line.startswith("#")] == kept
        assert book.cells[0].source.startswith("# ")


@pytest.mark.slow
def test_the_readmes_snippet_runs_and_is_the_same_everywhere(tmp_path):
    snippets = {
        re.search(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)[1]
        for page in ("README.md", "docs/index.md", "docs/package_index.md")
    }
    (snippet,) = snippets
    clouds = (
        "import numpy as np, open3d as o3d\n"
        "points = np.random.default_rng(0).normal(size=(500, 3)) * (1.0, 0.6, 0.3)\n"
        "for name, shift in (('source', 0.02), ('target', 0.0)):\n"
        "    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points + shift))\n"
        "    o3d.io.write_point_cloud(f'{name}.ply', cloud)\n"
    )
    done = python(clouds + snippet, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("()")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)#\s]+)", text):
        if not re.match(r"[a-z]+:", link):
            assert (page.parent / link).exists(), link


def test_the_readme_is_short():
    text = re.sub(r"```.*?```", "", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    prose = [line for line in text.splitlines() if not line.startswith(("    ", "|"))]
    assert len(re.sub(r"\]\([^)]*\)", "]", "\n".join(prose)).split()) <= 900


def names(program):
    return next(a for a in PROGRAMS[program]._actions if isinstance(a, argparse._SubParsersAction)).choices


def commands(page):
    """The words of each command of ours that a page shows on a line of its own."""
    for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].replace("`", " ").split()
        words = words[1:] if words[:1] == ["|"] else words
        if len(words) > 1 and words[0] in PROGRAMS and (words[1] in names(words[0]) or words[1].startswith("-")):
            yield words


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_and_options_that_are_shown_exist(page):
    for program, *words in commands(page):
        parser = names(program).get(words[0], PROGRAMS[program])
        for option in (word.partition("=")[0] for word in words if word.startswith("--")):
            assert option in parser._option_string_actions, f"{program} {' '.join(words)}"


@pytest.mark.slow
def test_the_reference_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    pytest.importorskip("mkdocstrings_handlers.python", reason="needs the extra docs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    page = Path(tmp_path / "reference" / "registration" / "index.html").read_text(encoding="utf-8")
    assert "<code>max_correspondence_distance</code>: [input units]" in page
