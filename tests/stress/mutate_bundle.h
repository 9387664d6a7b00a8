// SPDX-License-Identifier: Apache-2.0
// Bundles as a stranger would write them: one that drc made, with a few fields or one word of SPIR-V changed.
#pragma once

#include <random>

#include "compiler/backend/bundle/bundle.h"

namespace dr::test {

using Random = std::mt19937_64;

// One to four changes of the tables.
void mutate_tables(bundle::BundleT& bundle, Random& random);
// One word of one shader.
void mutate_spirv(bundle::BundleT& bundle, Random& random);

}  // namespace dr::test
