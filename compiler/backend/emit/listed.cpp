// SPDX-License-Identifier: Apache-2.0
// Map passes in two dispatches (lowering/heavy_branches.h): the first gives the elements for which all heavy branches
// are left out, and lists the others; the second runs those alone. Or in three: the second leaves unlikely branches
// out, and lists what takes them for the third.
#include <algorithm>
#include <set>

#include "compiler/backend/analysis/same_in_run.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/analysis/zero_without.h"
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

std::set<ValueId> conditions_of(const ir::Graph& graph, const std::vector<ir::OpId>& branches) {
  std::set<ValueId> out;
  for (const ir::OpId id : branches) out.insert(graph.op(id).operands[0]);
  return out;
}

// Computes elements without some branches. Where no condition of theirs holds, `false` stands for all: nothing is read
// that only a branch left out needs. Elsewhere what follows a condition that holds is wrong, another condition too, and
// does not count.
class LeftOut {
 public:
  LeftOut(const ir::Graph& graph, Shader& s, const Pass& pass, const std::vector<ir::OpId>& branches)
      : graph_(graph), shader_(s), conditions_(conditions_of(graph, branches)) {
    std::set<ValueId> computed;
    for (const ir::OpId id : pass.ops) computed.insert(graph.op(id).results.begin(), graph.op(id).results.end());
    for (const ValueId v : std::set<ValueId>(conditions_))
      if (computed.count(v) == 0) suppose(v);
    for (const ir::OpId id : branches) s.leave_out_branch(id);
  }

  // These stand for zero.
  void suppose_zero(const std::vector<ir::OpId>& ops) {
    for (const ir::OpId id : ops)
      for (const ValueId v : graph_.op(id).results) shader_.define(v, shader_.hidden_zero(graph_.value(v).type));
    zeros_.insert(ops.begin(), ops.end());
  }

  void element_ops(const std::vector<ir::OpId>& ops) {
    std::vector<ir::OpId> before;
    for (const ir::OpId id : ops) {
      if (zeros_.contains(id)) continue;
      before.push_back(id);
      const auto& results = graph_.op(id).results;
      if (std::ranges::none_of(results, [&](ValueId v) { return conditions_.contains(v); })) continue;
      shader_.element_ops(before);
      before.clear();
      for (const ValueId v : results) suppose(v);
    }
    shader_.element_ops(before);
  }

  // Whether one of the conditions holds.
  std::string any() const {
    std::string out;
    for (const std::string& condition : found_) out += (out.empty() ? "" : " || ") + condition;
    return out;
  }

 private:
  void suppose(ValueId v) {
    if (conditions_.erase(v) == 0) return;
    found_.insert(shader_.use(v));
    shader_.define(v, "false");
  }

  const ir::Graph& graph_;
  Shader& shader_;
  std::set<ValueId> conditions_;
  std::set<ir::OpId> zeros_;
  std::set<std::string> found_;
};

// What a pass, and the scatters that join it, need not compute without some branches.
std::vector<ir::OpId> unshown_zeros(const ir::Graph& graph, const Pass& pass, const std::vector<const Pass*>& scatters,
                                    const std::vector<ir::OpId>& branches) {
  std::vector<ir::OpId> ops = pass.ops;
  for (const Pass* scatter : scatters) ops.insert(ops.end(), scatter->ops.begin(), scatter->ops.end());
  const std::vector<ValueId> stored(pass.writes.begin(), pass.writes.end());
  return zeros_without(graph, ops, branches, stored);
}

}  // namespace

void Generator::listed_map_pass(const Pass& pass, const HeavyBranches& branches) {
  const MapCode& code = pass.get<MapPass>().code;
  const uint32_t list = add_list(pass, "heavy", bundle::ListKind::Branches);
  {
    Shader s = shader();
    const RunReads shared = reads_in_runs(pass, conditions_of(graph_, branches.ops));
    ListingLoop loop(s, pass.domain, code.lists_in_runs, false, shared);
    LeftOut light(graph_, s, pass, branches.ops);
    const Cut cut = this->cut(s, pass, code.cut, loop.element(), loop.each());
    open_cut(s, cut, loop.skip());
    light.element_ops(without(pass.ops, shared.ops()));
    close_cut(s, cut);
    const std::string words = s.bind_words(list, "heavy_elements", bundle::Access::ReadWrite);
    s.body().line("if (" + light.any() + ") {");
    if (branches.by_subgroups) subgroup_extensions(s);
    loop.add(words, branches.by_subgroups);
    s.body().line(loop.skip());
    s.body().line("}");
    store_results(s, pass, listed_without(pass, branches.ops), &loop);
    end_cut(s, cut);
    const std::string invocations = loop.close();
    set_trips(dispatch(pass, "", s, invocations), cut);
  }
  if (branches.unlikely.empty()) return listed_dispatch(pass, branches, "_heavy", list, std::nullopt);
  const uint32_t rest = add_list(pass, "unlikely", bundle::ListKind::Branches);
  listed_dispatch(pass, branches, "_heavy", list, rest);
  listed_dispatch(pass, branches, "_unlikely", rest, std::nullopt);
}

std::vector<const Pass*> Generator::listed_without(const Pass& pass, const std::vector<ir::OpId>& branches) const {
  std::vector<const Pass*> scatters = listed_for(pass);
  std::erase_if(scatters, [&](const Pass* scatter) {
    return adds_nothing_without(graph_, scatter->get<ScatterPass>(), branches);
  });
  return scatters;
}

void Generator::listed_dispatch(const Pass& pass, const HeavyBranches& branches, const std::string& name, uint32_t list,
                                std::optional<uint32_t> rest) {
  Shader s = shader();
  const std::string words = s.read_words(list, "listed_elements");
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
  const std::vector<ir::OpId> left_out = rest ? branches.unlikely : std::vector<ir::OpId>();
  const std::vector<const Pass*> scatters = listed_without(pass, left_out);
  LeftOut likely(graph_, s, pass, left_out);
  if (rest) likely.suppose_zero(unshown_zeros(graph_, pass, scatters, left_out));
  likely.element_ops(pass.ops);
  close_cut(s, cut);
  s.share_no_more();
  if (rest) {
    s.body().line("if (" + likely.any() + ") {");
    s.body().line(
        append(s, s.bind_words(*rest, "unlikely_elements", bundle::Access::ReadWrite), "element", pass.domain) + ";");
    s.body().line("return;");
    s.body().line("}");
  }
  if (branches.shares_loops) s.body().line("if (share == 0) {");
  store_results(s, pass, scatters, nullptr, !branches.unlikely.empty() && !rest);
  if (branches.shares_loops) s.body().line("}");
  end_cut(s, cut);
  if (walks) {
    s.pop_scope();
    s.body().line("}");
  }
  auto& c = dispatch(pass, name, s, walks ? walking : element_count(pass.domain).str());
  if (!walks) c.indirect = static_cast<int>(list);
  set_trips(c, cut);
}

}  // namespace dr::backend
