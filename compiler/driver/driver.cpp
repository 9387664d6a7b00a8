// SPDX-License-Identifier: Apache-2.0
#include "compiler/driver/driver.h"

#include <algorithm>
#include <sstream>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/pipeline.h"
#include "compiler/backend/plan/show.h"
#include "compiler/backend/schedule/structure.h"
#include "compiler/backend/schedule/text.h"
#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/ir/internal_error.h"
#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "compiler/lower/lower.h"

namespace dr::driver {
namespace {

std::string lines(const std::vector<std::string>& violations) {
  std::string out;
  for (const std::string& violation : violations) out += (out.empty() ? "" : "\n") + violation;
  return out;
}

std::vector<std::string> parts_of(const std::string& text, char at) {
  std::vector<std::string> out;
  std::stringstream stream(text);
  for (std::string part; std::getline(stream, part, at);) out.push_back(part);
  return out;
}

std::optional<passes::Adjoint> adjoint_of(const std::string& words) {
  const std::vector<std::string> parts = parts_of(words, ':');
  if (parts.size() != 3) return std::nullopt;
  return passes::Adjoint{parts[0], parts_of(parts[1], ','), parts_of(parts[2], ',')};
}

}  // namespace

std::vector<std::string> graph_pass_names() {
  std::vector<std::string> names;
  for (const passes::Pass& pass : passes::default_passes())
    if (std::ranges::find(names, pass.name) == names.end()) names.emplace_back(pass.name);
  return names;
}

std::vector<std::string> schedule_pass_names() {
  std::vector<std::string> names;
  for (const backend::BackendPass& pass : backend::backend_passes()) {
    if ((pass.makes & static_cast<backend::Facts>(backend::Fact::Emitted)) != 0) break;
    names.emplace_back(pass.name);
  }
  return names;
}

std::vector<std::string> bundle_pass_names() {
  std::vector<std::string> names;
  const size_t schedules = schedule_pass_names().size();
  for (const backend::BackendPass& pass : backend::backend_passes().subspan(schedules)) names.emplace_back(pass.name);
  return names;
}

Compilation::Compilation(std::string name, std::string text, Options options, Hooks hooks)
    : options_(std::move(options)),
      hooks_(std::move(hooks)),
      is_graph_(name.ends_with(".ir")),
      is_schedule_(name.ends_with(".schedule")) {
  const bool is_bundle = bundle::has_identifier(text);
  const std::string file = name;
  file_ = sources_.add(std::move(name), is_bundle ? std::string() : std::move(text));
  if (is_bundle)
    fail({Error::Kind::User, "'" + file +
                                 "' is a bundle, which is compiled already: drun runs it where its name ends in "
                                 ".drb, drc inspect shows it"});
}

std::nullptr_t Compilation::fail(Error error) {
  error_ = std::move(error);
  return nullptr;
}

std::string Compilation::messages() const {
  std::string out = dsl::format(diagnostics_, sources_);
  if (!error_) return out;
  const std::string name(sources_.name(file_));
  if (error_->line != 0) return out + name + ":" + std::to_string(error_->line) + ": error: " + error_->text + "\n";
  if (error_->kind == Error::Kind::Limit) return out + name + ": error: " + error_->text + "\n";
  return out + "error: " + error_->text + "\n";
}

// An internal error within `make` says where what reproduces it is.
template <typename Make>
auto Compilation::keeping_reproducer(const ir::Graph& graph, const Make& make) {
  try {
    return make();
  } catch (const ir::InternalError& error) {
    const std::string file = keep_reproducer(graph, options_, error.what());
    if (file.empty()) throw;
    throw ir::InternalError(std::string(error.what()) + "\nThis is a mistake of the compiler. The graph is kept in " +
                            file + "; this shows the mistake again:\n  drc build " + file + " --emit=bundle -o -" +
                            command_line(options_));
  }
}

const target::Profile* Compilation::profile() {
  if (profile_) return &*profile_;
  auto loaded = target::load_profile(options_.profile);
  if (const auto* problem = std::get_if<std::string>(&loaded)) return fail({Error::Kind::User, *problem});
  profile_ = std::get<target::Profile>(std::move(loaded));
  return &*profile_;
}

// A graph from the compiler that is unsound is the compiler's mistake; one from a file is the user's.
const ir::Graph* Compilation::read_graph() {
  const std::string text(sources_.text(file_));
  if (is_schedule_) {
    auto parsed = backend::parse_schedule(text);
    if (const auto* problem = std::get_if<ir::ParseError>(&parsed))
      return fail({Error::Kind::User, problem->message, problem->line});
    lowered_ = std::get<backend::ParsedSchedule>(parsed).graph;
    schedule_ = std::get<backend::ParsedSchedule>(std::move(parsed)).schedule;
  } else {
    auto parsed = ir::parse(text);
    if (const auto* problem = std::get_if<ir::ParseError>(&parsed))
      return fail({Error::Kind::User, problem->message, problem->line});
    lowered_ = std::get<ir::Graph>(std::move(parsed));
  }
  std::optional<Error> error;
  if (const auto violations = passes::verify(*lowered_); !violations.empty())
    error = Error{Error::Kind::User, lines(violations)};
  else if (is_schedule_)
    error = wrong_schedule();
  if (!error) return &*lowered_;
  lowered_.reset();
  return fail(*std::move(error));
}

std::optional<Error> Compilation::wrong_schedule() {
  const std::vector<std::string> known = schedule_pass_names();
  if (std::ranges::find(known, schedule_.after) == known.end()) {
    const auto nearest = dsl::nearest_name(schedule_.after, known);
    return Error{Error::Kind::User, "the schedule is after '" + schedule_.after + "', which is no pass over schedules" +
                                        (nearest ? ", did you mean '" + *nearest + "'?" : "")};
  }
  const bool has_profile = profile_ || !options_.profile.empty();  // the evaluator needs none
  if (has_profile && !profile()) return error_;
  std::vector<std::string> unsound;
  for (const backend::Violation& v : has_profile ? backend::check_schedule(*lowered_, schedule_, *profile_)
                                                 : backend::check_structure(*lowered_, schedule_))
    if (v.kind == backend::Violation::Kind::Unsound) unsound.push_back(v.text);
  if (unsound.empty()) return std::nullopt;
  return Error{Error::Kind::User, lines(unsound)};
}

// Known values of what is no input of one element and so many components.
std::optional<Error> Compilation::wrong_known() const {
  for (const auto& [name, numbers] : options_.known) {
    const auto index = lowered_->leaf_index(name);
    const std::string expected = "expected an input of one element of floats for --known, found '" + name + "', ";
    if (!index) {
      std::vector<std::string> inputs;
      for (const ir::Leaf& leaf : lowered_->leaves)
        if (leaf.kind == ir::Leaf::Kind::Input) inputs.push_back(leaf.name);
      const auto nearest = dsl::nearest_name(name, inputs);
      return Error{Error::Kind::User, expected + "which the program does not have" +
                                          (nearest ? ", did you mean '" + *nearest + "'?" : "")};
    }
    const ir::Leaf& leaf = lowered_->leaves[*index];
    if (leaf.kind != ir::Leaf::Kind::Input)
      return Error{Error::Kind::User, expected + "a " + (leaf.kind == ir::Leaf::Kind::Param ? "param" : "state") +
                                          ", whose value changes"};
    if (!leaf.extent.is_unit() || !leaf.type.is_float())
      return Error{Error::Kind::User, expected + leaf.type.str() + leaf.extent.str()};
    const auto components = static_cast<size_t>(leaf.type.components());
    if (numbers.size() != 1 && numbers.size() != components)
      return Error{Error::Kind::User,
                   "expected one number" + (components == 1 ? "" : " or " + std::to_string(components)) +
                       " as the --known value of '" + name + "', found " + std::to_string(numbers.size())};
  }
  return std::nullopt;
}

const ir::Graph* Compilation::lowered() {
  if (lowered_) return &*lowered_;
  if (error_ || diagnostics_.has_errors()) return nullptr;
  if (is_graph_ || is_schedule_) return read_graph();
  lower::Options lowering;
  lowering.include_dirs = options_.include_dirs;
  lowering.plain_gradients = options_.plain_gradients;
  lowering.defines = options_.defines;
  lowering.known = options_.known;
  lowering.bound = options_.bound;
  lowering.find_zeros = std::ranges::find(options_.ablate, "layers") == options_.ablate.end();
  lower::Options::ZeroCount zeros;
  lowering.zero_count = &zeros;
  for (const std::string& words : options_.adjoints)
    if (const auto adjoint = adjoint_of(words)) lowering.open.insert(adjoint->leaves.begin(), adjoint->leaves.end());
  lowering.parse_milliseconds = &parse_milliseconds_;
  if (!options_.profile.empty() || profile_) {
    if (!profile()) return nullptr;
    for (auto& define : backend::build_defines(options_.ablate, *profile_)) lowering.defines.insert(std::move(define));
  }
  lowered_ = lower::lower(sources_, file_, lowering, diagnostics_);
  if (!lowered_) return nullptr;
  left_out_.layers = zeros.zero;
  left_out_.layers_kept = zeros.other;
  if (auto wrong = wrong_known()) {
    lowered_.reset();
    return fail(*std::move(wrong));
  }
  for (const std::string& words : options_.adjoints) {
    const auto adjoint = adjoint_of(words);
    if (!adjoint)
      return fail({Error::Kind::User, "expected STEP:LEAF,...:OUTPUT,... for an adjoint, found '" + words + "'"});
    auto more = passes::add_adjoint(*lowered_, *adjoint);
    if (auto* problem = std::get_if<std::string>(&more)) return fail({Error::Kind::User, std::move(*problem)});
    lowered_ = std::get<ir::Graph>(std::move(more));
  }
  if (!hooks_.verify_each) return &*lowered_;
  if (const auto violations = passes::verify(*lowered_); !violations.empty())
    keeping_reproducer(*lowered_, [&]() -> int { DR_ICE("lowering gave an unsound graph\n" + lines(violations)); });
  return &*lowered_;
}

const ir::Graph* Compilation::differentiated() {
  if (differentiated_) return &*differentiated_;
  if (!lowered()) return nullptr;
  if (is_schedule_) return &*lowered_;
  std::vector<passes::Pass> chosen;
  const std::span<const passes::Pass> known = passes::default_passes();
  if (hooks_.passes) {
    for (const std::string& name : *hooks_.passes) {
      const auto found = std::ranges::find(known, name, &passes::Pass::name);
      if (found == known.end()) return fail({Error::Kind::User, "unknown pass '" + name + "'"});
      chosen.push_back(*found);
    }
  } else {
    chosen.assign(known.begin(), known.end());
  }
  if (const auto last = std::ranges::find(chosen, hooks_.stop_after, &passes::Pass::name); last != chosen.end())
    chosen.erase(last + 1, chosen.end());
  passes::PipelineOptions pipeline;
  pipeline.verify_each = hooks_.verify_each;
  pipeline.skips = backend::pass_skips(options_.ablate);
  pipeline.skips.left_out = &left_out_;
  if (hooks_.after)
    pipeline.after = [&](std::string_view name, const ir::Graph& graph, double milliseconds) {
      hooks_.after(
          name, [&] { return ir::print(graph); }, milliseconds);
    };
  differentiated_ = keeping_reproducer(*lowered_, [&] { return passes::run_passes(*lowered_, chosen, pipeline); });
  return &*differentiated_;
}

const backend::Compiled* Compilation::compiled() {
  if (compiled_) return &*compiled_;
  if (!differentiated() || !profile()) return nullptr;
  const ir::Graph& graph = *differentiated();
  auto options = backend::compile_options(options_.lower, options_.raster, options_.pack, options_.ablate,
                                          options_.scatter, options_.float_profile);
  if (const auto* problem = std::get_if<std::string>(&options)) return fail({Error::Kind::User, *problem});
  auto& chosen = std::get<backend::CompileOptions>(options);
  if (!is_graph_ && !is_schedule_) chosen.lines = backend::SourceLines(graph, sources_);
  if (options_.shader_cache) chosen.cache_folder = backend::default_cache_folder();
  chosen.hooks.verify_each = hooks_.verify_each;
  chosen.hooks.stop_after = hooks_.stop_after;
  chosen.hooks.break_after = hooks_.break_after;
  if (hooks_.after)
    chosen.hooks.after = [&](std::string_view name, const ir::Graph& of, const backend::Schedule* schedule,
                             const bundle::BundleT& bundle, double milliseconds) {
      hooks_.after(
          name, [&] { return schedule ? backend::print_whole(of, *schedule) : backend::show(bundle); }, milliseconds);
    };
  auto result = keeping_reproducer(graph, [&] { return backend::compile(graph, *profile_, chosen, schedule_); });
  if (const auto* limit = std::get_if<backend::Limit>(&result)) return fail({Error::Kind::Limit, limit->text});
  compiled_ = std::get<backend::Compiled>(std::move(result));
  return &*compiled_;
}

}  // namespace dr::driver
