"""What the package promises about itself agrees: versions, Pythons, requirements, licence."""

import ast
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

import adagmm_o3d
from adagmm_bench.report import machine_note
from adagmm_fusion.package_versions import package_version
from adagmm_fusion.pairs import report
from adagmm_fusion.source_digest import source_digest
from adagmm_o3d.lazy_open3d import LIBRARIES

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MINIMUM_VERSIONS = ROOT / "tests" / "minimum_versions"
# Linters, the CUDA compiler and what builds the documentation: their versions decide no result.
NOT_PINNED = {"ruff", "mypy", "pyright", "numba-cuda", "cuda-toolkit", "nvidia-nvjitlink", "nvidia-cuda-nvcc"}
NOT_PINNED |= {"mkdocs", "mkdocs-material", "mkdocstrings"}
WITHOUT_WHEELS = {"cycpd", "kiss-matcher"}


def requirements(extra):
    return PROJECT["dependencies"] if extra is None else PROJECT["optional-dependencies"][extra]


def name_of(requirement):
    return re.match(r"[A-Za-z0-9_.-]+", requirement)[0].lower()


def pins(file):
    lines = (MINIMUM_VERSIONS / file).read_text().splitlines()
    return dict(line.split("==") for line in lines if not line.startswith("#"))


def test_the_version_is_written_once():
    version = adagmm_o3d.__version__
    assert PROJECT["dynamic"] == ["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_pythons_that_are_promised_are_those_that_may_install():
    listed = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)]
    first, after = (int(minor) for minor in re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups())
    assert listed == [f"3.{minor}" for minor in range(first, after)]
    scripts = (ROOT / "apps" / "system_packages.sh").read_text()
    assert f"(3, {first}) <= sys.version_info < (3, {after})" in scripts


@pytest.mark.parametrize(("file", "extras"), [("core.txt", [None, "open3d", "open3d-cpu"]), ("apps.txt", None)])
def test_the_oldest_versions_are_those_that_the_requirements_name(file, extras):
    extras = extras or [None, *PROJECT["optional-dependencies"]]
    oldest = {}
    for requirement in (r for extra in extras for r in requirements(extra)):
        least = re.search(r">=([0-9.]+)", requirement)
        if least is not None and name_of(requirement) not in NOT_PINNED:
            oldest.setdefault(name_of(requirement), []).append(least[1])
    if file == "core.txt":
        oldest |= {"pytest": ["8"], "pytest-timeout": ["2.3"], "hypothesis": ["6.100"], "scipy": ["1.13"]}
    pinned = pins(file)
    assert set(oldest) - {"dask"} == set(pinned) - {"dask", "distributed"}
    for name, versions in oldest.items():
        newest_of_the_oldest = max(versions, key=lambda version: [int(part) for part in version.split(".")])
        assert f"{pinned[name]}.".startswith(f"{newest_of_the_oldest}."), name


def imports_of(path):
    """The first names of all that a file imports when it is imported itself."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.partition(".")[0]


def test_the_minimum_environment_of_the_core_has_all_that_its_tests_import():
    own = {path.stem: path for path in (ROOT / "tests").glob("support/*.py")}
    left = list((ROOT / "tests" / "plugin").glob("*.py"))
    known = {path.stem for path in left} | set(sys.stdlib_module_names) | {"adagmm_o3d", "adagmm_bench"}
    needed = set()
    while left:
        for name in set(imports_of(left.pop())) - known:
            known.add(name)
            if name in own:
                left.append(own[name])
            else:
                needed.add(name)
    script = (ROOT / "tests" / "minimum_versions.sh").read_text()
    installed = re.search(r'pip -e "\.\[open3d-cpu\]" (.+) --constraint', script)[1].split()
    assert needed >= {"numpy", "pytest"} and needed <= {"numpy", "numba", "open3d", *installed}
    assert set(installed) <= set(pins("core.txt"))


def test_nothing_is_required_that_has_to_be_compiled():
    for extra, entries in PROJECT["optional-dependencies"].items():
        for entry in entries:
            if name_of(entry) in WITHOUT_WHEELS:
                assert "python_version < '3.13'" in entry, extra


def test_neither_package_of_open3d_is_forced_on_anybody():
    for extra in (None, *PROJECT["optional-dependencies"]):
        named = {name_of(entry) for entry in requirements(extra)} & {"open3d", "open3d-cpu"}
        assert named == ({extra} if extra in ("open3d", "open3d-cpu") else set()), extra


def test_the_description_stands_alone_on_a_package_index():
    text = (ROOT / PROJECT["readme"]).read_text()
    assert re.findall(r"\]\((?!https?://)", text) == []
    extras = {line.split("|")[1] for line in text.splitlines() if line.startswith("| ")}
    for extra in set(PROJECT["optional-dependencies"]) - {"dev", "docs", "cuda-check"}:
        assert any(f"`{extra}`" in cell for cell in extras), extra


def test_there_is_a_licence_and_a_word_on_types():
    assert (ROOT / "LICENSE").read_text().startswith("MIT License")
    assert PROJECT["license"] == "MIT"
    assert (ROOT / "adagmm_o3d" / "py.typed").exists()


def test_the_workflow_runs_what_is_promised():
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text()
    promised = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)]
    (listed,) = re.findall(r'python: \[("3.*)\]', workflow)
    assert listed == ", ".join(f'"{python}"' for python in promised)
    assert "bash tests/run.sh" in workflow and "bash tests/minimum_versions.sh" in workflow


def test_the_steps_of_the_workflow_run_scripts_that_are_there():
    yaml = pytest.importorskip("yaml", reason="needs PyYAML, which the extra apps brings")
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())["jobs"]
    commands = {job: [step["run"] for step in jobs[job]["steps"] if "run" in step] for job in jobs}
    scripts = {job: [run.split()[1] for run in runs if run.startswith("bash ")] for job, runs in commands.items()}
    assert scripts == {
        "tests": ["tests/run.sh"],
        "minimum-versions": ["tests/minimum_versions.sh"],
        "distribution": ["tests/distribution.sh"],
    }
    assert all((ROOT / script).is_file() for (script,) in scripts.values())


def test_what_is_checked_before_a_commit_is_what_the_tests_check():
    yaml = pytest.importorskip("yaml", reason="needs PyYAML, which the extra apps brings")
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    hooks = {hook["id"]: hook["entry"] for hook in repository["hooks"]}
    run = (ROOT / "tests" / "run.sh").read_text()
    for tool in ("ruff-check", "ruff-format", "mypy"):
        assert f".venv/bin/{hooks.pop(tool)}" in run, tool
    assert hooks == {"notebooks": "python examples/make_notebooks.py"}
    assert (ROOT / hooks["notebooks"].split()[1]).is_file()


def test_either_package_of_open3d_will_do(monkeypatch):
    """What is kept of a bench or a fusion depends on its version, whichever of the two is installed."""
    found = {"open3d-cpu": "0.20.0", "numpy": "2.0.0", "numba": "0.63.0"}

    def version(name):
        if name not in found:
            raise metadata.PackageNotFoundError(name)
        return found[name]

    monkeypatch.setattr(metadata, "version", version)
    assert package_version("open3d") == "0.20.0" and package_version("rerun-sdk") == "absent"
    assert "open3d 0.20.0, numpy 2.0.0" in machine_note()
    assert report.versions()["open3d"] == "0.20.0"
    before = source_digest.__wrapped__("adagmm_fusion.errors", distributions=("open3d",))
    found["open3d-cpu"] = "0.21.0"
    assert source_digest.__wrapped__("adagmm_fusion.errors", distributions=("open3d",)) != before


def test_the_libraries_of_the_system_are_the_same_wherever_they_are_named():
    scripts = (ROOT / "apps" / "system_packages.sh").read_text()
    needed = set(re.search(r'^LIBRARIES="(.*?)"', scripts, re.MULTILINE)[1].split())
    assert set(LIBRARIES.split()) == needed
    for page in ("docs/how-to/gpu_containers_cluster.md", "docs/how-to/questions.md", ".github/workflows/tests.yml"):
        for line in re.findall(r"apt-get install(.*)", (ROOT / page).read_text()):
            assert needed <= set(line.strip("`.").split()), page
