// SPDX-License-Identifier: Apache-2.0
// The tables of a bundle as text or JSON, also of one that is not done: shaders are numbers then.
#pragma once

#include <string>

#include "compiler/backend/bundle/bundle.h"

namespace dr::backend {

std::string show(const bundle::BundleT& bundle);
std::string show_json(const bundle::BundleT& bundle);
// The commands of a step, as JSON: what show_json() has under "commands".
std::string show_commands(const bundle::BundleT& bundle, const bundle::StepT& step);

}  // namespace dr::backend
