// SPDX-License-Identifier: Apache-2.0
// Constant folding: an element-wise op whose operands are all constants, or constants stretched to more elements, is
// one.
//   %3 = add %1, %2    with %1 = const 1, %2 = const 2    =>    %3 = const 3
// Integers and Bools always fold. Floats fold where every device computes the same bits: one correctly rounded
// operation on float32 operands, or a move. Subnormals are left to the device, which may flush them; so are NaN and Inf
// that would arise. In the float64 evaluator a folded 0.1 * 0.3 differs from the computed one by that rounding, some
// 1e-8 of it: the one way in which simplifying changes what the evaluator gives, and towards the device.
#include <algorithm>
#include <cfloat>
#include <cmath>

#include "compiler/ops/op.h"
#include "compiler/passes/simplify/simplify.h"

namespace dr::passes {

using namespace ir;

namespace {

double round_to_float(double x) { return static_cast<double>(static_cast<float>(x)); }

bool is_plain(double x) { return x == 0 || (std::isfinite(x) && std::abs(x) >= static_cast<double>(FLT_MIN)); }

}  // namespace

std::optional<ValueId> fold(Emitter& emitter, const Candidate& candidate) {
  const ops::OpInfo& info = ops::info(candidate.kind);
  if (info.shape != ops::Shape::Elementwise || !info.eval || candidate.operands.empty()) return std::nullopt;
  if (info.folds == ops::Folds::Never) return std::nullopt;
  const bool is_float = candidate.type.is_float(), rounds = is_float && info.folds == ops::Folds::Rounds;
  if (is_float && info.folds == ops::Folds::Integers) return std::nullopt;

  std::vector<std::vector<double>> operands;
  std::vector<const double*> planes;
  std::vector<Type> types;
  operands.reserve(candidate.operands.size());
  for (ValueId id : candidate.operands) {
    const std::vector<double>* constant = emitter.constant_everywhere(id);
    if (!constant) return std::nullopt;
    types.push_back(emitter.value(id).type);
    // The device has the float32 nearest to what the program says.
    std::vector<double>& components = operands.emplace_back(*constant);
    if (types.back().is_float())
      std::transform(components.begin(), components.end(), components.begin(), round_to_float);
    if (rounds && !std::all_of(components.begin(), components.end(), is_plain)) return std::nullopt;
    planes.push_back(components.data());
  }

  std::vector<double> result(static_cast<size_t>(candidate.type.components()));
  info.eval({.n = 1,
             .operands = planes,
             .operand_types = types,
             .attrs = candidate.attrs,
             .result_type = candidate.type,
             .result = result.data()});
  if (candidate.type.is_float()) {
    // A float64 sum or product of float32 operands, rounded once more, is the correctly rounded float32 one: 53 >= 2 *
    // 24 + 2.
    for (double& component : result) {
      const double exact = component;
      component = round_to_float(exact);
      if (rounds && !(is_plain(component) && (component != 0 || exact == 0))) return std::nullopt;
    }
  }
  return emitter.stretched(emitter.make_constant(candidate.type, std::move(result)), candidate.extent);
}

}  // namespace dr::passes
