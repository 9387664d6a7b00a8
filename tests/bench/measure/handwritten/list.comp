// SPDX-License-Identifier: Apache-2.0
// For devices whose lanes run both branches of every `if`: the pixels that the next pass has work for, the
// covered ones or, with EDGES, those beside one that is not as they are. The list begins with the workgroups of an indirect dispatch and the number of pixels.
READ_UVEC2(0, entries);
WRITE(1, list, uint);

bool covered(ivec2 p) { return int(TWO(entries, p.y * W + p.x).x) >= 0; }

void main() {
  int index = invocation();
  if (index >= W * W) return;
  ivec2 p = ivec2(index % W, index / W);
  bool mine = covered(p);
#ifdef EDGES
  bool same = covered(ivec2(min(p.x + 1, W - 1), p.y)) == mine && covered(ivec2(max(p.x - 1, 0), p.y)) == mine &&
              covered(ivec2(p.x, min(p.y + 1, W - 1))) == mine && covered(ivec2(p.x, max(p.y - 1, 0))) == mine;
  if (same) return;
#else
  if (!mine) return;
#endif
  uint place = atomicAdd(list.d[3], 1u);
  list.d[4u + place] = uint(index);
  if (place % 64u != 0u) return;
  atomicMax(list.d[0], place / 64u + 1u);
  list.d[1] = list.d[2] = 1u;
}
