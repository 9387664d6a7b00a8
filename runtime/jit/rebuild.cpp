// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/rebuild.h"

#include <algorithm>
#include <tuple>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/ir/internal_error.h"
#include "compiler/ir/parse.h"

namespace dr::jit {

namespace {

using io::Error;
using io::Result;

Options with_lowering_of(const bundle::BundleT& bundle, Options options) {
  options.pack = bundle::word(EnumNamePacking(bundle.packing));
  options.lower = bundle::word(EnumNameLowering(bundle.lowering));
  options.raster = bundle::word(EnumNameRasterLowering(bundle.raster));
  options.float_profile = bundle::word(EnumNameFloatProfile(bundle.float_profile));
  if (options.profile.empty()) options.profile = bundle.profile;
  return options;
}

Result<backend::Compiled> compile(const bundle::BundleT& bundle, const Options& options,
                                  const runtime::Moving& moving) {
  auto compile = backend::compile_options(options.lower, options.raster, options.pack, options.ablate, options.scatter,
                                          options.float_profile);
  if (const auto* problem = std::get_if<std::string>(&compile)) return Error{*problem};
  auto& chosen = std::get<backend::CompileOptions>(compile);
  chosen.moving = moving;
  if (options.shader_cache) chosen.cache_folder = backend::default_cache_folder();
  const auto graph = ir::parse(bundle.graph);
  if (std::holds_alternative<ir::ParseError>(graph)) return Error{"the bundle's graph cannot be read"};
  chosen.lines = backend::SourceLines(std::get<ir::Graph>(graph), bundle);
  const auto profile = target::load_profile(options.profile);
  if (const auto* problem = std::get_if<std::string>(&profile)) return Error{*problem};
  auto compiled = backend::compile(std::get<ir::Graph>(graph), std::get<target::Profile>(profile), chosen);
  if (const auto* problem = std::get_if<backend::Limit>(&compiled)) return Error{problem->text};
  return std::move(std::get<backend::Compiled>(compiled));
}

bool same_shaders(const bundle::BundleT& a, const bundle::BundleT& b) {
  return std::ranges::equal(a.shaders, b.shaders, [](const auto& x, const auto& y) { return x->spirv == y->spirv; });
}

// What decides on the bits of scattered sums: those that one pass makes, of which terms, and how.
auto sums_of(const backend::Schedule& schedule) {
  using Sums = std::vector<std::pair<ir::ValueId, std::vector<ir::ValueId>>>;
  std::vector<std::tuple<size_t, backend::ScatterLowering, Sums>> out;
  for (size_t k = 0; k < schedule.steps.size(); ++k)
    for (const backend::Pass& pass : schedule.steps[k].passes) {
      const auto* scatter = pass.as<backend::ScatterPass>();
      if (scatter == nullptr || scatter->sums.empty()) continue;
      Sums sums;
      for (const backend::ScatterSum& sum : scatter->sums) sums.emplace_back(sum.value, sum.terms);
      out.emplace_back(k, scatter->lowering(), std::move(sums));
    }
  std::sort(out.begin(), out.end());
  return out;
}

Result<std::vector<uint8_t>> rebuild(const std::vector<uint8_t>& bytes, const Options& options,
                                     const runtime::Moving& moving) {
  const auto read = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&read)) return Error{*problem};
  const auto& bundle = std::get<bundle::BundleT>(read);
  const Options same = with_lowering_of(bundle, options);
  const auto before = compile(bundle, same, {});
  if (!before) return Error{before.error()};
  if (!same_shaders(before->bundle, bundle)) return Error{"these options do not give the bundle's shaders"};
  const auto after = compile(bundle, same, moving);
  if (!after) return Error{after.error()};
  if (sums_of(before->schedule) != sums_of(after->schedule)) return Error{"scattered values would sum in another way"};
  return bundle::write(after->bundle);
}

}  // namespace

runtime::Rebuild rebuilder(std::vector<uint8_t> bytes, const Options& options) {
  return [bytes = std::move(bytes), options](const runtime::Moving& moving) -> Result<std::vector<uint8_t>> {
    try {
      return rebuild(bytes, options, moving);
    } catch (const ir::InternalError& error) {
      return Error{std::string("internal error: ") + error.what()};  // the program goes on as it is
    }
  };
}

}  // namespace dr::jit
