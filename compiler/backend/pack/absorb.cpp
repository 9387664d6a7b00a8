// SPDX-License-Identifier: Apache-2.0
// What only a scatter uses may run in the scatter's own shader rather than be stored for it:
//   %2 = gather %image, %i ; %3 = scatter_add %j, %2    =>    one shader, %2 is in a register
// That shader runs twice, so it loads and computes everything twice, and may need values stored that a shader before it
// has in registers. What decides is the cost of an element: an image counts as large as the domain, a list or a number
// beside it as nothing.
#include <queue>

#include "compiler/backend/cost/cost.h"
#include "compiler/backend/pack/step_packer.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

namespace {

constexpr int kRuns = 2;        // of a scatter's shader
constexpr size_t kMaxOps = 64;  // that a scatter absorbs

}  // namespace

// Whether a value has to be stored whatever scatters do.
bool StepPacker::stored_anyway(ValueId v) const {
  if (roots_.count(v) != 0 || read_elsewhere_[v.index] || pass_kind(def(v)) != PassKind::Map) return true;
  return std::ranges::any_of(users_[v.index], [&](OpId user) {
    const Op& by = graph_.op(user);
    return pass_kind(by) == PassKind::Map && domain_of(graph_, by) != graph_.value(v).extent;
  });
}

void StepPacker::absorb_into(OpId scatter) {
  const Extent domain = domain_of(graph_, graph_.op(scatter));
  const bool fragment = options_.fragment && !domain.h.is_one();
  const target::Costs& costs = profile_.costs;
  // To load or store an element, in a pass before the scatter or in the scatter.
  const auto move_ns = [&](ValueId v, bool before) {
    const ir::ValueInfo& info = graph_.value(v);
    if (is_small(info.extent, domain)) return 0.0;
    const bool image = is_image(v);
    const double image_rate = before && fragment ? costs.fragment_image_bytes_per_ns : costs.compute_image_bytes_per_ns;
    const double buffer_rate =
        before && fragment ? costs.fragment_buffer_bytes_per_ns : costs.compute_buffer_bytes_per_ns;
    const double bytes = (is_packed(graph_, v) && !image ? 2.0 : 4.0) * info.type.components();
    return bytes / (image ? image_rate : buffer_rate);
  };
  const auto work_ns = [&](ValueId v, bool before) {
    const Op& op = def(v);
    const bool rate = before && fragment;
    return op_cost(op.kind) * graph_.value(v).type.components() /
           (rate ? costs.fragment_operations_per_ns : costs.compute_operations_per_ns);
  };

  // Goes through what the scatter needs, users first: when an op's turn comes it is known whether all of them are here.
  // What it reads and computes as it is does not count.
  std::priority_queue<std::pair<uint32_t, OpId>> open;  // by place in the step
  std::set<OpId> seen, own{scatter}, moved;
  std::set<ValueId> own_reads, reads;
  const auto visit = [&](OpId user) {
    std::set<ValueId>& to = own.count(user) != 0 ? own_reads : reads;
    to.insert(uses_[user.index].elsewhere.begin(), uses_[user.index].elsewhere.end());
    for (ValueId v : uses_[user.index].at_element) {
      const OpId from = graph_.value(v).op;
      if (is_memory(def(v)))
        to.insert(v);
      else if (!is_inline(def(v)) && seen.insert(from).second)
        open.emplace(position_[from.index], from);
    }
  };
  const auto is_here = [&](OpId user) { return own.count(user) != 0 || moved.count(user) != 0; };
  const auto is_own = [&](OpId user) { return own.count(user) != 0; };
  double before = 0, inside = 0;
  visit(scatter);
  while (!open.empty() && moved.size() <= kMaxOps) {
    const OpId id = open.top().second;
    open.pop();
    const Op& op = graph_.op(id);
    const ValueId v = op.results[0];
    const std::vector<OpId>& users = users_[v.index];
    const bool cheap = recomputable(v, scatter);
    if (cheap && std::ranges::any_of(users, is_own)) {
      own.insert(id);
    } else if (cheap || (!stored_anyway(v) && std::ranges::all_of(users, is_here) && op.kind != OpKind::Pin &&
                         op.regions.empty() && graph_.value(v).extent == domain &&
                         steady_[id.index] == steady_[scatter.index])) {
      inside += kRuns * work_ns(v, false);
      if (std::ranges::all_of(users, is_here)) before += work_ns(v, true);
      if (!cheap && std::ranges::any_of(users, is_own)) before += move_ns(v, true) + kRuns * move_ns(v, false);
      moved.insert(id);
    } else {
      (std::ranges::any_of(users, is_own) ? own_reads : reads).insert(v);
      if (!stored_anyway(v) && !std::ranges::any_of(users, is_own)) inside += move_ns(v, true);
      continue;
    }
    visit(id);
  }
  std::erase_if(moved, [&](OpId id) { return recomputable(graph_.op(id).results[0], scatter); });
  if (moved.empty() || moved.size() > kMaxOps) return;
  for (ValueId v : reads) {
    if (own_reads.insert(v).second) inside += kRuns * move_ns(v, false);
    if (std::ranges::all_of(users_[v.index], is_here)) before += move_ns(v, true);
  }
  const auto buffers = static_cast<uint32_t>(own_reads.size());
  if (inside > before || !fits(profile_, {.buffers = buffers, .writes = 1, .more = kScatterBuffers})) return;
  for (OpId id : moved) absorbed_[id.index] = true;
}

void StepPacker::find_absorbed() {
  // A scatter of a region may leave elements out by what it reads (lowering/scatter_active.h), and others of its domain
  // with it.
  std::set<Extent> by_regions;
  for (OpId id : order_)
    if (const Op& op = graph_.op(id); !op.regions.empty() && pass_kind(op) == PassKind::Scatter)
      by_regions.insert(domain_of(graph_, op));
  for (OpId id : order_) {
    const Op& op = graph_.op(id);
    if (op.regions.empty() && pass_kind(op) == PassKind::Scatter && by_regions.count(domain_of(graph_, op)) == 0)
      absorb_into(id);
  }
}

}  // namespace dr::backend
