#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# scatter.sh BUILD_FOLDER [--device NAME] [--quick]: microseconds that it takes to add 400,000 vec3 (--quick: 40,000) to 65,536
# targets by each way that drc has (--scatter; *sorted*: rows of a computed index), while several runs are under way, the least of three. The figures go to
# bench-out/scatter.jsonl.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite scatter "$@"
no_more
count=400000 runs=60
if [[ -n $quick ]]; then count=40000 runs=20; fi
/usr/bin/python3 - "$out" "$count" << 'END'
import sys
import numpy as np
folder, count = sys.argv[1], int(sys.argv[2])
random = np.random.default_rng(1)
anywhere = random.integers(0, 65536, count).astype(np.int32)
np.save(f"{folder}/anywhere.npy", anywhere)
np.save(f"{folder}/near.npy", np.sort(anywhere))
np.save(f"{folder}/one.npy", np.zeros(count, np.int32))
np.save(f"{folder}/value.npy", random.normal(size=(count, 3)).astype(np.float32))
END
: > bench-out/scatter.jsonl
printf '%-9s %10s %10s %10s %10s\n' index rows sorted exact atomic
for index in near anywhere one; do
  line=$(printf '%-9s' "$index")
  for way in rows sorted exact atomic; do
    least='' scatter=$way step=add
    if [[ $way == sorted ]]; then scatter=rows step=add_computed; fi
    for _ in 1 2 3; do
      us=$("$bin/drun" "$here/cases/scatter.dr" --device "$device" --scatter "$scatter" --bind "index=$out/$index.npy" --bind "value=$out/value.npy" \
        --step "$step=$runs" --timing 2>&1 | sed -n 's/^add[a-z_]*: \([0-9.]*\) us a run while.*/\1/p') || us=''
      [[ -n $us ]] || break
      least=$(printf '%s\n' "$us" $least | sort -g | head -1)
    done
    line+=$(printf ' %10s' "${least:--}")
    [[ -z $least ]] || echo "{\"bench\": \"scatter\", \"index\": \"$index\", \"sources\": $count, \"scatter\": \"$way\", \"us\": $least}" >> bench-out/scatter.jsonl
  done
  echo "$line"
done
