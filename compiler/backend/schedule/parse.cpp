// SPDX-License-Identifier: Apache-2.0
// Reads the text form that text.h describes. It takes any bytes: texts come from files.
#include <algorithm>
#include <map>
#include <optional>

#include "compiler/backend/schedule/text.h"
#include "compiler/ir/text_reader.h"

namespace dr::backend {

using ir::Graph;
using ir::OpId;
using ir::ParseError;
using ir::ValueId;

namespace {

class Parser : private ir::TextReader {
 public:
  Parser(std::string_view text, uint32_t line, const ir::NumberedGraph& graph)
      : TextReader(text, line), graph_(graph.graph), values_(graph.values) {}

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
      if (take_word("hidden")) return code.hidden_stores = expect_word("stores");
      if (take_word("wide")) return code.wide_words = expect_word("words");
      if (take_word("layers")) return code.layers_at_once = expect_word("at") && expect_word("once");
      if (take_word("clears")) return expect_word("of") && number("a number of fills", code.clears);
      if (take_word("loops")) return expect_word("of") && number("a number of trips", code.loop_trips);
      return expected("'native', 'texel', 'hidden', 'wide', 'layers', 'clears' or 'loops'");
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
    std::string word;
    bool has_storage = false, is_leaf = false;
    for (;;) {
      const bool is_quoted = peek() == '"';
      if (!name("'step' or a resource", word)) return false;
      if (peek() == ':') break;
      const auto storage = storage_named(word);
      if (is_quoted) return expected("':'");
      if (storage && !has_storage) {
        has_storage = true;
        r.storage = *storage;
      } else if (bool* flag = word == "leaf"         ? &is_leaf
                              : word == "step_index" ? &r.step_index
                              : word == "entries"    ? &r.entries
                              : word == "sums"       ? &r.sums
                              : word == "half"       ? &r.half
                                                     : nullptr;
                 flag && !*flag && !has_storage) {
        *flag = true;
      } else {
        return fail("expected a storage (buffer, image, tile) and a resource's name before ':', found " + shown(word));
      }
    }
    r.name = word;
    if (is_leaf) r.leaf = static_cast<int>(schedule_.resources.size());
    if (is_leaf && schedule_.resources.size() >= graph_.leaves.size())
      return fail("there are more leaves here than in the graph");
    if (!resources_.emplace(word, static_cast<uint32_t>(schedule_.resources.size())).second)
      return fail("resource " + shown(word) + " is defined twice");
    if (!expect(':') || !type(r.type, r.extent)) return false;
    schedule_.resources.push_back(std::move(r));
    return expect_line_end();
  }

  static std::optional<Resource::Storage> storage_named(std::string_view word) {
    if (word == "buffer") return Resource::Storage::Buffer;
    if (word == "image") return Resource::Storage::Image;
    if (word == "tile") return Resource::Storage::Tile;
    return std::nullopt;
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

  // %7
  bool use(ValueId& out) {
    std::string given;
    uint64_t number = 0;
    if (!value_name(given, number)) return false;
    const auto found = values_.find(number);
    if (found == values_.end()) return fail("the graph has no value %" + std::to_string(number));
    out = found->second;
    const std::string& defined = graph_.value(out).name;
    if (!given.empty() && given != defined)
      return fail("value %" + std::to_string(number) + " is named " + shown(defined) + ", found " + shown(given));
    return true;
  }

  // %7, normal, or position%40
  bool value(ValueId& out) {
    if (peek() == '%') return use(out);
    std::string word;
    if (!name("a value", word)) return false;
    const auto found = resources_.find(word);
    if (found == resources_.end()) return fail("there is no resource " + shown(word));
    const std::vector<ValueId>& held = held_[found->second];
    if (adjoins('%')) {
      if (!use(out)) return false;
      return std::ranges::find(held, out) != held.end() ||
             fail("resource " + shown(word) + " does not hold this value");
    }
    if (held.size() != 1)
      return fail("resource " + shown(word) +
                  (held.empty() ? " holds no value of this step" : " holds several values: say which, as in x%12"));
    out = held[0];
    return true;
  }

  bool values(std::vector<ValueId>& out) {
    while (peek() != '\n')
      if (!value(out.emplace_back())) return false;
    return true;
  }

  // add %5
  bool op(OpId& out) {
    const auto kind = ir::op_kind(peek_word());
    if (!kind) return expected("an op's name");
    take_word(peek_word());
    ValueId v;
    if (!use(v)) return false;
    out = graph_.value(v).op;
    if (!out.valid() || graph_.value(v).result_index != 0) return fail("expected the first result of an op");
    const ir::OpKind found = graph_.op(out).kind;
    return found == *kind || fail("this value is made by '" + std::string(ir::op_name(found)) + "', found '" +
                                  std::string(ir::op_name(*kind)) + "'");
  }

  bool leaf_name(uint32_t& out) {
    std::string word;
    if (!name("a leaf's name", word)) return false;
    const auto found = graph_.leaf_index(word);
    if (!found) return fail("the graph has no leaf " + shown(word));
    out = *found;
    return true;
  }

  // An earlier pass of the step.
  bool pass_name(int& out) {
    std::string word;
    if (!name("a pass's name", word)) return false;
    const std::vector<Pass>& passes = step_->passes;
    size_t place = 0;
    if (take_word("at")) {
      if (!number("a pass's place", place)) return false;
      if (place >= passes.size() || passes[place].name != word)
        return fail("there is no pass " + shown(word) + " there");
    } else {
      place = static_cast<size_t>(std::ranges::find(passes, word, &Pass::name) - passes.begin());
      if (place == passes.size()) return fail("there is no pass " + shown(word) + " before this one");
    }
    out = static_cast<int>(place);
    return true;
  }

  bool kind(Pass& pass) {
    if (take_word("fragment")) {
      pass.hardware = true;
    } else if (take_word("reduce")) {
      pass.kind = Pass::Kind::Reduce;
    } else if (take_word("scatter")) {
      pass.kind = Pass::Kind::Scatter;
      pass.scatter = take_word("rows")     ? ScatterLowering::Rows
                     : take_word("atomic") ? ScatterLowering::Atomic
                                           : ScatterLowering::Exact;
      return pass.scatter != ScatterLowering::Exact || take_word("exact") || expected("'exact', 'rows' or 'atomic'");
    } else if (take_word("raster")) {
      pass.kind = Pass::Kind::Raster;
      pass.hardware = take_word("hardware");
      return pass.hardware || take_word("compute") || expected("'hardware' or 'compute'");
    } else if (!take_word("compute")) {
      return expected("'compute', 'fragment', 'reduce', 'scatter' or 'raster'");
    }
    return true;
  }

  bool pass(uint32_t stage) {
    Pass pass;
    pass.stage = stage;
    if (!name("a pass's name", pass.name) || !kind(pass) || !extent(pass.domain)) return false;
    pass.steady = !take_word("prologue");
    if (!expect_line_end()) return false;
    skip_lines();
    if (!expect_word("reads")) return false;
    while (peek() != '\n') {
      const Mark before = mark();
      if (!(take_word("input") && adjoins(':') && take(':'))) go_back(before);
      if (!value(pass.reads.emplace_back())) return false;
    }
    skip_lines();
    if (!expect_word("ops")) return false;
    if (peek() != '\n' && !comma_list([&] { return op(pass.ops.emplace_back()); })) return false;
    if (!expect_line_end()) return false;
    skip_lines();
    if (!expect_word("writes") || !values(pass.writes)) return false;
    for (;;) {
      const Mark before = mark();
      skip_lines();
      bool is_decision = true;
      if (!decision(pass, is_decision)) return false;
      if (!is_decision) {
        go_back(before);
        step_->passes.push_back(std::move(pass));
        return true;
      }
    }
  }

  // One line about a pass, if there is one.
  bool decision(Pass& pass, bool& is_one) {
    bool ok = true;
    if (take_word("partial")) {
      ok = values(pass.partial);
    } else if (take_word("sum")) {
      ScatterSum& sum = pass.sums.emplace_back();
      ok = value(sum.value) && expect_word("of") && values(sum.terms);
    } else if (take_word("active")) {
      ok = clauses(pass.active);
    } else if (take_word("listed")) {
      ok = expect_word("by") && pass_name(pass.listed_by);
    } else if (take_word("joins")) {
      pass.joins_lister = true;
      ok = pass_name(pass.listed_by);
    } else if (take_word("set")) {
      ok = expect_word("up") && expect_word("by") && pass_name(pass.set_up_by);
      if (ok && take(',')) {
        pass.sets_up_again = true;
        ok = expect_word("twice") && expect_word("where") && expect_word("listed");
      }
    } else if (take_word("keeps")) {
      ok = pass.keeps_terms = expect_word("terms");
    } else if (take_word("join")) {
      ok = pass.join_lanes = expect_word("lanes");
    } else if (take_word("relist")) {
      pass.relist = true;
    } else if (take_word("no")) {
      ok = expect_word("rows") && quoted(pass.no_rows);
    } else if (take_word("rows")) {
      ok = rows(pass.rows);
    } else if (take_word("place")) {
      ok = place(pass.rows.places.emplace_back());
    } else if (!pass_code(pass.code, ok)) {
      is_one = false;
      return true;
    }
    return ok && expect_line_end();
  }

  // Whether the line says how the pass's shader is written, and, in `ok`, as it should.
  bool pass_code(PassCode& code, bool& ok) {
    if (take_word("lists")) {
      ok = code.lists_in_runs = expect_word("in") && expect_word("runs");
    } else if (take_word("heavy")) {
      ok = comma_list([&] { return op(code.heavy.emplace_back()); });
      if (ok && take_word("by")) ok = code.heavy_by_subgroups = expect_word("subgroups");
      if (ok && take_word("apart")) ok = number("a number of lanes", code.heavy_apart);
    } else if (take_word("cut")) {
      LoopCut& cut = take_word("heavy") ? code.heavy_cut : code.cut;
      ok = expect_word("loops") && number("a number of trips", cut.part) && watched(cut.watched);
    } else if (take_word("skips")) {
      ok = code.skips_zeros = expect_word("zeros");
    } else if (take_word("tells")) {
      ok = values(code.told);
    } else if (take_word("walks")) {
      ok = expect_word("faces") && walk(code.walk) && watched(code.walk.watched);
    } else {
      return false;
    }
    return true;
  }

  bool watched(bool& out) {
    if (!take(',')) return true;
    return out = expect_word("watched");
  }

  // alone, or: of 64 alone, of 4096 by 8 in 8192, others in 4096
  bool walk(FaceWalk& out) {
    if (take_word("alone")) return true;
    out.lists = true;
    const auto count = [&](int& n) { return number("a number", n) && (n >= 0 || fail("this number is negative")); };
    return expect_word("of") && count(out.small_box) && expect_word("alone") && expect(',') && expect_word("of") &&
           count(out.middle_box) && expect_word("by") && count(out.team) && expect_word("in") &&
           count(out.middle_invocations) && expect(',') && expect_word("others") && expect_word("in") &&
           count(out.large_invocations);
  }

  // a and b, or c
  bool clauses(std::vector<std::vector<ValueId>>& out) {
    do {
      if (!out.empty() && !expect_word("or")) return false;
      std::vector<ValueId>& clause = out.emplace_back();
      do {
        if (!value(clause.emplace_back())) return false;
      } while (take_word("and"));
    } while (take(','));
    return true;
  }

  bool rows(RowsTable& out) {
    const Mark before = mark();
    if (!(take_word("sorted") && peek() != '[')) {
      go_back(before);
      if (!leaf_name(out.leaf) || !bracket_list([&] { return number("a column", out.columns.emplace_back()); }))
        return false;
    }
    return expect_word("of") && dim(out.targets);
  }

  // %12 adds %13 in if %40 branch 0 of the table, if %41 branch 1
  bool place(ScatterLeaf& out) {
    if (!use(out.index) || !expect_word("adds") || !use(out.value)) return false;
    if (!take_word("in")) return true;
    return comma_list([&] {
      ScatterLeaf::Branch& branch = out.path.emplace_back();
      if (!op(branch.op) || !expect_word("branch") || !number("a branch's number", branch.region)) return false;
      branch.in_table = take_word("of");
      return !branch.in_table || (expect_word("the") && expect_word("table"));
    });
  }

  const Graph& graph_;
  const std::unordered_map<uint64_t, ValueId>& values_;
  Schedule schedule_;
  std::map<std::string, uint32_t, std::less<>> resources_;
  StepSchedule* step_ = nullptr;
  std::map<uint32_t, std::vector<ValueId>> held_;  // values in a resource, in this step
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
