// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <bit>
#include <cfloat>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/ir/pins.h"
#include "compiler/reference/evaluate.h"
#include "tests/device/accuracy/errors.h"
#include "tests/device/accuracy/library_draw.h"
#include "tests/device/accuracy/library_native.h"
#include "tests/device/accuracy/library_text.h"
#include "tests/must.h"

namespace dr::accuracy::library {

namespace {

using reference::Image;
using Images = std::map<std::string, Image>;

// Functions of one program: more of them take more memory than time.
constexpr size_t kTogether = 10;
// Sizes below this count as it: what a device flushes, times up to 2^12, is below their last place.
constexpr double kLeast = 0x1p-90;
// How the condition is found: each component of the operands is changed by the smaller part of its vector's largest
// one, or all elements at once where they depend on each other. Where changes of the larger size, of random signs,
// change the result by so many times more, a decision falls otherwise close by.
constexpr double kLargeChange = 0x1p-18, kSmallChange = 0x1p-24;
constexpr double kJump = 64;
// The worst elements that the search goes on from, of each direction, and how many are looked at near each.
constexpr size_t kWorst = 64;

using benchmark::must;
using benchmark::stop;

io::Array array_of(const Image& image) {
  const auto n = static_cast<size_t>(image.count()), components = static_cast<size_t>(image.type.components());
  std::vector<double> values(image.data.size());
  for (size_t c = 0; c < components; ++c)
    for (size_t i = 0; i < n; ++i) values[i * components + c] = image.data[c * n + i];
  return must(io::Array::from_doubles(values, static_cast<int>(components), image.width, image.height, image.layers)
                  .converted(image.type.is_float()                   ? io::ElementKind::Float32
                             : image.type.is_bool()                  ? io::ElementKind::Bool
                             : image.type.scalar == ir::Scalar::Uint ? io::ElementKind::UInt32
                                                                     : io::ElementKind::Int32));
}

Image image_of(const io::Array& array, const ir::Type& type) {
  Image image = reference::zeros(type, array.width, array.height, array.layers);
  const std::vector<double> values = array.to_doubles();
  const auto n = static_cast<size_t>(array.components), count = static_cast<size_t>(array.size());
  for (size_t e = 0; e < count; ++e)
    for (size_t c = 0; c < n; ++c) image.data[c * count + e] = values[e * n + c];
  return image;
}

void give(reference::Session& session, const std::string& leaf, const Image& image) {
  if (const auto problem = session.bind(leaf, image)) stop(*problem);
}

Images run(reference::Session& session, const std::string& step, const reference::Options& options = {}) {
  auto result = session.run(step, options);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) stop(step + ": " + error->message);
  return std::move(std::get<reference::StepResult>(result).outputs);
}

double norm(const Image& image, size_t element) {
  const auto n = static_cast<size_t>(image.count());
  double sum = 0;
  for (size_t at = element; at < image.data.size(); at += n) sum = std::hypot(sum, image.data[at]);
  return sum;
}

// A worst element: its operands, drawn ones and the seed, component by component.
struct Worst {
  double error = 0;
  std::map<std::string, std::vector<double>> operands;
};

// Some functions in one program on a device, and their judge.
class Group {
 public:
  Group(const runtime::Device& device, std::span<const Function> functions, const Options& options)
      : functions_(functions),
        options_(options),
        judge_graph_(graph_of(judge_text(functions))),
        draw_graph_(graph_of(draw_text(functions))),
        device_graph_(graph_of(device_text(functions))),
        judge_(judge_graph_),
        draw_(draw_graph_),
        program_(load(device, device_graph_, options)) {}

  std::vector<Row> run_all() {
    std::vector<Row> rows;
    for (size_t k = 0; k < functions_.size(); ++k)
      for (Row& row : measure_one(k)) rows.push_back(std::move(row));
    return rows;
  }

 private:
  static runtime::Program load(const runtime::Device& device, const ir::Graph& graph, const Options& options) {
    auto profile = target::load_profile(options.profile);
    if (const auto* problem = std::get_if<std::string>(&profile)) stop(*problem);
    backend::CompileOptions compile;
    compile.cache_folder = backend::default_cache_folder();
    compile.native_floats = options.numbers == "native";
    auto compiled = backend::compile(graph, std::get<target::Profile>(profile), compile);
    if (const auto* problem = std::get_if<backend::Limit>(&compiled)) stop(problem->text);
    return must(runtime::Program::load(device, bundle::write(std::get<backend::Compiled>(compiled).bundle)));
  }

  const ir::Leaf* leaf(const ir::Graph& graph, const std::string& name) const {
    const auto index = graph.leaf_index(name);
    return index ? &graph.leaves[*index] : nullptr;
  }

  // An image of the leaf's type and extent; the draw program has leaves that the judge's does not.
  Image empty(const std::string& name) const {
    const ir::Leaf* found = leaf(judge_graph_, name);
    if (found == nullptr) found = leaf(draw_graph_, name);
    if (found == nullptr) stop("no leaf " + name);
    const auto size = [](const ir::Dim& d) { return d.evaluate({}).value_or(kSide); };
    return reference::zeros(found->type, size(found->extent.w), size(found->extent.h), size(found->extent.l));
  }

  static void put(Image& image, size_t i, const std::vector<double>& components) {
    const auto n = static_cast<size_t>(image.count());
    for (size_t c = 0; c < components.size(); ++c) image.data[c * n + i] = components[c];
  }
  static std::vector<double> get(const Image& image, size_t i) {
    const auto n = static_cast<size_t>(image.count());
    std::vector<double> components;
    for (size_t at = i; at < image.data.size(); at += n) components.push_back(image.data[at]);
    return components;
  }

  // Random operands, by name, the seed as "g".
  Images draw(size_t k, Draw& random) {
    const Function& f = functions_[k];
    Images drawn;
    const auto fill = [&](const std::string& name, const std::string& leaf_name, const auto& element) {
      Image image = empty(leaf_name);
      for (size_t i = 0; i < static_cast<size_t>(image.count()); ++i) put(image, i, element(image.type));
      drawn.emplace(name, std::move(image));
    };
    for (const Operand& o : f.operands)
      if (o.from.empty()) fill(o.name, leaf_name(k, o), [&](const ir::Type& type) { return random.element(o, type); });
    if (leaf(judge_graph_, seed_name(k)) != nullptr)
      fill("g", seed_name(k), [&](const ir::Type& type) { return random.adjoint(type, f.whole); });
    return drawn;
  }

  // Elements near the worst ones of each direction.
  Images near(size_t k, const std::vector<std::vector<Worst>>& worst, Draw& random) {
    Images drawn = draw(k, random);
    const auto n = static_cast<size_t>(kSide * kSide);
    std::vector<const Worst*> from;
    for (const auto& list : worst)
      for (size_t j = 0; j < std::min(list.size(), kWorst / std::max<size_t>(1, worst.size()) + 1); ++j)
        from.push_back(&list[j]);
    if (from.empty()) return drawn;
    for (size_t i = 0; i < n; ++i) {
      const Worst& w = *from[i % from.size()];
      for (auto& [name, image] : drawn) {
        if (image.count() != kSide * kSide) continue;
        std::vector<double> components = w.operands.at(name);
        const auto o = std::ranges::find(functions_[k].operands, name, &Operand::name);
        if (o != functions_[k].operands.end())
          for (double& x : components)
            if (random.pick(2) == 0) x = random.near(*o, image.type, x);
        put(image, i, components);
      }
    }
    return drawn;
  }

  // All operands of drawn ones, by leaf.
  Images derive(size_t k, const Images& drawn) {
    Images leaves;
    bool any = false;
    for (const Operand& o : functions_[k].operands) {
      any = any || !o.from.empty();
      if (!o.from.empty()) continue;
      const std::string name = leaf_name(k, o);
      if (leaf(draw_graph_, name) != nullptr) give(draw_, name, drawn.at(o.name));
      if (leaf(judge_graph_, name) != nullptr) leaves.emplace(name, drawn.at(o.name));
    }
    if (const auto g = drawn.find("g"); g != drawn.end()) leaves.emplace(seed_name(k), g->second);
    if (!any || !draw_graph_.step_index(step_name(k))) return leaves;
    Images made = run(draw_, step_name(k));
    for (const Operand& o : functions_[k].operands) {
      const auto found = made.find(o.name);
      if (found == made.end()) continue;
      Image image = std::move(found->second);
      if (image.type.is_float())
        for (double& x : image.data) x = static_cast<double>(static_cast<float>(x));
      leaves.emplace(leaf_name(k, o), std::move(image));
    }
    return leaves;
  }

  struct Result {
    Images expected, found;
    std::vector<Images> large, small;  // for changed operands
  };

  Result evaluate(size_t k, const Images& leaves, Draw& random) {
    Result result{};
    const std::string step = step_name(k);
    // Schedules and optimizers count from the step's runs.
    const auto runs = static_cast<int64_t>(std::exp2(random.uniform(0, 20))) - 1;
    for (const auto& [name, image] : leaves) must(program_.bind(name, array_of(image)));
    // With `only` this component is changed alone, counted through all operands.
    const auto run_judge = [&](double change, uint64_t signs, const reference::Options& given, int only = -1) {
      std::mt19937_64 sign(signs);
      int component = 0;
      for (const auto& [name, image] : leaves) {
        Image copy = image;
        if (change != 0 && image.type.is_float() && name != seed_name(k)) {
          // Of vectors relative to the largest component.
          const auto n = static_cast<size_t>(image.count());
          for (size_t i = 0; i < copy.data.size(); ++i) {
            double most = 0;
            for (size_t at = i % n; at < image.data.size(); at += n) most = std::max(most, std::abs(image.data[at]));
            const bool up = (sign() & 1) != 0;
            if (only < 0 || component + static_cast<int>(i / n) == only) copy.data[i] += most * (up ? change : -change);
          }
          component += image.type.components();
        }
        give(judge_, name, copy);
      }
      judge_.set_runs(step, runs);
      return run(judge_, step, given);
    };
    must(program_.set_runs(step, runs));
    must(program_.run(step));
    reference::Frozen frozen;
    for (const auto& raster : must(program_.rasters(step)))
      for (auto& ranks = frozen.rasters.emplace_back(); const io::Array& a : raster)
        ranks.push_back(image_of(a, ir::kInt));
    // A face is seen at the place that the device chose.
    for (const auto& [value, name] : ir::pin_names(judge_graph_))
      for (const auto& [pinned, pin] : must(program_.pins(step)))
        if (pinned == name) frozen.pins[name] = image_of(pin, judge_graph_.value(value).type);
    const reference::Options given{.frozen = frozen.rasters.empty() ? nullptr : &frozen};
    result.expected = run_judge(0, 0, given);
    bool conditioned = false;
    for (const Direction& d : functions_[k].directions) {
      conditioned = conditioned || d.metric == Metric::Conditioned;
      const std::string name = output_name(d);
      if (is_next(d)) {
        const auto o = std::find_if(functions_[k].operands.begin(), functions_[k].operands.end(),
                                    [&](const Operand& operand) { return operand.name == d.of.substr(5); });
        const std::string leaf = leaf_name(k, *o);
        result.expected[name] = judge_.leaf(leaf);
        result.found[name] = image_of(must(program_.leaf(leaf)), judge_.leaf(leaf).type);
      } else {
        result.found[name] = image_of(must(program_.output(step, name)), result.expected.at(name).type);
      }
    }
    if (!conditioned) return result;
    int components = 0;
    for (const auto& [name, image] : leaves)
      if (image.type.is_float() && name != seed_name(k)) components += image.type.components();
    const uint64_t signs = random.pick(SIZE_MAX);
    for (const double change : {kLargeChange, -kLargeChange}) result.large.push_back(run_judge(change, signs, given));
    for (int c = functions_[k].whole ? -1 : 0; c < (functions_[k].whole ? 0 : components); ++c)
      result.small.push_back(run_judge(kSmallChange, signs + 1, given, c));
    return result;
  }

  // Errors by element; -1 where there is none to take.
  std::vector<double> errors(const Function& f, const Direction& d, const Result& result, Row& row) {
    const std::string name = output_name(d);
    const Image& expected = result.expected.at(name);
    const Image& found = result.found.at(name);
    const auto n = static_cast<size_t>(expected.count()), components = static_cast<size_t>(expected.type.components());
    if (found.data.size() != expected.data.size()) stop(f.name + ": results of another size");
    const auto of = [&](const std::string& kind) {
      const auto it = result.expected.find(kind + name);
      return it == result.expected.end() ? nullptr : &it->second;
    };
    const auto at = [&](const Image* image, size_t i, size_t c) {
      const auto m = static_cast<size_t>(image->count());
      const size_t plane = static_cast<size_t>(image->type.components()) == 1 ? 0 : c;
      return image->data[plane * m + (m == n ? i : m == 1 ? 0 : i % m)];
    };
    const Image *scale = of("scale_"), *except = of("except_");
    std::vector<double> all(n, -1);
    if (d.metric == Metric::L2) {
      double difference = 0, size = 0;
      for (size_t j = 0; j < expected.data.size(); ++j) {
        if (!std::isfinite(found.data[j])) ++row.not_finite;
        difference = std::hypot(difference, found.data[j] - expected.data[j]);
        size = std::hypot(size, expected.data[j]);
      }
      return {size > 0 ? difference / size : difference};
    }
    for (size_t i = 0; i < n; ++i) {
      bool finite = true, sound = true;
      for (size_t c = 0; c < components; ++c) {
        finite = finite && std::isfinite(static_cast<float>(at(&expected, i, c)));
        sound = sound && std::isfinite(at(&found, i, c));
      }
      if (!finite) continue;  // beyond float32
      if (!sound) {
        ++row.not_finite;
        all[i] = HUGE_VAL;
        continue;
      }
      if (except != nullptr && at(except, i, 0) != 0) {
        ++row.excepted;
        continue;
      }
      const auto over = [](double error, double size) { return error == 0 ? 0 : error / std::max(size, kLeast); };
      if (d.metric == Metric::Scaled && scale->type.components() > 1) {
        all[i] = 0;
        for (size_t c = 0; c < components; ++c)
          all[i] = std::max(all[i], over(std::abs(at(&found, i, c) - at(&expected, i, c)), at(scale, i, c)));
        continue;
      }
      double error = 0;
      for (size_t c = 0; c < components; ++c) error = std::hypot(error, at(&found, i, c) - at(&expected, i, c));
      double size = norm(expected, i);
      if (d.metric == Metric::Scaled) size = at(scale, i, 0);
      if (d.metric == Metric::Conditioned) {
        const auto moved = [&](const Images& changed) {
          double sum = 0;
          for (size_t c = 0; c < components; ++c)
            sum = std::hypot(sum, at(&changed.at(name), i, c) - at(&expected, i, c));
          return sum;
        };
        double large = 0, small = 0;
        for (const Images& changed : result.large) large = std::max(large, moved(changed) / kLargeChange);
        for (const Images& changed : result.small) small += moved(changed) / kSmallChange;
        if (large > kJump * (small + size)) {
          ++row.excepted;
          continue;
        }
        size += std::max(large, small);
      }
      all[i] = over(error, size);
    }
    return all;
  }

  std::vector<Row> measure_one(size_t k) {
    const Function& f = functions_[k];
    Draw random(options_.seed * 1000 + std::hash<std::string>{}(f.name + f.part) % 1000);
    std::vector<Row> rows;
    for (const Direction& d : f.directions)
      rows.push_back({.function = f.name,
                      .part = f.part,
                      .direction = d.of == "value" || is_next(d) ? d.of : "d/d" + d.of,
                      .formula = f.value.empty() ? f.statement : f.value,
                      .domain = domain_of(f),
                      .metric = metric_of(d),
                      .why = d.why,
                      .profile = options_.numbers,
                      .except = d.except_text,
                      .worst_input = {}});
    for (size_t r = 0; r < rows.size(); ++r) set_bound(rows[r], k, f.directions[r]);
    std::vector<std::vector<double>> kept(rows.size());
    std::vector<std::vector<Worst>> worst(rows.size());
    const int rounds = f.whole ? 0 : options_.rounds;
    int batches = f.operands.empty() ? 1 : options_.batches;
    for (int batch = 0; batch < batches + rounds; ++batch) {
      const bool searching = batch >= batches;
      const Images drawn = searching ? near(k, worst, random) : draw(k, random);
      const Images leaves = derive(k, drawn);
      const Result result = evaluate(k, leaves, random);
      if (batch == 0 && f.whole) batches = enough(k, result, batches);
      for (size_t r = 0; r < rows.size(); ++r) {
        Row& row = rows[r];
        const Direction& d = f.directions[r];
        const std::vector<double> found = errors(f, d, result, row);
        for (size_t i = 0; i < found.size(); ++i) {
          if (found[i] < 0) continue;
          ++row.samples;
          if (!searching) kept[r].push_back(found[i]);
          if (found[i] > row.worst || row.worst_input.empty())
            tell(row, k, d, leaves, result, i, found[i], found.size());
        }
        if (!searching) row.drawn = row.worst;
        if (!f.whole) remember(worst[r], found, drawn);
      }
    }
    for (size_t r = 0; r < rows.size(); ++r) {
      if (kept[r].empty()) continue;
      const auto place = kept[r].begin() + static_cast<std::ptrdiff_t>((kept[r].size() - 1) * 999 / 1000);
      std::nth_element(kept[r].begin(), place, kept[r].end());
      rows[r].p999 = *place;
    }
    return rows;
  }

  // In the profile `native` as many times as large as one of the result's built-ins may be further off than our
  // function.
  void set_bound(Row& row, size_t k, const Direction& d) const {
    row.bound = d.bound;
    if (options_.numbers != "native" || d.metric == Metric::Equal) return;
    if (d.native > 0) row.bound = d.native, row.why = d.native_why;
    const ir::Step& step = device_graph_.steps.at(*device_graph_.step_index(step_name(k)));
    std::vector<ir::ValueId> roots;
    for (const ir::Update& update : step.updates)
      if (is_next(d)) roots.push_back(update.value);
    for (const ir::Output& output : step.outputs)
      if (output.name == output_name(d)) roots.push_back(output.value);
    const FurtherOff further = further_off(device_graph_, roots);
    if (further.times <= 1) return;
    char text[96];
    std::snprintf(text, sizeof text, "%.3g times %.1e (%s): ", further.times, row.bound,
                  std::string(ir::op_name(further.kind)).c_str());
    row.why = text + row.why;
    row.bound *= further.times;
  }

  // As many batches as give as many errors of the largest result as elements have, six times as many at most.
  int enough(size_t k, const Result& result, int batches) const {
    int64_t elements = 1;
    for (const Direction& d : functions_[k].directions)
      elements = std::max(elements, result.expected.at(output_name(d)).count());
    const int64_t wanted = (batches * kSide * kSide + elements - 1) / elements;
    return batches == 1 || functions_[k].operands.empty() ? 1
                                                          : static_cast<int>(std::min<int64_t>(wanted, 6 * batches));
  }

  // Where the worst error is.
  void tell(Row& row, size_t k, const Direction& d, const Images& leaves, const Result& result, size_t i, double error,
            size_t elements) {
    const Function& f = functions_[k];
    row.worst = std::max(row.worst, error);
    const std::string name = output_name(d);
    const std::vector<double> expected = get(result.expected.at(name), i), found = get(result.found.at(name), i);
    size_t most = 0;
    for (size_t c = 0; c < expected.size(); ++c)
      if (!(std::abs(found[c] - expected[c]) <= std::abs(found[most] - expected[most]))) most = c;
    row.expected = expected[most];
    row.found = found[most];
    row.worst_input.clear();
    if (f.whole) {
      row.worst_input = d.metric == Metric::L2 ? "all elements" : "element " + std::to_string(i);
      return;
    }
    for (const Operand& o : f.operands) {
      const auto leaf = leaves.find(leaf_name(k, o));
      if (leaf == leaves.end() || static_cast<size_t>(leaf->second.count()) != elements) continue;
      for (const double x : get(leaf->second, i)) {
        char text[32];
        std::snprintf(text, sizeof text, "%.0f", x);
        row.worst_input += (row.worst_input.empty() ? "" : " ") + (leaf->second.type.is_float() ? hex(x) : text);
      }
    }
  }

  void remember(std::vector<Worst>& list, const std::vector<double>& found, const Images& drawn) {
    std::vector<size_t> order;
    for (size_t i = 0; i < found.size(); ++i)
      if (found[i] > 0) order.push_back(i);
    const size_t count = std::min(order.size(), kWorst);
    std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count), order.end(),
                      [&](size_t a, size_t b) { return found[a] > found[b]; });
    for (size_t j = 0; j < count; ++j) {
      const size_t i = order[j];
      if (list.size() >= kWorst && list.back().error >= found[i]) break;
      Worst w{.error = found[i], .operands = {}};
      for (const auto& [name, image] : drawn)
        if (image.count() == kSide * kSide) w.operands[name] = get(image, i);
      const auto place = std::upper_bound(list.begin(), list.end(), w,
                                          [](const Worst& a, const Worst& b) { return a.error > b.error; });
      list.insert(place, std::move(w));
      if (list.size() > kWorst) list.pop_back();
    }
  }

  static std::string domain_of(const Function& f) {
    std::string text = f.domain;
    for (const Operand& o : f.operands) {
      if (!o.from.empty() || (o.low == 0 && o.high == 0) || o.name.ends_with('_')) continue;
      char range[96];
      std::snprintf(range, sizeof range,
                    o.least > 0 && o.low < 0 ? "%s %.4g … %.4g, sizes from %.2g" : "%s %.4g … %.4g", o.name.c_str(),
                    o.low, o.high, o.least);
      text += (text.empty() ? "" : "; ") + std::string(range);
    }
    return text;
  }

  static std::string metric_of(const Direction& d) {
    switch (d.metric) {
      case Metric::Relative: return "relative";
      case Metric::Scaled: return "over " + d.scale_text;
      case Metric::Conditioned: return "conditioned";
      case Metric::L2: return "L2";
      case Metric::Equal: return "equal";
    }
    return "";
  }

  std::span<const Function> functions_;
  Options options_;
  ir::Graph judge_graph_, draw_graph_, device_graph_;
  reference::Session judge_, draw_;
  runtime::Program program_;
};

}  // namespace

std::vector<Row> measure(const runtime::Device& device, std::span<const Function> functions, const Options& options) {
  std::vector<Row> rows;
  std::vector<Function> all(functions.begin(), functions.end());
  if (options.numbers == "native")
    for (Function& f : all)
      for (Direction& d : f.directions)
        if (!d.native_scale.empty())
          d.metric = Metric::Scaled, d.scale = d.native_scale, d.scale_text = d.native_scale_text;
  for (size_t first = 0; first < all.size(); first += kTogether) {
    Group group(device, std::span(all).subspan(first, std::min(kTogether, all.size() - first)), options);
    for (Row& row : group.run_all()) rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace dr::accuracy::library
