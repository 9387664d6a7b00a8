// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/measure.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/device/accuracy/errors.h"
#include "tests/device/accuracy/samples.h"
#include "tests/gradient/build.h"
#include "tests/must.h"

namespace dr::accuracy {

namespace {

using ir::Extent;
using ir::Graph;
using ir::ValueId;
using reference::Image;
using Images = std::map<std::string, Image>;

using benchmark::must;
using benchmark::stop;

std::string named(const char* what, size_t c, size_t k = 0) {
  return std::string(what) + std::to_string(c) + "_" + std::to_string(k);
}

// The graphs of some cases: what the device runs, and what only the judge computes.
struct Graphs {
  Graph device, judge;
};

Graphs graphs_of(std::span<const Case> cases, const std::vector<Samples>& samples, bool native) {
  ir::Builder device, judge;
  std::vector<std::pair<std::string, ValueId>> values, derivatives, judged;
  for (size_t c = 0; c < cases.size(); ++c) {
    const Case entry = in_profile(cases[c], native);
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
    if (native && entry.native) judged.emplace_back(named("bound", c), entry.native->bound(judge, twins, {}));
    if (entry.except) judged.emplace_back(named("except", c), entry.except(judge, twins));
    if (entry.derivatives.empty()) continue;
    const ir::ValueInfo result = device.value(y);
    const ValueId w = gradient_test::leaf(device, named("w", c), result.type, result.extent);
    const ValueId twin = gradient_test::leaf(judge, named("w", c), result.type, result.extent);
    std::vector<ValueId> targets;
    for (const Derivative& d : entry.derivatives) targets.push_back(xs[d.operand]);
    const std::vector<ValueId> found = gradient_test::grad(device, y, w, targets);
    for (size_t k = 0; k < found.size(); ++k) {
      const Derivative d = in_profile(entry.derivatives[k], native);
      derivatives.emplace_back(named("derivative", c, k), found[k]);
      if (d.scale) judged.emplace_back(named("derivative_scale", c, k), d.scale(judge, twins, twin));
      if (d.except) judged.emplace_back(named("derivative_except", c, k), d.except(judge, twins));
      if (native && d.native) judged.emplace_back(named("derivative_bound", c, k), d.native->bound(judge, twins, twin));
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

// What one output is judged by: pairs of results for operands as they are and for flushed ones.
struct Judged {
  const Image* expected[2];
  const Image* scale[2] = {nullptr, nullptr};
  const Image* bound[2] = {nullptr, nullptr};
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
  const Asked asked{.is_float = image.type.is_float(),
                    .derivative = by.value[0] != nullptr,
                    .exact = row.bound == 0,
                    .promised = by.bound[0] != nullptr,
                    .has_scale = by.scale[0] != nullptr};
  std::vector<double> errors;
  double worst_share = -1, worst_error = -1;
  for (size_t i = 0; i < n; ++i) {
    // Operands of images mix: all are inside, or none counts.
    bool inside = own ? samples.inside[i] : true;
    // Nor have derivatives all their digits where an operand or the result is a subnormal number.
    if (own && by.value[0] && !asked.exact)
      for (const Image& operand : samples.operands)
        for (size_t p = 0; p < static_cast<size_t>(operand.type.components()); ++p)
          inside = inside && !(operand.type.is_float() && is_subnormal(operand.data[p * n + i]));
    for (size_t k = 0; k < components; ++k) {
      const double result = found[i * components + k];
      Expected twins[2];
      for (size_t f = 0; f < 2; ++f) {
        twins[f].value = by.expected[f]->data[k * n + i];
        twins[f].scale = by.scale[f] ? at(by.scale[f], i, k) : 0;
        twins[f].bound = by.bound[f] ? at(by.bound[f], i, k) : row.bound;
        twins[f].except = by.except[f] && at(by.except[f], i, k) != 0;
        if (by.value[f])
          for (size_t v = 0; v < static_cast<size_t>(by.value[f]->type.components()); ++v) {
            twins[f].value_infinite = twins[f].value_infinite || !finite_float(at(by.value[f], i, v));
            twins[f].value_subnormal = twins[f].value_subnormal || is_subnormal(at(by.value[f], i, v));
          }
      }
      const Verdict v = judge_one(asked, result, inside, twins, 2);
      row.special += v.special ? 1 : 0;
      row.not_finite += v.not_finite ? 1 : 0;
      if (v.special || v.left_out) continue;
      const double error = v.not_finite ? HUGE_VAL : v.error, share = v.not_finite ? HUGE_VAL : v.share;
      const double expected = twins[v.twin].value;
      if (std::abs(expected) >= 0x1p-126 && std::isfinite(expected) && finite_float(expected) && std::isfinite(result))
        row.relative = std::max(row.relative, std::abs(result - expected) / std::abs(expected));
      else if (std::abs(expected) < 0x1p-126 && std::isfinite(result))
        row.near_zero = std::max(row.near_zero, std::abs(result - expected));
      errors.push_back(error);
      row.worst = std::max(row.worst, error);
      if (share > worst_share || (share == worst_share && error > worst_error)) {
        worst_share = share;
        worst_error = error;
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
  row.share = std::max(worst_share, 0.0);
  if (!errors.empty()) {
    const auto place = errors.begin() + static_cast<std::ptrdiff_t>((errors.size() - 1) * 999 / 1000);
    std::nth_element(errors.begin(), place, errors.end());
    row.p999 = *place;
  }
}

}  // namespace

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

std::vector<Row> measure(const runtime::Device& device, std::span<const Case> cases, const Options& options) {
  std::vector<Samples> samples;
  for (const Case& c : cases)
    samples.push_back(draw(c, options.random, options.seed + static_cast<uint64_t>(c.kind) * 1000 + c.name.size()));
  const bool native = options.float_profile == "native";
  const Graphs graphs = graphs_of(cases, samples, native);
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
  auto chosen = backend::compile_options(options.lower, "auto", "fused", {}, "auto", options.float_profile);
  if (const auto* problem = std::get_if<std::string>(&chosen)) stop(*problem);
  auto& compile_options = std::get<backend::CompileOptions>(chosen);
  compile_options.cache_folder = backend::default_cache_folder();
  auto compiled = backend::compile(graphs.device, std::get<target::Profile>(profile), compile_options);
  if (const auto* problem = std::get_if<backend::Limit>(&compiled)) stop(problem->text);
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
    const Case entry = in_profile(cases[c], native);
    Row row{
        .op = entry.name, .direction = "value", .domain = entry.domain, .scale = entry.scale_text, .why = entry.why};
    for (size_t k = 0; k < entry.operands.size(); ++k) {
      const std::string text = range(entry.operands[k]);
      if (!text.empty()) row.domain += (row.domain.empty() ? "" : "; ") + text;
    }
    row.bound = entry.bound;
    if (native && entry.native) row.promise = entry.native->text;
    Judged by{};
    both(expected, named("value", c), by.expected);
    both(judged, named("scale", c), by.scale);
    both(judged, named("bound", c), by.bound);
    both(judged, named("except", c), by.except);
    judge(row, must(program.output("values", named("value", c))), by, entry, samples[c]);
    rows.push_back(row);
    for (size_t k = 0; k < entry.derivatives.size(); ++k) {
      const Derivative d = in_profile(entry.derivatives[k], native);
      Row other{.op = entry.name,
                .direction = "d/dx" + std::to_string(d.operand + 1),
                .domain = row.domain,
                .scale = d.scale_text,
                .why = d.why,
                .bound = d.bound};
      Judged of{};
      both(expected, named("derivative", c, k), of.expected);
      both(judged, named("derivative_scale", c, k), of.scale);
      both(judged, named("derivative_bound", c, k), of.bound);
      both(judged, named("derivative_except", c, k), of.except);
      if (native && d.native) other.promise = d.native->text;
      if (expected[0].at(named("value", c)).count() == expected[0].at(named("derivative", c, k)).count())
        both(expected, named("value", c), of.value);
      judge(other, must(program.output("derivatives", named("derivative", c, k))), of, entry, samples[c]);
      rows.push_back(other);
    }
  }
  return rows;
}

}  // namespace dr::accuracy
