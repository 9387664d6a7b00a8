// SPDX-License-Identifier: Apache-2.0
// Element-wise graphs over a batch of numbers: the ops' own float64 evaluation without images around it, for judging
// billions of elements.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/ops/op.h"

namespace dr::accuracy {

class BatchGraph {
 public:
  static constexpr size_t kBatch = 1024;
  static constexpr size_t kNone = SIZE_MAX;

  // Of a graph without Grad ops whose values are all scalars; an op that is not element-wise ends the process. The
  // graph must outlive this.
  explicit BatchGraph(const ir::Graph& graph);

  // The number of an output of the graph's steps; kNone: there is none of that name.
  size_t output(const std::string& name) const;
  // Where a leaf's numbers are to be written before run(); null: the graph does not need it.
  double* leaf(const std::string& name);
  // For the first `n` <= kBatch numbers.
  void run(size_t n);
  const double* result(size_t output) const { return outputs_[output].second; }

 private:
  struct Op {
    const ops::OpInfo* info;
    std::vector<const double*> operands;
    std::vector<ir::Type> types;
    const ir::Attrs* attrs;
    ir::Type type;
    double* result;
  };
  std::vector<std::unique_ptr<double[]>> planes_;
  std::vector<std::pair<std::string, double*>> leaves_, outputs_;
  std::vector<Op> ops_;
};

}  // namespace dr::accuracy
