#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every field of the bundle's tables is looked at by check(): its name stands in compiler/backend/bundle/check*.cpp, or in
# bundle.cpp, as a member. usage: bundle_fields_test.sh SOURCE_ROOT
set -euo pipefail
cd "$1/compiler/backend/bundle"
fields=$(sed 's,//.*,,' bundle.fbs | awk '/^table|^struct/ { inside = 1; next } /^}/ { inside = 0 } inside && /:/ { sub(/ *:.*/, ""); gsub(/ /, ""); print }' | sort -u)
(($(wc -w <<< "$fields") > 50)) || { echo "found too few fields: $fields"; exit 1; }
missing=0
for field in $fields; do
  grep -qE "(->|\\.)$field\\b" check.cpp check_command.cpp bundle.cpp || { echo "check() does not look at '$field'"; missing=1; }
done
exit $missing
