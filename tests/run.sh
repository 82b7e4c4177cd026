#!/usr/bin/env bash
# Sets up everything the tests need and runs them all; see README.md, "Tests".
#   bash tests/run.sh [pytest arguments]
set -euo pipefail
cd "$(dirname "$0")/.."

# shellcheck source=apps/system_packages.sh
source apps/system_packages.sh
install_system_packages "$LIBRARIES $VIEWER_LIBRARIES"
install_project dev

export OMP_WAIT_POLICY=passive
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy
.venv/bin/python -m pytest "$@"
