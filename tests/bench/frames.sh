#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# frames.sh BUILD_FOLDER [--device NAME] [--quick]: Avocado, shoe and helmet under one lamp and under two skies beside Mitsuba 3, as a mean difference of a
# term each, and how far normals by frames of uv are from those by MikkTSpace's tangents. It wants Mitsuba in the python that $DR_MITSUBA_PYTHON
# names (python3; `pip install mitsuba`), LLVM for it in $DRJIT_LIBLLVM_PATH where it is not found, and the meshes and maps in $DR_SHARED_DATA, or
# shared/data beside the sources; without them it is skipped. --quick: Avocado and one sky.
set -euo pipefail
source "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/suite.bash"
suite frames "$@"
no_more
python=${DR_MITSUBA_PYTHON:-python3}
data=${DR_SHARED_DATA:-$root/../shared/data}
if [[ ! -d $data/gltf ]]; then echo "frames: skipped, there is no $data/gltf"; exit 0; fi
if ! "$python" -c 'import mitsuba' 2> /dev/null; then echo "frames: skipped, $python has no mitsuba (pip install mitsuba)"; exit 0; fi
meshes=(gltf/Avocado/Avocado.gltf gltf/MaterialsVariantsShoe/MaterialsVariantsShoe.gltf restricted/DamagedHelmet/DamagedHelmet.glb)
skies=(venice_sunset_1k quarry_01_1k)
if [[ -n $quick ]]; then meshes=("${meshes[0]}") skies=("${skies[0]}"); fi

for mesh in "${meshes[@]}"; do
  file=$data/$mesh name=$(basename "${mesh%.*}") folder=$out/$(basename "${mesh%.*}")
  if [[ ! -f $file ]]; then echo "frames: $name left out, there is no $file"; continue; fi
  mkdir -p "$folder"
  bound=(--bind "position=$file:position" --bind "face=$file:indices" --bind "normals=$file:normal" --bind "uv=$file:uv" --bind "uv_face=$file:uv_indices"
    --bind "base_map=$file:material:0:base_color_texture:rgb" --bind "metal_map=$file:material:0:metallic_texture"
    --bind "rough_map=$file:material:0:roughness_texture" --bind "normal_map=$file:material:0:normal_texture:rgb")
  draw() { "$bin/drun" "$here/cases/frames.dr" --device "$device" "${bound[@]}" "$@" > /dev/null; }
  # A file need not have tangents: those of MikkTSpace are made of what the first run writes.
  draw --bind "sky=$data/hdr/${skies[0]}.hdr" --step shape --out "$folder"
  "$python" "$here/frames.py" tangents "$folder"
  tangents=(--bind "tangent=$folder/mikk.npy")
  draw "${tangents[@]}" --bind "sky=$data/hdr/${skies[0]}.hdr" --step tangents --out "$folder"
  "$python" "$here/frames.py" apart "$folder" "$name"
  draw "${tangents[@]}" --bind "sky=$data/hdr/${skies[0]}.hdr" --step under_lamp --step textures --out "$folder/lamp"
  for sky in "${skies[@]}"; do draw "${tangents[@]}" --bind "sky=$data/hdr/$sky.hdr" --step under_sky --out "$folder/lamp/$sky"; done
  "$python" "$here/frames.py" frames "$folder/lamp" "$name"
done | tee "$out/figures.json"
