// SPDX-License-Identifier: Apache-2.0
// Vertices to the picture: pixels, depth, distance; and, where CLEAR, the picture's entries and the vertices' sums emptied.
READ_VEC4(0, position);
WRITE(1, screen, vec4);
#ifdef CLEAR
WRITE(2, entries, uint64_t);
WRITE(3, sums, SUM);
#endif

void main() {
  int i = invocation();
#ifdef CLEAR
  for (int k = i; k < W * W; k += CLEARING) entries.d[k] = 0xfffffffffffffffful;
  for (int k = i; k < SUMS; k += CLEARING) sums.d[k] = SUM(0);
#endif
  if (i >= V) return;
  vec4 clip = VIEW * vec4(FOUR(position, i).xyz, 1.0);
  vec4 place = vec4((clip.xy / clip.w * 0.5 + 0.5) * float(W), clip.z / clip.w, clip.w);
  screen.d[i] = KEEP(place);
}
