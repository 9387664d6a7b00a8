// SPDX-License-Identifier: Apache-2.0
// Writes the text form that text.h describes. It prints unsound schedules too: messages of the checker show them.
#include "compiler/ir/print.h"

#include <algorithm>
#include <map>

#include "compiler/backend/schedule/text.h"
#include "compiler/ir/text_reader.h"

namespace dr::backend {

using ir::Graph;
using ir::OpId;
using ir::ValueId;

std::string_view storage_words(Resource::Storage storage) {
  switch (storage) {
    case Resource::Storage::Leaf: return "leaf";
    case Resource::Storage::StepIndex: return "step_index buffer";
    case Resource::Storage::Buffer: return "buffer";
    case Resource::Storage::Halves: return "half buffer";
    case Resource::Storage::Entries: return "entries buffer";
    case Resource::Storage::EpochEntries: return "epoch entries buffer";
    case Resource::Storage::Bits: return "bits buffer";
    case Resource::Storage::Sums: return "sums buffer";
    case Resource::Storage::EmptiedSums: return "emptied sums buffer";
    case Resource::Storage::ListedSums: return "listed sums buffer";
    case Resource::Storage::Emptied: return "emptied buffer";
    case Resource::Storage::Image: return "image";
    case Resource::Storage::Tile: return "tile";
  }
  return "";
}

namespace {

class Writer {
 public:
  Writer(const Graph& graph, const Schedule& schedule)
      : graph_(graph), schedule_(schedule), numbers_(ir::print_numbers(graph)) {}

  std::string text() {
    out_ = "schedule after " + (schedule_.after.empty() ? "?" : schedule_.after) + "\n";
    write_code(schedule_.code);
    for (const Resource& r : schedule_.resources) write_resource(r);
    for (const StepSchedule& step : schedule_.steps) write_step(step);
    return std::move(out_);
  }

 private:
  void write_code(const Code& code) {
    std::string how;
    const auto add = [&](bool holds, const std::string& what) {
      if (holds) how += (how.empty() ? "code " : ", ") + what;
    };
    add(code.native, "native floats");
    add(code.texel_reads, "texel reads");
    add(code.hidden_stores, "hidden stores");
    add(code.hidden_zeros, "hidden zeros");
    add(code.no_else, "no else");
    add(code.divides_by_any, "divides by any");
    add(code.wide_words, "wide words");
    add(code.layers_at_once, "layers at once");
    add(code.clears > 0, "clears of " + std::to_string(code.clears));
    add(code.loop_trips > 0, "loops of " + std::to_string(code.loop_trips));
    if (!how.empty()) out_ += how + "\n";
    write_divisors("hidden", code.hidden_divisors);
    write_divisors("strict hidden", code.strict_hidden_divisors);
    write_divisors("moderate", code.moderate_divisors);
  }

  void write_divisors(const char* what, const std::set<ValueId>& values) {
    if (values.empty()) return;
    out_ += std::string(what) + " divisors";
    for (const ValueId v : values) out_ += " " + use(v);
    out_ += "\n";
  }

  void write_cut(const char* what, const std::optional<LoopCut>& cut) {
    if (cut) out_ += what + std::to_string(cut->part) + (cut->watched ? ", watched\n" : "\n");
  }

  void write_resource(const Resource& r) {
    out_ += std::string(storage_words(r.storage)) + " " + ir::written_name(r.name) + " : " + r.type.str() +
            r.extent.str() + "\n";
  }

  std::string use(ValueId v) const { return ir::print_use(graph_, v, numbers_); }

  // A stored value by its resource, and by its own name too where that holds several; any other by its own.
  std::string at(ValueId v) const {
    const auto stored = step_->stored.find(v);
    if (stored == step_->stored.end() || stored->second.index >= schedule_.resources.size()) return use(v);
    const std::string name = ir::written_name(schedule_.resources[stored->second.index].name);
    return held_.at(stored->second.index) == 1 ? name : name + use(v);
  }

  std::string op(OpId id) const {
    const ir::Op& op = graph_.op(id);
    return std::string(ir::op_name(op.kind)) + " " + (op.results.empty() ? "%?" : use(op.results[0]));
  }

  // A pass by its name, and by its place too where several have that.
  std::string pass_at(PassId id) const {
    if (id.index >= step_->passes.size()) return "?";
    const std::string& name = step_->pass(id).name;
    const auto same = std::ranges::count(step_->passes, name, &Pass::name);
    return ir::written_name(name) + (same == 1 ? "" : " at " + std::to_string(id.index));
  }

  void write_step(const StepSchedule& step) {
    step_ = &step;
    held_.clear();
    for (const auto& [v, id] : step.stored) ++held_[id.index];
    out_ += "step " + ir::written_name(step.name) + " {\n";
    for (const auto& [v, id] : step.stored)
      out_ += "  " + use(v) + " in " +
              (id.index < schedule_.resources.size() ? ir::written_name(schedule_.resources[id.index].name) : "?") +
              "\n";
    for (size_t k = 0; k < step.passes.size(); ++k) {
      if (k == 0 || step.passes[k - 1].stage != step.passes[k].stage)
        out_ += "  stage " + std::to_string(step.passes[k].stage) + "\n";
      write_pass(step.passes[k], stage_inputs(step, k));
    }
    for (const auto& [name, v] : step.outputs) out_ += "  output " + ir::written_name(name) + " = " + at(v) + "\n";
    for (const auto& [leaf, v] : step.updates) {
      const auto stored = step.stored.find(v);
      const bool in_place = stored != step.stored.end() && stored->second.index == leaf;
      out_ +=
          "  update " + ir::written_name(graph_.leaves[leaf].name) + " <- " + at(v) + (in_place ? " in place\n" : "\n");
    }
    out_ += "}\n";
  }

  void write_values(const char* what, const std::vector<ValueId>& values) {
    if (values.empty()) return;
    out_ += what;
    for (const ValueId v : values) out_ += " " + at(v);
    out_ += "\n";
  }

  void write_pass(const Pass& pass, const std::vector<ValueId>& inputs) {
    out_ += "  pass " + ir::written_name(pass.name) + " " + kind_name(pass) + " " +
            (pass.domain.is_unit() ? "[1]" : pass.domain.str()) + (pass.steady ? "\n" : " prologue\n");
    out_ += "    reads";
    for (const ValueId v : pass.reads) out_ += (std::ranges::find(inputs, v) != inputs.end() ? " input:" : " ") + at(v);
    out_ += "\n    ops";
    for (const OpId& id : pass.ops) out_ += (&id == pass.ops.data() ? " " : ", ") + op(id);
    out_ += "\n    writes";
    for (const ValueId v : pass.writes) out_ += " " + at(v);
    out_ += "\n";
    std::visit([&](const auto& own) { write_decisions(own); }, pass.of_kind);
  }

  void write_decisions(const MapPass& map) {
    write_values("    partial", map.partial);
    if (map.rest) write_rest(*map.rest);
    if (map.block) write_block(*map.block);
    if (map.code.lists_in_runs) out_ += "    lists in runs\n";
    if (map.code.joining_group != kJoiningGroup)
      out_ += "    workgroups of " + std::to_string(map.code.joining_group) + "\n";
    if (map.code.in_tiles) out_ += "    in tiles\n";
    if (map.code.each > 1) out_ += "    up to " + std::to_string(map.code.each) + " elements in turn\n";
    if (map.code.heavy) write_heavy(*map.code.heavy);
    write_cut("    cut loops ", map.code.cut);
    if (map.code.heavy) write_cut("    cut heavy loops ", map.code.heavy->cut);
    write_values("    tells", map.code.told);
  }

  void write_decisions(const FragmentPass&) {}
  void write_decisions(const ReducePass& reduce) {
    if (reduce.in_teams) out_ += "    in teams\n";
  }

  void write_decisions(const ScatterPass& scatter) {
    for (const ScatterSum& sum : scatter.sums) {
      out_ += "    sum " + at(sum.value) + " of";
      for (const ValueId v : sum.terms) out_ += " " + use(v);
      out_ += "\n";
    }
    const Clauses& clauses = scatter.clauses();
    if (!clauses.empty()) out_ += "    active";
    for (size_t c = 0; c < clauses.size(); ++c)
      for (size_t i = 0; i < clauses[c].size(); ++i)
        out_ += (i > 0 ? " and " : c > 0 ? ", or " : " ") + at(clauses[c][i]);
    if (!clauses.empty()) out_ += "\n";
    if (const auto lister = scatter.lister())
      out_ += (scatter.joined_run() != nullptr ? "    joins " : "    listed by ") + pass_at(*lister) + "\n";
    if (scatter.keeps_terms()) out_ += "    keeps terms\n";
    if (scatter.runs_again()) out_ += "    again\n";
    if (scatter.guesses()) out_ += scatter.asks() ? "    guesses exponents, asked\n" : "    guesses exponents\n";
    if (scatter.shares_loops()) out_ += "    shares loops\n";
    if (scatter.joins_lanes()) out_ += "    join lanes\n";
    if (scatter.joins_parts()) out_ += "    join parts\n";
    if (scatter.joins_groups()) out_ += "    join workgroups\n";
    if (scatter.joins_pairs()) out_ += "    join pairs\n";
    if (scatter.joins_runs() > 0) out_ += "    join runs of " + std::to_string(scatter.joins_runs()) + "\n";
    if (scatter.relists()) out_ += "    relist\n";
    write_values("    if not zero", scatter.nonzero());
    if (!scatter.no_rows().empty()) out_ += "    no rows " + ir::quoted_text(scatter.no_rows()) + "\n";
    if (const auto* rows = std::get_if<RowsScatter>(&scatter.how)) write_rows(*rows);
    const ActiveList* list = scatter.active_list();
    const OwnList* own = list == nullptr ? nullptr : std::get_if<OwnList>(&list->listed_by);
    if (own != nullptr && own->in_runs) out_ += "    lists in runs\n";
    write_cut("    cut loops ", scatter.cut());
    if (const auto* atomic = std::get_if<AtomicScatter>(&scatter.how); atomic != nullptr && atomic->skips_zeros)
      out_ += "    skips zeros\n";
  }

  void write_decisions(const RasterPass& raster) {
    if (raster.setup) out_ += "    set up by " + pass_at(raster.setup->pass) + "\n";
    if (const auto& turn = raster.walk.in_turn) {
      out_ += "    up to " + std::to_string(turn->each) + " faces in turn";
      if (turn->shown.empty())
        out_ += "\n";
      else
        write_values(" where", turn->shown);
    }
    if (raster.walk.wanted) out_ += "    looks at bits of " + at(*raster.walk.wanted) + "\n";
    if (raster.rows) out_ += "    gives rows " + at(*raster.rows) + "\n";
    const std::string watched = raster.walk.watched ? ", watched\n" : "\n";
    if (const auto& bins = raster.walk.lists)
      out_ += "    walks faces of " + std::to_string(bins->small_box) + " alone, " +
              (bins->few_box > 0 ? "or of " + std::to_string(bins->few_box) + " if few, of " : "of ") +
              std::to_string(bins->middle_box) + " by " + std::to_string(bins->team) + " in " +
              std::to_string(bins->middle_invocations) + ", others in " + std::to_string(bins->large_invocations) +
              watched;
    else if (raster.walk.watched)
      out_ += "    walks faces alone" + watched;
  }

  void write_decisions(const DrawnRasterPass&) {}

  void write_rest(const AtRest& rest) {
    out_ += "    rests without " + pass_at(rest.gradient) +
            (rest.lists_in_runs ? ", listed in runs\n"
             : rest.in_bits     ? ", marked in bits\n"
             : rest.in_blocks   ? ", marked in blocks\n"
                                : "\n");
    write_values("    memory", rest.memory);
    for (const OpId& id : rest.gathers) out_ += (&id == rest.gathers.data() ? "    looks at " : ", ") + op(id);
    if (!rest.gathers.empty()) out_ += "\n";
  }

  void write_heavy(const HeavyBranches& heavy) {
    for (const OpId& id : heavy.ops) out_ += (&id == heavy.ops.data() ? "    heavy " : ", ") + op(id);
    for (const OpId& id : heavy.unlikely) out_ += (&id == heavy.unlikely.data() ? " unlikely " : ", ") + op(id);
    out_ += std::string(heavy.by_subgroups ? " by subgroups" : "") +
            (heavy.apart > 0 ? " apart " + std::to_string(heavy.apart) : "") +
            (heavy.shares_loops ? " sharing loops" : "") + "\n";
  }

  static std::string numbers(const std::array<int, 3>& n) {
    return std::to_string(n[0]) + " " + std::to_string(n[1]) + " " + std::to_string(n[2]);
  }

  void write_block(const Block& block) {
    out_ += "    block " + numbers(block.each) + "\n";
    if (!block.together) return;
    const GroupReads& together = *block.together;
    out_ += "    read together";
    for (const OpId& id : together.gathers) out_ += (&id == together.gathers.data() ? " " : ", ") + op(id);
    out_ +=
        " by " + numbers(together.group) + " for " + std::to_string(together.trips) + " of " + op(together.loop) + "\n";
  }

  void write_rows(const RowsScatter& rows) {
    std::visit([&](const auto& table) { write_table(table, rows.targets); }, rows.table);
    if (rows.lanes > 1) out_ += "    rows by " + std::to_string(rows.lanes) + " lanes\n";
  }

  void write_table(const RowsOfLeaf& table, const ir::Dim& targets) {
    if (table.columns.empty()) return;
    out_ += "    rows " + ir::written_name(graph_.leaves[table.leaf].name) + "[";
    for (size_t c = 0; c < table.columns.size(); ++c) out_ += (c ? ", " : "") + std::to_string(table.columns[c]);
    out_ += "] of " + targets.str() + "\n";
  }

  void write_table(const SortedRows& table, const ir::Dim& targets) {
    out_ += "    rows sorted of " + targets.str() + "\n";
    for (const ScatterLeaf& place : table.places) {
      out_ += "      place " + use(place.index) + " adds " + use(place.value);
      for (const ScatterLeaf::Branch& branch : place.path)
        out_ += (&branch == place.path.data() ? " in " : ", ") + op(branch.op) + " branch " +
                std::to_string(branch.region) + (branch.in_table ? " of the table" : "");
      out_ += "\n";
    }
  }

  const Graph& graph_;
  const Schedule& schedule_;
  std::vector<uint32_t> numbers_;
  const StepSchedule* step_ = nullptr;
  std::map<uint32_t, int> held_;  // values in a resource, in this step
  std::string out_;
};

}  // namespace

std::string print(const Graph& graph, const Schedule& schedule) { return Writer(graph, schedule).text(); }

std::string print_whole(const Graph& graph, const Schedule& schedule) {
  return ir::print(graph) + print(graph, schedule);
}

}  // namespace dr::backend
