// SPDX-License-Identifier: Apache-2.0
// From pulls in the picture to the vertices, and a step against them.
READ_SUMS(0);
WRITE(1, position, vec4);
READ_FLOAT(2, rate);
#ifdef CHECK
WRITE(3, gradient, vec4);
#endif

void main() {
  int i = invocation();
  if (i >= V) return;
  vec4 at = position.d[i];
  vec4 clip = VIEW * vec4(at.xyz, 1.0);
  vec2 g = vec2(SUM_AT(i * 2), SUM_AT(i * 2 + 1)) * (0.5 * float(W) / (float(W) * float(W))) / clip.w;
  vec3 down = (vec4(g, 0.0, -dot(g, clip.xy) / clip.w) * VIEW).xyz;
#ifdef CHECK
  gradient.d[i] = KEEP(vec4(down, 0.0));
#endif
  position.d[i] = KEEP(vec4(at.xyz - ONE(rate, 0) * down, 0.0));
}
