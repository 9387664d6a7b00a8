#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# run.sh DRUN DATA [OUT] [ARGUMENTS OF DRUN]: opens eyes and mouth of the scan DATA/gltf/LeePerrySmith by open.dr and draws head.dr with it, the
# strands of DATA/hair and the sky of DATA/hdr, if all are there, into OUT (by default human). VIEW=face looks closer.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
drun=$1 data=${2-} out=${3-human}
scan=$data/gltf/LeePerrySmith/LeePerrySmith.glb strands=$data/hair/Ratboy_mohawk.tfx sky=$data/hdr/venice_sunset_1k.hdr
for file in "$scan" "$strands" "$sky"; do
  if [[ ! -f $file ]]; then echo "there is no $file: nothing is drawn"; exit 77; fi
done
case ${VIEW-head} in
  face) camera=('from=[3.6, 2.2, 11]' 'middle=[-0.05, 1.05, 0.8]' 'angle=17') ;;
  *) camera=('from=[9, 4, 13]' 'middle=[0, 0.6, 0]' 'angle=32') ;;
esac
"$drun" "$here/open.dr" --bind "position=$scan:position" --bind "face=$scan:indices" \
  --step sort=200 --step relax=300 --step take --out "$out/open"
"$drun" "$here/head.dr" --bind "position=$out/open/take.opened.npy" --bind "face=$scan:indices" --bind "uv=$scan:uv" \
  --bind "albedo=$data/gltf/LeePerrySmith/Map-COL.jpg" \
  --bind "bumps=$data/gltf/LeePerrySmith/Infinite-Level_02_Tangent_SmoothUV.jpg:raw" --bind 'roughness=[[1.0]]' \
  --bind "sky=$sky" --bind "hair_at=$strands:position" --bind "segment=$strands:segments" --bind "strand=$strands:strand" \
  --bind "${camera[0]}" --bind "${camera[1]}" --bind "${camera[2]}" --step draw --out "$out" "${@:4}"
