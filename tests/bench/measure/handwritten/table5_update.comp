// SPDX-License-Identifier: Apache-2.0
// A step of the texels against what pulls at them; and what the program does to the vertices.
READ_SUMS(0);
READ_VEC3(1, before);
READ_FLOAT(2, rate);
WRITE(3, texels, float);
WRITE(4, position, vec4);
#ifdef CHECK
WRITE(5, gradient, float);
#endif

void main() {
  int i = invocation();
  if (i < V) position.d[i] = KEEP(position.d[i] * ONE(rate, 1));
  if (i >= T * T) return;
  vec3 g = vec3(SUM_AT(i * 3), SUM_AT(i * 3 + 1), SUM_AT(i * 3 + 2)) * (1.0 / (float(W) * float(W)));
  vec3 after = THREE(before, i) - ONE(rate, 0) * g;
  for (int k = 0; k < 3; ++k) {
    texels.d[i * 3 + k] = KEEP(after[k]);
#ifdef CHECK
    gradient.d[i * 3 + k] = KEEP(g[k]);
#endif
  }
}
