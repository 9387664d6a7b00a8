// SPDX-License-Identifier: Apache-2.0
// Map passes whose invocations compute several elements side by side (lowering/block_loops.h). Members of an invocation
// lie apart, so that lanes that follow each other still read and store what lies side by side.
#include "compiler/backend/emit/generator.h"

namespace dr::backend {

using glsl::dim_expression;
using glsl::Shader;
using ir::Dim;
using ir::Extent;

namespace {

const char* const kAxis[] = {".x", ".y", ".z"};

const Dim& size_on(const Extent& e, size_t axis) { return axis == 0 ? e.w : axis == 1 ? e.h : e.l; }

// How many boxes of that size cover an extent, on each axis.
Extent boxes(const Extent& e, const std::array<int, 3>& size) {
  const auto count = [](const Dim& d, int n) { return (d + Dim(n - 1)).divided_by(n); };
  return {count(e.w, size[0]), count(e.h, size[1]), count(e.l, size[2])};
}

bool divides(int n, const Dim& d) { return n == 1 || (d.is_constant() && d.constant() % n == 0); }

}  // namespace

void Generator::block_map_pass(const Pass& pass, const Block& block) {
  const Extent& domain = pass.domain;
  Shader s = shader();
  if (!changing_) changing_.emplace(graph_);
  Extent blocks = boxes(domain, block.each);
  std::array<std::string, 3> apart;  // from member to member
  std::string first;                 // the place of the first member
  Dim invocations = element_count(blocks);
  const std::array<int, 3> box = block.box();
  if (const auto& together = block.together) {
    const Extent groups = boxes(domain, box);
    s.body().line("int group = int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x);");
    s.body().line("if (group >= " + dim_expression(element_count(groups)) + ") return;");
    s.body().line("int lane = int(gl_LocalInvocationID.x);");
    place_from_index(s, groups, "group");
    const auto vector = [](const std::array<int, 3>& v) {
      return "ivec3(" + std::to_string(v[0]) + ", " + std::to_string(v[1]) + ", " + std::to_string(v[2]) + ")";
    };
    s.body().line("ivec3 origin = at * " + vector(box) + ";");
    const std::string w = std::to_string(together->group[0]), h = std::to_string(together->group[1]);
    s.body().line("ivec3 in_group = ivec3(lane % " + w + ", (lane / " + w + ") % " + h + ", lane / (" + w + " * " + h +
                  "));");
    for (size_t axis = 0; axis < 3; ++axis) apart[axis] = std::to_string(together->group[axis]);
    first = "origin + in_group";
    invocations = element_count(groups) * Dim(together->invocations());
  } else {
    linear_index(s, dim_expression(invocations));
    place_from_index(s, blocks);
    for (size_t axis = 0; axis < 3; ++axis) apart[axis] = dim_expression(size_on(blocks, axis));
    first = "at";
  }
  const Cut cut = this->cut(s, pass, pass.get<MapPass>().code.cut, "index", 1, &blocks);
  std::vector<Shader::Member> members;
  std::string last;  // the last place there is, where members may lie beyond
  for (size_t axis = 0; axis < 3; ++axis)
    last += (axis == 0 ? "" : ", ") + dim_expression(size_on(domain, axis)) + " - 1";
  const bool whole = divides(box[0], domain.w) && divides(box[1], domain.h) && divides(box[2], domain.l);
  for (int z = 0; z < block.each[2]; ++z)
    for (int y = 0; y < block.each[1]; ++y)
      for (int x = 0; x < block.each[0]; ++x) {
        const std::array<int, 3> place{x, y, z};
        std::string step;
        for (size_t axis = 0; axis < 3; ++axis)
          step +=
              (axis == 0 ? "" : ", ") + (place[axis] == 0 ? "0" : std::to_string(place[axis]) + " * " + apart[axis]);
        const std::string k = std::to_string(members.size()), at = "at_" + k, in = "in_group_" + k;
        const std::string there = first + " + ivec3(" + step + ")";
        // Beyond the last element stand those there that compute what it does, and store nothing.
        s.body().line("ivec3 " + at + " = " + (whole ? there : "min(" + there + ", ivec3(" + last + "))") + ";");
        if (block.together) s.body().line("ivec3 " + in + " = in_group + ivec3(" + step + ");");
        members.push_back({.at = at, .in_group = in, .place = place});
      }
  const size_t count = members.size();
  std::vector<std::array<int, 3>> places;
  for (const Shader::Member& m : members) places.push_back(m.place);
  s.set_members(*changing_, std::move(members));
  if (const auto& together = block.together) {
    Shader::SharedReads reads{.loop = together->loop,
                              .trips = together->trips,
                              .group = together->invocations(),
                              .lane = "lane",
                              .origin = "origin",
                              .reads = {}};
    for (const ir::OpId id : together->gathers)
      reads.reads.emplace_back(id, *read_part(graph_, graph_.op(id), together->loop, box, together->trips, *changing_));
    s.read_together(std::move(reads));
  }
  open_cut(s, cut, "return;");
  s.element_ops(pass.ops);
  s.only_member(0);
  close_cut(s, cut);
  for (size_t k = 0; k < count; ++k) {
    s.only_member(k);
    std::string inside;
    for (size_t axis = 0; axis < 3; ++axis) {
      const Dim& size = size_on(domain, axis);
      const int n = places[k][axis];
      // The first member of a block is there.
      if (divides(box[axis], size) || (n == 0 && !block.together)) continue;
      inside += (inside.empty() ? "" : " && ") + ("(" + first + ")") + kAxis[axis] +
                (n == 0 ? "" : " + " + std::to_string(n) + " * " + apart[axis]) + " < " + dim_expression(size);
    }
    if (!inside.empty()) s.body().line("if (" + inside + ") {");
    s.push_scope();
    store_results(s, pass);
    s.pop_scope();
    if (!inside.empty()) s.body().line("}");
  }
  s.only_member(0);
  end_cut(s, cut);
  set_trips(dispatch(pass, "", s, invocations.str(), {0, 0, 0}, block.together ? block.together->invocations() : 0),
            cut);
}

}  // namespace dr::backend
