#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Small bundles for the fuzz targets of bundles to start from. usage: bundle_seeds.sh DRC SOURCE_ROOT FOLDER
set -euo pipefail
drc=$1 programs=$2/tests/golden/programs folder=$3
mkdir -p "$folder"
for program in checked_gradients half adam mesh_topology texture_fit fold both_sides; do
  for lower in compute fragment; do
    "$drc" build "$programs/$program.dr" --emit bundle --lower $lower -o "$folder/${program}_$lower.drb"
  done
done
