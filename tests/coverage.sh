#!/usr/bin/env bash
# Which lines of adagmm_o3d the tests run; fails below 95 %. Takes some minutes.
#   bash tests/coverage.sh
# Three runs are added up: the plugin's tests, the CPU kernels' tests uncompiled, as a compiled line is not seen, and
# the CUDA kernels' in the simulator.
set -euo pipefail
cd "$(dirname "$0")/.."

python=.venv/bin/python
plugin=(bad_input_evaluation bad_input_registration bad_input_uncertainty device evaluation global_search lie
    observability paper_rules pose_covariance register_points registration registration_tensor uncertainty)

export OMP_WAIT_POLICY=passive COVERAGE_FILE=${COVERAGE_FILE:-.coverage}
run=("$python" -m coverage run --parallel-mode -m pytest -q -p no:cacheprovider)
"$python" -m coverage erase
"${run[@]}" $(printf "tests/test_%s.py " "${plugin[@]}")
NUMBA_DISABLE_JIT=1 "${run[@]}" tests/test_kernels.py tests/test_search_kernel.py tests/test_pose_covariance.py \
    -k "$("$python" -c 'import sys; sys.path.insert(0, "tests"); from test_uncompiled import CHOSEN; print(CHOSEN)')"
NUMBA_ENABLE_CUDASIM=1 "${run[@]}" tests/cuda_simulator
"$python" -m coverage combine -q
"$python" -m coverage report --skip-empty
