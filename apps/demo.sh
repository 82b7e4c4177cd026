#!/usr/bin/env bash
# Sets everything up on a fresh Debian or Ubuntu machine with Python >= 3.11, and registers the shipped recording.
#   bash apps/demo.sh [further options of adagmm-fusion run, such as --no-rerun]
set -euo pipefail
cd "$(dirname "$0")/.."

# shellcheck source=apps/system_packages.sh
source apps/system_packages.sh
install_system_packages "$LIBRARIES"

if [ ! -x .venv/bin/python ]; then
    python="$(find_python)"
    echo "making .venv with $python"
    "$python" -m venv .venv
fi
echo "installing the project and the app into .venv"
.venv/bin/python -m pip install --quiet --disable-pip-version-check -e ".[apps]"

recording=recordings/two_kinects
output=output/two_kinects
echo "registering $recording"
.venv/bin/adagmm-fusion run "$recording" --output "$output" "$@"

cat <<TEXT

Look at the results:
  .venv/bin/rerun $output/two_kinects.rrd    the registration, step by step, in the Rerun viewer
  less $output/report.md                     the report; report.json has the same and the poses
  $output/fused/*.ply                        fused coloured clouds, for any point cloud viewer, or:
  .venv/bin/open3d draw $output/fused/000000_right_to_left.ply
TEXT
