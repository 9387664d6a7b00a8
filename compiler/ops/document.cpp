// SPDX-License-Identifier: Apache-2.0
// docs/reference/ops.md. Types come from the type rules themselves, which are asked about scalars, vectors and
// matrices.
#include "compiler/ops/document.h"

#include <array>
#include <charconv>
#include <utility>

#include "compiler/ops/families.h"

namespace dr::ops {
namespace {

using ir::Scalar;
using ir::Type;

constexpr std::string_view kIntroduction =
    R"(# The ops

What a graph is made of, one entry an op under `compiler/ops/`; `drc doc --ops` prints this. Names are those of the graph's text
form; vectors and matrices are shown with three components a column, others go alike. `T` is the type of the last operand, `boolT` a
bool or vector of bools of its size. *Gradient* says whether derivatives pass; where they do not, they are 0. *Random* are the ranges
that tests draw operands from, *singular* operands that they look at besides, where the value is defined and the gradient finite.
*Distance* is what the shader's result may be off from float64, in units of the last place.
)";

std::string number(double value) {
  std::array<char, 40> digits{};
  return {digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr};
}

std::string join(std::string list, const std::string& item, std::string_view separator = ", ") {
  if (!list.empty()) list += separator;
  return list + item;
}

const std::array<Type, 9>& probes() {
  static const std::array<Type, 9> kTypes = {Type{Scalar::Float, 1, 1}, {Scalar::Float, 3, 1}, {Scalar::Float, 3, 3},
                                             {Scalar::Int, 1, 1},       {Scalar::Int, 3, 1},   {Scalar::Uint, 1, 1},
                                             {Scalar::Uint, 3, 1},      {Scalar::Bool, 1, 1},  {Scalar::Bool, 3, 1}};
  return kTypes;
}

// A type beside the last operand's.
std::string relative(const Type& type, const Type& last) {
  if (type == last) return "T";
  if (type.is_bool() && type.rows == last.rows && type.cols == last.cols) return "boolT";
  return type.str();
}

// `(T, T) → T for float, vec3`, a line for each form that the rule takes.
class Signatures {
 public:
  explicit Signatures(const OpInfo& info) : info_(info) {
    for (size_t count = 1; count <= 3 && forms_.empty(); ++count) probe(count);
  }

  std::string text() const {
    std::string out;
    for (const auto& [form, types] : forms_) out = join(out, "`" + form + "` for " + types, "<br>");
    return out.empty() ? "see the text" : out;
  }

 private:
  void probe(size_t count) {
    if (operands_.size() < count) {
      for (const Type& type : probes()) {
        operands_.push_back({type, {}});
        probe(count);
        operands_.pop_back();
      }
      return;
    }
    const ir::Attrs none;
    const InferResult result = info_.infer({operands_, none});
    const auto* types = std::get_if<std::vector<ir::ResultType>>(&result);
    if (types == nullptr) return;
    const Type last = operands_.back().type;
    std::string form;
    for (const ir::ResultType& operand : operands_) form = join(form, relative(operand.type, last));
    form = "(" + form + ") → " + relative(types->front().type, last);
    for (auto& [known, list] : forms_) {
      if (known == form) {
        list = join(list, last.str());
        return;
      }
    }
    forms_.emplace_back(form, last.str());
  }

  const OpInfo& info_;
  std::vector<ir::ResultType> operands_;
  std::vector<std::pair<std::string, std::string>> forms_;
};

std::string domains(const OpInfo& info) {
  std::string out;
  for (const Domain& domain : info.domains) out = join(out, number(domain.low) + " to " + number(domain.high));
  return out;
}

std::string singular(const OpInfo& info) {
  std::string out;
  for (const TestPoint& point : info.singular) {
    std::string operands;
    for (const double operand : point.operands) operands = join(operands, number(operand));
    out = join(out, "(" + operands + ")");
  }
  return out;
}

// `|` ends a cell of a table.
std::string cell(std::string_view text) {
  std::string out;
  for (const char c : text) out += c == '|' ? std::string("\\|") : std::string(1, c);
  return out;
}

std::string row(const OpInfo& info) {
  const bool elementwise = info.shape == Shape::Elementwise;
  std::string out = "| `" + std::string(ir::op_name(info.kind)) + "` | " + cell(info.doc) + " | ";
  if (elementwise && info.infer != nullptr) out += Signatures(info).text();
  out += " | ";
  if (elementwise || info.shape == Shape::Image) out += info.differentiable ? "yes" : "no";
  out += " | " + domains(info) + " | " + singular(info) + " | ";
  if (elementwise && info.differentiable) out += number(info.ulp_bound);
  return out + " |\n";
}

}  // namespace

std::string document_ops() {
  std::string out(kIntroduction), functions;
  for (const Family& family : families())
    for (const OpInfo& entry : family.entries())
      if (entry.is_function) functions = join(functions, std::string(ir::op_name(entry.kind)), " ");
  out += "\nPrograms call these by their names, with floats or vectors of them: `" + functions + "`.\n";
  for (const Family& family : families()) {
    out += "\n## " + std::string(family.title) +
           "\n\n| op | meaning | types | gradient | random | singular | distance |\n" +
           "| --- | --- | --- | --- | --- | --- | --- |\n";
    for (const OpInfo& entry : family.entries()) out += row(entry);
  }
  return out;
}

}  // namespace dr::ops
