# SPDX-License-Identifier: Apache-2.0
# A sphere around the y axis as .obj, of 2 * around * (rings - 1) triangles: awk -v around=31 -v rings=12 -f uv_sphere.awk
# With -v textured=1 it has texture coordinates, with a seam.
BEGIN {
  pi = atan2(0, -1)
  print "v 0 1 0"
  for (r = 1; r < rings; ++r) for (k = 0; k < around; ++k) {
    t = pi * r / rings; p = 2 * pi * k / around
    printf "v %.9g %.9g %.9g\n", sin(t) * sin(p), cos(t), sin(t) * cos(p)
  }
  print "v 0 -1 0"
  if (textured) for (r = 0; r <= rings; ++r) for (k = 0; k <= around; ++k) printf "vt %.9g %.9g\n", k / around, 1 - r / rings
  last = 2 + (rings - 1) * around
  for (k = 0; k < around; ++k) {
    n = (k + 1) % around
    face(1, 2 + k, 2 + n, 0, k, 1, k, 1, k + 1)
    for (r = 0; r < rings - 2; ++r) {
      a = 2 + r * around
      face(a + k, a + around + k, a + around + n, r + 1, k, r + 2, k, r + 2, k + 1)
      face(a + k, a + around + n, a + n, r + 1, k, r + 2, k + 1, r + 1, k + 1)
    }
    a = 2 + (rings - 2) * around
    face(a + k, last, a + n, rings - 1, k, rings, k, rings - 1, k + 1)
  }
}

function corner(v, r, k) { return textured ? v "/" r * (around + 1) + k + 1 : v }
function face(a, b, c, ar, ak, br, bk, cr, ck) { print "f " corner(a, ar, ak) " " corner(b, br, bk) " " corner(c, cr, ck) }
