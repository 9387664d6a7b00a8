// SPDX-License-Identifier: Apache-2.0
// List scheduling of passes by what they wait for.
#include "compiler/backend/pack/stages.h"

#include <algorithm>
#include <map>
#include <set>

#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// Attachments and dependencies of a render pass are checked pairwise by drivers and layers: hundreds of subpasses take
// minutes to create, and gain nothing over a few render passes.
constexpr size_t kMaxSubpasses = 32;

class StagePacker {
 public:
  StagePacker(const ir::Graph& graph, StepSchedule& step, const target::Profile& profile, bool join)
      : graph_(graph), step_(step), profile_(profile), join_(join) {}

  void process() {
    const size_t n = step_.passes.size();
    for (size_t k = 0; k < n; ++k)
      for (ValueId v : step_.passes[k].writes) writer_[v] = k;
    done_.assign(n, false);
    waits_.resize(n);
    users_.resize(n);
    pending_.assign(n, 0);
    for (size_t k = 0; k < n; ++k) {
      for (ValueId v : step_.passes[k].reads)
        if (const auto from = writer_.find(v); from != writer_.end()) waits_[k].insert(from->second);
      for (size_t from : waits_[k]) users_[from].push_back(k);
      pending_[k] = waits_[k].size();
    }
    elsewhere_.resize(n);
    for (size_t k = 0; k < n; ++k)
      for (ir::OpId id : step_.passes[k].ops)
        for (ValueId v : uses_of(graph_, graph_.op(id)).elsewhere) elsewhere_[k].insert(v);
    while (order_.size() < n)
      if (!add_run()) add_render_pass();
    std::vector<Pass> passes;
    for (const auto& [pass, stage] : order_) {
      passes.push_back(std::move(step_.passes[pass]));
      passes.back().stage = stage;
    }
    step_.passes = std::move(passes);
  }

 private:
  const Pass& pass(size_t k) const { return step_.passes[k]; }
  bool is_fragment(size_t k) const { return pass(k).is<FragmentPass>(); }

  // Whether all that a pass reads has been written, by passes that are done or in `stage`.
  bool is_ready(size_t k, const std::set<size_t>& stage = {}) const {
    if (pending_[k] == 0) return true;
    if (pending_[k] > stage.size()) return false;
    return std::all_of(waits_[k].begin(), waits_[k].end(),
                       [&](size_t from) { return done_[from] || stage.count(from) != 0; });
  }
  void finish(const std::vector<size_t>& stage) {
    // A subpass that costs more than a pass of its own is none.
    const bool join = join_ && (!is_fragment(stage[0]) || profile_.costs.subpass_ns <= profile_.costs.pass_ns);
    for (size_t k : stage) {
      done_[k] = true;
      for (size_t user : users_[k]) --pending_[user];
      order_.emplace_back(k, next_stage_);
      if (!join) ++next_stage_;
    }
    if (join) ++next_stage_;
  }

  // Everything that is ready and no fragment pass. Draws of raster are render passes of their own. Others come first:
  // what they read of their faces may be computed with them (lowering/set_up_in_raster.h), if nothing between waits for
  // it.
  bool add_run() {
    std::vector<size_t> run, draws;
    for (size_t k = 0; k < step_.passes.size(); ++k)
      if (!done_[k] && !is_fragment(k) && is_ready(k)) (pass(k).is_drawn() ? draws : run).push_back(k);
    std::ranges::stable_partition(run, [&](size_t k) { return pass(k).is<RasterPass>(); });
    if (!run.empty()) finish(run);
    for (size_t k : draws) finish({k});
    return !run.empty() || !draws.empty();
  }

  void add_render_pass() {
    std::vector<size_t> best;
    std::set<ir::Extent> tried;
    for (size_t k = 0; k < step_.passes.size(); ++k) {
      if (done_[k] || !is_fragment(k) || !is_ready(k) || !tried.insert(pass(k).domain).second) continue;
      std::vector<size_t> stage = grow(pass(k).domain);
      if (stage.size() > best.size()) best = std::move(stage);
    }
    DR_ASSERT(!best.empty());  // passes do not wait for each other in a circle
    finish(best);
  }

  // All fragment passes over an extent that one render pass can hold now, in an order that works.
  std::vector<size_t> grow(const ir::Extent& domain) const {
    std::vector<size_t> stage;
    std::set<size_t> members;
    for (bool grew = true; grew;) {
      grew = false;
      for (size_t k = 0; k < step_.passes.size(); ++k) {
        if (done_[k] || members.count(k) != 0 || !is_fragment(k) || pass(k).domain != domain || !is_ready(k, members))
          continue;
        if (!stage.empty() && pass(k).steady != pass(stage[0]).steady) continue;  // one may be left out, the other not
        if (!may_join(k, members)) continue;
        if (stage.size() == kMaxSubpasses) return stage;
        stage.push_back(k);
        members.insert(k);
        grew = true;
      }
    }
    return stage;
  }

  bool may_join(size_t k, const std::set<size_t>& members) const {
    uint32_t inputs = 0;
    for (ValueId v : pass(k).reads) {
      const auto it = writer_.find(v);
      if (it == writer_.end() || members.count(it->second) == 0) continue;
      if (elsewhere_[k].count(v) != 0) return false;
      ++inputs;
    }
    return inputs <= profile_.max_per_stage_descriptor_input_attachments;
  }

  const ir::Graph& graph_;
  StepSchedule& step_;
  const target::Profile& profile_;
  bool join_;
  std::map<ValueId, size_t> writer_;
  std::vector<std::set<ValueId>> elsewhere_;
  std::vector<bool> done_;
  std::vector<std::set<size_t>> waits_;     // the passes that a pass waits for
  std::vector<std::vector<size_t>> users_;  // those that wait for it
  std::vector<size_t> pending_;             // how many of waits_ are not done
  std::vector<std::pair<size_t, uint32_t>> order_;
  uint32_t next_stage_ = 0;
};

}  // namespace

void pack_stages(const ir::Graph& graph, StepSchedule& step, const target::Profile& profile, bool join) {
  StagePacker(graph, step, profile, join).process();
}

}  // namespace dr::backend
