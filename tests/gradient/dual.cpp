// SPDX-License-Identifier: Apache-2.0
#include "tests/gradient/dual.h"

#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "compiler/ir/yields.h"

namespace dr::gradient_test {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::Type;
using ir::ValueId;
using ir::Yield;

namespace {

struct Place {
  int64_t x = 0, y = 0, l = 0;
};

// What a name in a region stands for: an element, or for an accumulation what it scatters so far.
struct Bound {
  Element element;
  std::vector<std::pair<Element, Element>> scattered;  // (index, value)
};
using Environment = std::map<ValueId, Bound>;

double wrap(double x) { return static_cast<double>(static_cast<int32_t>(static_cast<int64_t>(x))); }

double erf_slope(double x) { return 2 / std::sqrt(std::numbers::pi) * std::exp(-x * x); }

Number product(Number a, Number b) { return {a.value * b.value, a.tangent * b.value + a.value * b.tangent}; }
double strong(double g, double x) { return g == 0 ? 0 : g * x; }

// A function of one float: its value and slope.
std::optional<Number> unary(OpKind kind, double x) {
  const double e = std::exp(x);
  switch (kind) {
    case OpKind::Neg: return Number{-x, -1};
    case OpKind::Abs: return Number{std::abs(x), x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0};
    case OpKind::Sign: return Number{x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0, 0};
    case OpKind::Floor: return Number{std::floor(x), 0};
    case OpKind::Sqrt: return Number{std::sqrt(x), 0.5 / std::sqrt(x)};
    case OpKind::InverseSqrt: return Number{1 / std::sqrt(x), -0.5 / (x * std::sqrt(x))};
    case OpKind::Exp: return Number{e, e};
    case OpKind::Exp2: return Number{std::exp2(x), std::exp2(x) * std::numbers::ln2};
    case OpKind::Expm1: return Number{std::expm1(x), e};
    case OpKind::Log: return Number{std::log(x), 1 / x};
    case OpKind::Log2: return Number{std::log2(x), 1 / (x * std::numbers::ln2)};
    case OpKind::Log1p: return Number{std::log1p(x), 1 / (1 + x)};
    case OpKind::Sin: return Number{std::sin(x), std::cos(x)};
    case OpKind::Cos: return Number{std::cos(x), -std::sin(x)};
    case OpKind::Atan: return Number{std::atan(x), 1 / (1 + x * x)};
    case OpKind::Sinh: return Number{std::sinh(x), std::cosh(x)};
    case OpKind::Cosh: return Number{std::cosh(x), std::sinh(x)};
    case OpKind::Tanh: return Number{std::tanh(x), 1 / (std::cosh(x) * std::cosh(x))};
    case OpKind::Asinh: return Number{std::asinh(x), 1 / std::hypot(1.0, x)};
    case OpKind::Acosh: return Number{std::acosh(x), 1 / std::sqrt(x * x - 1)};
    case OpKind::Atanh: return Number{std::atanh(x), 1 / (1 - x * x)};
    case OpKind::Sigmoid: return Number{1 / (1 + std::exp(-x)), 1 / ((1 + std::exp(-x)) * (1 + e))};
    case OpKind::Softplus: return Number{std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x))), 1 / (1 + std::exp(-x))};
    case OpKind::Erf: return Number{std::erf(x), erf_slope(x)};
    case OpKind::Pin: return Number{x, 1};
    case OpKind::Detach: return Number{x, 0};
    default: return std::nullopt;
  }
}

// A function of two floats or integers.
std::optional<Number> binary(OpKind kind, Type type, Number a, Number b) {
  const double x = a.value, y = b.value;
  if (type.is_integer()) {
    switch (kind) {
      case OpKind::Add: return Number{wrap(x + y), 0};
      case OpKind::Sub: return Number{wrap(x - y), 0};
      case OpKind::Mul: return Number{wrap(x * y), 0};
      case OpKind::Div: return Number{y == 0 ? 0 : std::trunc(x / y), 0};
      case OpKind::Mod: return Number{y == 0 ? 0 : x - y * std::floor(x / y), 0};
      case OpKind::Min: return Number{std::min(x, y), 0};
      case OpKind::Max: return Number{std::max(x, y), 0};
      default: break;
    }
  }
  const double tie = 0.5 * (a.tangent + b.tangent);
  switch (kind) {
    case OpKind::Add: return Number{x + y, a.tangent + b.tangent};
    case OpKind::Sub: return Number{x - y, a.tangent - b.tangent};
    case OpKind::Mul: return product(a, b);
    case OpKind::SMul: return Number{strong(x, y), strong(a.tangent, y) + strong(x, b.tangent)};
    case OpKind::Div: return Number{x / y, a.tangent / y - x / y * b.tangent / y};
    case OpKind::Min: return Number{std::min(x, y), x < y ? a.tangent : y < x ? b.tangent : tie};
    case OpKind::Max: return Number{std::max(x, y), x > y ? a.tangent : y > x ? b.tangent : tie};
    case OpKind::Atan2: return Number{std::atan2(x, y), (a.tangent * y - b.tangent * x) / (x * x + y * y)};
    case OpKind::Less: return Number{x < y ? 1.0 : 0.0, 0};
    case OpKind::LessEqual: return Number{x <= y ? 1.0 : 0.0, 0};
    case OpKind::Equal: return Number{x == y ? 1.0 : 0.0, 0};
    case OpKind::NotEqual: return Number{x != y ? 1.0 : 0.0, 0};
    case OpKind::LogicalAnd: return Number{x != 0 && y != 0 ? 1.0 : 0.0, 0};
    case OpKind::LogicalOr: return Number{x != 0 || y != 0 ? 1.0 : 0.0, 0};
    default: return std::nullopt;
  }
}

class Evaluator {
 public:
  Evaluator(const Graph& graph, const std::map<std::string, LeafData>& leaves)
      : graph_(graph), leaves_(leaves), images_(graph.value_count()) {}

  std::vector<DualImage> run() {
    for (const OpId id : graph_.region(graph_.root()).ops) {
      const Op& op = graph_.op(id);
      for (const ValueId result : op.results) images_[result.index] = blank(graph_.value(result));
      root_op(op);
    }
    return std::move(images_);
  }

 private:
  static DualImage blank(const ir::ValueInfo& info) {
    DualImage image{info.extent.w.constant(), info.extent.h.constant(), info.extent.l.constant(), {}};
    image.elements.assign(static_cast<size_t>(image.width * image.height * image.layers),
                          Element(static_cast<size_t>(info.type.components())));
    return image;
  }

  static Element& at(DualImage& image, Place p) {
    return image.elements[static_cast<size_t>((p.l * image.height + p.y) * image.width + p.x)];
  }
  // The element at a place of a larger extent.
  static const Element& stretched(const DualImage& image, Place p) {
    const Place q{image.width == 1 ? 0 : p.x, image.height == 1 ? 0 : p.y, image.layers == 1 ? 0 : p.l};
    return at(const_cast<DualImage&>(image), q);
  }

  template <class F>
  static void each(int64_t w, int64_t h, int64_t l, const F& visit) {
    for (Place p; p.l < l; ++p.l) {
      for (p.y = 0; p.y < h; ++p.y) {
        for (p.x = 0; p.x < w; ++p.x) visit(p);
      }
    }
  }
  template <class F>
  static void each(const DualImage& image, const F& visit) {
    each(image.width, image.height, image.layers, visit);
  }

  // Where an index points, from the element at `here`; nothing when that is outside.
  static std::optional<Place> target(const DualImage& image, const Element& index, Place here) {
    const auto integer = [&](size_t k) { return static_cast<int64_t>(index[k].value); };
    Place p{integer(0), index.size() > 1 ? integer(1) : 0, 0};
    p.l = index.size() > 2 ? integer(2) : image.layers == 1 ? 0 : here.l;
    const bool inside =
        p.x >= 0 && p.x < image.width && p.y >= 0 && p.y < image.height && p.l >= 0 && p.l < image.layers;
    return inside ? std::optional(p) : std::nullopt;
  }

  static void add_to(Element& sum, const Element& term) {
    for (size_t c = 0; c < sum.size(); ++c) {
      sum[c].value += term[c].value;
      sum[c].tangent += term[c].tangent;
    }
  }

  void root_op(const Op& op) {
    if (ir::combines_yields(op.kind)) return region_op(op);
    DualImage& result = images_[op.results[0].index];
    const auto operand = [&](size_t k) -> const DualImage& { return images_[op.operands[k].index]; };
    switch (op.kind) {
      case OpKind::Leaf: return read_leaf(op, result);
      case OpKind::Coord: each(result, [&](Place p) { at(result, p)[0].value = coordinate(op, p); }); return;
      case OpKind::Gather:
        each(result, [&](Place p) {
          if (const auto q = target(operand(0), stretched(operand(1), p), p)) at(result, p) = stretched(operand(0), *q);
        });
        return;
      case OpKind::ScatterAdd: {
        const DualImage &i = operand(0), &v = operand(1);
        each(std::max(i.width, v.width), std::max(i.height, v.height), std::max(i.layers, v.layers), [&](Place p) {
          if (const auto q = target(result, stretched(i, p), p)) add_to(at(result, *q), stretched(v, p));
        });
        return;
      }
      case OpKind::Shift:
        each(result, [&](Place p) {
          const Place q{p.x + op.attrs.ints[0], p.y + op.attrs.ints[1], p.l};
          if (q.x >= 0 && q.x < result.width && q.y >= 0 && q.y < result.height)
            at(result, p) = stretched(operand(0), q);
        });
        return;
      case OpKind::Broadcast: each(result, [&](Place p) { at(result, p) = stretched(operand(0), p); }); return;
      case OpKind::ReduceSum:
        each(operand(0), [&](Place p) { add_to(at(result, image_place(result, p)), stretched(operand(0), p)); });
        return;
      case OpKind::ReduceMin: reduce_extreme(op, 1); return;
      case OpKind::ReduceMax: reduce_extreme(op, -1); return;
      default:
        each(result, [&](Place p) {
          std::vector<const Element*> operands;
          for (const ValueId id : op.operands) operands.push_back(&stretched(images_[id.index], p));
          at(result, p) = apply(op, operands);
        });
    }
  }

  static double coordinate(const Op& op, Place p) {
    const int64_t axis = op.attrs.ints[0];
    if (op.attrs.dims[static_cast<size_t>(axis)].is_one()) return 0;
    return static_cast<double>(axis == 0 ? p.x : axis == 1 ? p.y : p.l);
  }

  static Place image_place(const DualImage& image, Place p) {
    return {image.width == 1 ? 0 : p.x, image.height == 1 ? 0 : p.y, image.layers == 1 ? 0 : p.l};
  }

  void reduce_extreme(const Op& op, double sign) {
    DualImage& result = images_[op.results[0].index];
    const DualImage& x = images_[op.operands[0].index];
    for (Element& e : result.elements) {
      for (Number& n : e) n.value = sign * std::numeric_limits<double>::infinity();
    }
    each(x, [&](Place p) {
      Element& best = at(result, image_place(result, p));
      const Element& here = stretched(x, p);
      for (size_t c = 0; c < best.size(); ++c)
        if (sign * here[c].value < sign * best[c].value) best[c].value = here[c].value;
    });
    // Those that are as small, or as large, share the derivative.
    DualImage counts = result;
    for (Element& e : counts.elements)
      for (Number& n : e) n.value = 0;
    each(x, [&](Place p) {
      Element &best = at(result, image_place(result, p)), &count = at(counts, image_place(result, p));
      const Element& here = stretched(x, p);
      for (size_t c = 0; c < best.size(); ++c) {
        if (here[c].value != best[c].value) continue;
        count[c].value += 1;
        best[c].tangent += here[c].tangent;
      }
    });
    for (size_t i = 0; i < result.elements.size(); ++i)
      for (size_t c = 0; c < result.elements[i].size(); ++c)
        if (counts.elements[i][c].value > 1) result.elements[i][c].tangent /= counts.elements[i][c].value;
  }

  void read_leaf(const Op& op, DualImage& result) {
    const LeafData& data = leaves_.at(op.attrs.text);
    each(result, [&](Place p) {
      Element& e = at(result, p);
      for (size_t c = 0; c < e.size(); ++c) {
        e[c].value = data.value.at(p.x, p.y, p.l, static_cast<int>(c));
        if (!data.tangent.data.empty()) e[c].tangent = data.tangent.at(p.x, p.y, p.l, static_cast<int>(c));
      }
    });
  }

  // An element-wise op on one element.
  Element apply(const Op& op, const std::vector<const Element*>& operands) const {
    const Type type = graph_.value(op.results[0]).type;
    const Type operand_type = op.operands.empty() ? type : graph_.value(op.operands[0]).type;
    Element result(static_cast<size_t>(type.components()));
    const auto component = [&](size_t k, size_t c) {
      const Element& e = *operands[k];
      return e[e.size() == 1 ? 0 : c];
    };
    for (size_t c = 0; c < result.size(); ++c) {
      std::optional<Number> n;
      switch (op.kind) {
        case OpKind::Const: n = Number{op.attrs.floats[c], 0}; break;
        case OpKind::DimValue: n = Number{static_cast<double>(op.attrs.dims[0].constant()), 0}; break;
        case OpKind::StepIndex: n = Number{0, 0}; break;
        case OpKind::Splat: n = component(0, 0); break;
        case OpKind::Extract: {
          const auto k = static_cast<size_t>(op.attrs.ints[0]);
          n = (*operands[0])[k * result.size() + c];
          break;
        }
        case OpKind::Compose: {
          const size_t size = operands[0]->size();
          n = (*operands[c / size])[c % size];
          break;
        }
        case OpKind::Select: n = component(0, c).value != 0 ? component(1, c) : component(2, c); break;
        case OpKind::Clamp: {
          const Number x = component(0, c), low = component(1, c), high = component(2, c);
          n = x.value < low.value ? low : x.value > high.value ? high : x;
          break;
        }
        case OpKind::LogicalNot: n = Number{component(0, c).value != 0 ? 0.0 : 1.0, 0}; break;
        case OpKind::Convert: {
          const Number x = component(0, c);
          if (type.is_float())
            n = operand_type.is_float() ? x : Number{x.value, 0};
          else if (type.is_bool())
            n = Number{x.value != 0 ? 1.0 : 0.0, 0};
          else
            n = Number{std::trunc(x.value), 0};
          break;
        }
        case OpKind::Dot: {
          Number sum;
          for (size_t k = 0; k < operands[0]->size(); ++k) {
            const Number term = product((*operands[0])[k], (*operands[1])[k]);
            sum = {sum.value + term.value, sum.tangent + term.tangent};
          }
          n = sum;
          break;
        }
        case OpKind::Length:
        case OpKind::Normalize: {
          double squares = 0, along = 0;
          for (const Number& x : *operands[0]) {
            squares += x.value * x.value;
            along += x.value * x.tangent;
          }
          const double length = std::sqrt(squares);
          const Number whole{length, length > 0 ? along / length : 0};
          if (op.kind == OpKind::Length)
            n = whole;
          else if (length > 0)
            n = binary(OpKind::Div, ir::kFloat, (*operands[0])[c], whole);
          else
            n = Number{0, 0};
          break;
        }
        default:
          if (operands.size() == 1 && operand_type.is_float()) {
            const Number x = component(0, c);
            n = unary(op.kind, x.value);
            // A constant has no tangent even where the slope is infinite.
            if (n) n->tangent = strong(x.tangent, n->tangent);
          } else if (operands.size() == 1 && op.kind == OpKind::Neg) {
            n = Number{wrap(-component(0, c).value), 0};
          } else if (operands.size() == 1 && op.kind == OpKind::Abs) {
            n = Number{wrap(std::abs(component(0, c).value)), 0};
          } else if (operands.size() == 2) {
            n = binary(op.kind, operand_type, component(0, c), component(1, c));
          }
      }
      if (!n) throw std::runtime_error("no tangent of op " + std::string(ir::op_name(op.kind)));
      result[c] = *n;
    }
    return result;
  }

  // --- regions ---

  void region_op(const Op& op) {
    const auto size = [&](size_t k) { return op.attrs.dims[k].constant(); };
    each(size(0), size(1), size(2), [&](Place p) {
      Environment environment;
      const std::vector<Bound> results = inner_op(op, environment, p);
      for (size_t k = 0; k < results.size(); ++k) {
        DualImage& image = images_[op.results[k].index];
        if (op.attrs.yields[k] != Yield::Scatter) {
          at(image, p) = results[k].element;
          continue;
        }
        for (const auto& [index, value] : results[k].scattered) {
          if (const auto q = target(image, index, p)) add_to(at(image, *q), value);
        }
      }
    });
  }

  const Element& lookup(ValueId id, const Environment& environment, Place here) const {
    const auto found = environment.find(id);
    return found != environment.end() ? found->second.element : stretched(images_[id.index], here);
  }

  // What the region yields for each result of its op.
  std::vector<Bound> run_region(const Op& op, RegionId region, Environment& environment, Place here) {
    run_ops(region, environment, here);
    return take_yields(op, region, environment, here);
  }

  void run_ops(RegionId region, Environment& environment, Place here) {
    for (const OpId id : graph_.region(region).ops) {
      const Op& inner = graph_.op(id);
      if (ir::combines_yields(inner.kind)) {
        std::vector<Bound> results = inner_op(inner, environment, here);
        for (size_t k = 0; k < results.size(); ++k) environment[inner.results[k]] = std::move(results[k]);
      } else if (inner.kind == OpKind::Gather) {
        const DualImage& image = images_[inner.operands[0].index];
        const auto q = target(image, lookup(inner.operands[1], environment, here), here);
        const auto components = static_cast<size_t>(graph_.value(inner.results[0]).type.components());
        environment[inner.results[0]].element = q ? stretched(image, *q) : Element(components);
      } else if (inner.kind == OpKind::Coord) {
        environment[inner.results[0]].element = {{coordinate(inner, here), 0}};
      } else {
        std::vector<const Element*> operands;
        for (const ValueId operand : inner.operands) operands.push_back(&lookup(operand, environment, here));
        Element element = apply(inner, operands);
        environment[inner.results[0]].element = std::move(element);
      }
    }
  }

  std::vector<Bound> take_yields(const Op& op, RegionId region, const Environment& environment, Place here) {
    std::vector<Bound> results;
    const std::vector<ValueId>& yields = graph_.region(region).yields;
    size_t next = op.kind == OpKind::Fold && ir::fold_sweeps(op) == 1 && ir::fold_stops(op) ? 1 : 0;
    for (const Yield how : op.attrs.yields) {
      if (how != Yield::Scatter) {
        results.push_back({lookup(yields[next++], environment, here), {}});
      } else if (graph_.value(yields[next]).accumulation) {
        results.push_back({{}, environment.at(yields[next++]).scattered});
      } else {
        const Element& index = lookup(yields[next++], environment, here);
        results.push_back({{}, {{index, lookup(yields[next++], environment, here)}}});
      }
    }
    return results;
  }

  // All states of all trips are kept.
  std::vector<Bound> fold_op(const Op& op, Environment& environment, Place here) {
    const double begin = lookup(op.operands[0], environment, here)[0].value;
    const double end = lookup(op.operands[1], environment, here)[0].value;
    const size_t sweeps = ir::fold_sweeps(op);
    std::vector<std::vector<std::vector<Element>>> kept(sweeps);  // by sweep, trip, state
    std::vector<Bound> results(op.results.size());
    for (size_t k = 0; k < results.size(); ++k)
      results[k].element.assign(static_cast<size_t>(graph_.value(op.results[k]).type.components()), {0, 0});
    size_t trips = SIZE_MAX;
    for (size_t sweep = 0; sweep < sweeps; ++sweep) {
      std::vector<Element> now;
      for (const ValueId start : ir::fold_starts(op, sweep)) now.push_back(lookup(start, environment, here));
      kept[sweep].resize(sweep == 0 ? 0 : trips);
      const RegionId region = op.regions[sweep];
      for (size_t done = 0; done < trips; ++done) {
        if (sweep == 0) {
          const bool bounded =
              ir::fold_bound(op) >= 0 && static_cast<double>(done) >= static_cast<double>(ir::fold_bound(op));
          if (bounded || begin + static_cast<double>(done) >= end) {
            trips = done;
            break;
          }
          kept[0].emplace_back();
        }
        const size_t trip = sweep % 2 == 0 ? done : trips - 1 - done;
        kept[sweep][trip] = now;
        environment[graph_.region(region).params[0]].element = {{begin + static_cast<double>(trip), 0}};
        for (size_t of = 0; of <= sweep; ++of) {
          const std::span<const ValueId> params = ir::fold_params(graph_, op, sweep, of);
          for (size_t k = 0; k < params.size(); ++k) environment[params[k]].element = kept[of][trip][k];
        }
        run_ops(region, environment, here);
        const std::span<const ValueId> next = ir::fold_next(graph_, op, sweep);
        std::vector<Element> after;
        for (const ValueId v : next) after.push_back(lookup(v, environment, here));
        now = std::move(after);
        if (sweep + 1 == sweeps) {
          const std::vector<Bound> yields = take_yields(op, region, environment, here);
          for (size_t k = now.size(); k < results.size(); ++k) {
            if (op.attrs.yields[k] == Yield::Sum) add_to(results[k].element, yields[k].element);
            results[k].scattered.insert(results[k].scattered.end(), yields[k].scattered.begin(),
                                        yields[k].scattered.end());
          }
        }
        const ValueId stop = ir::fold_stop(graph_, op);
        if (sweep == 0 && stop.valid() && lookup(stop, environment, here)[0].value != 0) trips = done + 1;
      }
      if (sweep + 1 == sweeps)
        for (size_t k = 0; k < now.size(); ++k) results[k].element = now[k];
    }
    return results;
  }

  std::vector<Bound> inner_op(const Op& op, Environment& environment, Place here) {
    if (op.kind == OpKind::Fold) return fold_op(op, environment, here);
    if (op.kind == OpKind::If) {
      const bool condition = lookup(op.operands[0], environment, here)[0].value != 0;
      return run_region(op, op.regions[condition ? 0 : 1], environment, here);
    }
    const double begin = lookup(op.operands[0], environment, here)[0].value;
    const double end = lookup(op.operands[1], environment, here)[0].value;
    const double infinity = std::numeric_limits<double>::infinity();
    std::vector<Bound> results(op.results.size());
    std::vector<double> best(op.results.size(), infinity);  // of ArgMin
    for (size_t k = 0; k < results.size(); ++k) {
      const Yield how = op.attrs.yields[k];
      const double start = how == Yield::Min      ? infinity
                           : how == Yield::Max    ? -infinity
                           : how == Yield::ArgMin ? begin - 1
                                                  : 0;
      results[k].element.assign(static_cast<size_t>(graph_.value(op.results[k]).type.components()), {start, 0});
    }
    for (int64_t turn = 0; begin + static_cast<double>(turn) < end; ++turn) {
      const double i = begin + static_cast<double>(turn);
      environment[graph_.region(op.regions[0]).params[0]].element = {{i, 0}};
      const std::vector<Bound> trip = run_region(op, op.regions[0], environment, here);
      for (size_t k = 0; k < results.size(); ++k) {
        Element& sum = results[k].element;
        const Element& e = trip[k].element;
        switch (op.attrs.yields[k]) {
          case Yield::Sum: add_to(sum, e); break;
          case Yield::Min:
          case Yield::Max: {
            const double sign = op.attrs.yields[k] == Yield::Min ? 1 : -1;
            for (size_t c = 0; c < e.size(); ++c) {
              if (sign * e[c].value < sign * sum[c].value) sum[c] = e[c];
            }
            break;
          }
          case Yield::ArgMin:
            if (e[0].value < best[k]) {
              best[k] = e[0].value;
              sum[0].value = i;
            }
            break;
          case Yield::Scatter:
            results[k].scattered.insert(results[k].scattered.end(), trip[k].scattered.begin(), trip[k].scattered.end());
            break;
          case Yield::Element: throw std::runtime_error("an element yield in a reduce");
        }
      }
    }
    return results;
  }

  const Graph& graph_;
  const std::map<std::string, LeafData>& leaves_;
  std::vector<DualImage> images_;
};

}  // namespace

std::vector<DualImage> evaluate_dual(const Graph& graph, const std::map<std::string, LeafData>& leaves) {
  return Evaluator(graph, leaves).run();
}

}  // namespace dr::gradient_test
