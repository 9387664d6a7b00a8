// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/pass_reader.h"

#include <algorithm>
#include <iterator>

namespace dr::backend {

using ir::OpId;
using ir::ValueId;

bool PassReader::use(ValueId& out) {
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

bool PassReader::value(ValueId& out) {
  if (peek() == '%') return use(out);
  std::string word;
  if (!name("a value", word)) return false;
  const auto found = resources_.find(word);
  if (found == resources_.end()) return fail("there is no resource " + shown(word));
  const std::vector<ValueId>& held = held_[found->second];
  if (adjoins('%')) {
    if (!use(out)) return false;
    return std::ranges::find(held, out) != held.end() || fail("resource " + shown(word) + " does not hold this value");
  }
  if (held.size() != 1)
    return fail("resource " + shown(word) +
                (held.empty() ? " holds no value of this step" : " holds several values: say which, as in x%12"));
  out = held[0];
  return true;
}

bool PassReader::values(std::vector<ValueId>& out) {
  while (peek() != '\n')
    if (!value(out.emplace_back())) return false;
  return true;
}

bool PassReader::op(OpId& out) {
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

bool PassReader::leaf_name(uint32_t& out) {
  std::string word;
  if (!name("a leaf's name", word)) return false;
  const auto found = graph_.leaf_index(word);
  if (!found) return fail("the graph has no leaf " + shown(word));
  out = *found;
  return true;
}
bool PassReader::pass_name(PassId& out) {
  std::string word;
  if (!name("a pass's name", word)) return false;
  const std::vector<Pass>& passes = step_->passes;
  size_t place = 0;
  if (take_word("at")) {
    if (!number("a pass's place", place)) return false;
    if (place >= passes.size() || passes[place].name != word) return fail("there is no pass " + shown(word) + " there");
  } else {
    place = static_cast<size_t>(std::ranges::find(passes, word, &Pass::name) - passes.begin());
    if (place == passes.size()) return fail("there is no pass " + shown(word) + " before this one");
  }
  out = pass_id(place);
  return true;
}

bool PassReader::kind(Pass& pass) {
  if (take_word("fragment")) {
    pass.of_kind = FragmentPass{};
  } else if (take_word("reduce")) {
    pass.of_kind = ReducePass{};
  } else if (take_word("scatter")) {
    return lowering(pass.of_kind.emplace<ScatterPass>());
  } else if (take_word("raster")) {
    if (take_word("hardware")) return pass.of_kind.emplace<DrawnRasterPass>(), true;
    pass.of_kind = RasterPass{};
    return take_word("compute") || expected("'hardware' or 'compute'");
  } else if (!take_word("compute")) {
    return expected("'compute', 'fragment', 'reduce', 'scatter' or 'raster'");
  }
  return true;
}

bool PassReader::lowering(ScatterPass& scatter) {
  if (take_word("rows")) return scatter.how.emplace<RowsScatter>(), true;
  if (take_word("atomic")) return scatter.how.emplace<AtomicScatter>(), true;
  if (take_word("binned")) return scatter.how.emplace<BinnedScatter>(), true;
  return take_word("exact") || expected("'exact', 'binned', 'rows' or 'atomic'");
}

bool PassReader::pass(uint32_t stage) {
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
      if (!ends_pass()) return expected("what passes of its kind have, 'stage', 'pass', 'output', 'update' or '}'");
      go_back(before);
      step_->passes.push_back(std::move(pass));
      return true;
    }
  }
}

// Whether what comes next is of the step.
bool PassReader::ends_pass() {
  constexpr std::string_view kWords[] = {"stage", "pass", "output", "update"};
  return at_end() || peek() == '}' || peek() == '%' || std::ranges::find(kWords, peek_word()) != std::end(kWords);
}

bool PassReader::decision(Pass& pass, bool& is_one) {
  bool ok = true;
  is_one = std::visit([&](auto& own) { return decides(own, ok); }, pass.of_kind);
  return !is_one || (ok && expect_line_end());
}

bool PassReader::decides(MapPass& map, bool& ok) {
  if (take_word("partial")) {
    ok = values(map.partial);
  } else if (take_word("rests")) {
    AtRest& rest = map.rest.emplace();
    ok = expect_word("without") && pass_name(rest.gradient);
    if (ok && take(',')) {
      const bool marked = take_word("marked");
      ok = (marked || expect_word("listed")) && expect_word("in");
      rest.in_bits = ok && marked && take_word("bits");
      rest.in_blocks = marked && !rest.in_bits;
      rest.lists_in_runs = !marked;
      ok = ok && (rest.in_bits || expect_word(marked ? "blocks" : "runs"));
    }
  } else if (map.rest && take_word("memory")) {
    ok = values(map.rest->memory);
  } else if (map.rest && take_word("looks")) {
    ok = expect_word("at") && comma_list([&] { return op(map.rest->gathers.emplace_back()); });
  } else if (take_word("block")) {
    ok = numbers("how many elements", map.block.emplace().each);
  } else if (map.block && take_word("read")) {
    GroupReads& reads = map.block->together.emplace();
    ok = expect_word("together") && comma_list([&] { return op(reads.gathers.emplace_back()); }) && expect_word("by") &&
         numbers("how many invocations", reads.group) && expect_word("for") &&
         number("a number of trips", reads.trips) && expect_word("of") && op(reads.loop);
  } else if (take_word("lists")) {
    ok = map.code.lists_in_runs = expect_word("in") && expect_word("runs");
  } else if (take_word("in")) {
    ok = map.code.in_tiles = expect_word("tiles");
  } else if (take_word("workgroups")) {
    ok = expect_word("of") && number("how many invocations", map.code.joining_group);
  } else if (take_word("up")) {
    ok = expect_word("to") && number("how many elements", map.code.each) && expect_word("elements") &&
         expect_word("in") && expect_word("turn");
  } else if (take_word("heavy")) {
    HeavyBranches& heavy = map.code.heavy.emplace();
    ok = comma_list([&] { return op(heavy.ops.emplace_back()); });
    if (ok && take_word("unlikely")) ok = comma_list([&] { return op(heavy.unlikely.emplace_back()); });
    if (ok && take_word("by")) ok = heavy.by_subgroups = expect_word("subgroups");
    if (ok && take_word("apart")) ok = number("a number of lanes", heavy.apart);
    if (ok && take_word("sharing")) ok = heavy.shares_loops = expect_word("loops");
  } else if (take_word("cut")) {
    ok = map.code.heavy && take_word("heavy") ? cut(map.code.heavy->cut) : cut(map.code.cut);
  } else if (take_word("tells")) {
    ok = values(map.code.told);
  } else {
    return false;
  }
  return true;
}

bool PassReader::decides(ReducePass& reduce, bool& ok) {
  if (!take_word("in")) return false;
  ok = reduce.in_teams = expect_word("teams");
  return true;
}

bool PassReader::decides(RasterPass& raster, bool& ok) {
  if (take_word("set")) {
    FaceSetup& setup = raster.setup.emplace();
    ok = expect_word("up") && expect_word("by") && pass_name(setup.pass);
  } else if (take_word("up")) {
    FacesInTurn& turn = raster.walk.in_turn.emplace();
    ok = expect_word("to") && number("how many faces", turn.each) && expect_word("faces") && expect_word("in") &&
         expect_word("turn") && (!take_word("where") || values(turn.shown));
  } else if (take_word("looks")) {
    ok = expect_word("at") && expect_word("bits") && expect_word("of") && value(raster.walk.wanted.emplace());
  } else if (take_word("gives")) {
    ok = expect_word("rows") && value(raster.rows.emplace());
  } else if (take_word("walks")) {
    ok = expect_word("faces") && walk(raster.walk) && watched(raster.walk.watched);
  } else {
    return false;
  }
  return true;
}

bool PassReader::decides(ScatterPass& scatter, bool& ok) {
  if (take_word("sum")) {
    ScatterSum& sum = scatter.sums.emplace_back();
    ok = value(sum.value) && expect_word("of") && values(sum.terms);
    return true;
  }
  return std::visit([&](auto& how) { return decides(scatter, how, ok); }, scatter.how);
}

bool PassReader::decides(ScatterPass& scatter, ExactScatter& exact, bool& ok) {
  auto* own = std::get_if<OwnFirstRun>(&exact.first_run);
  auto* joined = std::get_if<JoinedFirstRun>(&exact.first_run);
  if (joined != nullptr && take_word("keeps")) {
    ok = joined->keeps_terms = expect_word("terms");
  } else if (joined != nullptr && take_word("again")) {
    joined->again = true;
  } else if (own != nullptr && take_word("relist")) {
    own->relists = true;
  } else if (own != nullptr && own->relists && take_word("if")) {
    ok = expect_word("not") && expect_word("zero") && values(own->nonzero);
  } else if (take_word("guesses")) {
    ok = exact.guesses = expect_word("exponents");
    if (ok && joined != nullptr && take(',')) ok = joined->asks = expect_word("asked");
  } else if (own != nullptr && take_word("shares")) {
    ok = exact.shares_loops = expect_word("loops");
  } else if (take_word("join")) {
    if (take_word("parts"))
      exact.joins_parts = true;
    else if (take_word("workgroups"))
      exact.joins_groups = true;
    else if (take_word("pairs"))
      exact.joins_pairs = true;
    else if (take_word("runs"))
      ok = expect_word("of") && number("how many lanes", exact.joins_runs);
    else
      ok = exact.joins_lanes = expect_word("lanes");
  } else if (take_word("no")) {
    ok = expect_word("rows") && quoted(exact.no_rows);
  } else if (take_word("cut")) {
    ok = cut(exact.cut);
  } else {
    return runs(scatter, own, ok);
  }
  return true;
}

bool PassReader::decides(ScatterPass& scatter, AtomicScatter& atomic, bool& ok) {
  if (take_word("skips")) {
    ok = atomic.skips_zeros = expect_word("zeros");
  } else if (take_word("cut")) {
    ok = cut(atomic.cut);
  } else {
    return runs(scatter, std::get_if<OwnRun>(&atomic.run), ok);
  }
  return true;
}

bool PassReader::decides(ScatterPass& scatter, BinnedScatter& binned, bool& ok) {
  if (take_word("join")) {
    ok = binned.joins_parts = expect_word("parts");
  } else if (take_word("no")) {
    ok = expect_word("rows") && quoted(binned.no_rows);
  } else if (take_word("cut")) {
    ok = cut(binned.cut);
  } else {
    return runs(scatter, std::get_if<OwnRun>(&binned.run), ok);
  }
  return true;
}

bool PassReader::decides(ScatterPass&, RowsScatter& rows, bool& ok) {
  auto* sorted = std::get_if<SortedRows>(&rows.table);
  if (take_word("rows")) {
    ok = take_word("by") ? number("lanes", rows.lanes) && expect_word("lanes") : table(rows);
  } else if (sorted != nullptr && take_word("place")) {
    ok = place(sorted->places.emplace_back());
  } else {
    return false;
  }
  return true;
}

bool PassReader::runs(ScatterPass& scatter, OwnRun* own, bool& ok) {
  ActiveList* list = scatter.active_list();
  if (own != nullptr && take_word("active")) {
    ok = clauses(own->active.emplace().clauses);
  } else if (list != nullptr && take_word("listed")) {
    ok = expect_word("by") && pass_name(list->listed_by.emplace<PassId>());
  } else if (list != nullptr && !scatter.relists() && take_word("joins")) {
    ok = pass_name(list->listed_by.emplace<PassId>());
    if (ok) scatter.join_lister();
  } else if (list != nullptr && std::holds_alternative<OwnList>(list->listed_by) && take_word("lists")) {
    ok = std::get<OwnList>(list->listed_by).in_runs = expect_word("in") && expect_word("runs");
  } else {
    return false;
  }
  return true;
}

bool PassReader::numbers(const char* what, std::array<int, 3>& out) {
  for (int& n : out)
    if (!number(what, n)) return false;
  return true;
}

bool PassReader::cut(std::optional<LoopCut>& out) {
  LoopCut& cut = out.emplace();
  return expect_word("loops") && number("a number of trips", cut.part) && watched(cut.watched);
}

bool PassReader::watched(bool& out) {
  if (!take(',')) return true;
  return out = expect_word("watched");
}

bool PassReader::walk(FaceWalk& out) {
  if (take_word("alone")) return true;
  FaceBins& bins = out.lists.emplace();
  const auto count = [&](int& n) { return number("a number", n) && (n >= 0 || fail("this number is negative")); };
  if (!expect_word("of") || !count(bins.small_box) || !expect_word("alone") || !expect(',')) return false;
  if (take_word("or") &&
      !(expect_word("of") && count(bins.few_box) && expect_word("if") && expect_word("few") && expect(',')))
    return false;
  return expect_word("of") && count(bins.middle_box) && expect_word("by") && count(bins.team) && expect_word("in") &&
         count(bins.middle_invocations) && expect(',') && expect_word("others") && expect_word("in") &&
         count(bins.large_invocations);
}

bool PassReader::clauses(Clauses& out) {
  do {
    if (!out.empty() && !expect_word("or")) return false;
    std::vector<ValueId>& clause = out.emplace_back();
    do {
      if (!value(clause.emplace_back())) return false;
    } while (take_word("and"));
  } while (take(','));
  return true;
}

bool PassReader::table(RowsScatter& out) {
  const Mark before = mark();
  if (take_word("sorted") && peek() != '[') {
    out.table = SortedRows{};
  } else {
    go_back(before);
    auto& table = out.table.emplace<RowsOfLeaf>();
    if (!leaf_name(table.leaf) || !bracket_list([&] { return number("a column", table.columns.emplace_back()); }))
      return false;
  }
  return expect_word("of") && dim(out.targets);
}

bool PassReader::place(ScatterLeaf& out) {
  if (!use(out.index) || !expect_word("adds") || !use(out.value)) return false;
  if (!take_word("in")) return true;
  return comma_list([&] {
    ScatterLeaf::Branch& branch = out.path.emplace_back();
    if (!op(branch.op) || !expect_word("branch") || !number("a branch's number", branch.region)) return false;
    branch.in_table = take_word("of");
    return !branch.in_table || (expect_word("the") && expect_word("table"));
  });
}

}  // namespace dr::backend
