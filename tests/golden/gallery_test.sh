#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The programs of docs/examples/gallery/ find what they look for, on small data, in the evaluator. usage: gallery_test.sh DRC EXAMPLES
set -euo pipefail
drc=$(realpath "$1") examples=$(realpath "$2")
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/printed.bash"
cd "$examples/gallery"
# finds PROGRAM OUTPUT LEAST MOST ARGUMENTS...: what the output is in its last run lies between the two.
finds() {
  local program=$1 output=$2 least=$3 most=$4
  shift 4
  "$drc" eval "$program.dr" "$@" > "$folder/$program.txt" || { echo "$program does not run"; failed=1; return; }
  lies_between "$least" "$most" "$output" "$folder/$program.txt"
}
finds light look.off 0 1e-9 -D S=32 --step fit --step look
finds colours fit.error 0 2e-5 -D S=24 -D rings=9 --step fit=60
finds pose look.shift_off 0 1e-9 -D S=8 --step fit=5 --step look
finds depth fit.off 0 0.03 -D W=48 -D H=32 --step fit=100
finds deblurring look.after 20 60 -D W=48 -D H=32 --step fit=60 --step look
finds metal fit.roughness_off 0 0.08 -D S=8 -D sky_width=16 -D samples=8 --step fit=40
mesh=(--bind position=../sphere.obj:position --bind face=../sphere.obj:indices)
finds shadow fit.degrees_off 0 20 -D S=16 -D M=16 "${mesh[@]}" --step fit=10
finds network fit.error 0 0.03 -D S=16 --step start --step fit=40
finds splats fit.error 0 0.03 -D G=20 -D S=24 --step start --step fit=30
finds skinning look.off 0 1e-5 -D S=16 --step fit=9 --step look
finds density fit.error 0 0.011 -D S=8 -D D=8 -D steps=12 --step fit=15
"$drc" check real_views.dr && "$drc" check loop.dr || failed=1
exit $failed
