// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/measure.h"

#include <algorithm>
#include <bit>
#include <cfloat>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "compiler/backend/compile.h"
#include "compiler/backend/shader_cache.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/device/accuracy/samples.h"
#include "tests/gradient/build.h"

namespace dr::accuracy {

namespace {

using ir::Extent;
using ir::Graph;
using ir::ValueId;
using reference::Image;
using Images = std::map<std::string, Image>;

[[noreturn]] void stop(const std::string& why) {
  std::fprintf(stderr, "accuracy: %s\n", why.c_str());
  std::exit(1);
}

template <class T>
T must(io::Result<T> result) {
  if (!result) stop(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

std::string named(const char* what, size_t c, size_t k = 0) {
  return std::string(what) + std::to_string(c) + "_" + std::to_string(k);
}

// The graphs of some cases: what the device runs, and what only the judge computes.
struct Graphs {
  Graph device, judge;
};

Graphs graphs_of(std::span<const Case> cases, const std::vector<Samples>& samples) {
  ir::Builder device, judge;
  std::vector<std::pair<std::string, ValueId>> values, derivatives, judged;
  for (size_t c = 0; c < cases.size(); ++c) {
    const Case& entry = cases[c];
    const Image& first = samples[c].operands[0];
    const Extent extent{first.width, first.height, first.layers};
    Values xs, twins;
    for (size_t k = 0; k < entry.operands.size(); ++k) {
      xs.push_back(gradient_test::leaf(device, named("x", c, k), entry.operands[k].type, extent));
      twins.push_back(gradient_test::leaf(judge, named("x", c, k), entry.operands[k].type, extent));
    }
    const ValueId y = entry.build(device, xs);
    values.emplace_back(named("value", c), y);
    if (entry.scale) judged.emplace_back(named("scale", c), entry.scale(judge, twins, {}));
    if (entry.except) judged.emplace_back(named("except", c), entry.except(judge, twins));
    if (entry.derivatives.empty()) continue;
    const ir::ValueInfo result = device.value(y);
    const ValueId w = gradient_test::leaf(device, named("w", c), result.type, result.extent);
    const ValueId twin = gradient_test::leaf(judge, named("w", c), result.type, result.extent);
    std::vector<ValueId> targets;
    for (const Derivative& d : entry.derivatives) targets.push_back(xs[d.operand]);
    const std::vector<ValueId> found = gradient_test::grad(device, y, w, targets);
    for (size_t k = 0; k < found.size(); ++k) {
      derivatives.emplace_back(named("derivative", c, k), found[k]);
      if (entry.derivatives[k].scale)
        judged.emplace_back(named("derivative_scale", c, k), entry.derivatives[k].scale(judge, twins, twin));
      if (entry.derivatives[k].except)
        judged.emplace_back(named("derivative_except", c, k), entry.derivatives[k].except(judge, twins));
    }
  }
  gradient_test::add_step(device.graph(), "values", values);
  if (!derivatives.empty()) gradient_test::add_step(device.graph(), "derivatives", derivatives);
  gradient_test::add_step(judge.graph(), "judge", judged);
  return {passes::run_passes(std::move(device).finish(), passes::default_passes()), std::move(judge).finish()};
}

io::Array array_of(const Image& image) {
  const auto n = static_cast<size_t>(image.count());
  const auto components = static_cast<size_t>(image.type.components());
  if (image.type.is_float()) {
    std::vector<float> values(image.data.size());
    for (size_t c = 0; c < components; ++c)
      for (size_t i = 0; i < n; ++i) values[i * components + c] = static_cast<float>(image.data[c * n + i]);
    return io::Array::from_floats(values, static_cast<int>(components), image.width, image.height, image.layers);
  }
  std::vector<double> values(image.data.size());
  for (size_t c = 0; c < components; ++c)
    for (size_t i = 0; i < n; ++i) values[i * components + c] = image.data[c * n + i];
  return io::Array::from_doubles(values, static_cast<int>(components), image.width, image.height, image.layers);
}

// Subnormal numbers as devices may take them.
Image flushed(Image image) {
  if (image.type.is_float())
    for (double& x : image.data)
      if (std::abs(x) < 0x1p-126) x = std::copysign(0.0, x);
  return image;
}

Images evaluate(const Graph& graph, const Images& leaves, bool flush) {
  Images results;
  for (const ir::Step& step : graph.steps) {
    if (step.outputs.empty()) continue;
    reference::Session session(graph);
    for (const auto& [name, image] : leaves)
      if (graph.leaf_index(name))
        if (const auto problem = session.bind(name, flush ? flushed(image) : image)) stop(*problem);
    for (auto& [name, image] : gradient_test::run(session, step.name)) results[name] = std::move(image);
  }
  return results;
}

double ulp_of(double size) { return std::exp2(std::floor(std::log2(std::max(size, 0x1p-126))) - 23); }

// In last places of the larger of `expected` and `scale`. Beyond float32's range Inf stands for 2^128; below `least`
// nothing is promised but that the result is there too.
double error_of(bool is_float, double found, double expected, double scale, double least) {
  if (std::isnan(found) || std::isnan(expected)) return std::isnan(found) && std::isnan(expected) ? 0 : HUGE_VAL;
  if (!is_float) return found == expected ? 0 : HUGE_VAL;
  const auto bounded = [](double x) { return std::clamp(x, -0x1p128, 0x1p128); };
  found = bounded(found);
  expected = bounded(expected);
  if (std::abs(expected) < least && std::abs(found) <= least) return 0;
  // Terms of a sum may be flushed, four of them at most where they are few.
  if (scale > 0 && std::abs(found - expected) <= 0x1p-124) return 0;
  const double size = std::max(std::abs(expected), std::isfinite(scale) ? std::max(scale, 0.0) : 0.0);
  return std::abs(found - expected) / ulp_of(std::min(size, double{FLT_MAX}));
}

bool is_subnormal(double x) { return x != 0 && std::abs(x) < 0x1p-126; }
bool finite_float(double x) { return std::isfinite(static_cast<float>(x)); }

std::string hex(double x) {
  char text[16];
  std::snprintf(text, sizeof text, "%08x", std::bit_cast<uint32_t>(static_cast<float>(x)));
  return text;
}

std::string range(const Operand& o) {
  if (o.type.is_bool()) return "all";
  if (o.low == 0 && o.high == 0) return "";
  char text[64];
  if (o.type.is_float() ? o.low <= -double{FLT_MAX} && o.high >= double{FLT_MAX} && o.least == 0 : o.high - o.low > 4e9)
    return "all";
  const auto number = [](double x) {
    char word[32];
    if (std::abs(x) >= double{FLT_MAX}) return std::string(x < 0 ? "-max" : "max");
    std::snprintf(word, sizeof word, "%.6g", x);
    return std::string(word);
  };
  std::snprintf(text, sizeof text, "%s … %s", number(o.low).c_str(), number(o.high).c_str());
  std::string result = text;
  if (o.least > 0) result += ", sizes from " + number(o.least);
  return result;
}

// What one output is judged by: pairs of results for operands as they are and for flushed ones.
struct Judged {
  const Image* expected[2];
  const Image* scale[2] = {nullptr, nullptr};
  const Image* except[2] = {nullptr, nullptr};
  const Image* value[2] = {nullptr, nullptr};  // of a derivative: the result itself
};

void judge(Row& row, const io::Array& array, const Judged& by, const Case& c, const Samples& samples) {
  const std::vector<double> found = array.to_doubles();
  const Image& image = *by.expected[0];
  const auto n = static_cast<size_t>(image.count());
  const auto components = static_cast<size_t>(image.type.components());
  if (found.size() != image.data.size()) stop(row.op + ": results of another size");
  const bool own = samples.inside.size() == n;  // an element of the result belongs to one of the operands
  const auto at = [&](const Image* from, size_t i, size_t k) {
    const size_t m = static_cast<size_t>(from->count());
    const size_t planes = from->data.size() / m;
    return from->data[(planes == 1 ? 0 : k) * m + (m == 1 ? 0 : i % m)];
  };
  std::vector<double> errors;
  row.worst = -1;
  for (size_t i = 0; i < n; ++i) {
    // Operands of images mix: all are inside, or none counts.
    bool inside = own ? samples.inside[i] : true;
    // Nor have derivatives all their digits where an operand or the result is a subnormal number.
    if (own && by.value[0] && row.bound > 0)
      for (const Image& operand : samples.operands)
        for (size_t p = 0; p < static_cast<size_t>(operand.type.components()); ++p)
          inside = inside && !(operand.type.is_float() && is_subnormal(operand.data[p * n + i]));
    for (size_t k = 0; k < components; ++k) {
      const double result = found[i * components + k];
      double error = HUGE_VAL;
      size_t twin = 0;
      bool may_be_infinite = false, except = false;
      for (size_t f = 0; f < 2; ++f) {
        const double expected = by.expected[f]->data[k * n + i];
        const double scale = by.scale[f] ? at(by.scale[f], i, k) : 0;
        // A factor of a derivative may leave the range before all of it does.
        const double room = by.value[f] ? 0x1p7 : 1;
        double e = error_of(image.type.is_float(), result, expected, scale, room * 0x1p-126);
        if (by.except[f] && at(by.except[f], i, k) != 0) except = true;
        may_be_infinite = may_be_infinite || !finite_float(room * expected) || !finite_float(scale);
        if (by.value[f])
          for (size_t v = 0; v < static_cast<size_t>(by.value[f]->type.components()); ++v) {
            may_be_infinite = may_be_infinite || !finite_float(at(by.value[f], i, v));
            except = except || (row.bound > 0 && is_subnormal(at(by.value[f], i, v)));
          }
        if (e < error) error = e, twin = f;
      }
      if (image.type.is_float() && !std::isfinite(result) && !may_be_infinite) {
        if (++row.not_finite == 1 || !inside) error = HUGE_VAL;
      } else if (!inside || except) {
        ++row.special;
        continue;
      }
      // Where the result itself overflows, the derivative that is made of it means nothing; nor does a sum where its
      // terms do.
      if (may_be_infinite && (by.value[0] || by.scale[0])) continue;
      const double expected = by.expected[twin]->data[k * n + i];
      if (std::abs(expected) >= 0x1p-126 && std::isfinite(expected) && finite_float(expected) && std::isfinite(result))
        row.relative = std::max(row.relative, std::abs(result - expected) / std::abs(expected));
      else if (std::abs(expected) < 0x1p-126 && std::isfinite(result))
        row.near_zero = std::max(row.near_zero, std::abs(result - expected));
      errors.push_back(error);
      if (error > row.worst) {
        row.worst = error;
        row.expected = expected;
        row.found = result;
        row.worst_input.clear();
        if (!own) row.worst_input = "element " + std::to_string(i);
        for (size_t o = 0; own && o < samples.operands.size(); ++o)
          for (size_t p = 0; p < static_cast<size_t>(c.operands[o].type.components()); ++p) {
            const double x = samples.operands[o].data[p * n + i];
            char text[32];
            std::snprintf(text, sizeof text, "%.0f", x);
            row.worst_input += (row.worst_input.empty() ? "" : " ") + (c.operands[o].type.is_float() ? hex(x) : text);
          }
      }
    }
  }
  row.samples = static_cast<int64_t>(errors.size());
  row.worst = std::max(row.worst, 0.0);
  if (!errors.empty()) {
    const auto place = errors.begin() + static_cast<std::ptrdiff_t>((errors.size() - 1) * 999 / 1000);
    std::nth_element(errors.begin(), place, errors.end());
    row.p999 = *place;
  }
}

}  // namespace

std::vector<Row> measure(const runtime::Device& device, std::span<const Case> cases, const Options& options) {
  std::vector<Samples> samples;
  for (const Case& c : cases)
    samples.push_back(draw(c, options.random, options.seed + static_cast<uint64_t>(c.kind) * 1000 + c.name.size()));
  const Graphs graphs = graphs_of(cases, samples);
  Images leaves;
  for (size_t c = 0; c < cases.size(); ++c)
    for (size_t k = 0; k < cases[c].operands.size(); ++k) leaves[named("x", c, k)] = samples[c].operands[k];
  for (const ir::Leaf& leaf : graphs.device.leaves) {
    if (leaves.contains(leaf.name)) continue;
    const Extent& e = leaf.extent;
    leaves[leaf.name] =
        draw_weights(leaf.type, e.w.constant(), e.h.constant(), e.l.constant(), options.seed + leaves.size());
  }

  auto profile = target::load_profile(options.profile);
  if (const auto* problem = std::get_if<std::string>(&profile)) stop(*problem);
  auto chosen = backend::compile_options(options.lower, "auto", "fused");
  if (const auto* problem = std::get_if<std::string>(&chosen)) stop(*problem);
  auto& compile_options = std::get<backend::CompileOptions>(chosen);
  compile_options.cache_folder = backend::default_cache_folder();
  auto compiled = backend::compile(graphs.device, std::get<target::Profile>(profile), compile_options);
  if (const auto* problem = std::get_if<std::string>(&compiled)) stop(*problem);
  auto program = must(runtime::Program::load(device, bundle::write(std::get<backend::Compiled>(compiled).bundle)));
  for (const auto& leaf : program.leaves()) must(program.bind(leaf.name, array_of(leaves.at(leaf.name))));
  for (const std::string& step : program.steps()) must(program.run(step));

  Images expected[2], judged[2];
  for (const bool flush : {false, true}) {
    expected[flush] = evaluate(graphs.device, leaves, flush);
    judged[flush] = evaluate(graphs.judge, leaves, flush);
  }
  const auto both = [](Images(&from)[2], const std::string& name, const Image*(&to)[2]) {
    for (size_t f = 0; f < 2; ++f)
      if (const auto found = from[f].find(name); found != from[f].end()) to[f] = &found->second;
  };
  std::vector<Row> rows;
  for (size_t c = 0; c < cases.size(); ++c) {
    const Case& entry = cases[c];
    Row row{
        .op = entry.name, .direction = "value", .domain = entry.domain, .scale = entry.scale_text, .why = entry.why};
    for (size_t k = 0; k < entry.operands.size(); ++k) {
      const std::string text = range(entry.operands[k]);
      if (!text.empty()) row.domain += (row.domain.empty() ? "" : "; ") + text;
    }
    row.bound = entry.bound;
    Judged by{};
    both(expected, named("value", c), by.expected);
    both(judged, named("scale", c), by.scale);
    both(judged, named("except", c), by.except);
    judge(row, must(program.output("values", named("value", c))), by, entry, samples[c]);
    rows.push_back(row);
    for (size_t k = 0; k < entry.derivatives.size(); ++k) {
      const Derivative& d = entry.derivatives[k];
      Row other{.op = entry.name,
                .direction = "d/dx" + std::to_string(d.operand + 1),
                .domain = row.domain,
                .scale = d.scale_text,
                .why = d.why,
                .bound = d.bound};
      Judged of{};
      both(expected, named("derivative", c, k), of.expected);
      both(judged, named("derivative_scale", c, k), of.scale);
      both(judged, named("derivative_except", c, k), of.except);
      if (expected[0].at(named("value", c)).count() == expected[0].at(named("derivative", c, k)).count())
        both(expected, named("value", c), of.value);
      judge(other, must(program.output("derivatives", named("derivative", c, k))), of, entry, samples[c]);
      rows.push_back(other);
    }
  }
  return rows;
}

}  // namespace dr::accuracy
