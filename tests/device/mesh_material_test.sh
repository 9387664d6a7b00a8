#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A mesh that drun writes has the textures and factors of its material, read back by their names; wrong ones are told.
# usage: mesh_material_test.sh DRUN
set -euo pipefail
drun=$(realpath "$1")
source "$(dirname "${BASH_SOURCE[0]}")/in_folder.sh"
cat > write.dr <<'END'
edition 1;
let position = [vec3(0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0)][coord(3).x];
let face = ivec3(0, 1, 2) + 0 * coord(1).x;
let uv = position.xy;
let p = coord(4, 2).xy;
let base = vec3(0.0, 1.0, 0.0) * float(p.x % 2);
let metal = float(1 - p.x % 2);
let rough = float(p.y);
let shine = vec3(0.5, 1.0, 0.25);
step go { output position, face, uv, base, metal, rough, bump = vec3(0.0, 0.0, 1.0) + 0.0 * base, shade = rough, glow = base, shine; }
END
cat > read.dr <<'END'
edition 1;
input base : vec3[W, H];
input metal : float[W, H];
input rough : float[W, H];
input shade : float[W, H];
input glow : vec3[W, H];
input shine : vec3;
let p = coord(W, H).xy;
let color = vec3(0.0, 1.0, 0.0) * float(p.x % 2);
let off = length(base - color) + length(glow - color) + abs(metal - float(1 - p.x % 2)) + abs(rough - float(p.y)) + abs(shade - float(p.y));
step go { output off = max(off) + length(shine - vec3(0.5, 1.0, 0.25)), width = W, height = H; }
END
go() { "$drun" --device reference "$@"; }
mesh=position:face:uv:face:base
textures=metallic_texture=metal:roughness_texture=rough:normal_texture=bump:occlusion_texture=shade:emissive_texture=glow
go write.dr --mesh "ball.glb=$mesh:$textures:emissive=shine" > said
of() { echo --bind "$1=ball.glb:material:$2"; }
# shellcheck disable=SC2046
go read.dr $(of base base_color_texture:rgb) $(of metal metallic_texture) $(of rough roughness_texture) \
  $(of shade occlusion_texture) $(of glow emissive_texture:rgb) $(of shine emissive) > said
[[ $(grep -c -e '^go.off = 0$' -e '^go.width = 4$' -e '^go.height = 2$' said) == 3 ]] || { cat said; failed=1; }
# Numbers that no material has become the nearest one.
cat > over.dr <<'END'
edition 1;
let position = [vec3(0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0)][coord(3).x];
let face = ivec3(0, 1, 2) + 0 * coord(1).x;
step go { output position, face, tint = vec3(1.75, 0.5, 1.0), rough = -0.25, glow = vec3(2.0, -1.0, 0.0), lost = 0.0 / 0.0; }
END
go over.dr --mesh over.glb=position:face:base_color=tint:roughness=rough:emissive=glow > said 2> err
cat > expected <<'END'
drun: warning: --mesh over.glb: 'tint' is 1.75, out of the range of base_color: 1 is written
drun: warning: --mesh over.glb: 'rough' is -0.25, out of the range of roughness: 0 is written
drun: warning: --mesh over.glb: 'glow' is -1, out of the range of emissive: 0 is written
END
grep -v go.lost err | diff expected - || failed=1
cat > again.dr <<'END'
edition 1;
input tint : vec4;
input rough : float;
input glow : vec3;
step go { output tint, rough, glow; }
END
go again.dr --bind tint=over.glb:material:base_color --bind rough=over.glb:material:roughness --bind glow=over.glb:material:emissive > said
printf 'go.%s\n' 'tint = (1, 0.5, 1, 1)' 'rough = 0' 'glow = (2, 0, 0)' | diff - said || failed=1
go over.dr --mesh lost.glb=position:face:metallic=lost > /dev/null 2> err && { echo 'a NaN is written'; failed=1; }
grep -q "the material's metallic factor is " err || { cat err; failed=1; }
refused() {
  if go write.dr --mesh "$1" > /dev/null 2> err || ! grep -qF -- "$2" err; then cat err; echo "not told: $2"; failed=1; fi
}
refused "a.glb=$mesh:rough=rough" "a material has no 'rough'"
refused "a.glb=$mesh:roughness=rough" "'rough' is a picture, expected one value for roughness"
refused "a.glb=$mesh:occlusion_texture=base" "'base' is not made of float"
refused "a.obj=$mesh:metallic_texture=metal" "an .obj file has no 'metallic_texture'"
refused "a.glb=position:face:metallic_texture=metal" "but no uv"
exit $failed
