#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The folder docs/ builds as a site without a warning, where mkdocs is installed. usage: site_test.sh SOURCE_ROOT
set -euo pipefail
if ! python3 -c 'import mkdocs' 2> /dev/null; then
  echo "no mkdocs: nothing to build with"
  exit 77
fi
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
export PYTHONDONTWRITEBYTECODE=1
# Not --quiet, which keeps warnings from being counted.
python3 -m mkdocs build --strict -f "$1/docs/site/mkdocs.yml" -d "$site"
[[ -f $site/howto/python/index.html && -f $site/files/dsl/explanations/index.html ]]
# A link to the tree leads to the copy in the site, and code is left as it is.
grep -q 'href="../../files/dsl/explanations/#e0001"' "$site/reference/errors/index.html"
! grep -rqE '<(script|link|img)[^>]*(src|href)="https?:' "$site" --include=index.html
