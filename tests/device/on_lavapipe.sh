# SPDX-License-Identifier: Apache-2.0
# Sourced by tests that run on lavapipe: leaves the test out where there is none (an error in CI), and goes to an empty
# folder that is removed at the end. $1 says what is left out.
if [[ -z ${DR_LAVAPIPE_ICD-} ]]; then
  echo "DR_LAVAPIPE_ICD is not set: $1 is left out"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi
export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD
folder=$(mktemp -d)
# Nothing goes on running when a test fails.
trap 'jobs -p | xargs -r kill -9; rm -rf "$folder"' EXIT
cd "$folder"
