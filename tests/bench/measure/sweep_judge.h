// SPDX-License-Identifier: Apache-2.0
// What the sweep asks of each op, and the judge: a row of the result from billions of elements.
#pragma once

#include <array>
#include <cmath>
#include <span>
#include <string>
#include <vector>

#include "tests/device/accuracy/batch.h"
#include "tests/device/accuracy/cases.h"
#include "tests/device/accuracy/verdicts.h"

namespace dr::sweep {

// The cases of one op, which differ in their domains.
struct Group {
  ir::OpKind kind;
  std::vector<accuracy::Case> cases;
  bool differentiable() const { return !cases[0].derivatives.empty(); }
  // Whether the profiles may differ: what is exact is the same GLSL.
  bool has_native() const {
    return std::ranges::any_of(cases, [](const accuracy::Case& c) {
      return c.bound > 0 ||
             std::ranges::any_of(c.derivatives, [](const accuracy::Derivative& d) { return d.bound > 0; });
    });
  }
};

// Of all unary float ops.
std::vector<Group> groups();

// A row of the result: a case, a direction, a float profile.
struct Row {
  const accuracy::Case* entry;
  bool native, derivative;
  accuracy::Asked asked;
  double bound = 0;
  std::string promise = {}, why = {}, scale_text = {}, key = {};  // the key names the judge's outputs
};

std::vector<Row> rows_of(const Group& group);

// The judge's graph: value, derivative, and each row's scale, bound and exception.
ir::Graph judge_graph(const Group& group, const std::vector<Row>& rows);

// The errors of one row.
struct Tally {
  std::vector<uint64_t> bins = std::vector<uint64_t>(8192);  // on a scale of 32 steps an octave
  uint64_t special = 0, left_out = 0, not_finite = 0;
  double share = -1, at_share = -1, worst = 0;  // the largest share of what is allowed, and the error there
  uint32_t input = 0;
  double expected = 0, found = 0;

  // An error that counts, not in `bins`. The first of the worst stays.
  void note(double error, double part, uint32_t bits, double expects, double finds);
  // Of other elements. Of equally bad ones the smaller pattern stays.
  void add(const Tally& other);
  uint64_t count() const;
  double p999() const;
};

// One thread's judge of the rows of a group; graph and rows must outlive it.
class Judge {
 public:
  static constexpr size_t kBatch = accuracy::BatchGraph::kBatch;

  Judge(const ir::Graph& graph, const std::vector<Row>& rows);

  // `found` by row: what the device says of these kBatch patterns.
  void batch(const uint32_t* bits, const std::vector<const float*>& found);

  const std::vector<Tally>& tallies() const { return tallies_; }

 private:
  using Plane = std::vector<double>;
  // Where the judge's outputs for a row are; where there are none, a plane of a constant.
  struct Outputs {
    const double *expected, *scale, *bound, *except;
  };

  // The domain of a case, which its rows share: 1 inside, else 0.
  struct Inside {
    const accuracy::Case* of;
    std::array<uint64_t, kBatch> is;
    bool any;
  };

  accuracy::Expected expected(size_t row, size_t i) const;
  void fast(size_t row, const uint32_t* bits, const float* found);
  void one_by_one(size_t row, const uint32_t* bits, const float* found);

  accuracy::BatchGraph graph_;
  const std::vector<Row>& rows_;
  double* operand_;
  const double* value_;
  std::vector<Outputs> outputs_;
  std::vector<Tally> tallies_;
  // Of the batch: operands, the domains, what is expected with flushed operands.
  Plane x_ = Plane(kBatch), zero_ = Plane(kBatch);
  std::vector<Plane> bounds_;
  std::vector<Inside> domains_;
  std::vector<size_t> domain_of_;
  std::vector<accuracy::Expected> flushed_;
  accuracy::Verdicts verdicts_;
};

}  // namespace dr::sweep
