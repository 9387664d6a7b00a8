# SPDX-License-Identifier: Apache-2.0
# Sourced by tests that run on lavapipe: leaves the test out where there is none (an error in CI), and goes to an empty
# folder. `$drun` is the program to test; $1 says what is left out.
if [[ -z ${DR_LAVAPIPE_ICD-} ]]; then
  echo "DR_LAVAPIPE_ICD is not set: $1 is left out"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi
export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD
profiles=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")")/../../compiler/target/profiles
source "$(dirname "${BASH_SOURCE[0]}")/in_folder.sh"

# expect STATUS TEXT ARGUMENTS...: drun on lavapipe ends so and says so.
expect() {
  local want=$1 text=$2 status=0
  shift 2
  "$drun" "$@" --device llvmpipe > said 2>&1 || status=$?
  if [[ $status != "$want" ]] || ! grep -qF -- "$text" said; then
    echo "drun $*: exit $status, expected $want and: $text"
    tail -n 5 said
    failed=1
  fi
}

# gpu_profile FILE: lavapipe's profile, but for subgroups as a GPU has them.
gpu_profile() {
  sed 's/"subgroup_size": [0-9]*/"subgroup_size": 32/; s/"lanes_in_turn": true/"lanes_in_turn": false/' "$profiles/lavapipe.json" > "$1"
  grep -q '"subgroup_size": 32' "$1" && grep -q '"lanes_in_turn": false' "$1"
}
