// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pipeline.h"

#include <bit>
#include <chrono>
#include <set>
#include <tuple>

#include "compiler/backend/analysis/fold_memory.h"
#include "compiler/backend/emit/generator.h"
#include "compiler/backend/lowering/add_where_computed.h"
#include "compiler/backend/lowering/block_loops.h"
#include "compiler/backend/lowering/choose_code.h"
#include "compiler/backend/lowering/clear_by_epochs.h"
#include "compiler/backend/lowering/clear_where_listed.h"
#include "compiler/backend/lowering/empty_sums.h"
#include "compiler/backend/lowering/guess_exponents.h"
#include "compiler/backend/lowering/keep_in_tiles.h"
#include "compiler/backend/lowering/keep_sums.h"
#include "compiler/backend/lowering/leave_at_rest.h"
#include "compiler/backend/lowering/list_where_computed.h"
#include "compiler/backend/lowering/raster_entries.h"
#include "compiler/backend/lowering/recompute_second_run.h"
#include "compiler/backend/lowering/reduce_where_computed.h"
#include "compiler/backend/lowering/scatter.h"
#include "compiler/backend/lowering/set_up_in_raster.h"
#include "compiler/backend/lowering/update_in_place.h"
#include "compiler/backend/pack/join_captures.h"
#include "compiler/backend/pack/loop_over_layers.h"
#include "compiler/backend/pack/pack.h"
#include "compiler/backend/pack/transform_at_faces.h"
#include "compiler/backend/plan/dependencies.h"
#include "compiler/backend/plan/plan_memory.h"
#include "compiler/backend/shaders.h"
#include "compiler/ir/print.h"

namespace dr::backend {
namespace {

using Outcome = std::optional<Limit>;

Outcome run_pack(Compilation& c) {
  const PackOptions options = pack_options(c.profile, c.options);
  const auto take = [&](Joined&& joined) {
    c.lines = c.lines.moved(joined.from);
    c.out.joined = std::move(joined.graph);
  };
  if (auto looping = loop_over_layers(c.graph(), c.profile)) take(std::move(*looping));
  if (options.fused)
    if (auto moved = transform_at_faces(c.graph(), c.profile)) take(std::move(*moved));
  for (;;) {
    c.out.schedule = pack(c.graph(), c.profile, options);
    // What a raster found is one buffer to those that read it.
    Schedule counted = c.out.schedule;
    keep_entries(c.graph(), c.profile, counted);
    auto joined = join_captures(c.graph(), counted, c.profile);
    if (!joined) return std::nullopt;
    take(std::move(*joined));
  }
}

Outcome run_reduce_where_computed(Compilation& c) {
  // What the driver's own floats give differs from shader to shader.
  if (pack_options(c.profile, c.options).fused && !c.options.native_floats)
    reduce_where_computed(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_choose_sums(Compilation& c) {
  const ScatterOptions options{c.options.scatter, c.options.stages, c.options.list_active};
  if (auto problem = legalize_scatter(c.graph(), c.profile, options, c.out.schedule)) return Limit{*problem};
  return std::nullopt;
}

Outcome run_update_in_place(Compilation& c) {
  update_in_place(c.graph(), c.out.schedule);
  return std::nullopt;
}

Outcome run_keep_in_tiles(Compilation& c) {
  keep_in_tiles(c.graph(), c.out.schedule);
  return std::nullopt;
}

Outcome run_add_where_computed(Compilation& c) {
  if (c.options.list_active && c.options.guess_exponents && !c.options.native_floats)
    add_where_computed(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_list_where_computed(Compilation& c) {
  list_where_computed(c.graph(), c.profile, c.options.list_branches, c.out.schedule);
  return std::nullopt;
}

Outcome run_keep_entries(Compilation& c) {
  keep_entries(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_keep_sums(Compilation& c) {
  keep_sums(c.graph(), c.out.schedule);
  return std::nullopt;
}

Outcome run_guess_exponents(Compilation& c) {
  if (c.options.guess_exponents && !c.options.native_floats) guess_exponents(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_recompute_second_run(Compilation& c) {
  recompute_second_run(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_clear_where_listed(Compilation& c) {
  if (c.options.empty_sums) clear_where_listed(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_set_up_in_raster(Compilation& c) {
  set_up_in_raster(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_leave_at_rest(Compilation& c) {
  if (c.options.leave_at_rest) leave_at_rest(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_block_loops(Compilation& c) {
  if (c.options.block_loops) block_loops(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_choose_code(Compilation& c) {
  choose_code(c.graph(), c.profile, {c.options.list_branches, c.options.native_floats}, c.out.schedule);
  return std::nullopt;
}

Outcome run_empty_sums(Compilation& c) {
  if (c.options.empty_sums) empty_sums(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

Outcome run_clear_by_epochs(Compilation& c) {
  if (c.options.empty_sums) clear_by_epochs(c.graph(), c.profile, c.out.schedule);
  return std::nullopt;
}

// Some of the lines behind ops, those of the program before those of the library: " (fit.dr:3, fit.dr:8, ...)".
std::string lines_behind(const SourceLines& lines, const std::vector<ir::OpId>& ops) {
  constexpr size_t kMost = 4;
  std::set<std::tuple<bool, std::string, uint32_t>> all;
  for (const ir::OpId id : ops)
    if (const auto line = lines.of(id)) {
      const std::string& file = lines.files()[line->file()];
      all.emplace(file.starts_with("std/"), file, line->line());
    }
  std::string out;
  size_t count = 0;
  for (const auto& [library, file, line] : all)
    if (++count <= kMost) out += (count == 1 ? " (" : ", ") + file + ":" + std::to_string(line);
  return out + (count > kMost ? ", ...)" : count > 0 ? ")" : "");
}

// The last word on limits, whatever the passes before took care of.
Outcome run_check_limits(Compilation& c) {
  std::string limits;
  for (const Violation& v : check_schedule(c.graph(), c.out.schedule, c.profile)) {
    if (v.kind != Violation::Kind::Limit) continue;
    limits += (limits.empty() ? "" : "\n") + v.text + lines_behind(c.lines, v.ops);
    if (v.of_buffers) limits += "; passes of other ops, as with '--pack naive' or '--lower fragment', may fit";
  }
  if (const auto loops = folds_over_limit(c.graph(), c.lines)) limits += (limits.empty() ? "" : "\n") + *loops;
  if (limits.empty()) return std::nullopt;
  return Limit{limits};
}

Outcome run_emit(Compilation& c) {
  bundle::BundleT& bundle = c.out.bundle;
  const PackOptions packing = pack_options(c.profile, c.options);
  bundle.version = bundle::kVersion;
  bundle.profile = c.profile.name;
  bundle.loop_trips = c.out.schedule.code.loop_trips;
  bundle.float_profile = c.out.schedule.code.native ? bundle::FloatProfile::Native : bundle::FloatProfile::Strict;
  const bool naive = !packing.fused && !packing.recompute && !packing.stages;
  bundle.packing = naive ? bundle::Packing::Naive : bundle::Packing::Fused;
  bundle.lowering = packing.fragment ? bundle::Lowering::Fragment : bundle::Lowering::Compute;
  bundle.raster = packing.hardware_raster ? bundle::RasterLowering::Hardware : bundle::RasterLowering::Compute;
  bundle.graph = ir::print(c.graph());
  if (!c.lines.files().empty()) bundle.op_lines = c.lines.in_text_order(c.graph());
  c.generator = std::make_unique<Generator>(c.graph(), c.out.schedule, c.lines);
  c.generator->process(bundle, c.out.glsl);
  return std::nullopt;
}

Outcome run_find_dependencies(Compilation& c) {
  find_dependencies(c.out.bundle);
  return std::nullopt;
}

Outcome run_clear_together(Compilation& c) {
  c.generator->clear_together();
  if (auto limit = words_over_limit(c.out.bundle)) return limit;
  return bindings_over_limit(c.out.bundle, c.profile);
}

Outcome run_plan_memory(Compilation& c) {
  bundle::BundleT& bundle = c.out.bundle;
  plan_memory(bundle);
  if (!c.options.share_memory)
    for (uint32_t k = 0; k < bundle.resources.size(); ++k) bundle.resources[k]->slot = k;
  if (const auto problems = check_memory(bundle); !problems.empty()) DR_ICE(problems.front());
  return std::nullopt;
}

Outcome run_assemble(Compilation& c) {
  assemble_shaders(c.options.cache_folder, c.out);
  return std::nullopt;
}

constexpr Facts only(Fact fact) { return static_cast<Facts>(fact); }

constexpr BackendPass kPasses[] = {
    {"pack", run_pack, 0, only(Fact::Packed), only(Fact::PlacesFixed)},
    {"reduce-where-computed", run_reduce_where_computed, only(Fact::Packed), 0,
     Fact::PlacesFixed | Fact::SumsChosen | Fact::EntriesKept | Fact::Lowered},
    {"keep-entries", run_keep_entries, only(Fact::Packed), only(Fact::EntriesKept),
     Fact::PlacesFixed | Fact::SumsChosen | Fact::Lowered},
    {"choose-sums", run_choose_sums, only(Fact::Packed), only(Fact::SumsChosen), only(Fact::PlacesFixed)},
    {"update-in-place", run_update_in_place, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"keep-in-tiles", run_keep_in_tiles, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"add-where-computed", run_add_where_computed, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"list-where-computed", run_list_where_computed, Fact::Packed | Fact::SumsChosen, only(Fact::PlacesFixed),
     only(Fact::Lowered)},
    {"keep-sums", run_keep_sums, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"guess-exponents", run_guess_exponents, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"recompute-second-run", run_recompute_second_run, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"clear-where-listed", run_clear_where_listed, Fact::Packed | Fact::SumsChosen, 0, only(Fact::Lowered)},
    {"set-up-in-raster", run_set_up_in_raster, Fact::Packed | Fact::EntriesKept, only(Fact::PlacesFixed),
     only(Fact::Lowered)},
    {"block-loops", run_block_loops, Fact::Packed | Fact::SumsChosen | Fact::PlacesFixed, 0, only(Fact::Lowered)},
    {"leave-at-rest", run_leave_at_rest, Fact::Packed | Fact::SumsChosen | Fact::PlacesFixed, 0, only(Fact::Lowered)},
    {"choose-code", run_choose_code, Fact::Packed | Fact::SumsChosen | Fact::PlacesFixed | Fact::EntriesKept,
     only(Fact::CodeChosen), only(Fact::Lowered)},
    {"empty-sums", run_empty_sums, Fact::Packed | Fact::SumsChosen | Fact::CodeChosen, 0, only(Fact::Lowered)},
    {"clear-by-epochs", run_clear_by_epochs, Fact::Packed | Fact::EntriesKept | Fact::CodeChosen, 0,
     only(Fact::Lowered)},
    {"check-limits", run_check_limits, Fact::Packed | Fact::SumsChosen | Fact::CodeChosen, only(Fact::Lowered),
     only(Fact::Emitted)},
    {"emit", run_emit, only(Fact::Lowered), only(Fact::Emitted), only(Fact::CommandsFixed)},
    {"find-dependencies", run_find_dependencies, only(Fact::Emitted), only(Fact::Dependencies), 0},
    {"clear-together", run_clear_together, Fact::Emitted | Fact::Dependencies, only(Fact::CommandsFixed),
     only(Fact::Slots)},
    {"plan-memory", run_plan_memory, Fact::Dependencies | Fact::CommandsFixed, only(Fact::Slots), 0},
    {"assemble", run_assemble, only(Fact::CommandsFixed), only(Fact::Assembled), 0},
};

void require_facts(const BackendPass& pass, Facts have) {
  const auto first = [](Facts facts) {
    return std::string(fact_name(static_cast<Fact>(Facts{1} << std::countr_zero(facts))));
  };
  if (const Facts missing = pass.needs & ~have; missing != 0)
    DR_ICE("pass " + std::string(pass.name) + " needs '" + first(missing) + "', which no pass before it establishes");
  if (const Facts late = pass.before & have; late != 0)
    DR_ICE("pass " + std::string(pass.name) + " has to run before '" + first(late) + "' is established");
}

void require_sound(const Compilation& c, std::string_view pass) {
  std::string message;
  for (const Violation& v : check_schedule(c.graph(), c.out.schedule, c.profile))
    if (v.kind == Violation::Kind::Unsound) message += "\n  " + v.text;
  if (!message.empty())
    DR_ICE("schedule fails verification after pass " + std::string(pass) + message + "\n" +
           print(c.graph(), c.out.schedule));
}

std::string wrong_bundle(const bundle::BundleT& bundle, size_t shaders, Facts have) {
  const auto holds = [&](Fact fact) { return (have & static_cast<Facts>(fact)) != 0; };
  for (const auto& step : bundle.steps)
    for (const auto& command : step->commands) {
      const std::string where = "step " + step->name + ", command " + command->label + ": ";
      bool sound = true;
      for_each_access(*command, [&](uint32_t r, bundle::Access) { sound = sound && r < bundle.resources.size(); });
      if (!sound) return where + "names no resource";
      for (const int shader : {command->compute, command->next, command->vertex, command->fragment})
        if (shader >= static_cast<int>(shaders)) return where + "names no shader";
      for (const uint32_t leaf : command->leaves)
        if (leaf >= bundle.leaves.size()) return where + "depends on no leaf";
    }
  if (holds(Fact::Slots))
    if (const auto problems = check_memory(bundle); !problems.empty()) return problems.front();
  return holds(Fact::Slots) && holds(Fact::Assembled) ? bundle::check(bundle) : "";
}

void require_sound_bundle(const Compilation& c, std::string_view pass, Facts have) {
  const std::string problem = wrong_bundle(c.out.bundle, c.out.glsl.size(), have);
  if (!problem.empty()) DR_ICE("bundle fails verification after pass " + std::string(pass) + "\n  " + problem);
}

// As a pass with a mistake would: what schedules write, or resources that commands name, are gone.
void make_unsound(Compiled& out, bool is_schedule) {
  if (!is_schedule) return out.bundle.resources.clear();
  for (StepSchedule& step : out.schedule.steps)
    for (Pass& pass : step.passes) pass.writes.clear();
}

}  // namespace

std::string_view fact_name(Fact fact) {
  switch (fact) {
    case Fact::Packed: return "packed";
    case Fact::SumsChosen: return "sums chosen";
    case Fact::PlacesFixed: return "places of passes fixed";
    case Fact::EntriesKept: return "entries kept";
    case Fact::Lowered: return "lowered";
    case Fact::Emitted: return "emitted";
    case Fact::Dependencies: return "dependencies";
    case Fact::CommandsFixed: return "commands fixed";
    case Fact::Slots: return "slots";
    case Fact::Assembled: return "assembled";
    case Fact::CodeChosen: return "code chosen";
  }
  return "";
}

Compilation::Compilation(const ir::Graph& g, const target::Profile& p, const CompileOptions& o, Schedule schedule)
    : profile(p), options(o), lines(o.lines), given_(g) {
  out.schedule = std::move(schedule);
}
Compilation::~Compilation() = default;

std::span<const BackendPass> backend_passes() { return kPasses; }

std::optional<Limit> run_backend(Compilation& compilation, std::span<const BackendPass> passes) {
  const PassHooks& hooks = compilation.options.hooks;
  std::string& last = compilation.out.schedule.after;
  const std::string done = last;
  bool is_done = !done.empty();
  Facts have = 0;
  for (const BackendPass& pass : passes) {
    const bool skips = is_done && (pass.makes & static_cast<Facts>(Fact::Lowered)) == 0;
    if (pass.name == done) is_done = false;
    if (skips) {
      have |= pass.makes;
      continue;
    }
    require_facts(pass, have);
    const auto start = std::chrono::steady_clock::now();
    if (auto limit = pass.run(compilation)) return limit;
    const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start;
    have |= pass.makes;
    if ((have & static_cast<Facts>(Fact::Emitted)) == 0) last = pass.name;
    const bool is_schedule = (have & static_cast<Facts>(Fact::Emitted)) == 0;
    if (pass.name == hooks.break_after) make_unsound(compilation.out, is_schedule);
    // A schedule is checked where it is done; after each pass on request.
    if (is_schedule && (hooks.verify_each || (pass.makes & static_cast<Facts>(Fact::Lowered)) != 0))
      require_sound(compilation, pass.name);
    if (!is_schedule && hooks.verify_each) require_sound_bundle(compilation, pass.name, have);
    if (hooks.after)
      hooks.after(pass.name, compilation.graph(), is_schedule ? &compilation.out.schedule : nullptr,
                  compilation.out.bundle, elapsed.count());
    if (pass.name == hooks.stop_after) break;
  }
  return std::nullopt;
}

}  // namespace dr::backend
