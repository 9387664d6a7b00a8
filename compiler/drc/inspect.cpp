// SPDX-License-Identifier: Apache-2.0
// `drc inspect`: the tables of a bundle as text or JSON. A bundle that is not sound gets the verifier's sentence.
#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/plan/show.h"
#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/drc/output.h"

namespace dr::drc {

int inspect(const InspectOptions& options) {
  const auto bytes = read_text(options.file);
  if (!bytes) return kUserError;
  const auto read = bundle::read(std::span(reinterpret_cast<const uint8_t*>(bytes->data()), bytes->size()));
  if (const auto* problem = std::get_if<std::string>(&read)) {
    print_error(options.file + ": " + *problem);
    return kUserError;
  }
  const auto& bundle = std::get<bundle::BundleT>(read);
  const std::string text = options.graph  ? bundle.graph
                           : options.json ? backend::show_json(bundle)
                                          : backend::show(bundle);
  return write_product("-", text) ? kOk : kUserError;
}

}  // namespace dr::drc
