// SPDX-License-Identifier: Apache-2.0
// A pixel's part of the antialiased silhouette (`antialias` of std.raster) and, in the same go, what its difference to the
// target pulls at vertices. Where two pixels side by side are both covered or both empty, the blend changes nothing.
READ_UVEC2(0, entries);
READ_VEC4(1, screen);
READ_IVEC4(2, face);
READ_IVEC4(3, beyond);
#ifdef TARGET
WRITE(4, goal, float);
#else
READ_FLOAT(4, goal);
WRITE(5, sums, SUM);
#endif
#ifdef LISTED
READ_UINT(6, list);
#endif

int face_at(ivec2 p) { return int(TWO(entries, p.y * W + p.x).x); }  // -1 where there is none

// An outline between two pixels: its ends, how much of the way lies before it, and the cross products that say so.
struct Crossing {
  int i, j;
  float t, slope;
  vec2 a, along;
};

Crossing crossing(int f, vec2 from, vec2 way) {
  Crossing best = Crossing(-1, -1, -1.0, 1.0, vec2(0.0), vec2(0.0));
  ivec4 corner = FOUR(face, f), other = FOUR(beyond, f);
  vec4 place[3] = {FOUR(screen, corner.x), FOUR(screen, corner.y), FOUR(screen, corner.z)};
  for (int k = 0; k < 3; ++k) {
    int i = corner[k], j = corner[(k + 1) % 3];
    vec2 a = place[k].xy, along = place[(k + 1) % 3].xy - a;
    float slope = cross2(along, way);
    bool steep = abs(along.y) >= abs(along.x);
    if (slope == 0.0 || steep != (way.y == 0.0)) continue;
    float t = cross2(along, a - from) / slope;
    float reach = dot(from + t * way - a, along);
    if (!(t >= 0.0 && t <= 1.0 && reach >= 0.0 && reach <= dot(along, along))) continue;
    if (!(best.t < 0.0 || abs(t - 0.5) < abs(best.t - 0.5))) continue;
    if (other[k] >= 0) {
      ivec3 far = FOUR(face, other[k]).xyz;
      vec2 p = FOUR(screen, far.x).xy;
      if (cross2(FOUR(screen, far.y).xy - p, FOUR(screen, far.z).xy - p) <= 0.0) continue;
    }
    best = Crossing(i, j, t, slope, a, along);
  }
  return best;
}

void main() {
  int index = invocation();
#ifdef LISTED
  if (index >= int(ONE(list, 3))) return;
  index = int(ONE(list, 4 + index));
#endif
  if (index >= W * W) return;
  ivec2 p = ivec2(index % W, index / W);
  int mine = face_at(p);
  float color = mine >= 0 ? 1.0 : 0.0, result = color;
  Crossing found[4];
  for (int k = 0; k < 4; ++k) {
    ivec2 q = clamp(p + ivec2(k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0), ivec2(0), ivec2(W - 1));
    int other = face_at(q);
    found[k].t = -1.0;
    if ((other >= 0) == (mine >= 0)) continue;
    bool nearer = other >= 0;  // the other one
    found[k] = crossing(nearer ? other : mine, vec2(nearer ? q : p) + 0.5, vec2(nearer ? p - q : q - p));
    if (found[k].t >= 0.0) result += max(nearer ? found[k].t - 0.5 : 0.5 - found[k].t, 0.0) * (1.0 - 2.0 * color);
  }
#ifdef TARGET
  goal.d[index] = KEEP(result);
#else
  float pull = 2.0 * (result - ONE(goal, index)) * (1.0 - 2.0 * color);  // by pixels, not by their number
  if (pull == 0.0) return;
  for (int k = 0; k < 4; ++k) {
    Crossing c = found[k];
    bool nearer = mine < 0;
    if (c.t < 0.0 || (nearer ? c.t <= 0.5 : c.t >= 0.5)) continue;
    ivec2 step = ivec2(k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0);
    vec2 from = vec2(nearer ? p + step : p) + 0.5, way = vec2(nearer ? -step : step);
    // t = cross(along, a - from) / cross(along, way)
    float g = (nearer ? pull : -pull) / c.slope;
    vec2 w = c.a - from;
    vec2 by_along = g * (vec2(w.y, -w.x) - c.t * vec2(way.y, -way.x));
    vec2 by_a = g * vec2(-c.along.y, c.along.x) - by_along;
    if (push.zero != 0) continue;
    atomicAdd(sums.d[c.i * 2], SUM_OF(by_a.x));
    atomicAdd(sums.d[c.i * 2 + 1], SUM_OF(by_a.y));
    atomicAdd(sums.d[c.j * 2], SUM_OF(by_along.x));
    atomicAdd(sums.d[c.j * 2 + 1], SUM_OF(by_along.y));
  }
#endif
}
