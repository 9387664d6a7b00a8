// SPDX-License-Identifier: Apache-2.0
// Lists of elements that shaders make and that later dispatches run for.
#pragma once

#include <string>
#include <vector>

#include "compiler/backend/analysis/same_in_run.h"
#include "compiler/backend/glsl/shader.h"

namespace dr::backend {

using bundle::kListEnd, bundle::kListHead, bundle::kRestingBlock;

// A call that adds an element of `extent` to a list and gives its place there. Workgroups go on in the next row as
// those of other dispatches do. `together`: the lanes of a subgroup that are here take their places by one atomic.
// `shares`: so many invocations have an element, a power of two up to 64.
std::string append(glsl::Shader& s, const std::string& list, const std::string& element, const ir::Extent& extent,
                   bool together = false, int shares = 1);

// Invocations that have a run of kListedRun elements each, or words that have a bit for each element.
ir::Dim runs_of(const ir::Dim& elements);

// Changes `index` so that 32 invocations that follow each other have a rectangle of 8 x 4 elements, and 256 a square;
// in one dimension it stays.
void index_in_tiles(glsl::Shader& s, const ir::Extent& extent);

// The main of a shader that computes the elements of an extent and lists some of them. With `runs` an invocation
// computes 32 that follow each other, and lists them together: where lanes access memory in turn, an atomic costs a
// subgroup that lists nothing as much as any other; what they share is computed or read once (analysis/same_in_run.h).
// With `tiles`: see index_in_tiles().
class ListingLoop {
 public:
  // Opens it: behind, `at` is an element's place.
  ListingLoop(glsl::Shader& shader, const ir::Extent& extent, bool runs, bool tiles = false,
              const RunReads& shared = {});
  // Of the elements of an extent that stand on a list already, whose words this function reads, in runs.
  ListingLoop(glsl::Shader& shader, const ir::Extent& extent, const std::string& listed);
  // Adds the element to a list, whose words are bound. `together`, `shares`: see append().
  void add(const std::string& list, bool together = false, int shares = 1);
  // A statement: is done with the element.
  const char* skip() const { return runs_ ? "continue;" : "return;"; }
  const char* element() const { return runs_ ? "element" : "index"; }
  // Elements of an invocation.
  int each() const;
  // Closes it; returns how many invocations there are.
  std::string close();

 private:
  glsl::Shader& shader_;
  const ir::Extent extent_;
  const bool runs_;
  const std::string listed_;
  std::vector<std::string> lists_;
};

}  // namespace dr::backend
