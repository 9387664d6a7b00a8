#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The installed package: what is there, a project elsewhere that finds it, and both its programs on lavapipe. Without
# that device they are built but not run. usage: install_test.sh CMAKE BUILD_FOLDER CXX
set -euo pipefail
cmake=$1 build=$(realpath "$2") cxx=$3
here=$(dirname "$(realpath "${BASH_SOURCE[0]}")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

"$cmake" --install "$build" --prefix "$work/prefix" > install.txt || { cat install.txt; exit 1; }
mv prefix moved # a package may be moved
cp -r "$here" source
"$cmake" -G Ninja -S source -B consumer -DCMAKE_PREFIX_PATH="$work/moved" -DCMAKE_CXX_COMPILER="$cxx" -DCMAKE_BUILD_TYPE=Release \
  > configure.txt 2>&1 || { cat configure.txt; exit 1; }
"$cmake" --build consumer > build.txt 2>&1 || { cat build.txt; exit 1; }
"$cmake" -G Ninja -S source/c -B consumer_in_c -DCMAKE_PREFIX_PATH="$work/moved" -DCMAKE_BUILD_TYPE=Release > configure.txt 2>&1 ||
  { cat configure.txt; exit 1; }
"$cmake" --build consumer_in_c > build.txt 2>&1 || { cat build.txt; exit 1; }
consumer_in_c/fit_in_c
# Nothing of the package points back to where it was built.
if grep -rlF -e "$build/" -e "$(realpath "$here/../..")/" moved/lib*/cmake moved/include; then
  echo "these files name folders of the build"
  exit 1
fi

moved/bin/drc build source/fit.dr --profile lavapipe -o fit.drb
moved/bin/drc --version
moved/bin/drun --version
if [[ -z ${DR_LAVAPIPE_ICD-} ]]; then
  echo "DR_LAVAPIPE_ICD is not set: the programs are built but not run"
  [[ -z ${CI-} ]] || exit 1
  exit 77
fi
export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD DRC_CACHE_DIR=$work/cache
consumer/play lavapipe fit.drb
consumer/fit lavapipe source/fit.dr
consumer_in_c/fit_in_c llvmpipe
