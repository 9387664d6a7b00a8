# SPDX-License-Identifier: Apache-2.0
# A sphere of 20 * 4^levels triangles as .obj: awk -v levels=3 -f icosphere.awk
function add(a, b, c,    l) {
  l = sqrt(a * a + b * b + c * c)
  ++vertices
  x[vertices] = a / l; y[vertices] = b / l; z[vertices] = c / l
  return vertices
}
function middle(a, b,    key) {
  key = a < b ? a " " b : b " " a
  if (!(key in known)) known[key] = add(x[a] + x[b], y[a] + y[b], z[a] + z[b])
  return known[key]
}
BEGIN {
  g = (1 + sqrt(5)) / 2
  for (s = -1; s <= 1; s += 2) for (t = -g; t <= g; t += 2 * g) { add(s, t, 0); add(0, s, t); add(t, 0, s) }
  # A face is three corners at distance 2 of each other, turned so that it faces outwards.
  n = 0
  for (a = 1; a <= 12; ++a) for (b = a + 1; b <= 12; ++b) for (c = b + 1; c <= 12; ++c) {
    if (far(a, b) || far(b, c) || far(a, c)) continue
    turn = x[a] * (y[b] * z[c] - z[b] * y[c]) - y[a] * (x[b] * z[c] - z[b] * x[c]) + z[a] * (x[b] * y[c] - y[b] * x[c])
    face[++n] = turn > 0 ? a " " b " " c : a " " c " " b
  }
  for (k = 0; k < levels; ++k) {
    m = 0
    for (f = 1; f <= n; ++f) {
      split(face[f], v, " ")
      p = middle(v[1], v[2]); q = middle(v[2], v[3]); r = middle(v[3], v[1])
      next_face[++m] = v[1] " " p " " r
      next_face[++m] = v[2] " " q " " p
      next_face[++m] = v[3] " " r " " q
      next_face[++m] = p " " q " " r
    }
    n = m
    for (f = 1; f <= n; ++f) face[f] = next_face[f]
  }
  for (k = 1; k <= vertices; ++k) printf "v %.9g %.9g %.9g\n", x[k], y[k], z[k]
  for (f = 1; f <= n; ++f) print "f " face[f]
}
function far(a, b) {
  # Corners of one edge are neighbours on the unit sphere: their distance is about 1.05.
  return (x[a] - x[b]) ^ 2 + (y[a] - y[b]) ^ 2 + (z[a] - z[b]) ^ 2 > 1.3
}
