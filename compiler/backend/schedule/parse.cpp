// SPDX-License-Identifier: Apache-2.0
// Reads the text form that text.h describes. It takes any bytes: texts come from files.
#include <algorithm>
#include <map>
#include <optional>

#include "compiler/backend/schedule/pass_reader.h"
#include "compiler/backend/schedule/text.h"

namespace dr::backend {

using ir::OpId;
using ir::ParseError;
using ir::ValueId;

namespace {

class Parser : private PassReader {
 public:
  Parser(std::string_view text, uint32_t line, const ir::NumberedGraph& graph) : PassReader(text, line, graph) {}

  std::variant<Schedule, ParseError> parse() {
    bool ok = expect_word("schedule") && expect_word("after") && after() && expect_line_end();
    for (skip_lines(); ok && !at_end(); skip_lines()) {
      bool is_code = true;
      ok = code(is_code) && (is_code || (take_word("step") ? step() : resource()));
    }
    if (!ok) return error();
    return std::move(schedule_);
  }

 private:
  // keep-sums
  bool after() {
    std::string word;
    do {
      if (!name("a pass's name", word)) return false;
      schedule_.after += (schedule_.after.empty() ? "" : "-") + word;
    } while (adjoins('-') && take('-'));
    return true;
  }

  // code native floats, loops of 65535
  bool code_words() {
    Code& code = schedule_.code;
    return comma_list([&] {
      if (take_word("native")) return code.native = expect_word("floats");
      if (take_word("texel")) return code.texel_reads = expect_word("reads");
      if (take_word("hidden"))
        return take_word("zeros") ? (code.hidden_zeros = true) : (code.hidden_stores = expect_word("stores"));
      if (take_word("no")) return code.no_else = expect_word("else");
      if (take_word("divides")) return code.divides_by_any = expect_word("by") && expect_word("any");
      if (take_word("wide")) return code.wide_words = expect_word("words");
      if (take_word("layers")) return code.layers_at_once = expect_word("at") && expect_word("once");
      if (take_word("clears")) return expect_word("of") && number("a number of fills", code.clears);
      if (take_word("loops")) return expect_word("of") && number("a number of trips", code.loop_trips);
      return expected("'native', 'texel', 'hidden', 'no', 'divides', 'wide', 'layers', 'clears' or 'loops'");
    });
  }

  bool divisors(std::set<ValueId>& out) {
    if (!expect_word("divisors")) return false;
    while (peek() != '\n') {
      ValueId v;
      if (!use(v)) return false;
      out.insert(v);
    }
    return true;
  }

  // A line about all shaders, if there is one.
  bool code(bool& is_one) {
    bool ok = true;
    if (take_word("code"))
      ok = code_words();
    else if (take_word("hidden"))
      ok = divisors(schedule_.code.hidden_divisors);
    else if (take_word("strict"))
      ok = expect_word("hidden") && divisors(schedule_.code.strict_hidden_divisors);
    else if (take_word("moderate"))
      ok = divisors(schedule_.code.moderate_divisors);
    else
      is_one = false;
    return !is_one || (ok && expect_line_end());
  }

  // `leaf`, `half buffer` and so on, a name, a type. A word is the name where a colon follows it.
  bool resource() {
    Resource r;
    std::string word, words;
    for (;;) {
      const bool is_quoted = peek() == '"';
      if (!name("'step' or a resource", word)) return false;
      if (peek() == ':') break;
      if (is_quoted) return expected("':'");
      words += (words.empty() ? "" : " ") + word;
      if (!std::ranges::any_of(kStorages, [&](Resource::Storage one) { return storage_words(one).starts_with(words); }))
        return unknown_storage(word);
    }
    r.name = word;
    const auto* storage = std::ranges::find(kStorages, words, storage_words);
    if (storage == kStorages.end()) return unknown_storage(words.empty() ? word : words);
    r.storage = *storage;
    if (r.is(Resource::Storage::Leaf) && schedule_.resources.size() >= graph_.leaves.size())
      return fail("there are more leaves here than in the graph");
    if (!resources_.emplace(word, static_cast<uint32_t>(schedule_.resources.size())).second)
      return fail("resource " + shown(word) + " is defined twice");
    if (!expect(':') || !type(r.type, r.extent)) return false;
    schedule_.resources.push_back(std::move(r));
    return expect_line_end();
  }

  bool unknown_storage(const std::string& found) {
    std::string all;
    for (const Resource::Storage one : kStorages) all += (all.empty() ? "" : ", ") + std::string(storage_words(one));
    return fail("expected a storage (" + all + ") and a resource's name before ':', found " + shown(found));
  }

  bool step() {
    StepSchedule step;
    step_ = &step;
    held_.clear();
    std::optional<uint32_t> stage;
    if (!name("a step's name", step.name) || !expect('{') || !expect_line_end()) return false;
    for (skip_lines(); !take('}'); skip_lines()) {
      bool ok = true;
      if (peek() == '%') {
        ok = stored();
      } else if (take_word("stage")) {
        ok = number("a stage's number", stage.emplace());
      } else if (take_word("pass")) {
        if (!stage) return fail("expected 'stage' before the first pass");
        ok = pass(*stage);
      } else if (take_word("output")) {
        auto& [name_of, v] = step.outputs.emplace_back();
        ok = name("an output's name", name_of) && expect('=') && value(v);
      } else if (take_word("update")) {
        auto& [leaf, v] = step.updates.emplace_back();
        ok = leaf_name(leaf) && expect('<') && expect('-') && value(v);
        if (ok && take_word("in")) ok = expect_word("place");
      } else {
        return expected("a stored value, 'stage', 'pass', 'output', 'update' or '}'");
      }
      if (!ok || !expect_line_end()) return false;
    }
    schedule_.steps.push_back(std::move(step));
    return expect_line_end();
  }

  // %7 in normal
  bool stored() {
    ValueId v;
    std::string resource;
    if (!use(v) || !expect_word("in") || !name("a resource's name", resource)) return false;
    const auto found = resources_.find(resource);
    if (found == resources_.end()) return fail("there is no resource " + shown(resource));
    if (!step_->stored.emplace(v, ResourceId{found->second}).second) return fail("a value is stored twice");
    held_[found->second].push_back(v);
    return true;
  }
};

// Where the schedule's part begins: no line of a graph's text begins so.
size_t find_schedule(std::string_view text) {
  constexpr std::string_view kWord = "schedule ";
  for (size_t at = 0; at < text.size();) {
    if (text.substr(at).starts_with(kWord)) return at;
    const size_t end = text.find('\n', at);
    if (end == std::string_view::npos) break;
    at = end + 1;
  }
  return text.size();
}

}  // namespace

std::variant<ParsedSchedule, ParseError> parse_schedule(std::string_view text) {
  const size_t begin = find_schedule(text);
  auto graph = ir::parse_numbered(text.substr(0, begin));
  if (auto* error = std::get_if<ParseError>(&graph)) return std::move(*error);
  auto& numbered = std::get<ir::NumberedGraph>(graph);
  const auto line = static_cast<uint32_t>(1 + std::ranges::count(text.substr(0, begin), '\n'));
  auto schedule = Parser(text.substr(begin), line, numbered).parse();
  if (auto* error = std::get_if<ParseError>(&schedule)) return std::move(*error);
  return ParsedSchedule{std::move(numbered.graph), std::get<Schedule>(std::move(schedule))};
}

}  // namespace dr::backend
