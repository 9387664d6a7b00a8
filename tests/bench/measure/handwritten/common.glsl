// SPDX-License-Identifier: Apache-2.0
// Ahead of each shader of this folder. The host defines W (the picture's side), V and F (vertices, faces), INVERSE_SIZE and so on,
// and LANES_IN_TURN where a device accesses storage buffers one lane after the other: there, what a shader only reads is a
// uniform texel buffer, and stores stand behind a choice that the driver cannot foresee (docs/results/notebook.md).
layout(local_size_x = 64) in;
layout(push_constant) uniform Push { int zero; } push;

#ifdef LANES_IN_TURN
#define READ_FLOAT(slot, name) layout(binding = slot) uniform textureBuffer name
#define READ_INT(slot, name) layout(binding = slot) uniform itextureBuffer name
#define READ_UINT(slot, name) layout(binding = slot) uniform utextureBuffer name
#define READ_VEC2(slot, name) READ_FLOAT(slot, name)
#define READ_VEC3(slot, name) READ_FLOAT(slot, name)
#define READ_VEC4(slot, name) READ_FLOAT(slot, name)
#define READ_IVEC4(slot, name) READ_INT(slot, name)
#define READ_UVEC2(slot, name) layout(binding = slot) uniform utextureBuffer name
#define ONE(name, i) texelFetch(name, i).x
#define TWO(name, i) texelFetch(name, i).xy
#define THREE(name, i) texelFetch(name, i).xyz
#define FOUR(name, i) texelFetch(name, i)
#define KEEP(x) (push.zero == 0 ? (x) : (x) - (x))
#else
#define READ(slot, name, type) layout(binding = slot, std430) readonly restrict buffer name##_block { type d[]; } name
#define READ_FLOAT(slot, name) READ(slot, name, float)
#define READ_INT(slot, name) READ(slot, name, int)
#define READ_UINT(slot, name) READ(slot, name, uint)
#define READ_VEC2(slot, name) READ(slot, name, vec2)
#define READ_VEC3(slot, name) READ(slot, name, float)
#define READ_VEC4(slot, name) READ(slot, name, vec4)
#define READ_IVEC4(slot, name) READ(slot, name, ivec4)
#define READ_UVEC2(slot, name) READ(slot, name, uvec2)
#define ONE(name, i) name.d[i]
#define TWO(name, i) name.d[i]
#define THREE(name, i) vec3(name.d[(i) * 3], name.d[(i) * 3 + 1], name.d[(i) * 3 + 2])
#define FOUR(name, i) name.d[i]
#define KEEP(x) (x)
#endif
#define WRITE(slot, name, type) layout(binding = slot, std430) restrict buffer name##_block { type d[]; } name

// Sums by 64-bit fixed point, in units of 1 / SUM_SCALE, or by float atomics.
#ifdef EXACT
#define SUM int64_t
#define SUM_OF(x) int64_t(round((x) * SUM_SCALE))
#define READ_SUMS(slot) READ_UVEC2(slot, sums)
#define SUM_AT(i) (float(packInt2x32(ivec2(TWO(sums, i)))) * (1.0 / SUM_SCALE))
#else
#define SUM float
#define SUM_OF(x) (x)
#define READ_SUMS(slot) READ_FLOAT(slot, sums)
#define SUM_AT(i) ONE(sums, i)
#endif

int invocation() { return int((gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64u + gl_LocalInvocationID.x); }
float cross2(vec2 a, vec2 b) { return a.x * b.y - a.y * b.x; }
