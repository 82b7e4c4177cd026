#!/usr/bin/env bash
# The tests with the oldest versions that pyproject.toml allows, on the oldest Python, in an environment of their own.
#   bash tests/minimum_versions.sh [python3.11]
set -euo pipefail
cd "$(dirname "$0")/.."

oldest=${1:-python3.11}
python=.venv-minimum/bin/python
pip() { "$python" -m pip install --quiet --disable-pip-version-check "$@"; }
[ -x "$python" ] || "$oldest" -m venv .venv-minimum

export OMP_WAIT_POLICY=passive
pip -e ".[open3d-cpu]" pytest pytest-timeout hypothesis scipy --constraint tests/minimum_versions/core.txt
"$python" -m pytest tests/plugin
pip -e ".[bench,distributed,open3d-cpu]" pytest pytest-timeout hypothesis coverage evo markdown --constraint tests/minimum_versions/apps.txt
"$python" -m pytest tests/fusion tests/bench
