# SPDX-License-Identifier: Apache-2.0
# A sphere around the y axis as .obj, of 2 * around * (rings - 1) triangles: awk -v around=31 -v rings=12 -f uv_sphere.awk
BEGIN {
  pi = atan2(0, -1)
  print "v 0 1 0"
  for (r = 1; r < rings; ++r) for (k = 0; k < around; ++k) {
    t = pi * r / rings; p = 2 * pi * k / around
    printf "v %.9g %.9g %.9g\n", sin(t) * sin(p), cos(t), sin(t) * cos(p)
  }
  print "v 0 -1 0"
  last = 2 + (rings - 1) * around
  for (k = 0; k < around; ++k) {
    n = (k + 1) % around
    print "f 1 " 2 + k " " 2 + n
    for (r = 0; r < rings - 2; ++r) {
      a = 2 + r * around
      print "f " a + k " " a + around + k " " a + around + n
      print "f " a + k " " a + around + n " " a + n
    }
    a = 2 + (rings - 2) * around
    print "f " a + k " " last " " a + n
  }
}
