// SPDX-License-Identifier: Apache-2.0
// Faces into the picture: LANES invocations walk the box around each, and an entry keeps the nearest: depth, then face.
// Faces that look away and those that reach behind the near plane are left out.
READ_IVEC4(0, face);
READ_VEC4(1, screen);
WRITE(2, entries, uint64_t);

// Positive on the inner side of an edge. It is exactly opposite for the two faces beside it; what lies on it counts as a
// little to the right and, much less, below.
bool within(float side, vec2 a, vec2 b) {
  float inner = side != 0.0 ? side : a.y != b.y ? a.y - b.y : b.x - a.x;
  return inner < 0.0;
}

void main() {
  int f = invocation() / LANES, lane = invocation() % LANES;
  if (f >= F) return;
  ivec3 corner = FOUR(face, f).xyz;
  vec4 a = FOUR(screen, corner.x), b = FOUR(screen, corner.y), c = FOUR(screen, corner.z);
  if (min(min(a.w, b.w), c.w) < 0.001) return;
  float area = cross2(b.xy - a.xy, c.xy - a.xy);
  if (area >= 0.0) return;
  vec2 low = min(min(a.xy, b.xy), c.xy), high = max(max(a.xy, b.xy), c.xy);
  ivec2 first = ivec2(max(ceil(low - 0.5), vec2(0.0))), last = ivec2(min(floor(high - 0.5), vec2(W - 1)));
  ivec2 box = last - first + 1;
  if (box.x <= 0 || box.y <= 0) return;
  int count = box.x * box.y;
  ivec2 at = first + ivec2(lane % box.x, lane / box.x);
  for (int k = lane; k < count; k += LANES) {
    vec2 p = vec2(at) + 0.5;
    vec2 u = a.xy - p, v = b.xy - p, w = c.xy - p;
    float bc = cross2(v, w), ca = cross2(w, u), ab = cross2(u, v);
    if (within(bc, b.xy, c.xy) && within(ca, c.xy, a.xy) && within(ab, a.xy, b.xy)) {
      float depth = (bc * a.z + ca * b.z + ab * c.z) / (bc + ca + ab);
      uint64_t entry = (uint64_t(floatBitsToUint(clamp(depth, 0.0, 1.0))) << 32) | uint64_t(uint(f));
      atomicMin(entries.d[at.y * W + at.x], KEEP(entry));
    }
    at.x += LANES;
    while (at.x > last.x) at += ivec2(-box.x, 1);
  }
}
