// SPDX-License-Identifier: Apache-2.0
// Map passes in two dispatches (lowering/heavy_branches.h): the first gives the elements for which all heavy branches
// are left out, and lists the others; the second runs those alone.
#include <algorithm>
#include <set>

#include "compiler/backend/analysis/same_in_run.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using glsl::Shader;
using ir::ValueId;

namespace {

// Invocations that share the listed elements of a GPU: where few elements are listed, starting more takes longer.
// Those that share loops are as many as it runs at once.
constexpr int kWalking = 1 << 14, kSharing = 1 << 16;

// Lanes that follow each other in a subgroup have an element, a power of two of them.
void share_by_lanes(Shader& s) {
  s.extension("GL_KHR_shader_subgroup_shuffle");
  s.body().line(
      "index += int(gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID) - int(gl_LocalInvocationID.x);");
  s.body().line("apart = 1 << findMSB(min(apart, int(gl_SubgroupSize)));");
  s.body().line("int share = index % apart;");
  s.share_loops("share", "apart", true);
}

}  // namespace

void Generator::listed_map_pass(const Pass& pass, const HeavyBranches& branches) {
  const MapCode& code = pass.get<MapPass>().code;
  const std::vector<ir::OpId>& heavy = branches.ops;
  const uint32_t list = add_list(pass, "heavy", bundle::ListKind::Branches);
  const std::string count = element_count(pass.domain).str();
  {
    Shader s = shader();
    // Where no condition holds, `false` stands for all: nothing is read that only a branch left out needs. Elsewhere
    // what follows a condition that holds is wrong, another condition too, and does not count.
    std::set<ValueId> conditions;
    for (const ir::OpId id : heavy) conditions.insert(graph_.op(id).operands[0]);
    const RunReads shared = reads_in_runs(pass, conditions);
    ListingLoop loop(s, pass.domain, code.lists_in_runs, false, shared);
    std::set<std::string> found;
    const auto suppose = [&](ValueId v) {
      if (conditions.erase(v) == 0) return;
      found.insert(s.use(v));
      s.define(v, "false");
    };
    std::set<ValueId> computed;
    for (const ir::OpId id : pass.ops) computed.insert(graph_.op(id).results.begin(), graph_.op(id).results.end());
    for (const ValueId v : std::set<ValueId>(conditions))
      if (computed.count(v) == 0) suppose(v);
    for (const ir::OpId id : heavy) s.leave_out_branch(id);
    const Cut cut = this->cut(s, pass, code.cut, loop.element(), loop.each());
    open_cut(s, cut, loop.skip());
    for (const ir::OpId id : without(pass.ops, shared.ops())) {
      s.element_ops({id});
      for (const ValueId v : graph_.op(id).results) suppose(v);
    }
    close_cut(s, cut);
    std::string any;
    for (const std::string& condition : found) any += (any.empty() ? "" : " || ") + condition;
    const std::string words = s.bind_words(list, "heavy_elements", bundle::Access::ReadWrite);
    s.body().line("if (" + any + ") {");
    if (branches.by_subgroups) subgroup_extensions(s);
    loop.add(words, branches.by_subgroups);
    s.body().line(loop.skip());
    s.body().line("}");
    std::vector<const Pass*> scatters = listed_for(pass);
    std::erase_if(scatters, [&](const Pass* scatter) {
      return adds_nothing_without(graph_, scatter->get<ScatterPass>(), heavy);
    });
    store_results(s, pass, scatters, &loop);
    end_cut(s, cut);
    const std::string invocations = loop.close();
    set_trips(dispatch(pass, "", s, invocations), cut);
  }
  Shader s = shader();
  const std::string words = s.read_words(list, "heavy_elements");
  const std::string item = std::to_string(kListHead) + " + ",
                    end = "int(" + words + "(" + std::to_string(kListEnd) + ")) - 1";
  const bool walks = branches.apart > 0;
  const std::string walking = std::to_string(branches.shares_loops ? kSharing : kWalking);
  if (walks) {
    // Elements side by side would take each other's branches: each gets a subgroup of its own where there are enough.
    linear_index(s, walking);
    s.body().line("int end = " + end + ", apart = clamp(" + walking + " / max(end, 1), 1, " +
                  std::to_string(branches.apart) + ");");
    if (branches.shares_loops) {
      subgroup_extensions(s);
      share_by_lanes(s);
    } else {
      s.body().line("if (index % apart != 0) return;");
    }
    s.body().line("for (index /= apart; index < end; index += (" + walking + " - 1) / apart + 1) {");
    s.push_scope();
  } else {
    linear_index(s, end);
  }
  s.body().line("int element = int(" + words + "(" + item + "index));");
  place_from_index(s, pass.domain, "element");
  const Cut cut = this->cut(s, pass, branches.cut, "element");
  open_cut(s, cut, "return;");
  s.element_ops(pass.ops);
  close_cut(s, cut);
  s.share_no_more();
  if (branches.shares_loops) s.body().line("if (share == 0) {");
  store_results(s, pass, listed_for(pass));
  if (branches.shares_loops) s.body().line("}");
  end_cut(s, cut);
  if (walks) {
    s.pop_scope();
    s.body().line("}");
  }
  auto& c = dispatch(pass, "_heavy", s, walks ? walking : count);
  if (!walks) c.indirect = static_cast<int>(list);
  set_trips(c, cut);
}

}  // namespace dr::backend
