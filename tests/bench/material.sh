#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# material.sh BUILD_FOLDER [--device NAME] [--quick]: base colour, roughness and metalness of a pear from six pictures of 512 x 512 under each of two
# photographed skies, in textures of 128 x 128: how far off they end. It wants the maps in $DR_SHARED_DATA, or shared/data beside the sources;
# --quick takes the skies that the program paints, pictures of 128 x 128 and textures of 32 x 32.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite material "$@"
no_more
program=$root/docs/examples/material_from_views.dr
maps=${DR_SHARED_DATA:-$root/../shared/data}/hdr
size=(-D S=512 -D T=128)
if [[ -n $quick ]]; then size=(-D S=128 -D T=32); fi
mesh=(--bind "position=$root/docs/examples/pear.obj:position" --bind "face=$root/docs/examples/pear.obj:indices")
"$bin/drun" "$program" --device "$device" "${mesh[@]}" "${size[@]}" --step make --out "$out/made" > "$out/made.txt"
skies=(--bind "sky_a=$out/made/make.sky_a.npy" --bind "sky_b=$out/made/make.sky_b.npy")
if [[ -z $quick ]]; then
  if [[ ! -d $maps ]]; then echo "material: skipped, there is no $maps"; exit 0; fi
  skies=(--bind "sky_a=$maps/venice_sunset_1k.hdr" --bind "sky_b=$maps/quarry_01_1k.hdr")
fi
try=(--step start --step fit=15 --step remember)
begin=$(date +%s.%N)
"$bin/drun" "$program" --device "$device" "${mesh[@]}" "${skies[@]}" "${size[@]}" \
  --bind "base_made=$out/made/make.base_made.npy" --bind "rest_made=$out/made/make.rest_made.npy" \
  "${try[@]}" "${try[@]}" "${try[@]}" "${try[@]}" --step take --step fit=40 --step judge --out "$out/found" > "$out/found.txt"
awk -v begin="$begin" -v end="$(date +%s.%N)" '{ value[$1] = $3 } END { printf "{\"base_dB\": %s, \"roughness\": %s, \"metalness\": %s, \"seconds\": %.1f}\n",
  value["judge.base_psnr"], value["judge.roughness_off"], value["judge.metallic_off"], end - begin }' "$out/found.txt" | tee "$out/figures.json"
