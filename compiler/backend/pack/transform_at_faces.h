// SPDX-License-Identifier: Apache-2.0
// What a raster's faces read of a few cheap ops on leaves is computed at the faces, so that no pass over the vertices
// stands before the raster:
//   %p = add(mul(%m, %position), %offset) ; %a = gather %p, %i    =>    %q = gather %position, %i ;
//   %a = select(0 <= %i < V, add(mul(%m, %q), %offset), 0)
// So it is where cameras see a list in layers, by what the list is before (%q = gather %drawn, %i).
// A vertex is transformed once for each of its faces' corners, and again for all else that reads %p; in exchange, the
// device waits for one dispatch less in each run. No bit of any result changes: outside, a read gives 0 as before.
#pragma once

#include <optional>

#include "compiler/backend/pack/rewriter.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Nothing where there is nothing to move, where no step changes what is read, or on a device that is no GPU.
std::optional<Joined> transform_at_faces(const ir::Graph& graph, const target::Profile& profile);

}  // namespace dr::backend
