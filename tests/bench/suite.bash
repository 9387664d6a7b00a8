# SPDX-License-Identifier: Apache-2.0
# What suites in bash share. A suite NAME.sh begins with `source .../suite.bash` and then `suite NAME "$@"`, which takes
# BUILD_FOLDER [--device NAME] [--quick] and sets
#   build, bin   the build folder and its programs
#   here, root   tests/bench and the sources
#   out          bench-out/NAME, which it makes, with run.json: device and driver, commit, date
#   quick        1, or nothing
#   device       for `drun --device`: --device, else DR_DEVICE; without either lavapipe where DR_LAVAPIPE_ICD names it
#   rest         all other arguments
#   suite        NAME

suite() {
  local name=$1 described
  suite=$name
  shift
  if [[ ! -d ${1-} ]]; then echo "$name: expected a build folder, found '${1-}'" >&2; exit 2; fi
  build=$(cd "$1" && pwd) bin=$build/bin quick='' device=${DR_DEVICE-} rest=()
  here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
  root=$(cd "$here/../.." && pwd)
  out=$PWD/bench-out/$name
  shift
  while (($# > 0)); do
    case $1 in
      --quick) quick=1 ;;
      --device) device=${2-}; [[ -n $device ]] || { echo "$name: --device takes a name" >&2; exit 2; }; shift ;;
      *) rest+=("$1") ;;
    esac
    shift
  done
  if [[ -z $device && -n ${DR_LAVAPIPE_ICD-} ]]; then export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD; fi
  mkdir -p "$out"
  described=$("$bin/drun" devices | grep -i -m 1 -e "^$device:" -e "$device" || "$bin/drun" devices | head -n 1)
  local commit changes
  commit=$(git -C "$here" rev-parse --short HEAD 2> /dev/null || true)
  changes=$(git -C "$here" status --porcelain -uno 2> /dev/null || true)
  printf '{"device": "%s", "commit": "%s", "quick": %s, "date": "%s", "processors": %d}\n' "${described#*: }" \
    "$commit${changes:+ with changes}" "$([[ -n $quick ]] && echo true || echo false)" "$(date -u '+%Y-%m-%d %H:%M UTC')" "$(nproc)" \
    > "$out/run.json"
}

# Of a suite that takes nothing else.
no_more() {
  if ((${#rest[@]} == 0)); then return; fi
  echo "$(basename "$out"): unknown argument ${rest[0]} (BUILD_FOLDER [--device NAME] [--quick])" >&2
  exit 2
}

# draw_points COUNT QUICK_COUNT LEAF...: NAME.py draws points into NAME.npy of each leaf.
draw_points() {
  local leaf count=$1
  if [[ -n $quick ]]; then count=$2; fi
  python3 "$here/$suite.py" points "$out" "$count"
  from=()
  for leaf in "${@:3}"; do from+=(--bind "$leaf=$out/$leaf.npy"); done
}

# judge_points DEVICE FILE: NAME.py judges what the step `terms` of NAME.dr makes of them there; FILE.json has its record.
judge_points() {
  "$bin/drun" "$here/cases/$suite.dr" --device "$1" "${from[@]}" --step terms --out "$out/out" > "$out/run.txt"
  python3 "$here/$suite.py" judge "$out" | tee "$out/$2.json"
}
