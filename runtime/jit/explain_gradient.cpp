// SPDX-License-Identifier: Apache-2.0
#include "runtime/jit/explain_gradient.h"

#include <nlohmann/json.hpp>

#include "compiler/driver/explained_gradient.h"

namespace dr::jit {

using Json = nlohmann::ordered_json;

namespace {

Json marks(const std::vector<driver::ExplainedGradient::Mark>& from) {
  Json out = Json::array();
  for (const auto& mark : from) out.push_back({{"place", mark.place}, {"reason", mark.reason}});
  return out;
}

}  // namespace

std::variant<Explanation, std::string> explain_gradient(const std::string& name, const std::string& text,
                                                        const Options& options, const std::string& loss,
                                                        const std::string& target) {
  driver::Compilation program(name, text, options);
  if (program.lowered() == nullptr) return program.messages();
  const auto explained = driver::explain_gradient(program, loss, target);
  if (const auto* problem = std::get_if<std::string>(&explained)) return *problem;
  const auto& found = std::get<driver::ExplainedGradient>(explained);
  Json paths = Json::array();
  for (const auto& path : found.paths) {
    Json stops = Json::array();
    for (const auto& stop : path)
      stops.push_back({{"name", stop.name}, {"place", stop.place}, {"through", stop.through}});
    paths.push_back(std::move(stops));
  }
  const Json out = {{"flows", found.flows},      {"summary", found.summary},       {"text", found.text()},
                    {"paths", std::move(paths)}, {"more_paths", found.more_paths}, {"clamps", marks(found.clamps)},
                    {"cuts", marks(found.cuts)}};
  return Explanation{out.dump(-1, ' ', false, Json::error_handler_t::replace)};
}

}  // namespace dr::jit
