// SPDX-License-Identifier: Apache-2.0
// Regions over work lists. A frame is a region being evaluated for a list of elements at once: every value of the
// region is an array over the list. If splits the list in two; Reduce makes a list of (trip, element) pairs; Fold's list
// gets shorter from trip to trip.
#pragma once

#include <span>
#include <utility>
#include <vector>

#include "compiler/reference/batch.h"
#include "compiler/reference/plan.h"
#include "compiler/reference/scatter.h"
#include "compiler/reference/workers.h"

namespace dr::reference {

// What one evaluation reads: the root's values and the numbers given from outside.
struct Context {
  const ir::Graph& graph;
  const ir::SymbolValues& symbols;
  int64_t step_index = 0;
  CheckFinite check_finite = CheckFinite::No;
  bool float32 = false;
  bool tracing() const { return check_finite != CheckFinite::No; }
  std::vector<const Image*> images;  // by ValueId index; null: not made, or no longer needed
  std::vector<Origin> origins;       // by ValueId index; filled when tracing()
};

struct Frame {
  const Plan* plan = nullptr;
  Frame* parent = nullptr;
  size_t n = 0;
  const std::vector<uint32_t>* from_parent = nullptr;  // element i's place in the parent's list; null: i
  const Places* places = nullptr;                      // null: not asked for yet
  Places own_places;
  std::vector<Lanes> lanes;  // by slot
};

// Evaluates frames. One a worker.
class RegionRunner {
 public:
  explicit RegionRunner(const Context& context) : context_(context) {}

  // The first NaN or Inf made since the last call, when tracing.
  Origin take_first() { return std::exchange(first_, {}); }
  // Where the Scatter results of the ops that run next go to.
  void set_log(ScatterLog* log) { log_ = log; }

  Frame outermost(const Plan& plan, const Places& places);
  // Runs the ops of the frame's plan.
  void run(Frame& frame);
  // A value of the frame, fetched first if it is captured.
  const Lanes& get(Frame& frame, uint32_t slot);
  // Memory for a value: the caller fills it before the next get().
  double* make(Frame& frame, uint32_t slot, size_t n);
  // Forgets the values. Captured ones stay when the list stays.
  void clear(Frame& frame, bool keep_captured = false);
  // The region's values for part of the parent's list; null: all of it.
  Frame inner(const Plan& plan, Frame& parent, const std::vector<uint32_t>* list);

 private:
  friend class ReduceRun;
  friend class FoldRun;
  const Places& places(Frame& frame);
  void fetch_root(Frame& frame, uint32_t slot, const Image& image);
  void fetch_parent(Frame& frame, uint32_t slot);
  void run_op(Frame& frame, const OpPlan& op);
  void run_elementwise(Frame& frame, const OpPlan& op);
  void run_gather(Frame& frame, const OpPlan& op);
  void run_source(Frame& frame, const OpPlan& op);
  void run_if(Frame& frame, const OpPlan& op);
  void run_branch(Frame& frame, const OpPlan& op, const Plan& branch, const std::vector<uint32_t>* list);
  void run_reduce(Frame& frame, const OpPlan& op);
  void run_fold(Frame& frame, const OpPlan& op);
  void scatter(Frame& frame, const YieldPlan& yield);
  void trace(Frame& frame, const OpPlan& op);
  Origin origin_here(Frame& frame, const OpPlan& plan, size_t i);
  ir::OpId op_id(const ir::Op& op) const { return context_.graph.value(op.results[0]).op; }

  const Context& context_;
  Pool pool_;
  std::vector<Buffer> expanded_;  // of run_elementwise, kept for its memory
  ScatterLog* log_ = nullptr;
  Origin first_;
};

// Evaluates an If, Reduce or Fold op of the root into its result images, which are zero where something scatters. Returns the
// first NaN or Inf made inside, when tracing.
Origin run_region_op(const Context& context, const ir::Op& op, std::span<Image* const> results,
                     std::span<Origin> origins, Workers& workers);

}  // namespace dr::reference
