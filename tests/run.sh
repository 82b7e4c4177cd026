#!/usr/bin/env bash
# Runs the tests; see CONTRIBUTING.md.
#   bash tests/run.sh [pytest arguments]          sets up everything they need in .venv, then runs them all
#   bash tests/run.sh quick [pytest arguments]    some five minutes: with what is set up already, all that are not marked slow
set -euo pipefail
cd "$(dirname "$0")/.."

chosen=()
if [ "${1-}" = quick ]; then
    shift
    chosen=(-m "not slow")
    if [ ! -x .venv/bin/python ]; then
        echo "tests/run.sh quick: expected .venv, which is not there; run bash tests/run.sh once" >&2
        exit 1
    fi
else
    # shellcheck source=apps/system_packages.sh
    source apps/system_packages.sh
    install_system_packages "$LIBRARIES $VIEWER_LIBRARIES"
    install_project dev
fi

export OMP_WAIT_POLICY=passive
# Compiled once here, not by whichever test comes first.
.venv/bin/python -m adagmm_o3d.warm_up
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy
# A file's tests share what they have prepared, so a file stays in one process; in their order, as the slow ones are not last.
.venv/bin/python -m pytest --numprocesses logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder "${chosen[@]}" "$@"
