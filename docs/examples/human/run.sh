#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# run.sh DRUN DATA [OUT] [ARGUMENTS OF DRUN]: draws head.dr with the scan DATA/gltf/LeePerrySmith and the strands DATA/hair, if both are there,
# into OUT (by default human).
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)
drun=$1 data=${2-} out=${3-human}
scan=$data/gltf/LeePerrySmith/LeePerrySmith.glb strands=$data/hair/Ratboy_mohawk.tfx
for file in "$scan" "$strands"; do
  if [[ ! -f $file ]]; then echo "there is no $file: nothing is drawn"; exit 77; fi
done
"$drun" "$here/head.dr" --bind "position=$scan:position" --bind "face=$scan:indices" --bind "uv=$scan:uv" \
  --bind "albedo=$data/gltf/LeePerrySmith/Map-COL.jpg" --bind "hair_at=$strands:position" \
  --bind "segment=$strands:segments" --bind "strand=$strands:strand" --step draw --out "$out" "${@:4}"
