# SPDX-License-Identifier: Apache-2.0
# Sourced by tests: goes to an empty folder that is removed at the end.
folder=$(mktemp -d)
# Nothing goes on running when a test fails.
trap 'jobs -p | xargs -r kill -9; rm -rf "$folder"' EXIT
cd "$folder"
failed=0
