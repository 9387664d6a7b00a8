#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A run that stops and goes on gives the same bits as one that does not; Ctrl-C lets a run write what it has. Also what
# --counters, --timing and --ablate=cache print. usage: resume_test.sh DRUN
set -euo pipefail
drun=$(readlink -f "$1")
source "$(dirname "${BASH_SOURCE[0]}")/on_lavapipe.sh" "resuming runs on lavapipe"
cat > fit.dr << 'END'
edition 1;
param a : float[W, H] = 0.5;
state momentum : float[W, H];
param tone : float = 1.0;
input photo : float[W, H];
let blurred = 0.5 * shift(photo, 1, 0) + 0.5 * photo - mean(photo);
let error = mean((a * tone - blurred) * (a * tone - blurred)) * (1.0 + 0.01 * float(step_index));
step fit { momentum <- 0.9 * momentum + grad(error, a); a <- a - momentum; output error; }
step tune { tone <- tone - 0.1 * grad(error, tone); output error; }
END
common=(fit.dr --bind 'photo==[[0.1, 0.7, 0.2], [0.9, 0.3, 0.5]]' --device)
fail() { echo "FAILED: $*"; exit 1; }
run() { "$drun" "${common[@]}" llvmpipe "$@"; }
same() { for leaf in a momentum tone; do cmp "$1/$leaf.npy" "$2/$leaf.npy" || fail "$leaf of $1 and $2"; done; cmp "$1/log.jsonl" "$2/log.jsonl"; }

# Stopped between steps and in the middle of one.
run --log-every 1 --step fit=7 --step tune=3 --out straight > /dev/null
run --log-every 1 --step fit=4 --out parts > /dev/null
run --log-every 1 --step fit=7 --resume --out parts > /dev/null
run --log-every 1 --step fit=7 --step tune=1 --resume --out parts > /dev/null
run --log-every 1 --step fit=7 --step tune=3 --resume --out parts > /dev/null
same straight parts
run --step fit=7 --step tune=3 --resume --out parts 2>&1 | grep -q "nothing is left to run" || fail "a run that is over goes on"
same straight parts
# What a step gave that ended before stands in the folder alone, and what goes to one file is seen before anything runs.
status=0; run --step fit=7 --step tune=4 --resume --out parts --save fit.error=error.npy > out.txt 2> err.txt || status=$?
[[ $status == 1 && ! -s out.txt ]] && grep -q "ended before --resume stands in 'parts'" err.txt || fail "an old output: $(cat err.txt)"
for file in ./a.npy parts/tone.npy "$PWD/parts/../parts/fit.error.npy"; do
  status=0; run --step fit=1 --out parts --save a=a.npy momentum="$file" > /dev/null 2> err.txt || status=$?
  [[ $status == 1 ]] && grep -q "is to be written twice" err.txt || fail "one file for two: $(cat err.txt)"
done
same straight parts
# What a step gives that a stop kept from running is left out with a word, and the code is the stop's.
status=0; run --step fit=100000000 --step tune=1 --timeout 1 --save tune.error=late.npy a=early.npy > /dev/null 2> err.txt || status=$?
[[ $status == 124 && -e early.npy && ! -e late.npy ]] && grep -q "the step of 'tune.error' has not run" err.txt || fail "a late result: $status $(cat err.txt)"
# With buffers that are bound in parts, too: of 16 bytes, with which 'a' and its momentum have two.
run --log-every 1 --step fit=4 --buffers 16 --out bound > /dev/null
run --log-every 1 --step fit=7 --step tune=3 --buffers 16 --resume --out bound > /dev/null
same straight bound

# A result that cannot be written costs no run: it is an error, what else there is is written, and --resume writes the rest.
# So does one after a kill for a step that was over before.
cat > seen.dr << 'END'
edition 1;
param a : float[4, 4] = 0.5;
step look { output seen = a + 1.0, last = a; }
step halve { a <- 0.5 * a; }
END
seen() { "$drun" seen.dr --device llvmpipe "$@"; }
rm -rf free; seen --step halve --step look --out free --save look.seen=asked.npy > /dev/null; mv asked.npy free
for blocked in look.seen.png look.seen.npy; do
  for every in 1 never; do
    rm -rf blocked; mkdir -p blocked/$blocked
    seen --step halve --step look --checkpoint-every $every --out blocked > /dev/null 2> err.txt && fail "$blocked is not written, and all is well"
    grep -q "cannot write 'blocked/$blocked'.*--resume" err.txt || fail "words for $blocked: $(cat err.txt)"
    [[ -s blocked/look.last.npy && -s blocked/look.last.png && -s blocked/a.npy ]] || fail "nothing is written beside $blocked"
    rmdir blocked/$blocked
    seen --step halve --step look --resume --out blocked --save look.seen=asked.npy > /dev/null 2> err.txt || fail "$(cat err.txt)"
    mv asked.npy blocked
    grep -q "nothing is left to run" err.txt || fail "a run is done again for $blocked"
    for file in look.seen.npy look.seen.png look.last.npy look.last.png a.npy asked.npy; do cmp free/$file blocked/$file || fail "$file after $blocked"; done
  done
done
rm -rf free blocked
"$drun" seen.dr --device llvmpipe --step look --step halve=900000000 --checkpoint-every 1 --out blocked > /dev/null 2>&1 &
for ((wait = 0; wait < 240; ++wait)); do [[ -s blocked/checkpoint.json ]] && break; sleep 0.05; done
kill -KILL $!; wait $! || true
done=$(sed -n 's/.*"done": \([0-9]*\).*/\1/p' blocked/checkpoint.json)
[[ ! -e blocked/look.seen.npy ]] || fail "results before the end"
seen --step look --step halve=$((done + 1)) --resume --out blocked > /dev/null
seen --step look --out free > /dev/null
cmp free/look.seen.npy blocked/look.seen.npy || fail "outputs of a step that was over before a kill"
# A checkpoint that cannot be named leaves nothing behind.
rm -rf blocked; mkdir -p blocked/checkpoint.json
seen --step look --out blocked > /dev/null 2> err.txt && fail "a checkpoint is not written, and all is well"
grep -q "cannot write 'blocked/checkpoint.json': " err.txt && [[ ! -e blocked/checkpoint.json.partial ]] || fail "$(cat err.txt; ls blocked)"

# Ctrl-C in a run that would take hours.
"$drun" "${common[@]}" llvmpipe --step fit=900000000 --out stopped > /dev/null 2> err.txt &
# The log grows while the step runs, by whole lines.
log=0
for ((wait = 0; wait < 120 && log < 2; ++wait)); do
  sleep 0.5
  log=$({ wc -l < stopped/log.jsonl; } 2> /dev/null || echo 0)
done
((log > 1)) || fail "nothing is logged while a step runs"
[[ $(head -n "$log" stopped/log.jsonl | grep -c '^{"step": "fit", "run": [0-9]*, "error": \([0-9.e+-]*\|null\)}$') == "$log" ]] || fail "lines of the log"
[[ ! -e stopped/a.npy && ! -e stopped/checkpoint.json ]] || fail "results before the end"
kill -INT $!
status=0; wait $! || status=$?
[[ $status == 130 ]] || fail "an interrupted run ends with $status: $(cat err.txt)"
grep -q "interrupted" err.txt || fail "an interrupted run says nothing"
done=$(sed -n 's/.*"done": \([0-9]*\).*/\1/p' stopped/checkpoint.json)
((done > 0 && done < 900000000)) || fail "an interrupted run has done $done runs"
[[ $(ls -d stopped/checkpoint-*) == stopped/checkpoint-0 ]] || fail "folders of checkpoints: $(ls stopped)"
run --step fit=$((done + 5)) --resume --out stopped > /dev/null
[[ $(ls -d stopped/checkpoint-*) == stopped/checkpoint-1 ]] || fail "folders of checkpoints: $(ls stopped)"
run --step fit=$((done + 5)) --out again > /dev/null
for leaf in a momentum; do cmp stopped/$leaf.npy again/$leaf.npy || fail "$leaf after an interrupted run"; done

# SIGTERM, which batch systems send, and SIGHUP, of a terminal that is closed, likewise; what ends with a signal is no success.
for signal in TERM HUP; do
  rm -rf terminated
  "$drun" "${common[@]}" llvmpipe --step fit=900000000 --out terminated > /dev/null 2> err.txt &
  for ((wait = 0; wait < 240; ++wait)); do [[ -s terminated/log.jsonl ]] && break; sleep 0.25; done
  kill -$signal $!
  status=0; wait $! || status=$?
  [[ $status == $(($(kill -l $signal) + 128)) && -s terminated/checkpoint.json ]] && grep -q 'terminated\|its terminal is gone' err.txt ||
    fail "SIG$signal: $status, $(cat err.txt)"
done
# Under nohup nobody asks for an end.
rm -rf terminated
nohup "$drun" "${common[@]}" llvmpipe --step fit=900000000 --timeout 3 --out terminated > /dev/null 2> err.txt &
for ((wait = 0; wait < 240; ++wait)); do [[ -s terminated/log.jsonl ]] && break; sleep 0.25; done
kill -HUP $!
status=0; wait $! || status=$?
[[ $status == 124 ]] || fail "SIGHUP under nohup: $status, $(cat err.txt)"

# --timeout likewise; a checkpoint is there before the end, by runs and by seconds.
for every in 1000 0.5s; do
  status=0
  run --step fit=900000000 --checkpoint-every $every --timeout 4 --out "timed-$every" > /dev/null 2> err.txt &
  for ((wait = 0; wait < 240; ++wait)); do [[ -s timed-$every/checkpoint.json ]] && break; sleep 0.05; done
  [[ -s timed-$every/checkpoint.json && ! -e timed-$every/a.npy ]] || fail "no checkpoint while a run goes on, every $every"
  # One run writes to a folder, and says so of another.
  other=0; run --step fit=1 --out "timed-$every" > /dev/null 2> other.txt || other=$?
  [[ $other == 1 ]] && grep -q "another drun writes to 'timed-$every'" other.txt || fail "two write to one folder: $(cat other.txt)"
  wait $! || status=$?
  [[ $status == 124 ]] && grep -q 'the time is over' err.txt || fail "--timeout: $status, $(cat err.txt)"
  [[ -s timed-$every/a.npy ]] || fail "--timeout writes nothing"
done
runs=$(sed -n 's/.*"done": \([0-9]*\).*/\1/p' timed-1000/checkpoint.json)
run --step fit=$runs --resume --out timed-1000 2>&1 | grep -q "nothing is left to run" || fail "checkpoint by runs"
run --step fit=$runs --checkpoint-every never --out timed-again > /dev/null
cmp timed-1000/a.npy timed-again/a.npy || fail "a run with checkpoints gives other bits"

# What killed runs left goes; what is the user's stays.
mkdir -p parts/checkpoint-7 parts/checkpoint-notes && touch parts/a.npy.123.tmp parts/checkpoint.json.partial parts/own.tmp
run --log-every 1 --step fit=8 --step tune=3 --out parts > /dev/null
[[ ! -e parts/checkpoint-7 && ! -e parts/a.npy.123.tmp && ! -e parts/checkpoint.json.partial ]] || fail "leftovers: $(ls parts)"
[[ -e parts/checkpoint-notes && -e parts/own.tmp ]] || fail "the user's files: $(ls parts)"

# The reference goes on too.
"$drun" "${common[@]}" reference --step fit=5 --out reference > /dev/null
"$drun" "${common[@]}" reference --step fit=2 --out reference-parts > /dev/null
"$drun" "${common[@]}" reference --step fit=5 --resume --out reference-parts > /dev/null
cmp reference/a.npy reference-parts/a.npy || fail "the reference goes on elsewhere"

# What is no checkpoint.
status=0; run --step fit=1 --resume --out nowhere > /dev/null 2> err.txt || status=$?
[[ $status == 1 ]] && grep -q "no checkpoint to resume from" err.txt || fail "resuming from nothing: $(cat err.txt)"
mkdir -p broken; echo '{"folder": "../a"}' > broken/checkpoint.json
status=0; run --step fit=1 --resume --out broken > /dev/null 2> err.txt || status=$?
[[ $status == 1 ]] && grep -q "is no checkpoint of drun" err.txt || fail "resuming from anything: $(cat err.txt)"
# One byte of a param, of the log, or of the counts: nothing goes on from numbers that nobody computed.
run --step fit=3 --out damaged > /dev/null
for file in checkpoint-0/a.npy checkpoint-0/log.jsonl checkpoint.json; do
  rm -rf copy && cp -r damaged copy
  at=$(($(stat -c %s "copy/$file") - 3)) # a number, not the header
  byte=$(od -An -tu1 -j $at -N 1 "copy/$file")
  printf "\\x$(printf %02x $((byte ^ 1)))" | dd of="copy/$file" bs=1 seek=$at conv=notrunc status=none
  status=0; run --step fit=4 --resume --out copy > /dev/null 2> err.txt || status=$?
  [[ $status == 1 ]] && grep -qE "is damaged|is no checkpoint of drun" err.txt || fail "$file changed: $status, $(cat err.txt)"
done
status=0; run --step fit=1 --resume > /dev/null 2> err.txt || status=$?
[[ $status == 2 ]] || fail "--resume without --out"

# The mean of the photo is computed once; without the cache, each time.
run --step fit=5 --counters > counters.txt
grep -Eq "^fit: 5 runs  commands [0-9]+ run, [1-9][0-9]* left out" counters.txt || fail "counters: $(cat counters.txt)"
run --step fit=5 --counters --ablate=cache > counters.txt
grep -Eq "^fit: 5 runs  commands [0-9]+ run, 0 left out" counters.txt || fail "no cache: $(cat counters.txt)"
run --step fit=5 --timing --out timed > timing.txt
grep -Eq "^ +[0-9.]+ +[0-9.]+% .* fit.dr:[0-9]" timing.txt || fail "timing: $(cat timing.txt)"
run --step fit=5 --out untimed > /dev/null
cmp timed/a.npy untimed/a.npy || fail "a timed run gives other bits"

# A device's own profile compiles programs for it.
"$drun" devices | grep -q llvmpipe || fail "drun devices"
"$drun" profile --device llvmpipe -o profile.json
grep -q '"compute_buffer_bytes_per_ns"' profile.json || fail "drun profile: $(cat profile.json)"
run --profile ./profile.json --step fit=5 --out untimed-again > /dev/null
cmp untimed/a.npy untimed-again/a.npy || fail "a measured profile gives other bits"
# Going on with something else is told: with other data, and with another program.
run --step fit=2 --out changed > /dev/null
words=$(run --step fit=3 --resume --out changed 2>&1 > /dev/null)
[[ $words != *'--resume goes on'* ]] || fail "words where nothing is changed: $words"
brighter=(--bind 'photo==[[0.1, 0.7, 0.2], [0.9, 0.3, 0.6]]' --device llvmpipe)
words=$("$drun" fit.dr "${brighter[@]}" --step fit=4 --resume --out changed 2>&1 > /dev/null)
[[ $words == *"other data of 'photo' than the run before"* && $words != *'another program'* ]] || fail "words for other data: $words"
sed 's/0.9 \* momentum/0.8 * momentum/' fit.dr > slower.dr
words=$("$drun" slower.dr "${common[@]:1}" llvmpipe --step fit=5 --resume --out changed 2>&1 > /dev/null)
[[ $words == *"another program"*"other data of 'photo'"* ]] || fail "words for another program: $words"
# What is bound anew to a leaf that the checkpoint holds is told to be left out; what is bound as before is not.
run --step fit=2 --bind 'a==[[1, 2, 3], [4, 5, 6]]' --out bound-anew > /dev/null
words=$(run --step fit=3 --bind 'a==[[1, 2, 3], [4, 5, 6]]' --resume --out bound-anew 2>&1 > /dev/null)
[[ $words != *'--resume takes'* ]] || fail "words where nothing is bound anew: $words"
words=$(run --step fit=4 --bind 'a==[[1, 2, 3], [4, 5, 7]]' --bind tone=2 --resume --out bound-anew 2>&1 > /dev/null)
for leaf in a tone; do
  [[ $words == *"--resume takes '$leaf' from the checkpoint, not from --bind"* ]] || fail "words for '$leaf': $words"
done

echo "resume: all as expected"
