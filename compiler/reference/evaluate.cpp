// SPDX-License-Identifier: Apache-2.0
// The walk over the root: ops in order, each value's image freed after its last use.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include "compiler/ir/pins.h"
#include "compiler/ir/print.h"
#include "compiler/ir/raster.h"
#include "compiler/ops/op.h"
#include "compiler/reference/evaluation.h"
#include "compiler/reference/image_ops.h"
#include "compiler/reference/raster.h"
#include "compiler/reference/region.h"
#include "compiler/reference/workers.h"
#include "compiler/topology/topology.h"

namespace dr::reference {
namespace {

using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

// Numbers in one image, beyond which an evaluation in memory is hopeless.
constexpr int64_t kMaxNumbers = int64_t{1} << 33;

class Evaluation {
 public:
  Evaluation(const ir::Graph& graph, const Given& given, const Options& options)
      : graph_(graph),
        given_(given),
        options_(options),
        workers_(options.threads),
        context_{.graph = graph,
                 .symbols = given.symbols,
                 .step_index = given.step_index,
                 .check_finite = options.check_finite,
                 .float32 = options.float32,
                 .images = std::vector<const Image*>(graph.value_count()),
                 .origins = {}},
        owned_(graph.value_count()) {
    if (context_.tracing()) context_.origins.resize(graph.value_count());
    if (options.frozen != nullptr || options.record != nullptr) pins_ = ir::pin_names(graph);
  }

  std::variant<Evaluated, EvalError> run(std::span<const ValueId> roots) {
    if (roots.empty()) return Evaluated{};
    find_last_uses(roots);
    if (options_.record != nullptr) *options_.record = {};
    for (size_t k = 0; k < ops_.size(); ++k) {
      if (auto error = run_op(graph_.op(ops_[k]))) return std::move(*error);
      if (options_.check_finite == CheckFinite::All && first_.valid()) return not_finite(first_, "");
      for (ValueId dead : dead_[k]) release(dead);
    }
    if (options_.check_finite == CheckFinite::Results) {
      if (auto error = check(roots)) return std::move(*error);
    }
    return Evaluated{results(roots), std::move(warnings_)};
  }

 private:
  void find_last_uses(std::span<const ValueId> roots) {
    const std::vector<bool> live = ir::live_ops(graph_, roots);
    for (OpId id : graph_.region(graph_.root()).ops) {
      if (live[id.index]) ops_.push_back(id);
    }
    dead_.resize(ops_.size());
    std::vector<bool> needed(graph_.value_count());
    for (ValueId root : roots) needed[root.index] = true;
    for (size_t k = ops_.size(); k-- > 0;) {
      const Op& op = graph_.op(ops_[k]);
      const auto use = [&](ValueId id) {
        if (!needed[id.index]) dead_[k].push_back(id);
        needed[id.index] = true;
      };
      for (ValueId result : op.results) use(result);
      for (ValueId operand : op.operands) use(operand);
      for (ir::RegionId region : op.regions) {
        for (ValueId captured : ir::captures(graph_, region)) use(captured);
      }
    }
  }

  std::optional<EvalError> run_op(const Op& op) {
    if (op.kind == OpKind::Leaf) {
      read_leaf(op);
      return std::nullopt;
    }
    std::vector<Image*> results;
    for (ValueId result : op.results) {
      if (auto error = allocate(op, result)) return error;
      results.push_back(&*owned_[result.index]);
    }
    if (auto error = check_dims(op)) return error;
    switch (op.kind) {
      case OpKind::Vjp:
      case OpKind::Cotangent:
      case OpKind::Grad: DR_ICE("the reference evaluator got a graph with Grad ops");
      case OpKind::Raster: return raster(op, results);
      case OpKind::If:
      case OpKind::Reduce:
      case OpKind::Fold: {
        for (size_t k = 0; k < results.size(); ++k) {
          if (op.attrs.yields[k] == ir::Yield::Scatter)
            std::fill(results[k]->data.begin(), results[k]->data.end(), 0.0);
        }
        std::vector<Origin> origins(results.size());
        note_first(run_region_op(context_, op, results, origins, workers_));
        if (context_.tracing()) {
          for (size_t k = 0; k < results.size(); ++k) context_.origins[op.results[k].index] = origins[k];
        }
        return std::nullopt;
      }
      case OpKind::Pin:
        if (auto error = pin(op, *results[0])) return error;
        break;
      case OpKind::Leaf: DR_ICE("a leaf is bound, not computed");
      case OpKind::Const:
      case OpKind::Coord:
      case OpKind::DimValue:
      case OpKind::StepIndex:
      case OpKind::Gather:
      case OpKind::ScatterAdd:
      case OpKind::ScatterMax:
      case OpKind::Shift:
      case OpKind::ReduceSum:
      case OpKind::ReduceMin:
      case OpKind::ReduceMax:
      case OpKind::Broadcast:
      case OpKind::Detach:
#define DR_OP(kind, name)
#define DR_ELEMENTWISE(kind, name) case OpKind::kind:
#include "compiler/ir/op_kinds.def"
#undef DR_OP
        run_image_op(context_, op, *results[0], workers_);
        break;
    }
    if (context_.tracing()) trace(op);
    return std::nullopt;
  }

  std::optional<EvalError> pin(const Op& op, Image& result) {
    const auto name = pins_.find(op.results[0]);
    const auto* frozen = options_.frozen;
    if (frozen != nullptr && name != pins_.end() && frozen->pins.count(name->second) != 0) {
      const Image& value = frozen->pins.at(name->second);
      if (size_of(value) != size_of(result) || value.data.size() != result.data.size())
        return EvalError{"the frozen value of '" + name->second + "' has another extent", op.span};
      result.data = value.data;
    } else {
      run_image_op(context_, op, result, workers_);
    }
    if (options_.record != nullptr && name != pins_.end()) options_.record->pins[name->second] = result;
    return std::nullopt;
  }

  void read_leaf(const Op& op) {
    const auto leaf = graph_.leaf_index(op.attrs.text);
    DR_ASSERT(leaf.has_value());
    const Image& data = *given_.leaves[*leaf];
    context_.images[op.results[0].index] = &data;
    if (graph_.leaves[*leaf].table == "closed" && data.data[0] == 0)
      warnings_.push_back({topology::not_closed(graph_.leaves[*leaf].table_of), op.span});
    if (options_.float32 && data.type.is_float()) {
      owned_[op.results[0].index] = data;
      round_to_float(owned_[op.results[0].index]->data.data(), data.data.size());
      context_.images[op.results[0].index] = &*owned_[op.results[0].index];
    }
    if (context_.tracing()) trace(op);
  }

  // Extents that only attributes name, in regions too.
  std::optional<EvalError> check_dims(const Op& op) const {
    for (const ir::Dim& dim : op.attrs.dims) {
      if (op.kind != OpKind::DimValue) {
        if (auto wrong = wrong_extent(dim))
          return EvalError{"'" + std::string(ir::op_name(op.kind)) + "' has " + *wrong, op.span};
      } else if (const std::string unknown = missing(dim); !unknown.empty()) {
        return EvalError{"'" + dim.str() + "' has no value" + unknown, op.span};
      } else if (auto why = dim.beyond_int(given_.symbols)) {
        return EvalError{std::move(*why), op.span};
      }
    }
    for (ir::RegionId region : op.regions) {
      for (OpId inner : graph_.region(region).ops) {
        if (auto error = check_dims(graph_.op(inner))) return error;
      }
    }
    return std::nullopt;
  }

  // Why an extent's value is none, if so.
  std::optional<std::string> wrong_extent(const ir::Dim& dim) const {
    const auto value = dim.evaluate(given_.symbols);
    if (!value) return "the extent '" + dim.str() + "', whose value is not known" + missing(dim);
    if (*value < 1)
      return "the extent '" + dim.str() + "', which is " + std::to_string(*value) + "; at least 1 is expected" +
             where(dim);
    if (*value > INT32_MAX)
      return "the extent '" + dim.str() + "', which is " + std::to_string(*value) + " and too large";
    return std::nullopt;
  }

  std::string where(const ir::Dim& dim) const {
    std::string out;
    for (const std::string& symbol : dim.symbols())
      out += (out.empty() ? ", where '" : ", '") + symbol + "' is " + std::to_string(given_.symbols.at(symbol));
    return out;
  }

  // Gives a value an image of its size, from a freed one if there is any that fits.
  std::optional<EvalError> allocate(const Op& op, ValueId id) {
    const ir::ValueInfo& info = graph_.value(id);
    int64_t size[3];
    int64_t numbers = info.type.components();
    const ir::Dim* const dims[3] = {&info.extent.w, &info.extent.h, &info.extent.l};
    for (size_t axis = 0; axis < 3; ++axis) {
      if (auto wrong = wrong_extent(*dims[axis])) return EvalError{name_of(id) + " has " + *wrong, op.span};
      size[axis] = dims[axis]->evaluate(given_.symbols).value();
      if (numbers > kMaxNumbers / size[axis]) {
        return EvalError{name_of(id) + " of extent " + info.extent.str() + " is too large for the reference evaluator",
                         op.span};
      }
      numbers *= size[axis];
    }
    Image image{info.type, size[0], size[1], size[2], {}};
    const auto wanted = static_cast<size_t>(numbers);
    const auto fits = std::find_if(free_.begin(), free_.end(),
                                   [&](const std::vector<double>& memory) { return memory.size() == wanted; });
    if (fits != free_.end()) {
      image.data = std::move(*fits);
      free_.erase(fits);
    } else {
      image.data.resize(wanted);
    }
    owned_[id.index] = std::move(image);
    context_.images[id.index] = &*owned_[id.index];
    return std::nullopt;
  }

  std::string missing(const ir::Dim& dim) const {
    for (const std::string& symbol : dim.symbols()) {
      if (given_.symbols.count(symbol) == 0) return ": no leaf that is bound gives '" + symbol + "' a value";
    }
    return "";
  }

  void release(ValueId id) {
    context_.images[id.index] = nullptr;
    if (!owned_[id.index]) return;
    // Memory of sizes that are not asked for again must not pile up.
    constexpr size_t kKept = 8;
    free_.insert(free_.begin(), std::move(owned_[id.index]->data));
    if (free_.size() > kKept) free_.pop_back();
    owned_[id.index].reset();
  }

  std::optional<EvalError> raster(const Op& op, const std::vector<Image*>& results) {
    const size_t k = rasters_++;
    // Orders follow from the faces.
    std::vector<Image*> decisions;
    for (size_t r = 0; r < results.size(); ++r)
      if (r % ir::results_a_rank(op.attrs) < 2) decisions.push_back(results[r]);
    if (options_.frozen != nullptr) {
      if (k >= options_.frozen->rasters.size() || options_.frozen->rasters[k].size() != decisions.size()) {
        return EvalError{"the frozen decisions do not have the results of raster " + std::to_string(k), op.span};
      }
      for (size_t r = 0; r < decisions.size(); ++r) {
        const Image& frozen = options_.frozen->rasters[k][r];
        if (size_of(frozen) != size_of(*decisions[r]) || frozen.data.size() != decisions[r]->data.size()) {
          return EvalError{"the frozen results of raster " + std::to_string(k) + " have another extent", op.span};
        }
        decisions[r]->data = frozen.data;
      }
      order_faces(context_, op, results);
    } else {
      const RasterFindings findings = run_raster(context_, op, results, workers_);
      note_first(findings.first);
      if (findings.outside > 0) warnings_.push_back(outside_hull(op, findings));
    }
    if (options_.record != nullptr) {
      std::vector<Image>& record = options_.record->rasters.emplace_back();
      for (const Image* decision : decisions) record.push_back(*decision);
    }
    return std::nullopt;
  }

  EvalError outside_hull(const Op& op, const RasterFindings& findings) const {
    const auto number = [](int64_t n) { return std::to_string(n); };
    // The line to look at is that of `keep`.
    const ir::OpId keep = graph_.value(graph_.region(op.regions[1]).yields[0]).op;
    std::string message = "'keep' holds outside the hull of the corners: for face " + number(findings.face) +
                          " at pixel (" + number(findings.x) + ", " + number(findings.y) + ", " +
                          number(findings.layer) + ")";
    if (findings.outside > 1) message += " and " + number(findings.outside - 1) + " more";
    return {message + "; a device may miss such pixels", keep.valid() ? graph_.op(keep).span : op.span, {}};
  }

  std::vector<Image> results(std::span<const ValueId> roots) {
    std::vector<Image> images;
    for (size_t k = 0; k < roots.size(); ++k) {
      auto& own = owned_[roots[k].index];
      const bool again = std::find(roots.begin() + static_cast<ptrdiff_t>(k) + 1, roots.end(), roots[k]) != roots.end();
      if (own && !again) {
        images.push_back(std::move(*own));
      } else {
        images.push_back(*context_.images[roots[k].index]);
      }
    }
    return images;
  }

  // --- finding what is not finite ---

  void note_first(const Origin& origin) {
    if (!first_.valid()) first_ = origin;
  }

  // Notes where the NaN or Inf of an op's result comes from.
  void trace(const Op& op) {
    const Image& result = *context_.images[op.results[0].index];
    const size_t count = size_of(result).count();
    const size_t bad = first_not_finite(result.data.data(), components(result.type), count);
    if (bad == count) return;
    Origin& origin = context_.origins[op.results[0].index];
    const Places place = places_of_range(size_of(result), bad, 1);
    const bool elementwise = ops::info(op.kind).shape == ops::Shape::Elementwise;
    for (ValueId operand : op.operands) {
      const Origin& before = context_.origins[operand.index];
      if (!before.valid()) continue;
      if (elementwise) {
        const Image& image = *context_.images[operand.index];
        std::vector<double> element(components(image.type));
        const double* values = fetch_range(image, size_of(result), bad, 1, element.data());
        if (first_not_finite(values, element.size(), 1) == 1) continue;
      }
      origin = before;
      return;
    }
    origin = {.op = context_.graph.value(op.results[0]).op, .x = place.x[0], .y = place.y[0], .l = place.l[0]};
    if (elementwise) {
      std::vector<std::vector<double>> operands;
      for (ValueId operand : op.operands) {
        const Image& image = *context_.images[operand.index];
        std::vector<double>& element = operands.emplace_back(components(image.type));
        const double* values = fetch_range(image, size_of(result), bad, 1, element.data());
        if (values != element.data()) std::copy_n(values, element.size(), element.data());
      }
      origin.operands = std::make_shared<const std::vector<std::vector<double>>>(std::move(operands));
    }
    note_first(origin);
  }

  std::optional<EvalError> check(std::span<const ValueId> roots) const {
    const Origin* first = nullptr;
    for (ValueId root : roots) {
      const Origin& origin = context_.origins[root.index];
      if (origin.valid() && (first == nullptr || origin.op < first->op)) first = &origin;
    }
    if (first == nullptr) return std::nullopt;
    return not_finite(*first, ", and it reaches a result");
  }

  EvalError not_finite(const Origin& origin, const std::string& consequence) const {
    const Op& op = graph_.op(origin.op);
    const std::string place =
        "(" + std::to_string(origin.x) + ", " + std::to_string(origin.y) + ", " + std::to_string(origin.l) + ")";
    std::string message;
    if (op.kind == OpKind::Leaf) {
      message = describe(graph_.leaves[*graph_.leaf_index(op.attrs.text)]) + " holds a NaN or Inf at element " + place;
    } else if (op.kind == OpKind::Const) {
      message = "the constant " + name_of(op.results[0]) + " is NaN or Inf";
    } else {
      message = "'" + std::string(ir::op_name(op.kind)) +
                "' makes a NaN or Inf of finite operands: " + name_of(op.results[0]) + " at element " + place;
    }
    EvalError error{message + consequence, op.span, {}};
    for (size_t k = 0; origin.operands != nullptr && k < origin.operands->size(); ++k) {
      const std::vector<double>& values = (*origin.operands)[k];
      if (!values.empty()) error.notes.push_back("operand " + name_of(op.operands[k]) + " is " + numbers(values));
    }
    return error;
  }

  static std::string numbers(const std::vector<double>& values) {
    std::string text;
    for (const double value : values) {
      char digits[32];
      const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
      text += (text.empty() ? "" : ", ") + std::string(digits, end);
    }
    return values.size() == 1 ? text : "(" + text + ")";
  }

  // The user's name of a value, or its number in the text form.
  std::string name_of(ValueId id) const {
    const std::string& name = graph_.value(id).name;
    if (!name.empty()) return "'" + name + "'";
    return "%" + std::to_string(ir::print_numbers(graph_)[id.index]);
  }

  const ir::Graph& graph_;
  const Given& given_;
  const Options& options_;
  Workers workers_;
  Context context_;
  std::vector<OpId> ops_;
  std::vector<std::vector<ValueId>> dead_;  // by position in ops_: values whose last use this is
  std::vector<std::optional<Image>> owned_;
  std::vector<std::vector<double>> free_;
  std::map<ValueId, std::string> pins_;
  std::vector<EvalError> warnings_;
  Origin first_;  // when tracing
  size_t rasters_ = 0;
};

}  // namespace

std::variant<Evaluated, EvalError> evaluate_values(const ir::Graph& graph, std::span<const ValueId> values,
                                                   const Given& given, const Options& options) {
  return Evaluation(graph, given, options).run(values);
}

}  // namespace dr::reference
