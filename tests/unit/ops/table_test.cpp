// SPDX-License-Identifier: Apache-2.0
// The op table has everything about every op, and its parts fit together.
#include <algorithm>
#include <set>
#include <string>

#include "tests/catch.h"
#include "tests/unit/ops/support.h"

using namespace dr;
using namespace dr::ops_test;
using ops::OpInfo;
using ops::Shape;

TEST_CASE("every op has an entry of its own") {
  for (const OpKind kind : ir::all_op_kinds()) {
    INFO(ir::op_name(kind));
    const OpInfo& info = ops::info(kind);
    CHECK(info.kind == kind);
    CHECK_FALSE(info.doc.empty());
    CHECK(info.doc.back() == '.');
    CHECK((info.infer != nullptr) != (info.infer_in_graph != nullptr));
  }
}

TEST_CASE("element-wise ops can be evaluated, printed and differentiated") {
  for (const OpKind kind : elementwise_kinds()) {
    INFO(ir::op_name(kind));
    const OpInfo& info = ops::info(kind);
    CHECK(info.eval != nullptr);
    CHECK(info.glsl != nullptr);
    CHECK((info.adjoint != nullptr) == info.differentiable);
    CHECK(info.ulp_bound >= 0);
  }
}

TEST_CASE("image ops have an adjoint or say that there is none") {
  for (const OpKind kind : ir::all_op_kinds()) {
    const OpInfo& info = ops::info(kind);
    if (info.shape != Shape::Image) continue;
    INFO(ir::op_name(kind));
    CHECK((info.adjoint != nullptr) == info.differentiable);
  }
}

TEST_CASE("ops that take floats say what to test them with") {
  for (const OpKind kind : elementwise_kinds()) {
    INFO(ir::op_name(kind));
    const OpInfo& info = ops::info(kind);
    size_t most = 0;
    for (const Form& form : forms(kind)) {
      const bool takes_float =
          std::any_of(form.operands.begin(), form.operands.end(), [](Type t) { return t.is_float(); });
      if (takes_float) most = std::max(most, form.operands.size());
    }
    CHECK(info.domains.size() == most);
    for (const ops::Domain& domain : info.domains) CHECK(domain.low < domain.high);
    for (const ops::TestPoint& point : info.singular) CHECK(point.operands.size() == most);
  }
}

namespace {

// The names of the functions that a text defines: "float dr_exp(" at the start of a line.
std::vector<std::string> defined(std::string_view text) {
  std::vector<std::string> names;
  size_t line = 0;
  while (line < text.size()) {
    const size_t end = std::min(text.find('\n', line), text.size());
    const std::string_view content = text.substr(line, end - line);
    const size_t open = content.find('(');
    const size_t space = content.find(' ');
    const bool starts = !content.empty() && content[0] >= 'a' && content[0] <= 'z';
    if (starts && open != std::string_view::npos && space < open)
      names.emplace_back(content.substr(0, content.find(')')));
    line = end + 1;
  }
  return names;
}

std::string without_comments(std::string_view text) {
  std::string code;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    code += std::string(line.substr(0, line.find("//"))) + "\n";
    text.remove_prefix(std::min(line.size() + 1, text.size()));
  }
  return code;
}

}  // namespace

TEST_CASE("GLSL functions have the prefix, and no two texts define the same") {
  std::set<std::string_view> texts;
  for (const OpKind kind : elementwise_kinds()) {
    const std::vector<std::string> names{"a", "b", "c", "d"};
    for (const Form& form : forms(kind)) {
      const std::vector<std::string_view> prelude =
          ops::prelude(ops::info(kind), {.operands = std::span(names).first(form.operands.size()),
                                         .operand_types = form.operands,
                                         .attrs = form.attrs,
                                         .result_type = form.result});
      std::set<std::string_view> once(prelude.begin(), prelude.end());
      CHECK(once.size() == prelude.size());
      texts.insert(prelude.begin(), prelude.end());
    }
  }
  std::set<std::string> functions;
  for (const std::string_view text : texts) {
    CHECK(text.back() == '\n');
    for (const std::string& name : defined(text)) {
      INFO(name);
      CHECK(name.substr(name.find(' ') + 1).starts_with("dr_"));
      CHECK(functions.insert(name).second);
    }
    for (const char* banned :
         {"isnan", "isinf", "double", "fma(", "inversesqrt", " exp(", " log(", " sin(", " cos(", " pow("}) {
      CHECK(without_comments(text).find(banned) == std::string::npos);
    }
  }
  CHECK(functions.size() > 100);
}
