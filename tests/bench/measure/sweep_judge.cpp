// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/measure/sweep_judge.h"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>
#include <utility>

#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/gradient/build.h"

namespace dr::sweep {

using namespace accuracy;
using ir::OpKind;
using ir::ValueId;

std::vector<Group> groups() {
  std::vector<Group> all;
  for (const Case& c : number_cases()) {
    if (c.operands.size() != 1) continue;
    if (all.empty() || all.back().kind != c.kind) all.push_back({c.kind, {}});
    all.back().cases.push_back(c);
  }
  return all;
}

std::vector<Row> rows_of(const Group& group) {
  std::vector<Row> rows;
  for (const bool native : {false, true}) {
    if (native && !group.has_native()) continue;
    for (size_t k = 0; k < group.cases.size(); ++k) {
      const Case& c = group.cases[k];
      const auto add = [&](const auto& plain, bool derivative) {
        const auto here = in_profile(plain, native);
        Row row{.entry = &c, .native = native, .derivative = derivative, .asked = {}};
        const bool promised = native && plain.native.has_value();
        row.asked = {.is_float = true,
                     .derivative = derivative,
                     .exact = here.bound == 0,
                     .promised = promised,
                     .has_scale = static_cast<bool>(here.scale)};
        row.bound = here.bound;
        row.promise = promised ? plain.native->text : "";
        row.why = here.why;
        row.scale_text = here.scale_text;
        row.key = std::to_string(rows.size());
        rows.push_back(row);
      };
      add(c, false);
      for (const Derivative& d : c.derivatives) add(d, true);
    }
  }
  return rows;
}

ir::Graph judge_graph(const Group& group, const std::vector<Row>& rows) {
  ir::Builder b;
  const Values xs{gradient_test::leaf(b, "x", ir::kFloat, {ir::Dim(8), 1, 1})};
  const ValueId y = group.cases[0].build(b, xs), w = ops::constant(b, ir::kFloat, 1.0);
  std::vector<std::pair<std::string, ValueId>> out{{"value", y}};
  if (group.differentiable()) out.emplace_back("derivative", gradient_test::grad(b, y, w, xs)[0]);
  for (const Row& row : rows) {
    const auto add = [&](const auto& plain) {
      const auto here = in_profile(plain, row.native);
      const ValueId adjoint = row.derivative ? w : ValueId{};
      if (here.scale) out.emplace_back("scale" + row.key, here.scale(b, xs, adjoint));
      if (row.asked.promised) out.emplace_back("bound" + row.key, here.native->bound(b, xs, adjoint));
      if (here.except) out.emplace_back("except" + row.key, here.except(b, xs));
    };
    if (row.derivative)
      add(row.entry->derivatives[0]);
    else
      add(*row.entry);
  }
  gradient_test::add_step(b.graph(), "judge", out);
  return passes::run_passes(std::move(b).finish(), passes::default_passes());
}

namespace {

size_t bin_of(double error) {
  return std::bit_cast<uint32_t>(static_cast<float>(std::min(error, double{FLT_MAX}))) >> 18;
}
bool all_finite(const float* found) {
  int32_t most = 0;
  for (size_t i = 0; i < Judge::kBatch; ++i)
    most = std::max(most, std::bit_cast<int32_t>(found[i]) & std::numeric_limits<int32_t>::max());
  return most < std::bit_cast<int32_t>(HUGE_VALF);
}
double upper_end(size_t bin) { return std::bit_cast<float>(static_cast<uint32_t>(bin + 1) << 18); }

}  // namespace

void Tally::note(double error, double part, uint32_t bits, double expects, double finds) {
  worst = std::max(worst, error);
  if (part < share || (part == share && error <= at_share)) return;
  share = part, at_share = error, input = bits, expected = expects, found = finds;
}

void Tally::add(const Tally& other) {
  for (size_t k = 0; k < bins.size(); ++k) bins[k] += other.bins[k];
  special += other.special, left_out += other.left_out, not_finite += other.not_finite;
  worst = std::max(worst, other.worst);
  const auto badness = [](const Tally& t) { return std::pair(t.share, t.at_share); };
  if (badness(other) < badness(*this) || (badness(other) == badness(*this) && other.input >= input)) return;
  share = other.share, at_share = other.at_share, input = other.input;
  expected = other.expected, found = other.found;
}

uint64_t Tally::count() const { return std::accumulate(bins.begin(), bins.end(), uint64_t{0}); }

double Tally::p999() const {
  uint64_t left = count() / 1000;
  for (size_t k = bins.size(); k-- > 0;) {
    if (bins[k] > left) return k == 0 ? 0 : std::min(upper_end(k), worst);
    left -= bins[k];
  }
  return 0;
}

Judge::Judge(const ir::Graph& graph, const std::vector<Row>& rows) : graph_(graph), rows_(rows), tallies_(rows.size()) {
  operand_ = graph_.leaf("x");
  value_ = graph_.result(graph_.output("value"));
  for (const Row& row : rows) {
    if (domains_.empty() || domains_.back().of != row.entry) domains_.push_back({row.entry, {}, false});
    domain_of_.push_back(domains_.size() - 1);
    bounds_.emplace_back(kBatch, row.bound);
    const auto plane = [&](const std::string& name, const double* otherwise) {
      const size_t output = graph_.output(name);
      return output == BatchGraph::kNone ? otherwise : graph_.result(output);
    };
    outputs_.push_back({.expected = row.derivative ? plane("derivative", nullptr) : value_,
                        .scale = plane("scale" + row.key, zero_.data()),
                        .bound = plane("bound" + row.key, bounds_.back().data()),
                        .except = plane("except" + row.key, zero_.data())});
  }
}

void Judge::batch(const uint32_t* bits, const std::vector<const float*>& found) {
  uint64_t tiny = 0;
  for (size_t i = 0; i < kBatch; ++i) {
    x_[i] = static_cast<double>(std::bit_cast<float>(bits[i]));
    tiny |= static_cast<uint64_t>(x_[i] != 0) & static_cast<uint64_t>(std::abs(x_[i]) < 0x1p-126);
  }
  for (Inside& inside : domains_) {
    const Operand& o = inside.of->operands[0];
    uint64_t any = 0;
    for (size_t i = 0; i < kBatch; ++i) {
      inside.is[i] = static_cast<uint64_t>(x_[i] >= o.low) & static_cast<uint64_t>(x_[i] <= o.high) &
                     static_cast<uint64_t>(std::abs(x_[i]) >= o.least);
      any |= inside.is[i];
    }
    inside.any = any != 0;
  }
  // Where a row has nothing to compare with, it is enough that all is finite.
  std::vector<size_t> asked;
  for (size_t r = 0; r < rows_.size(); ++r)
    if (domains_[domain_of_[r]].any || !all_finite(found[r]))
      asked.push_back(r);
    else
      tallies_[r].special += kBatch;
  if (asked.empty()) return;
  if (tiny != 0) {
    for (size_t i = 0; i < kBatch; ++i) operand_[i] = is_subnormal(x_[i]) ? std::copysign(0.0, x_[i]) : x_[i];
    graph_.run(kBatch);
    flushed_.resize(rows_.size() * kBatch);
    for (const size_t r : asked)
      for (size_t i = 0; i < kBatch; ++i) flushed_[r * kBatch + i] = expected(r, i);
  }
  std::ranges::copy(x_, operand_);
  graph_.run(kBatch);
  for (const size_t r : asked)
    if (tiny != 0)
      one_by_one(r, bits, found[r]);
    else
      fast(r, bits, found[r]);
}

Expected Judge::expected(size_t r, size_t i) const {
  const Outputs& o = outputs_[r];
  Expected e{.value = o.expected[i], .scale = o.scale[i], .bound = o.bound[i], .except = o.except[i] != 0};
  if (rows_[r].derivative) e.value_infinite = !finite_float(value_[i]), e.value_subnormal = is_subnormal(value_[i]);
  return e;
}

void Judge::fast(size_t r, const uint32_t* bits, const float* found) {
  const Outputs& o = outputs_[r];
  Tally& tally = tallies_[r];
  Verdicts& v = verdicts_;
  v.judge(rows_[r].asked, {.found = found,
                           .inside = domains_[domain_of_[r]].is.data(),
                           .expected = o.expected,
                           .value = rows_[r].derivative ? value_ : o.expected,
                           .scale = o.scale,
                           .bound = o.bound,
                           .except = o.except});
  tally.special += v.special, tally.left_out += v.left_out, tally.not_finite += v.not_finite;
  if (v.count == 0) return;
  if (v.worst == 0)
    tally.bins[bin_of(0)] += v.count;
  else
    for (size_t i = 0; i < kBatch; ++i) tally.bins[bin_of(v.error[i])] += v.counted[i];
  tally.worst = std::max(tally.worst, v.worst);
  if (std::pair(v.worst_share, v.at_share) <= std::pair(tally.share, tally.at_share)) return;
  for (size_t i = 0; i < kBatch; ++i)
    if (v.counted[i] != 0) tally.note(v.error[i], v.share[i], bits[i], o.expected[i], static_cast<double>(found[i]));
}

// Subnormal operands may be taken as they are or as zeros.
void Judge::one_by_one(size_t r, const uint32_t* bits, const float* found) {
  const Row& row = rows_[r];
  Tally& tally = tallies_[r];
  for (size_t i = 0; i < kBatch; ++i) {
    const bool inside =
        domains_[domain_of_[r]].is[i] != 0 && !(row.derivative && !row.asked.exact && is_subnormal(x_[i]));
    const Expected twins[2] = {expected(r, i), flushed_[r * kBatch + i]};
    const Verdict verdict = judge_one(row.asked, static_cast<double>(found[i]), inside, twins, 2);
    tally.special += verdict.special ? 1 : 0;
    tally.left_out += verdict.left_out ? 1 : 0;
    tally.not_finite += verdict.not_finite ? 1 : 0;
    if (verdict.special || verdict.left_out) continue;
    const double error = verdict.not_finite ? HUGE_VAL : verdict.error;
    ++tally.bins[bin_of(error)];
    tally.note(error, verdict.not_finite ? HUGE_VAL : verdict.share, bits[i], twins[verdict.twin].value,
               static_cast<double>(found[i]));
  }
}

}  // namespace dr::sweep
