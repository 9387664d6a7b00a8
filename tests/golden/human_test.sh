#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The fits of docs/examples/human/ find what they look for, on small data, in the evaluator. usage: human_test.sh DRC EXAMPLES
set -euo pipefail
drc=$(realpath "$1") examples=$(realpath "$2")
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/printed.bash"
cd "$examples/human"
# finds PROGRAM OUTPUT LEAST MOST ARGUMENTS...: what the output is in its last run lies between the two.
finds() {
  local program=$1 output=$2 least=$3 most=$4
  shift 4
  if (($#)); then
    "$drc" eval "$program.dr" "$@" > "$folder/$program.txt" || { echo "$program does not run"; failed=1; return; }
  fi
  lies_between "$least" "$most" "$output" "$folder/$program.txt"
}
finds curvature judge.found 3 3 -D W=40 -D N=3 -D P=9 -D bends=1.0 -D STEPS=60 --step fit=60 --step judge
finds curvature judge.off 0 0.01  # of a strand's length; 0.23 at first

# An egg with a nose instead of a head.
awk -v uv="$folder/uv.csv" '/^v / {
  nose = $4 > 0 ? 0.8 * exp(-($2 * $2 + ($3 - 0.1) * ($3 - 0.1)) / 0.05) : 0
  print 2 * $2 "," 2.8 * $3 + 1 "," 2.2 * $4 + nose
  print "0.5,0.5" > uv
}' ../sphere.obj > "$folder/position.csv"
finds basis judge.shape_held 0.9 0.999 -D N=24 -D M=6 -D S=6 -D E=6 -D A=2 -D bumps=4 \
  --bind "position=$folder/position.csv" --bind "uv=$folder/uv.csv" --bind 'albedo=[[[0.7,0.5,0.4]]]' \
  --step sample --step compare --step turn=12 --step judge --out "$folder/basis"
# Heads that components are not made of are held less well, but held.
finds basis judge.shape_held_of_others 0.85 0.95
made=$folder/basis/judge
finds morphable judge.off_mm 0 10 -D W=32 -D STEPS=60 --bind face=../sphere.obj:indices \
  --bind "base=$made.base.npy" --bind "shapes=$made.shapes.npy" --bind "expressions=$made.expressions.npy" \
  --bind "paint=$made.paint.npy" --bind "tints=$made.tints.npy" --bind "head=$made.head.npy" \
  --bind "head_paint=$made.head_paint.npy" --step make --step fit=60 --step judge
finds morphable judge.psnr 28.5 60
exit $failed
