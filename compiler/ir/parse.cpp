// SPDX-License-Identifier: Apache-2.0
// A recursive-descent parser of the text form, one rule for all ops. It takes any bytes: texts come from files.
#include "compiler/ir/parse.h"

#include <unordered_map>

#include "compiler/ir/print.h"
#include "compiler/ir/text_reader.h"

namespace dr::ir {
namespace {

constexpr int kMaxDepth = 200;  // of regions in regions

struct Definition {
  uint64_t number = 0;
  std::string name;
  ResultType type;
};

class Parser : private TextReader {
 public:
  explicit Parser(std::string_view text) : TextReader(text) {}

  std::variant<NumberedGraph, ParseError> parse() {
    for (skip_lines(); !at_end(); skip_lines()) {
      const bool ok = take_word("leaf") ? leaf() : take_word("step") ? step() : op(0);
      if (!ok) return error();
    }
    return NumberedGraph{std::move(builder_).finish(), std::move(values_)};
  }

 private:
  bool use(ValueId& out) {
    std::string given;
    uint64_t number = 0;
    if (!value_name(given, number)) return false;
    const auto found = values_.find(number);
    if (found == values_.end()) return fail("value %" + std::to_string(number) + " is used before its definition");
    out = found->second;
    const std::string& defined = builder_.value(out).name;
    if (!given.empty() && given != defined) {
      return fail("value %" + std::to_string(number) + " is named " + shown(defined) + ", found " + shown(given));
    }
    return true;
  }

  bool uses(std::vector<ValueId>& out) {
    return comma_list([&] { return use(out.emplace_back()); });
  }

  // %name.12 : vec3[W, H]
  bool definition(Definition& out) {
    if (!value_name(out.name, out.number) || !expect(':')) return false;
    out.type.accumulation = take_word("accumulation");
    return type(out.type.type, out.type.extent);
  }

  bool definitions(std::vector<Definition>& out) {
    return comma_list([&] { return definition(out.emplace_back()); });
  }

  bool define(const std::vector<Definition>& definitions, const std::vector<ValueId>& ids) {
    for (size_t i = 0; i < ids.size(); ++i) {
      if (!values_.emplace(definitions[i].number, ids[i]).second) {
        return fail("value %" + std::to_string(definitions[i].number) + " is defined twice");
      }
      if (!definitions[i].name.empty()) builder_.set_name(ids[i], definitions[i].name);
    }
    return true;
  }

  static std::vector<ResultType> types(const std::vector<Definition>& definitions) {
    std::vector<ResultType> out;
    for (const Definition& definition : definitions) out.push_back(definition.type);
    return out;
  }

  // Statements.

  bool leaf() {
    Leaf leaf;
    if (!name("a leaf's name", leaf.name) || !expect(':') || !type(leaf.type, leaf.extent)) return false;
    bool known = false;
    for (Leaf::Kind kind : {Leaf::Kind::Param, Leaf::Kind::Input, Leaf::Kind::State}) {
      if (!take_word(leaf_kind_name(kind))) continue;
      leaf.kind = kind;
      known = true;
      break;
    }
    if (!known) return expected("'param', 'input' or 'state'");
    if (take('=') && !bracket_list([&] { return number("a number", leaf.initial.emplace_back()); })) return false;
    leaf.is_fixed = take_word("fixed");
    if (take_word("topology") && (!name("a table's name", leaf.table) || !name("a leaf's name", leaf.table_of)))
      return false;
    builder_.graph().leaves.push_back(std::move(leaf));
    return expect_line_end();
  }

  bool attributes(Attrs& attrs) {
    for (;;) {
      if (take_word("ints")) {
        if (!attrs.ints.empty()) return fail("ints given twice");
        if (!bracket_list([&] { return number("an integer", attrs.ints.emplace_back()); })) return false;
      } else if (take_word("floats")) {
        if (!attrs.floats.empty()) return fail("floats given twice");
        if (!bracket_list([&] { return number("a number", attrs.floats.emplace_back()); })) return false;
      } else if (take_word("dims")) {
        if (!attrs.dims.empty()) return fail("dims given twice");
        if (!bracket_list([&] { return dim(attrs.dims.emplace_back()); })) return false;
      } else if (take_word("yields")) {
        if (!attrs.yields.empty()) return fail("yields given twice");
        if (!bracket_list([&] { return yield_kind(attrs.yields.emplace_back()); })) return false;
      } else if (take_word("text")) {
        if (!attrs.text.empty()) return fail("text given twice");
        if (!quoted(attrs.text)) return false;
      } else {
        return true;
      }
    }
  }

  bool yield_kind(Yield& out) {
    for (Yield kind : {Yield::Element, Yield::Sum, Yield::Min, Yield::Max, Yield::ArgMin, Yield::Scatter}) {
      if (!take_word(yield_name(kind))) continue;
      out = kind;
      return true;
    }
    return expected("'element', 'sum', 'min', 'max', 'argmin' or 'scatter'");
  }

  bool op(int depth) {
    std::vector<Definition> results;
    if (peek() == '%' && !definitions(results)) return false;
    if (results.empty() && peek() != '=')
      return expected(depth == 0 ? "'leaf', 'step', or an op's results" : "'yield' or an op's results");
    if (!expect('=')) return false;
    const std::string_view word = peek_word();
    const auto kind = op_kind(word);
    if (!kind) return expected("an op's name");
    take_word(word);

    std::vector<ValueId> operands;
    Attrs attrs;
    std::vector<RegionId> regions;
    if (peek() == '%' && !uses(operands)) return false;
    if (!attributes(attrs)) return false;
    while (peek() == '(' || peek() == '{') {
      if (!region(depth + 1, regions.emplace_back())) return false;
    }
    if (!expect_line_end()) return false;
    const OpId id = builder_.add(*kind, std::move(operands), types(results), std::move(attrs), std::move(regions));
    return define(results, builder_.graph().op(id).results);
  }

  bool region(int depth, RegionId& out) {
    if (depth > kMaxDepth) return fail("regions nest deeper than " + std::to_string(kMaxDepth));
    std::vector<Definition> params;
    if (take('(') && !(definitions(params) && expect(')'))) return false;
    if (!expect('{') || !expect_line_end()) return false;
    out = builder_.begin_region(types(params));
    if (!define(params, builder_.graph().region(out).params)) return false;
    for (skip_lines(); !take_word("yield"); skip_lines()) {
      if (!op(depth)) return false;
    }
    std::vector<ValueId> yields;
    if (peek() == '%' && !uses(yields)) return false;
    if (!expect_line_end()) return false;
    skip_lines();
    if (!expect('}')) return false;
    builder_.end_region(std::move(yields));
    return true;
  }

  bool step() {
    Step step;
    if (!name("a step's name", step.name) || !expect('{') || !expect_line_end()) return false;
    for (skip_lines(); !take('}'); skip_lines()) {
      std::string word;
      if (take_word("output")) {
        Output& output = step.outputs.emplace_back();
        if (!name("an output's name", output.name) || !use(output.value)) return false;
      } else if (take_word("update")) {
        Update& update = step.updates.emplace_back();
        if (!name("a leaf's name", word)) return false;
        const auto index = builder_.graph().leaf_index(word);
        if (!index) return fail("expected a leaf's name, found " + shown(word));
        update.leaf = *index;
        if (!use(update.value)) return false;
      } else {
        return expected("'output', 'update' or '}'");
      }
      if (!expect_line_end()) return false;
    }
    builder_.graph().steps.push_back(std::move(step));
    return expect_line_end();
  }

  Builder builder_;
  std::unordered_map<uint64_t, ValueId> values_;
};

}  // namespace

std::variant<NumberedGraph, ParseError> parse_numbered(std::string_view text) { return Parser(text).parse(); }

std::variant<Graph, ParseError> parse(std::string_view text) {
  auto parsed = parse_numbered(text);
  if (auto* error = std::get_if<ParseError>(&parsed)) return std::move(*error);
  return std::get<NumberedGraph>(std::move(parsed)).graph;
}

}  // namespace dr::ir
