#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What a stranger's bundle, a full disk or a careless hand may do to drun and drc, by category: how many were tried, how many
# ended in a signal, took more than 20 s of processor time (SIGXCPU, 24) or waited for two minutes, left a file where none
# belongs, or printed what a terminal obeys. All of these are to be zero. usage: faults.sh DRC DRUN CRAFT_BUNDLES
set -euo pipefail
drc=$(readlink -f "$1") drun=$(readlink -f "$2") craft=$(readlink -f "$3")
source "$(dirname "${BASH_SOURCE[0]}")/../device/on_lavapipe.sh" "faults on lavapipe"
cat > fit.dr << 'END'
edition 1;
param p : float[W] = 0.5;
input t : float[W];
let d = p - t;
let far = sum(d * d);
let e = far / float(W) + 0.1 * mean(reduce(sum, k in 0..4) { sin(p * float(k)) });
step fit { p <- p - 0.1 * grad(e, p); output e, d; }
END
"$drc" build fit.dr --emit bundle -o fit.drb
mkdir crafted && "$craft" fit.drb crafted
data=(-b 't==[1, 2, 3, 4, 5, 6, 7, 8]')

tried=0 signals=0 hangs=0 outside=0 escapes=0 answered=0 ran=0 bad=''
# attempt NAME COMMAND...: in a folder of its own.
attempt() {
  local name=$1 status=0
  shift
  rm -rf room && mkdir -p room/inside/deep
  # Seconds of the clock say how busy a machine is; but what waits takes no others.
  (cd room/inside/deep && ulimit -S -t 20 && ulimit -H -t 25 && exec timeout -k 1 120 "$@") > out.txt 2> err.txt || status=$?
  tried=$((tried + 1))
  if ((status == 124 || status == 137 || status == 128 + 24)); then hangs=$((hangs + 1)) bad+=" $name(hangs)"
  elif ((status > 128 || status == 3)); then signals=$((signals + 1)) bad+=" $name(signal $((status - 128)))"
  elif ((status == 0)); then ran=$((ran + 1))
  elif [[ -s err.txt ]]; then answered=$((answered + 1))
  else bad+=" $name(no word)" signals=$((signals + 1)); fi
  if find room -type f -not -path 'room/inside/deep/o/*' | grep -q .; then outside=$((outside + 1)) bad+=" $name(file outside)"; fi
  if grep -qP '[\x00-\x08\x0b-\x1f\x7f]' out.txt err.txt; then escapes=$((escapes + 1)) bad+=" $name(escapes)"; fi
}
failed=0
report() { # CATEGORY
  printf '%-34s %5d tried  %3d signals  %3d hangs  %3d files outside  %3d escapes  %5d answered  %4d ran\n' \
    "$1" $tried $signals $hangs $outside $escapes $answered $ran
  if ((signals + hangs + outside + escapes > 0)); then echo "  $bad"; failed=1; fi
  tried=0 signals=0 hangs=0 outside=0 escapes=0 answered=0 ran=0 bad=''
}

for bundle in "$folder"/crafted/*.drb; do
  name=$(basename "$bundle" .drb)
  attempt "$name" "$drun" "$bundle" "${data[@]}" --out o
done
report 'crafted bundles: drun'
for bundle in "$folder"/crafted/*.drb; do
  name=$(basename "$bundle" .drb)
  attempt "$name" "$drun" "$bundle" "${data[@]}" --out o --dump-raster o/rasters --counters --check-finite
  attempt "$name" "$drun" "$bundle" "${data[@]}" --out o --timing
  attempt "$name" "$drc" inspect "$bundle"
  attempt "$name" "$drc" inspect --json "$bundle"
  attempt "$name" "$drun" "$bundle" "${data[@]}" --out o --device reference
done
report 'crafted bundles: other roads'

# One bit in each of 20 places: all of them are noticed, as bundle_test has it of every bit.
size=$(stat -c %s fit.drb)
for ((k = 0; k < 20; ++k)); do
  at=$((k * size / 20))
  cp fit.drb bit.drb
  byte=$(od -An -tu1 -j $at -N 1 fit.drb)
  printf "\\x$(printf %02x $((byte ^ 1 << k % 8)))" | dd of=bit.drb bs=1 seek=$at conv=notrunc status=none
  attempt "bit $at" "$drun" "$folder/bit.drb" "${data[@]}" --out o
  head -c $at fit.drb > bit.drb
  attempt "cut at $at" "$drun" "$folder/bit.drb" "${data[@]}" --out o
done
((ran == 0)) || { echo "  $ran damaged bundles ran"; failed=1; }
report 'bundles damaged on their way'

# Hands and disks.
fit=("$drun" "$folder/fit.dr" "${data[@]}")
attempt 'full stdout' bash -c '"$@" > /dev/full' _ "${fit[@]}"
attempt 'full stdout of drc' bash -c '"$@" > /dev/full' _ "$drc" eval "$folder/fit.dr" --bind 't==[1, 2]'
attempt 'memory overflows' "${fit[@]}" --memory=99999999999999999999
attempt 'no memory' "${fit[@]}" --memory=0
attempt 'no folder' "${fit[@]}" --out ''
((ran == 0)) || { echo "  $ran of what cannot be done was done"; failed=1; }
export DRC_CACHE_DIR=$folder/cache
"${fit[@]}" > /dev/null
for file in cache/*; do rm "$file" && mkdir "$file"; done
attempt 'folders in the cache' "${fit[@]}"
rm -rf cache && "${fit[@]}" > /dev/null && chmod a+w cache/*
attempt 'a cache that all may write' "${fit[@]}"
((ran == 2)) || { echo "  a cache stops the run"; failed=1; }
unset DRC_CACHE_DIR
for kilobytes in 20000 50000 80000 150000; do
  attempt "drc in $kilobytes KB" bash -c "ulimit -v $kilobytes; exec \"\$@\"" _ "$drc" check "$folder/fit.dr"
done
report 'hands, disks and memory'
exit $failed
