// SPDX-License-Identifier: Apache-2.0
// A pixel's colour, read between four texels where a face is seen, its difference to the target, and what that pulls at
// those texels.
READ_UVEC2(0, entries);
READ_VEC4(1, screen);
READ_IVEC4(2, face);
READ_VEC2(3, uv);
READ_IVEC4(4, uv_face);
READ_VEC3(5, texels);
READ_VEC3(6, goal);
WRITE(7, sums, SUM);
#ifdef LISTED
READ_UINT(8, list);
#endif

void add(int i, vec3 x) {
  if (push.zero != 0) return;
  atomicAdd(sums.d[i * 3], SUM_OF(x.x));
  atomicAdd(sums.d[i * 3 + 1], SUM_OF(x.y));
  atomicAdd(sums.d[i * 3 + 2], SUM_OF(x.z));
}

void main() {
  int index = invocation();
#ifdef LISTED
  if (index >= int(ONE(list, 3))) return;
  index = int(ONE(list, 4 + index));
#endif
  if (index >= W * W) return;
  int f = int(TWO(entries, index).x);
  if (f < 0) return;
  vec2 p = vec2(index % W, index / W) + 0.5;
  ivec4 corner = FOUR(face, f), ends = FOUR(uv_face, f);
  vec4 a = FOUR(screen, corner.x), b = FOUR(screen, corner.y), c = FOUR(screen, corner.z);
  vec2 u = a.xy - p, v = b.xy - p, w = c.xy - p;
  vec3 share = vec3(cross2(v, w) / a.w, cross2(w, u) / b.w, cross2(u, v) / c.w);
  share /= share.x + share.y + share.z;
  vec2 place = (share.x * TWO(uv, ends.x) + share.y * TWO(uv, ends.y) + share.z * TWO(uv, ends.z)) * float(T) - 0.5;
  vec2 low = floor(place), t = place - low;
  ivec2 from = clamp(ivec2(low), ivec2(0), ivec2(T - 1)), to = clamp(ivec2(low) + 1, ivec2(0), ivec2(T - 1));
  ivec4 at = ivec4(from.y * T + from.x, from.y * T + to.x, to.y * T + from.x, to.y * T + to.x);
  vec4 weight = vec4((1.0 - t.x) * (1.0 - t.y), t.x * (1.0 - t.y), (1.0 - t.x) * t.y, t.x * t.y);
  vec3 color = weight.x * THREE(texels, at.x) + weight.y * THREE(texels, at.y) + weight.z * THREE(texels, at.z) + weight.w * THREE(texels, at.w);
  vec3 pull = (2.0 / 3.0) * (color - THREE(goal, index));  // by pixels, not by their number
  for (int k = 0; k < 4; ++k) add(at[k], weight[k] * pull);
}
