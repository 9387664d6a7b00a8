#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A fit that is killed at random moments, by SIGKILL, SIGTERM and SIGINT in turn, and resumed until it is done has the bits
# of one that ran through: params, states, outputs and the log. DR_KILLS says how often it is killed, DR_KILLED_RUNS how
# many runs it has. usage: killed_fit.sh DRUN
set -euo pipefail
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/../device/on_lavapipe.sh" "killing and resuming a fit on lavapipe"
kills=${DR_KILLS:-10} runs=${DR_KILLED_RUNS:-4000}
cat > fit.dr << 'END'
edition 1;
import std.optim;
import std.random;
param p : vec3[W, H] = 0.0;
state s : float[W, H] = 0.0;
input t : vec3[W, H];
let off = p - t;
let noise = 0.01 * float(random.integer(ivec3(step_index, 0, 0), 3, 16));
let e = mean(dot(off, off)) * (1.0 + noise) + 0.001 * mean(s);
step fit { minimize e over p with optim.adam(rate = 0.01); s <- s * 0.9 + sin(p.x + float(step_index)); output error = e, img = p; }
END
fit=(fit.dr --bind 't==[[[1, 2, 3], [4, 5, 6]], [[7, 8, 9], [1, 0, 1]]]' --device llvmpipe --step "fit=$runs" --checkpoint-every 100)
fail() { echo "FAILED: $*"; exit 1; }
"$drun" "${fit[@]}" --out straight > /dev/null
begin=$(date +%s%N)
"$drun" "${fit[@]}" --out timed > /dev/null
took=$((($(date +%s%N) - begin) / 1000000)) # ms
"$drun" "${fit[@]/fit=$runs/fit=1}" --out killed > /dev/null
RANDOM=${DR_SEED:-7}
signals=(KILL TERM INT) codes=(137 143 130)
killed=0 over=0
while ((killed < kills)); do
  "$drun" "${fit[@]}" --resume --out killed > /dev/null 2> err.txt &
  sleep "$(awk -v ms=$((RANDOM % (took / 2 + 50) + took / 20)) 'BEGIN { print ms / 1000 }')"
  which=$((killed % 3)) status=0
  kill -"${signals[which]}" $! 2> /dev/null || true
  wait $! 2> /dev/null || status=$?
  ((status == 0 || status == codes[which])) || fail "after SIG${signals[which]} it ends with $status: $(cat err.txt)"
  killed=$((killed + 1))
  # It may have been faster: then from the start, so that each kill meets a run.
  if ((status == 0)); then
    over=$((over + 1))
    for file in straight/*.npy straight/log.jsonl; do cmp "$file" "killed/${file##*/}" || fail "${file##*/} after $killed kills"; done
    rm -rf killed
    "$drun" "${fit[@]/fit=$runs/fit=1}" --out killed > /dev/null
  fi
done
"$drun" "${fit[@]}" --resume --out killed > /dev/null
for file in straight/*.npy straight/log.jsonl; do cmp "$file" "killed/${file##*/}" || fail "${file##*/} differs"; done
[[ $(ls killed | grep -c checkpoint-) == 1 ]] || fail "leftovers: $(ls killed)"
echo "killed $killed times, $over of them too late: the same bits"
