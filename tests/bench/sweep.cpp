// SPDX-License-Identifier: Apache-2.0
// Every float: unary float ops, value and derivative with adjoint 1, on a device over all 2^32 bit patterns, in both
// float profiles, against the float64 evaluator. Measure, domain, scale and exceptions are those of the accuracy table.
//
//   bench_sweep run OUT NAME DEVICE [--quick] [--threads N] [--ops A,B]   lines of JSON, one a row
//   bench_sweep points OUT COUNT     operands and what the evaluator says, for tests/bench/judge.py
#include <malloc.h>

#include <array>
#include <atomic>
#include <bit>
#include <cfloat>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "compiler/backend/compile.h"
#include "compiler/backend/shader_cache.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/bench/must.h"
#include "tests/device/accuracy/batch.h"
#include "tests/device/accuracy/errors.h"
#include "tests/device/accuracy/measure.h"
#include "tests/device/accuracy/samples.h"
#include "tests/gradient/build.h"

using namespace dr;
using namespace dr::accuracy;
using ir::OpKind;
using ir::ValueId;

namespace {

constexpr int64_t kSide = 2048;     // of an image: 2^22 patterns
constexpr uint32_t kStride = 4099;  // of patterns with --quick, a prime
constexpr int64_t kQuickWidth = 1024;
constexpr size_t kBatch = BatchGraph::kBatch;

using benchmark::must;
using benchmark::stop;

// The cases of one op, which differ in their domains.
struct Group {
  OpKind kind;
  std::vector<Case> cases;
  bool differentiable() const { return !cases[0].derivatives.empty(); }
  // Whether the profiles may differ: what is exact is the same GLSL.
  bool has_native() const {
    return std::ranges::any_of(cases, [](const Case& c) {
      return c.bound > 0 || std::ranges::any_of(c.derivatives, [](const Derivative& d) { return d.bound > 0; });
    });
  }
};

std::vector<Group> groups() {
  std::vector<Group> all;
  for (const Case& c : number_cases()) {
    if (c.operands.size() != 1) continue;
    if (all.empty() || all.back().kind != c.kind) all.push_back({c.kind, {}});
    all.back().cases.push_back(c);
  }
  return all;
}

ir::Graph finish(ir::Builder&& b) { return passes::run_passes(std::move(b).finish(), passes::default_passes()); }

// ---- What is asked ----

// A row of the result: a case, a direction, a float profile.
struct Row {
  const Case* entry;
  bool native, derivative;
  Asked asked;
  double bound = 0;
  std::string promise = {}, why = {}, scale_text = {}, key = {};  // the key names the judge's outputs
};

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

// The judge's graph: value, derivative, and each row's scale, bound and exception.
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
  return finish(std::move(b));
}

// ---- Patterns ----

// Every kStride-th pattern, the ends and the middle of each exponent of both signs, and the special values.
std::vector<int32_t> quick_patterns() {
  std::vector<uint32_t> bits;
  for (uint64_t p = 0; p < uint64_t{1} << 32; p += kStride) bits.push_back(static_cast<uint32_t>(p));
  for (uint32_t e = 0; e < 512; ++e)
    for (const uint32_t m : {0u, 1u, 2u, 0x3fffffu, 0x400000u, 0x7ffffeu, 0x7fffffu}) bits.push_back(e << 23 | m);
  for (const double x : special_floats()) bits.push_back(std::bit_cast<uint32_t>(static_cast<float>(x)));
  while (bits.size() % kQuickWidth != 0) bits.push_back(0x3f800000);
  return {reinterpret_cast<int32_t*>(bits.data()), reinterpret_cast<int32_t*>(bits.data()) + bits.size()};
}

// ---- The device ----

// The bundle that computes value and derivative of patterns that count on from `base`, or that `base` lists.
std::vector<uint8_t> compile(const Group& group, bool native, const std::string& profile_name,
                             const std::vector<int32_t>& patterns) {
  ir::Builder b;
  const int64_t width = patterns.empty() ? kSide : kQuickWidth;
  const int64_t height = patterns.empty() ? kSide : static_cast<int64_t>(patterns.size()) / kQuickWidth;
  const ir::Extent extent{ir::Dim(width), ir::Dim(height), 1};
  ValueId bits;
  if (patterns.empty()) {
    const auto coordinate = [&](int64_t axis) {
      ir::Attrs attrs = gradient_test::dims(extent);
      attrs.ints = {axis};
      return ops::emit(b, OpKind::Coord, {}, attrs);
    };
    const ValueId row = ops::mul(b, coordinate(1), ops::constant(b, ir::kInt, static_cast<double>(width)));
    bits = ops::add(b, gradient_test::leaf(b, "base", ir::kInt, {}), ops::add(b, row, coordinate(0)));
  } else {
    bits = gradient_test::leaf(b, "base", ir::kInt, extent);
  }
  const Values xs{ops::emit(b, OpKind::Bitcast, {bits}, gradient_test::ints({int64_t(ir::Scalar::Float)}))};
  const ValueId y = group.cases[0].build(b, xs);
  std::vector<std::pair<std::string, ValueId>> out{{"value", y}};
  if (group.differentiable())
    out.emplace_back("derivative", gradient_test::grad(b, y, ops::constant(b, ir::kFloat, 1.0), xs)[0]);
  gradient_test::add_step(b.graph(), "go", out);
  const ir::Graph graph = finish(std::move(b));

  const auto profile = target::load_profile(profile_name);
  if (const auto* problem = std::get_if<std::string>(&profile)) stop(*problem);
  auto options = std::get<backend::CompileOptions>(
      backend::compile_options("auto", "auto", "fused", {}, "auto", native ? "native" : "strict"));
  options.cache_folder = backend::default_cache_folder();
  const auto compiled = backend::compile(graph, std::get<target::Profile>(profile), options);
  if (const auto* problem = std::get_if<std::string>(&compiled)) stop(*problem);
  return bundle::write(std::get<backend::Compiled>(compiled).bundle);
}

class DeviceProgram {
 public:
  DeviceProgram(const runtime::Device& device, const std::vector<uint8_t>& bundle, bool differentiable,
                const std::vector<int32_t>& patterns)
      : program_(must(runtime::Program::load(device, bundle))), differentiable_(differentiable) {
    if (!patterns.empty())
      must(program_.bind(
          "base", io::Array::from_ints(patterns, 1, kQuickWidth, static_cast<int64_t>(patterns.size()) / kQuickWidth)));
  }

  // Value, and the derivative if there is one, of the patterns from `base` on, if they are not listed.
  std::vector<io::Array> run(std::optional<uint32_t> base) {
    if (base) must(program_.bind("base", io::Array::from_ints(std::array{static_cast<int32_t>(*base)})));
    must(program_.run("go"));
    std::vector<io::Array> out;
    out.push_back(must(program_.output("go", "value")));
    if (differentiable_) out.push_back(must(program_.output("go", "derivative")));
    return out;
  }

 private:
  runtime::Program program_;
  bool differentiable_;
};

// ---- Judging ----

// Errors on a scale of 32 steps an octave.
uint32_t bin_of(double error) {
  return std::bit_cast<uint32_t>(static_cast<float>(std::min(error, double{FLT_MAX}))) >> 18;
}
double upper_end(size_t bin) { return std::bit_cast<float>(static_cast<uint32_t>(bin + 1) << 18); }

// The part of a batch that is easily judged: normal numbers of the domain far from the ends of the range, of which
// nothing special is said, and finite ones outside. No branches, so that it takes a nanosecond or two an element.
struct Simple {
  std::array<double, kBatch> size, error, share;
  std::array<uint64_t, kBatch> is, outside;
  std::array<uint32_t, kBatch> bin;
  double worst_share = 0, worst = 0;
  uint64_t count = 0, outside_count = 0;

  // `domain`: 1 inside, else 0. `scale`, `except`: null where there are none. `bound`: of each element, or of all.
  void judge(size_t n, const double* exact, const double* value, const float* found, const uint64_t* domain,
             const double* scale, const double* except, const double* bound, bool one_bound) {
    for (size_t i = 0; i < n; ++i) size[i] = std::abs(exact[i]);
    if (scale != nullptr)
      for (size_t i = 0; i < n; ++i) size[i] = scale[i] > size[i] ? scale[i] : size[i];
    for (size_t i = 0; i < n; ++i) {
      const double v = std::abs(value[i]), f = std::abs(static_cast<double>(found[i])), e = std::abs(exact[i]);
      const auto finite = static_cast<uint64_t>(f <= double{FLT_MAX});
      is[i] = domain[i] & finite & static_cast<uint64_t>(size[i] >= 0x1p-90) &
              static_cast<uint64_t>(size[i] <= 0x1p118) & static_cast<uint64_t>(v >= 0x1p-126) &
              static_cast<uint64_t>(v <= 0x1p118) & static_cast<uint64_t>(e >= 0x1p-118);
      outside[i] = finite & (domain[i] ^ 1);
    }
    if (except != nullptr)
      for (size_t i = 0; i < n; ++i) is[i] &= static_cast<uint64_t>(except[i] == 0);
    for (size_t i = 0; i < n; ++i) {
      // 1 / ulp_of(size)
      const uint64_t exponent = std::bit_cast<uint64_t>(size[i]) & 0x7ff0000000000000u;
      const double places = std::bit_cast<double>((uint64_t{2046 + 23} << 52) - exponent);
      const double e = std::abs(static_cast<double>(found[i]) - exact[i]) * places;
      error[i] = is[i] != 0 ? e : 0.0;
    }
    worst_share = worst = 0;
    count = outside_count = 0;
    for (size_t i = 0; i < n; ++i) {
      const double b = one_bound ? bound[0] : bound[i];
      share[i] = error[i] == 0 ? 0 : error[i] / b;
      worst = error[i] > worst ? error[i] : worst;
      worst_share = share[i] > worst_share ? share[i] : worst_share;
      count += is[i];
      outside_count += outside[i];
    }
    for (size_t i = 0; i < n; ++i) bin[i] = std::bit_cast<uint32_t>(static_cast<float>(error[i])) >> 18;
  }
};

struct Tally {
  std::vector<uint64_t> bins = std::vector<uint64_t>(8192);
  uint64_t special = 0, left_out = 0, not_finite = 0;
  double share = -1, at_share = -1, worst = 0;  // the largest share of what is allowed, and the error there
  uint32_t input = 0;
  double expected = 0, found = 0;

  void take(double error, double part, uint32_t bits, double expects, double finds) {
    ++bins[bin_of(error)];
    note(error, part, bits, expects, finds);
  }
  // Without counting it.
  void note(double error, double part, uint32_t bits, double expects, double finds) {
    worst = std::max(worst, error);
    if (part < share || (part == share && error <= at_share)) return;
    share = part, at_share = error, input = bits, expected = expects, found = finds;
  }
  void add(const Tally& other) {
    for (size_t k = 0; k < bins.size(); ++k) bins[k] += other.bins[k];
    special += other.special, left_out += other.left_out, not_finite += other.not_finite;
    worst = std::max(worst, other.worst);
    if (other.share < share || (other.share == share && other.at_share <= at_share)) return;
    share = other.share, at_share = other.at_share, input = other.input;
    expected = other.expected, found = other.found;
  }
  uint64_t count() const {
    uint64_t n = 0;
    for (const uint64_t bin : bins) n += bin;
    return n;
  }
  double p999() const {
    uint64_t left = count() / 1000;
    for (size_t k = bins.size(); k-- > 0;) {
      if (bins[k] > left) return k == 0 ? 0 : std::min(upper_end(k), worst);
      left -= bins[k];
    }
    return 0;
  }
};

// One thread's judge of a group.
class Judge {
 public:
  Judge(const ir::Graph& graph, const std::vector<Row>& rows) : graph_(graph), rows_(rows), tallies(rows.size()) {
    x_ = graph_.leaf("x");
    value_ = graph_.output("value");
    derivative_ = graph_.output("derivative");
    for (const Row& row : rows)
      needs_.push_back(
          {graph_.output("scale" + row.key), graph_.output("bound" + row.key), graph_.output("except" + row.key)});
  }

  // `found` by row: what the device says of the `n` patterns.
  void batch(const uint32_t* bits, const std::vector<const float*>& found, size_t n) {
    bool tiny = false, any = false;
    for (size_t i = 0; i < n; ++i) {
      x[i] = static_cast<double>(std::bit_cast<float>(bits[i]));
      tiny = tiny || is_subnormal(x[i]);
    }
    for (size_t r = 0; r < rows_.size(); ++r) {
      const Operand& o = rows_[r].entry->operands[0];
      for (size_t i = 0; i < n && !any; ++i) any = (x[i] >= o.low && x[i] <= o.high) || !std::isfinite(found[r][i]);
    }
    // Nothing to compare with, and all finite.
    if (!any) {
      for (Tally& t : tallies) t.special += n;
      return;
    }
    if (tiny) {
      for (size_t i = 0; i < n; ++i) x_[i] = is_subnormal(x[i]) ? std::copysign(0.0, x[i]) : x[i];
      graph_.run(n);
      flushed_.assign(rows_.size() * n, {});
      for (size_t r = 0; r < rows_.size(); ++r)
        for (size_t i = 0; i < n; ++i) flushed_[r * n + i] = expected(r, i);
    }
    std::copy_n(x.data(), n, x_);
    graph_.run(n);
    for (size_t r = 0; r < rows_.size(); ++r) row(r, bits, found[r], n, tiny);
  }

 private:
  struct Needs {
    size_t scale, bound, except;
  };

  Expected expected(size_t r, size_t i) const {
    const Needs& needs = needs_[r];
    const double value = graph_.result(value_)[i];
    Expected e;
    e.value = rows_[r].derivative ? graph_.result(derivative_)[i] : value;
    if (needs.scale != BatchGraph::kNone) e.scale = graph_.result(needs.scale)[i];
    e.bound = needs.bound != BatchGraph::kNone ? graph_.result(needs.bound)[i] : rows_[r].bound;
    e.except = needs.except != BatchGraph::kNone && graph_.result(needs.except)[i] != 0;
    if (rows_[r].derivative) e.value_infinite = !finite_float(value), e.value_subnormal = is_subnormal(value);
    return e;
  }

  void row(size_t r, const uint32_t* bits, const float* found, size_t n, bool tiny) {
    const Row& row = rows_[r];
    const Operand& o = row.entry->operands[0];
    const Needs& needs = needs_[r];
    const double* exact = graph_.result(row.derivative ? derivative_ : value_);
    const double* value = graph_.result(value_);
    const double* bound = needs.bound != BatchGraph::kNone ? graph_.result(needs.bound) : nullptr;
    Tally& tally = tallies[r];
    for (size_t i = 0; i < n; ++i)
      domain_[i] = static_cast<uint64_t>(x[i] >= o.low) & static_cast<uint64_t>(x[i] <= o.high) &
                   static_cast<uint64_t>(std::abs(x[i]) >= o.least);
    if (!tiny) {
      Simple& s = simple_;
      const auto plane = [&](size_t output) { return output == BatchGraph::kNone ? nullptr : graph_.result(output); };
      s.judge(n, exact, value, found, domain_.data(), plane(needs.scale), plane(needs.except),
              bound ? bound : &row.bound, bound == nullptr);
      tally.special += s.outside_count;
      if (s.count == n)
        for (size_t i = 0; i < n; ++i) ++tally.bins[s.bin[i]];
      else if (s.count > 0)
        for (size_t i = 0; i < n; ++i) tally.bins[s.bin[i]] += s.is[i];
      if (s.count > 0 && (s.worst_share >= tally.share || s.worst > tally.worst))
        for (size_t i = 0; i < n; ++i)
          if (s.is[i] != 0) tally.note(s.error[i], s.share[i], bits[i], exact[i], static_cast<double>(found[i]));
      if (s.count + s.outside_count == n) return;
    }
    for (size_t i = 0; i < n; ++i) {
      if (!tiny && (simple_.is[i] | simple_.outside[i]) != 0) continue;
      bool inside = domain_[i] != 0;
      if (row.derivative && !row.asked.exact && is_subnormal(x[i])) inside = false;
      const Expected twins[2] = {expected(r, i), tiny ? flushed_[r * n + i] : Expected{}};
      const Verdict verdict = judge_one(row.asked, static_cast<double>(found[i]), inside, twins, tiny ? 2 : 1);
      tally.special += verdict.special ? 1 : 0;
      tally.left_out += verdict.left_out ? 1 : 0;
      tally.not_finite += verdict.not_finite ? 1 : 0;
      if (verdict.special || verdict.left_out) continue;
      tally.take(verdict.not_finite ? HUGE_VAL : verdict.error, verdict.not_finite ? HUGE_VAL : verdict.share, bits[i],
                 twins[verdict.twin].value, static_cast<double>(found[i]));
    }
  }

  BatchGraph graph_;
  const std::vector<Row>& rows_;
  double* x_;
  size_t value_, derivative_;
  std::vector<Needs> needs_;
  std::vector<double> x = std::vector<double>(kBatch);
  std::array<uint64_t, kBatch> domain_;
  Simple simple_;
  std::vector<Expected> flushed_;

 public:
  std::vector<Tally> tallies;
};

// What the device found of the patterns from `base` on, or of those listed, by profile and output.
void judge(Judge& one, const std::vector<Row>& rows, const std::vector<io::Array> (&found)[2], uint32_t base,
           const std::vector<int32_t>& patterns) {
  const auto count = static_cast<size_t>(found[0][0].scalar_count());
  std::vector<uint32_t> bits(kBatch);
  std::vector<const float*> by_row(rows.size());
  for (size_t begin = 0; begin < count; begin += kBatch) {
    const size_t n = std::min(kBatch, count - begin);
    for (size_t i = 0; i < n; ++i)
      bits[i] = patterns.empty() ? base + static_cast<uint32_t>(begin + i) : static_cast<uint32_t>(patterns[begin + i]);
    for (size_t r = 0; r < rows.size(); ++r)
      by_row[r] = found[rows[r].native][rows[r].derivative].as<float>().data() + begin;
    one.batch(bits.data(), by_row, n);
  }
}

// Each device is one opening of the same, for a thread that runs, reads back and judges chunks.
void sweep(const std::vector<runtime::Device>& devices, const std::string& name, const Group& group,
           const std::vector<int32_t>& patterns, std::ofstream& out) {
  const auto begin = std::chrono::steady_clock::now();
  const std::vector<Row> rows = rows_of(group);
  const ir::Graph graph = judge_graph(group, rows);
  const runtime::Device& device = devices[0];
  const std::string known = device.profile_name();
  std::vector<std::vector<uint8_t>> bundles;
  for (const bool native : {false, true})
    if (!native || group.has_native())
      bundles.push_back(compile(group, native, known.empty() ? "lavapipe" : known, patterns));
  const size_t chunks = patterns.empty() ? (size_t{1} << 32) / (kSide * kSide) : 1;
  std::vector<Judge> judges;
  for (size_t t = 0; t < devices.size(); ++t) judges.emplace_back(graph, rows);
  std::atomic<size_t> next{0};
  {
    std::vector<std::jthread> threads;
    for (size_t t = 0; t < devices.size(); ++t)
      threads.emplace_back([&, t] {
        std::vector<DeviceProgram> programs;
        for (const auto& bundle : bundles) programs.emplace_back(devices[t], bundle, group.differentiable(), patterns);
        std::vector<io::Array> found[2];
        for (size_t k = next++; k < chunks; k = next++) {
          const auto base = static_cast<uint32_t>(k * kSide * kSide);
          for (size_t p = 0; p < programs.size(); ++p)
            found[p] = programs[p].run(patterns.empty() ? std::optional(base) : std::nullopt);
          judge(judges[t], rows, found, base, patterns);
        }
      });
  }
  const std::string op(ir::op_name(group.kind));
  for (size_t r = 0; r < rows.size(); ++r) {
    Tally all = judges[0].tallies[r];
    for (size_t t = 1; t < judges.size(); ++t) all.add(judges[t].tallies[r]);
    const Row& row = rows[r];
    const bool pass = all.share <= 1 && all.not_finite == 0;
    char input[16];
    std::snprintf(input, sizeof input, "%08x", all.input);
    out << nlohmann::json{{"op", op},
                          {"direction", row.derivative ? "d/dx1" : "value"},
                          {"domain", range(row.entry->operands[0])},
                          {"profile", row.native ? "native" : "strict"},
                          {"name", name},
                          {"device", device.info().name},
                          {"driver", device.info().driver},
                          {"patterns", patterns.empty() ? "all" : "every " + std::to_string(kStride) + "th"},
                          {"n", all.count()},
                          {"special", all.special},
                          {"not_finite", all.not_finite},
                          {"max", std::min(all.worst, 1e30)},
                          {"p999", std::min(all.p999(), 1e30)},
                          {"share", std::min(all.share, 1e30)},
                          {"worst_input", input},
                          {"expected", all.expected},
                          {"found", all.found},
                          {"scale", row.scale_text},
                          {"bound", row.bound},
                          {"promise", row.promise},
                          {"why", row.why},
                          {"pass", pass}}
               .dump()
        << "\n";
    if (!pass)
      std::printf("beyond: %s %s %s, %s: %g last places, %g of what is allowed, at %s (found %g, expected %g)\n",
                  row.native ? "native" : "strict", op.c_str(), row.derivative ? "d/dx1" : "value",
                  range(row.entry->operands[0]).c_str(), all.worst, all.share, input, all.found, all.expected);
  }
  out.flush();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  std::printf("%-12s %6.1f s\n", op.c_str(), seconds);
  std::fflush(stdout);
}

int run(const std::vector<std::string>& arguments) {
  const std::string &file = arguments[0], &name = arguments[1], &wanted = arguments[2];
  size_t threads = std::max(1u, std::thread::hardware_concurrency());
  std::vector<int32_t> patterns;
  std::string only;
  for (size_t k = 3; k < arguments.size(); ++k) {
    const std::string& a = arguments[k];
    const std::string next = k + 1 < arguments.size() ? arguments[k + 1] : "";
    if (a == "--quick")
      patterns = quick_patterns(), threads = 1;
    else if (a == "--threads" && std::atoi(next.c_str()) > 0)
      threads = static_cast<size_t>(std::atoi(next.c_str())), ++k;
    else if (a == "--ops" && !next.empty())
      only = "," + next + ",", ++k;
    else
      stop("unknown or incomplete option '" + a + "'");
  }
  // Arrays of many MiB come and go: their pages stay.
  mallopt(M_MMAP_THRESHOLD, 1 << 30);
  mallopt(M_TRIM_THRESHOLD, -1);
  std::vector<runtime::Device> devices;
  for (size_t t = 0; t < threads; ++t) devices.push_back(must(runtime::Device::open({wanted, false})));
  std::ofstream out(file);
  if (!out) stop("cannot write '" + file + "'");
  for (const Group& group : groups())
    if (only.empty() || only.find("," + std::string(ir::op_name(group.kind)) + ",") != std::string::npos)
      sweep(devices, name, group, patterns, out);
  return 0;
}

// ---- Points for another judge ----

// For each case and direction a share of `count`: operands of the case's domain and special ones, and the result.
int points(const std::string& file, size_t count) {
  std::ofstream out(file);
  const std::vector<Case> cases = number_cases();
  size_t directions = 0;
  for (const Case& c : cases) directions += 1 + c.derivatives.size();
  for (const Case& c : cases) {
    const Samples samples = draw(c, static_cast<int64_t>(count / directions), 7);
    ir::Builder b;
    Values xs;
    for (size_t k = 0; k < c.operands.size(); ++k)
      xs.push_back(gradient_test::leaf(b, "x" + std::to_string(k), ir::kFloat, {ir::Dim(8), 1, 1}));
    std::vector<std::pair<std::string, ValueId>> results{{"value", c.build(b, xs)}};
    std::vector<ValueId> targets;
    for (const Derivative& d : c.derivatives) targets.push_back(xs[d.operand]);
    if (!targets.empty()) {
      const auto found = gradient_test::grad(b, results[0].second, ops::constant(b, ir::kFloat, 1.0), targets);
      for (size_t k = 0; k < found.size(); ++k)
        results.emplace_back("d/dx" + std::to_string(c.derivatives[k].operand + 1), found[k]);
    }
    gradient_test::add_step(b.graph(), "go", results);
    const ir::Graph graph = finish(std::move(b));
    BatchGraph batch(graph);
    const auto n = static_cast<size_t>(samples.operands[0].count());
    for (size_t begin = 0; begin < n; begin += kBatch) {
      const size_t here = std::min(kBatch, n - begin);
      for (size_t k = 0; k < xs.size(); ++k)
        if (double* leaf = batch.leaf("x" + std::to_string(k)))
          std::copy_n(samples.operands[k].data.data() + begin, here, leaf);
      batch.run(here);
      for (size_t i = 0; i < here; ++i)
        for (const auto& [direction, value] : results) {
          char text[64];
          out << c.name << "\t" << direction;
          for (const reference::Image& operand : samples.operands) {
            std::snprintf(text, sizeof text, "\t%a", operand.data[begin + i]);
            out << text;
          }
          std::snprintf(text, sizeof text, "\t%a\n", batch.result(batch.output(direction))[i]);
          out << text;
        }
    }
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.size() >= 4 && arguments[0] == "run") return run({arguments.begin() + 1, arguments.end()});
  if (arguments.size() == 3 && arguments[0] == "points" && std::atoll(argv[3]) > 0)
    return points(arguments[1], static_cast<size_t>(std::atoll(argv[3])));
  std::fputs("usage: bench_sweep run OUT NAME DEVICE [--quick] [--threads N] [--ops A,B] | points OUT COUNT\n", stderr);
  return 2;
}
