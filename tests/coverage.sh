#!/usr/bin/env bash
# Which lines of adagmm_o3d the tests run; fails below 95 %. Takes some minutes.
#   bash tests/coverage.sh
# Three runs are added up: the plugin's tests, the CPU kernels' tests uncompiled, as a compiled line is not seen, and
# the CUDA kernels' in the simulator.
set -euo pipefail
cd "$(dirname "$0")/.."

python=.venv/bin/python
plugin=(result_copies bad_input_evaluation bad_input_registration bad_input_uncertainty device evaluation global_search lie
    observability sampling paper_rules pose_covariance register_points registration registration_tensor uncertainty)

export OMP_WAIT_POLICY=passive COVERAGE_FILE=${COVERAGE_FILE:-.coverage}
run=("$python" -m coverage run --parallel-mode -m pytest -q -p no:cacheprovider)
"$python" -m coverage erase
"${run[@]}" $(printf "tests/plugin/test_%s.py " "${plugin[@]}") tests/package/test_without_open3d.py tests/package/test_extensions.py
mapfile -t uncompiled < <("$python" -c '
import sys
sys.path.insert(0, "tests/kernels")
from test_uncompiled import CHOSEN, FILES
print(CHOSEN, *(f"tests/{file}" for file in FILES), sep="\n")')
NUMBA_DISABLE_JIT=1 "${run[@]}" "${uncompiled[@]:1}" -k "${uncompiled[0]}"
NUMBA_ENABLE_CUDASIM=1 "${run[@]}" tests/kernels/cuda_simulator
"$python" -m coverage combine -q
"$python" -m coverage report --skip-empty
