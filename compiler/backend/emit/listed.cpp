// SPDX-License-Identifier: Apache-2.0
// Map passes in two dispatches, for devices whose lanes run both branches of every `if` (Profile::lanes_in_turn), and
// for large pictures on others: the first gives the elements for which all heavy branches are left out, and lists the
// others; the second runs those alone.
#include <algorithm>
#include <set>

#include "compiler/backend/cost/cost.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/ir/yields.h"

namespace dr::backend {

using glsl::Shader;
using ir::OpKind;
using ir::ValueId;

namespace {

// What must be left out for each element to pay for a list and a dispatch more, in op_cost() units, and how many times
// what is done instead. How many elements take a branch is not known: branches that cost 126 take, with a list, half
// the time where one element in fifty takes them, nine tenths where a third do, and half as long again where all do.
constexpr int kWorthListing = 120, kTimesLighter = 4;
// Lighter branches run for all: a common one would put most elements on the list.
constexpr int kHeavy = 20;
constexpr int kLoopTrips = 8;
// Invocations that share the listed elements of a GPU.
constexpr int kWalking = 1 << 16;

int region_cost(const ir::Graph& graph, ir::RegionId region) {
  int cost = 0;
  for (const ir::OpId id : graph.region(region).ops) {
    const ir::Op& op = graph.op(id);
    cost += op.regions.empty() ? op_cost(op.kind) : 0;
    for (const ir::RegionId inner : op.regions)
      cost += region_cost(graph, inner) * (ir::is_loop(op.kind) ? kLoopTrips : 1);
  }
  return cost;
}

// Whether there surely are more elements than a GPU runs at once. A heavy branch needs registers, so that fewer run at
// once, whether they take it or not; a dispatch more costs as much as some hundred thousand elements.
bool is_large(const ir::Extent& domain) {
  constexpr int64_t kLarge = 1 << 20;
  const auto elements = element_count(domain).evaluate({});
  return elements && *elements >= kLarge;
}

// What the loops of the first dispatch take, which leaves the heavy branches out.
Trips light_trips(const ir::Graph& graph, const Pass& pass, const std::vector<ir::OpId>& heavy) {
  Trips all;
  for (const ir::OpId id : pass.ops) {
    const bool left_out = std::ranges::find(heavy, id) != heavy.end();
    all += left_out ? trips_of(graph, graph.region(graph.op(id).regions[1]).ops) : trips_of(graph, {&id, 1});
  }
  return all;
}

}  // namespace

std::vector<ir::OpId> Generator::heavy_branches(const Pass& pass, const Trips& trips) const {
  std::vector<ir::OpId> heavy;
  if (!list_branches_ || may_pass_limit(trips, profile_)) return heavy;
  if (!profile_.lanes_in_turn && !is_large(pass.domain)) return heavy;
  int saved = 0;
  for (const ir::OpId id : pass.ops) {
    const ir::Op& op = graph_.op(id);
    if (op.kind != OpKind::If) continue;
    const int then = region_cost(graph_, op.regions[0]), otherwise = region_cost(graph_, op.regions[1]);
    if (then < kHeavy || then < kTimesLighter * (otherwise + 1)) continue;
    heavy.push_back(id);
    saved += then;
  }
  return saved < kWorthListing ? std::vector<ir::OpId>() : heavy;
}

void Generator::listed_map_pass(const Pass& pass, const Trips& trips, const std::vector<ir::OpId>& heavy) {
  const uint32_t list = add_list(pass, "heavy");
  const std::string count = element_count(pass.domain).str();
  {
    Shader s = shader();
    ListingLoop loop(s, pass.domain, profile_.lanes_in_turn);
    // Where no condition holds, `false` stands for all: nothing is read that only a branch left out needs. Elsewhere
    // what follows a condition that holds is wrong, another condition too, and does not count.
    std::set<ValueId> conditions;
    for (const ir::OpId id : heavy) conditions.insert(graph_.op(id).operands[0]);
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
    const Cut cut = this->cut(s, pass, light_trips(graph_, pass, heavy), loop.element(), loop.each());
    open_cut(s, cut, loop.skip());
    for (const ir::OpId id : pass.ops) {
      s.element_ops({id});
      for (const ValueId v : graph_.op(id).results) suppose(v);
    }
    close_cut(s, cut);
    std::string any;
    for (const std::string& condition : found) any += (any.empty() ? "" : " || ") + condition;
    const std::string words = s.bind_words(list, "heavy_elements", bundle::Access::ReadWrite);
    s.body().line("if (" + any + ") {");
    const bool together = profile_.subgroup_arithmetic && !profile_.lanes_in_turn;
    if (together) subgroup_extensions(s);
    loop.add(words, together);
    s.body().line(loop.skip());
    s.body().line("}");
    // Where each clause of the scatter has a condition of a branch left out, no element is active here.
    bool active = false;
    if (const Pass* scatter = listed_for(pass))
      active = std::ranges::any_of(scatter->active, [&](const std::vector<ValueId>& clause) {
        return std::ranges::none_of(
            heavy, [&](ir::OpId id) { return std::ranges::find(clause, graph_.op(id).operands[0]) != clause.end(); });
      });
    store_results(s, pass, &loop, active);
    end_cut(s, cut);
    const std::string invocations = loop.close();
    set_trips(dispatch(pass, "", s, invocations), cut);
  }
  Shader s = shader();
  const std::string words = s.read_words(list, "heavy_elements");
  const std::string item = std::to_string(kListHead) + " + ",
                    end = "int(" + words + "(" + std::to_string(kListEnd) + ")) - 1";
  const bool walks = !profile_.lanes_in_turn;
  if (walks) {
    // Elements side by side would take each other's branches: each gets a subgroup of its own where there are enough.
    const std::string all = std::to_string(kWalking);
    linear_index(s, all);
    s.body().line("int end = " + end + ", apart = clamp(" + all + " / max(end, 1), 1, " +
                  std::to_string(profile_.subgroup_size) + ");");
    s.body().line("if (index % apart != 0) return;");
    s.body().line("for (index /= apart; index < end; index += (" + all + " - 1) / apart + 1) {");
    s.push_scope();
  } else {
    linear_index(s, end);
  }
  s.body().line("int element = int(" + words + "(" + item + "index));");
  place_from_index(s, pass.domain, "element");
  const Cut cut = this->cut(s, pass, trips, "element");
  open_cut(s, cut, "return;");
  s.element_ops(pass.ops);
  close_cut(s, cut);
  store_results(s, pass);
  end_cut(s, cut);
  if (walks) {
    s.pop_scope();
    s.body().line("}");
  }
  auto& c = dispatch(pass, "_heavy", s, walks ? std::to_string(kWalking) : count);
  if (!walks) c.indirect = static_cast<int>(list);
  set_trips(c, cut);
}

}  // namespace dr::backend
