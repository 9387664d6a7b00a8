// SPDX-License-Identifier: Apache-2.0
// Every float: unary float ops, value and derivative with adjoint 1, on a device over all 2^32 bit patterns, in both
// float profiles, against the float64 evaluator. Measure, domain, scale and exceptions are those of the accuracy table.
//
//   bench_sweep OUT NAME DEVICE [--every N] [--threads N] [--ops A,B]   lines of JSON, one a row
//
// With --every, each Nth pattern from 0 on, and the ends of exponents and special values. An odd N has all low bits.
#include <malloc.h>

#include <array>
#include <atomic>
#include <bit>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/bench/measure/sweep_judge.h"
#include "tests/device/accuracy/measure.h"
#include "tests/device/accuracy/samples.h"
#include "tests/gradient/build.h"
#include "tests/must.h"

using namespace dr;
using accuracy::Values;
using ir::OpKind;
using ir::ValueId;

namespace {

using benchmark::must;
using benchmark::stop;
using sweep::Group;
using sweep::Judge;
using sweep::Row;
using sweep::Tally;

constexpr int64_t kSide = 2048;  // of an image: 2^22 patterns at most
constexpr int64_t kListWidth = 1024;
static_assert(kSide % Judge::kBatch == 0 && kListWidth % Judge::kBatch == 0);  // it takes whole batches

// ---- Patterns ----

// Images of patterns that are `stride` apart, or one of patterns that are listed.
struct Patterns {
  uint32_t stride = 1;
  std::vector<int32_t> list = {};

  int64_t width() const { return list.empty() ? kSide : kListWidth; }
  int64_t height() const {
    if (!list.empty()) return static_cast<int64_t>(list.size()) / kListWidth;
    return std::clamp<int64_t>((int64_t{1} << 32) / (stride * kSide), 1, kSide);
  }
  int64_t count() const { return width() * height(); }
  // Enough for all; what the last one has beyond 2^32 begins anew between those that were.
  size_t images() const {
    const int64_t all = ((int64_t{1} << 32) + stride - 1) / stride;
    return list.empty() ? static_cast<size_t>((all + count() - 1) / count()) : 1;
  }
  uint32_t base(size_t image) const {
    return static_cast<uint32_t>(static_cast<uint64_t>(image) * static_cast<uint64_t>(count()) * stride);
  }
  uint32_t at(uint32_t base, size_t k) const {
    return list.empty() ? base + stride * static_cast<uint32_t>(k) : static_cast<uint32_t>(list[k]);
  }
};

// The ends and the middle of each exponent of both signs, and the special values.
Patterns special_patterns() {
  std::vector<uint32_t> bits;
  for (uint32_t e = 0; e < 512; ++e)
    for (const uint32_t m : {0u, 1u, 2u, 0x3fffffu, 0x400000u, 0x7ffffeu, 0x7fffffu}) bits.push_back(e << 23 | m);
  for (const double x : accuracy::special_floats()) bits.push_back(std::bit_cast<uint32_t>(static_cast<float>(x)));
  while (bits.size() % kListWidth != 0) bits.push_back(0x3f800000);
  Patterns out;
  for (const uint32_t b : bits) out.list.push_back(static_cast<int32_t>(b));
  return out;
}

// ---- The device ----

// The bundle that computes value and derivative of patterns from `base` on, or that `base` lists.
std::vector<uint8_t> compile(const Group& group, bool native, const std::string& profile_name,
                             const Patterns& patterns) {
  ir::Builder b;
  const ir::Extent extent{ir::Dim(patterns.width()), ir::Dim(patterns.height()), 1};
  ValueId bits;
  if (patterns.list.empty()) {
    const auto coordinate = [&](int64_t axis) {
      ir::Attrs attrs = gradient_test::dims(extent);
      attrs.ints = {axis};
      return ops::emit(b, OpKind::Coord, {}, attrs);
    };
    const auto times = [&](ValueId x, int64_t by) {
      return by == 1 ? x : ops::mul(b, x, ops::constant(b, ir::kInt, static_cast<double>(by)));
    };
    const ValueId place = ops::add(b, times(coordinate(1), patterns.width()), coordinate(0));
    bits = ops::add(b, gradient_test::leaf(b, "base", ir::kInt, {}), times(place, patterns.stride));
  } else {
    bits = gradient_test::leaf(b, "base", ir::kInt, extent);
  }
  const Values xs{ops::emit(b, OpKind::Bitcast, {bits}, gradient_test::ints({int64_t(ir::Scalar::Float)}))};
  const ValueId y = group.cases[0].build(b, xs);
  std::vector<std::pair<std::string, ValueId>> out{{"value", y}};
  if (group.differentiable())
    out.emplace_back("derivative", gradient_test::grad(b, y, ops::constant(b, ir::kFloat, 1.0), xs)[0]);
  gradient_test::add_step(b.graph(), "go", out);
  const ir::Graph graph = passes::run_passes(std::move(b).finish(), passes::default_passes());

  const auto profile = target::load_profile(profile_name);
  if (const auto* problem = std::get_if<std::string>(&profile)) stop(*problem);
  auto options = std::get<backend::CompileOptions>(
      backend::compile_options("auto", "auto", "fused", {}, "auto", native ? "native" : "strict"));
  options.cache_folder = backend::default_cache_folder();
  const auto compiled = backend::compile(graph, std::get<target::Profile>(profile), options);
  if (const auto* problem = std::get_if<backend::Limit>(&compiled)) stop(problem->text);
  return bundle::write(std::get<backend::Compiled>(compiled).bundle);
}

// Half of all patterns give NaN or Inf, or take some.
runtime::LoadOptions quiet() {
  runtime::LoadOptions options;
  options.warn = nullptr;
  return options;
}

class DeviceProgram {
 public:
  DeviceProgram(const runtime::Device& device, const std::vector<uint8_t>& bundle, bool differentiable,
                const Patterns& patterns)
      : program_(must(runtime::Program::load(device, bundle, quiet()))),
        differentiable_(differentiable),
        listed_(!patterns.list.empty()) {
    if (listed_)
      must(program_.bind("base", io::Array::from_ints(patterns.list, 1, patterns.width(), patterns.height())));
  }

  // Value, and the derivative if there is one, of the patterns from `base` on, if they are not listed.
  std::vector<io::Array> run(uint32_t base) {
    if (!listed_) must(program_.bind("base", io::Array::from_ints(std::array{static_cast<int32_t>(base)})));
    must(program_.run("go"));
    std::vector<io::Array> out;
    out.push_back(must(program_.output("go", "value")));
    if (differentiable_) out.push_back(must(program_.output("go", "derivative")));
    return out;
  }

 private:
  runtime::Program program_;
  bool differentiable_, listed_;
};

// ---- Judging ----

// What the device found of the patterns from `base` on, or of those listed, by profile and output.
void judge(Judge& one, const std::vector<Row>& rows, const std::vector<io::Array> (&found)[2], uint32_t base,
           const Patterns& patterns) {
  const auto count = static_cast<size_t>(found[0][0].scalar_count());
  std::vector<uint32_t> bits(Judge::kBatch);
  std::vector<const float*> by_row(rows.size());
  for (size_t begin = 0; begin < count; begin += bits.size()) {
    for (size_t i = 0; i < bits.size(); ++i) bits[i] = patterns.at(base, begin + i);
    for (size_t r = 0; r < rows.size(); ++r)
      by_row[r] = found[rows[r].native][rows[r].derivative].as<float>().data() + begin;
    one.batch(bits.data(), by_row);
  }
}

// Each device is one opening of the same, for a thread that runs, reads back and judges images.
void sweep_patterns(const std::vector<runtime::Device>& devices, const Group& group, const std::vector<Row>& rows,
                    const Patterns& patterns, std::vector<Judge>& judges) {
  const std::string known = devices[0].profile_name();
  std::vector<std::vector<uint8_t>> bundles;
  for (const bool native : {false, true})
    if (!native || group.has_native())
      bundles.push_back(compile(group, native, known.empty() ? "lavapipe" : known, patterns));
  std::atomic<size_t> next{0};
  std::vector<std::jthread> threads;
  for (size_t t = 0; t < devices.size(); ++t)
    threads.emplace_back([&, t] {
      std::vector<DeviceProgram> programs;
      for (const auto& bundle : bundles) programs.emplace_back(devices[t], bundle, group.differentiable(), patterns);
      std::vector<io::Array> found[2];
      for (size_t k = next++; k < patterns.images(); k = next++) {
        const uint32_t base = patterns.base(k);
        for (size_t p = 0; p < programs.size(); ++p) found[p] = programs[p].run(base);
        judge(judges[t], rows, found, base, patterns);
      }
    });
}

void sweep_op(const std::vector<runtime::Device>& devices, const std::string& name, const Group& group, uint32_t stride,
              std::ofstream& out) {
  const auto begin = std::chrono::steady_clock::now();
  const std::vector<Row> rows = sweep::rows_of(group);
  const ir::Graph graph = sweep::judge_graph(group, rows);
  const runtime::Device& device = devices[0];
  std::vector<Judge> judges;
  for (size_t t = 0; t < devices.size(); ++t) judges.emplace_back(graph, rows);
  sweep_patterns(devices, group, rows, {.stride = stride}, judges);
  if (stride > 1) sweep_patterns(devices, group, rows, special_patterns(), judges);
  const std::string op(ir::op_name(group.kind));
  for (size_t r = 0; r < rows.size(); ++r) {
    Tally all = judges[0].tallies()[r];
    for (size_t t = 1; t < judges.size(); ++t) all.add(judges[t].tallies()[r]);
    const Row& row = rows[r];
    const bool pass = all.share <= 1 && all.not_finite == 0;
    char input[16];
    std::snprintf(input, sizeof input, "%08x", all.input);
    out << nlohmann::json{{"op", op},
                          {"direction", row.derivative ? "d/dx1" : "value"},
                          {"domain", accuracy::range(row.entry->operands[0])},
                          {"profile", row.native ? "native" : "strict"},
                          {"name", name},
                          {"device", device.info().name},
                          {"driver", device.info().driver},
                          {"patterns", stride == 1 ? "all" : "every " + std::to_string(stride) + "th"},
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
                  accuracy::range(row.entry->operands[0]).c_str(), all.worst, all.share, input, all.found,
                  all.expected);
  }
  out.flush();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  std::printf("%-12s %6.1f s\n", op.c_str(), seconds);
  std::fflush(stdout);
}

int run(const std::vector<std::string>& arguments) {
  const std::string &file = arguments[0], &name = arguments[1], &wanted = arguments[2];
  size_t threads = std::max(1u, std::thread::hardware_concurrency());
  uint32_t stride = 1;
  std::string only;
  for (size_t k = 3; k < arguments.size(); ++k) {
    const std::string& a = arguments[k];
    const std::string next = k + 1 < arguments.size() ? arguments[k + 1] : "";
    if (a == "--every" && std::atoi(next.c_str()) > 0)
      stride = static_cast<uint32_t>(std::atoi(next.c_str())), ++k;
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
  for (const Group& group : sweep::groups())
    if (only.empty() || only.find("," + std::string(ir::op_name(group.kind)) + ",") != std::string::npos)
      sweep_op(devices, name, group, stride, out);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.size() >= 4 && arguments[0] == "run") return run({arguments.begin() + 1, arguments.end()});
  std::fputs("usage: bench_sweep run OUT NAME DEVICE [--every N] [--threads N] [--ops A,B]\n", stderr);
  return 2;
}
