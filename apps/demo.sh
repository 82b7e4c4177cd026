#!/usr/bin/env bash
# Sets everything up on a fresh Debian or Ubuntu machine with Python 3.11 to 3.14, and registers the shipped recording.
#   bash apps/demo.sh [further options of adagmm-fusion run, such as --no-rerun]
# Once it has been set up, it needs no network.
set -euo pipefail
cd "$(dirname "$0")/.."

# shellcheck source=apps/system_packages.sh
source apps/system_packages.sh
install_system_packages "$LIBRARIES"
install_project apps
.venv/bin/python -m adagmm_o3d.warm_up

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
