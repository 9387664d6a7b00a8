#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What the tutorials teach, on real meshes of $DR_SHARED_DATA, or shared/data beside the sources, small and short: a shape
# from silhouettes, a texture, a pose, a shading function. usage: data_test.sh DRUN; 77 where data or device are missing.
set -euo pipefail
drun=$(realpath "$1")
here=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
root=$(realpath "$here/../..")
data=${DR_SHARED_DATA:-$root/../shared/data}
if [[ ! -e $data/obj/spot/cow.obj ]]; then echo "skipped: there is no $data"; exit 77; fi
if [[ -z ${DR_LAVAPIPE_ICD-} ]]; then echo "skipped: DR_LAVAPIPE_ICD names no device"; exit 77; fi
export VK_ICD_FILENAMES=$DR_LAVAPIPE_ICD VK_DRIVER_FILES=$DR_LAVAPIPE_ICD
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
failed=0
run() { "$drun" "$@" > "$out/run.txt" || { cat "$out/run.txt"; exit 1; }; }
# bind FOLDER STEP NAME...: outputs of the step as leaves of their names.
bind() { local leaf; for leaf in "${@:3}"; do printf -- '--bind\n%s=%s/%s.npy\n' "$leaf" "$1" "$2.$leaf"; done; }
# holds WHAT STEP NAME CONDITION: of the values `first` and `last` that the step printed for NAME.
holds() {
  awk -v what="$1" -v name="\"$3\": " '
    index($0, "\"step\": \"'"$2"'\"") && (i = index($0, name)) {
      value = substr($0, i + length(name)) + 0
      if (first == "") first = value
      last = value
    }
    END { if (first == "" || !('"$4"')) { print what ": '"$3"' from " first " to " last ", expected '"$4"'"; exit 1 } }
  ' "$out/fit/log.jsonl" || failed=1
}

# 1. Shapes from silhouettes, from a sphere: closed meshes of one piece.
run "$root/docs/examples/pear/target.dr" -D fine=8 --step meshes --out "$out/sphere"
for mesh in obj/spot/cow.obj obj/blub/blub_triangulated.obj obj/bob/bob_tri.obj; do
  run "$root/docs/examples/studio.dr" -D W=64 -D H=64 -D N=4 --bind "position=$data/$mesh:position" \
    --bind "face=$data/$mesh:indices" --step silhouettes --out "$out/target"
  mapfile -t from < <(bind "$out/sphere" meshes position face; bind "$out/target" silhouettes view mask)
  run "$root/docs/examples/pear/fit.dr" -D steps=40 "${from[@]}" --step fit_shape=40 --out "$out/fit"
  holds "$mesh" fit_shape loss 'last < 0.2 * first'
done

# 2. Textures.
for mesh in obj/spot/cow.obj:obj/spot/cow_texture.png gltf/Avocado/Avocado.gltf:gltf/Avocado/Avocado_baseColor.png \
  obj/blub/blub_triangulated.obj:obj/blub/blub_texture.png; do
  file=$data/${mesh%:*} picture=$data/${mesh#*:}
  run "$root/docs/examples/studio.dr" -D W=64 -D H=64 -D N=6 --bind "position=$file:position" --bind "face=$file:indices" \
    --bind "uv=$file:uv" --bind "uv_face=$file:uv_indices" --bind "albedo=$picture" --step pictures --out "$out/target"
  mapfile -t from < <(bind "$out/target" pictures position face uv uv_face view mask image)
  run "$root/docs/examples/pear/fit.dr" -D T=64 "${from[@]}" --step fit_texture=30 --out "$out/fit"
  holds "$mesh" fit_texture loss 'last < 0.05 * first'
done

# 3. Poses, of Spot in its last pictures' place.
file=$data/obj/spot/cow.obj picture=$data/obj/spot/cow_texture.png
run "$root/docs/examples/studio.dr" -D N=2 --bind "position=$file:position" --bind "face=$file:indices" \
  --bind "uv=$file:uv" --bind "uv_face=$file:uv_indices" --bind "albedo=$picture" --step pictures --out "$out/target"
mapfile -t from < <(bind "$out/target" pictures position face uv uv_face view mask)
from+=(--bind "photo=$out/target/pictures.image.npy")
run "$root/tests/bench/cases/pose.dr" -D steps=60 "${from[@]}" --bind "albedo=$picture" --step fit=60 --out "$out/fit"
holds "pose of spot" fit degrees_off 'last < 0.2 && first > 0.99'
holds "pose of spot" fit percent_off 'last < 0.1 && first > 0.99'

# 4. A shading function of one's own.
for mesh in gltf/armchair/armchair.gltf obj/spot/cow.obj; do
  run "$here/lamp_on_mesh.dr" --bind "position=$data/$mesh:position" --bind "face=$data/$mesh:indices" --step fit=80 \
    --out "$out/fit"
  holds "$mesh" fit error 'last < 0.02 * first'
done
exit $failed
