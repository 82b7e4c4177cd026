#!/usr/bin/env bash
# Builds the source distribution and the wheel, looks into both, and uses the wheel in an environment with nothing else.
#   bash tests/distribution.sh [python3]
set -euo pipefail
cd "$(dirname "$0")/.."

unset PYTHONPATH
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${1:-python3}" -m venv "$folder/venv"
python=$folder/venv/bin/python
"$python" -m pip install --quiet --disable-pip-version-check build
"$python" -m build --outdir "$folder/dist" . >"$folder/log" || { cat "$folder/log"; exit 1; }

"$python" - "$folder"/dist/* <<'CHECK'
import sys, tarfile, zipfile

wheel, sdist = sorted(sys.argv[1:], key=lambda path: path.endswith(".gz"))
in_wheel = set(zipfile.ZipFile(wheel).namelist())
in_sdist = {name.partition("/")[2] for name in tarfile.open(sdist).getnames()}
wanted = {"adagmm_o3d/py.typed", "adagmm_bench/recorded_ratios.json", "adagmm_bench/belief/outcomes.json"}
wanted |= {"adagmm_fusion/cli.py"}
assert wanted <= in_wheel, wanted - in_wheel
others = {name.partition("/")[0] for name in in_wheel} - {"adagmm_o3d", "adagmm_fusion", "adagmm_bench"}
assert all(name.endswith(".dist-info") for name in others), others
wanted = {"LICENSE", "README.md", "CHANGELOG.md", "CITATION.cff", "mkdocs.yml", "docs/why.jpg", "examples/swap_icp.py"}
wanted |= {"tests/run.sh", "tests/conftest.py", "tests/support/shapes.py", "tests/minimum_versions/core.txt"}
wanted |= {"calibration/two_kinects.yaml", "recordings/two_kinects/left/depth/000000.png", "apps/demo.sh"}
assert wanted <= in_sdist, wanted - in_sdist
CHECK

"$python" -m pip install --quiet --disable-pip-version-check "$folder"/dist/*.whl
cd "$folder"
"$python" -c '
import numpy as np, adagmm_o3d
points = np.random.default_rng(0).normal(size=(60, 3))
assert adagmm_o3d.register_points(points, points).converged
print("adagmm_o3d", adagmm_o3d.__version__, "registers without Open3D")'
venv/bin/adagmm-fusion --version
for command in "adagmm-fusion run somewhere" "adagmm-bench methods"; do
    if venv/bin/$command 2>said; then echo "$command: expected an error without its extra"; exit 1; fi
    [ "$(wc -l <said)" -eq 1 ] && grep "pip install 'adagmm-o3d\[" said
done
