// SPDX-License-Identifier: Apache-2.0
// A recursive-descent parser of the text form, one rule for all ops. It takes any bytes: texts come from files.
#include "compiler/ir/parse.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <unordered_map>

#include "compiler/ir/print.h"

namespace dr::ir {
namespace {

constexpr int kMaxDepth = 200;  // of regions in regions

// What a message repeats of the text.
std::string shown(std::string_view text) { return "'" + std::string(text.substr(0, 40)) + "'"; }

struct Definition {
  uint64_t number = 0;
  std::string name;
  ResultType type;
};

// Every rule returns whether it succeeded; the first failure writes error_, and the callers unwind.
class Parser {
 public:
  explicit Parser(std::string_view text) : text_(text) {}

  std::variant<Graph, ParseError> parse() {
    for (skip_lines(); at_ < text_.size(); skip_lines()) {
      const bool ok = take_word("leaf") ? leaf() : take_word("step") ? step() : op(0);
      if (!ok) return std::move(error_);
    }
    return std::move(builder_).finish();
  }

 private:
  // Characters.

  char peek() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t' || text_[at_] == '\r')) ++at_;
    if (text_.substr(at_).starts_with("//")) at_ = std::min(text_.find('\n', at_), text_.size());
    return at_ < text_.size() ? text_[at_] : '\n';
  }

  void skip_lines() {
    while (peek() == '\n' && at_ < text_.size()) {
      ++at_;
      ++line_;
    }
  }

  bool fail(std::string message) {
    error_ = {line_, std::move(message)};
    return false;
  }

  bool expected(std::string_view what) {
    const char c = peek();
    std::string found;
    if (at_ >= text_.size()) {
      found = "the end of the text";
    } else if (c == '\n') {
      found = "the end of the line";
    } else {
      const std::string_view word = peek_word();
      found = shown(word.empty() ? std::string_view(&c, 1) : word);
    }
    return fail("expected " + std::string(what) + ", found " + found);
  }

  bool take(char c) {
    if (peek() != c || at_ >= text_.size()) return false;
    ++at_;
    return true;
  }

  bool expect(char c) { return take(c) || expected(std::string{'\'', c, '\''}); }

  bool expect_line_end() { return peek() == '\n' || expected("the end of the line"); }

  std::string_view peek_word() {
    peek();
    size_t end = at_;
    while (end < text_.size() && is_name_char(text_[end])) ++end;
    return text_.substr(at_, end - at_);
  }

  bool take_word(std::string_view word) {
    if (peek_word() != word) return false;
    at_ += word.size();
    return true;
  }

  // Words, numbers, lists.

  // "..." with \" \\ \n \xHH.
  bool quoted(std::string& out) {
    if (!expect('"')) return false;
    out.clear();
    while (at_ < text_.size() && text_[at_] != '\n') {
      const char c = text_[at_++];
      if (c == '"') return true;
      if (c != '\\') {
        out += c;
        continue;
      }
      const char escape = at_ < text_.size() ? text_[at_++] : '\n';
      if (escape == '"' || escape == '\\') {
        out += escape;
      } else if (escape == 'n') {
        out += '\n';
      } else if (unsigned byte = 0;
                 escape == 'x' && at_ + 2 <= text_.size() &&
                 std::from_chars(text_.data() + at_, text_.data() + at_ + 2, byte, 16).ptr == text_.data() + at_ + 2) {
        out += static_cast<char>(byte);
        at_ += 2;
      } else {
        return fail("expected \\\", \\\\, \\n or \\x and two hexadecimal digits in a quoted text");
      }
    }
    return fail("expected '\"' at the end of a quoted text, found the end of the line");
  }

  bool name(std::string_view what, std::string& out) {
    if (peek() == '"') return quoted(out);
    const std::string_view word = peek_word();
    if (word.empty()) return expected(what);
    out = word;
    at_ += word.size();
    return true;
  }

  template <class T>
  bool number(std::string_view what, T& out) {
    peek();
    const char* begin = text_.data() + at_;
    const auto [end, error] = std::from_chars(begin, text_.data() + text_.size(), out);
    if (error == std::errc::result_out_of_range)
      return fail(std::string(what) +
                  " out of range: " + std::string(begin, std::min<size_t>(40, static_cast<size_t>(end - begin))));
    if (error != std::errc{}) return expected(what);
    at_ += static_cast<size_t>(end - begin);
    return true;
  }

  template <class Item>
  bool comma_list(Item item) {
    do {
      if (!item()) return false;
    } while (take(','));
    return true;
  }

  template <class Item>
  bool bracket_list(Item item) {
    if (!expect('[')) return false;
    if (take(']')) return true;
    return comma_list(item) && (take(']') || expected("',' or ']'"));
  }

  bool dim(Dim& out) {
    peek();
    const size_t end = std::min(text_.find_first_of(",]\n", at_), text_.size());
    const std::string_view expression = text_.substr(at_, end - at_);
    const auto parsed = Dim::parse(expression);
    if (!parsed) return fail("expected an extent, found " + shown(expression));
    out = *parsed;
    at_ = end;
    return true;
  }

  // vec3[W, H]
  bool type(Type& type, Extent& extent) {
    const std::string_view word = peek_word();
    const auto parsed = Type::parse(word);
    if (!parsed) return expected("a type");
    type = *parsed;
    at_ += word.size();
    if (peek() != '[') return true;
    const std::array<Dim*, 3> axes = {&extent.w, &extent.h, &extent.l};
    size_t count = 0;
    return bracket_list(
        [&] { return count < axes.size() ? dim(*axes[count++]) : fail("expected at most three extents, found more"); });
  }

  // %12 or %name.12
  bool value_name(std::string& name, uint64_t& number) {
    if (!expect('%')) return false;
    name.clear();
    const size_t begin = at_;
    if (at_ < text_.size() && text_[at_] == '"') {
      if (!quoted(name)) return false;
      if (at_ == text_.size() || text_[at_] != '.') return expected("'.' and a number after a value's name");
      ++at_;
    } else if (begin < text_.size() && is_name_char(text_[begin])) {
      const std::string_view word = peek_word();
      if (const size_t dot = word.rfind('.'); dot != std::string_view::npos) {
        name = word.substr(0, dot);
        at_ += dot + 1;
      }
    }
    const char* first = text_.data() + at_;
    const auto [end, error] = std::from_chars(first, text_.data() + text_.size(), number);
    if (error != std::errc{}) return fail("expected a value's number, as in %12 or %name.12");
    at_ += static_cast<size_t>(end - first);
    if (at_ < text_.size() && is_name_char(text_[at_])) return fail("expected a value's number, as in %12 or %name.12");
    return true;
  }

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
    at_ += word.size();

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

  std::string_view text_;
  size_t at_ = 0;
  uint32_t line_ = 1;
  Builder builder_;
  std::unordered_map<uint64_t, ValueId> values_;
  ParseError error_;
};

}  // namespace

std::variant<Graph, ParseError> parse(std::string_view text) { return Parser(text).parse(); }

}  // namespace dr::ir
