#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# sweep.sh BUILD_FOLDER [--quick | --every N] [--device NAME] [--ops A,B]: unary float ops, value and derivative, in both
# float profiles, over every float or every Nth, the ends of exponents and special values, against the float64 evaluator.
# CPU devices get every 13th if nothing else is asked for; --quick is every 4099th. All floats are 40 minutes to an hour of
# processor time, which all cores share, every 13th a quarter of an hour a CPU device. Lines of JSON go to
# bench-out/sweep/, one file a device (with --ops one of these ops), and with bench-out/accuracy.json into
# docs/results/accuracy.md, where that is, without --quick and --every. Needs nothing but BUILD_FOLDER/bin.
set -euo pipefail
bin=$(realpath "$1")/bin
shift
every=() on_cpu=() device='' ops=()
while (($# > 0)); do
  case $1 in
    --quick) every=(--every 4099) ;;
    --every) every=(--every "${2-}"); [[ -n ${2-} ]] || { echo "sweep.sh: --every takes a number" >&2; exit 2; }; shift ;;
    --device) device=${2-}; [[ -n $device ]] || { echo "sweep.sh: --device takes a name" >&2; exit 2; }; shift ;;
    --ops) ops=(--ops "${2-}"); [[ -n ${2-} ]] || { echo "sweep.sh: --ops takes names, with commas" >&2; exit 2; }; shift ;;
    *) echo "sweep.sh: unknown option $1 (--quick, --every N, --device NAME, --ops A,B)" >&2; exit 2 ;;
  esac
  shift
done
mkdir -p bench-out/sweep
suffix=${ops[1]:+.${ops[1]//,/-}}

# sweep NAME DEVICE [OPTION...]
sweep() {
  local name=$1 wanted=$2 file
  shift 2
  file=bench-out/sweep/$name$suffix.jsonl
  "$bin/bench_sweep" run "$file.part" "$name" "$wanted" "${ops[@]}" "$@"
  mv "$file.part" "$file"
}

if [[ -n $device ]]; then
  sweep "$device" "$device" "${every[@]}"
else
  ((${#every[@]} > 0)) || on_cpu=(--every 13)
  for pair in "lavapipe ${DR_LAVAPIPE_ICD-}" "swiftshader ${DR_SWIFTSHADER_ICD-}"; do
    read -r name icd <<< "$pair"
    if [[ -z $icd ]]; then echo "no ICD of $name is named: left out"; continue; fi
    VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd sweep "$name" '' --threads 1 "${every[@]}" "${on_cpu[@]}"
  done
fi
document=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/../../docs/results/accuracy.md
if ((${#every[@]} == 0)) && [[ -f bench-out/accuracy.json && -f $document ]]; then
  "$bin/bench_accuracy" document bench-out/accuracy.json > bench-out/accuracy.md
  cp bench-out/accuracy.md "$document"
fi
