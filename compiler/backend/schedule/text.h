// SPDX-License-Identifier: Apache-2.0
// The schedule's text form, behind the text of its graph (ir/print.h):
//
//   schedule after keep-sums                    // the pass that left it; compiling goes on with the next one
//   code wide words, clears of 31               // how shaders are written, where that is chosen: see below
//   leaf position : vec3[V]                     // resources: leaves first, in the graph's order
//   half buffer normal : vec3[V]                // or a plain buffer, step_index, entries, epoch entries, bits or sums
//   buffer, tile image shade : float[W, H] step fit {
//     %0 in position                            // values that are stored, and where
//     %normal.7 in normal
//     stage 0
//     pass normal compute [V] prologue          // name, kind, domain; `prologue`: the step changes nothing it needs
//       reads position
//       ops mul %5, normalize %normal.7         // an op by its first result
//       writes normal
//     pass shade fragment [W, H]
//       ...
//     output error = loss
//     update position <- position%40 in place   // a resource that holds several values: which one, too
//   }
//
// Behind `writes` stand the decisions about a pass, as far as there are any:
//
//   partial clip pixel                          // stored for listed elements only
//   block 4 4 1                                 // elements that an invocation computes side by side
//   rests without grad, listed in runs          // or: marked in blocks; for elements that grad does not reach,
//   memory m%4 s%5                              // and whose memory is zero
//   looks at gather %12, gather %15             // and where these give zeros
//   read together gather %9, gather %11 by 16 16 1 for 16 of reduce %14
//   sum grad of %31 %33                         // what a scatter sums up
//   active hit and %12, or weight               // elements that may add something
//   listed by seen                              // or: joins seen
//   set up by clip_pixel, twice where listed
//   keeps terms                                 // or: again
//   guesses exponents                           // `guesses exponents, asked`: see JoinedFirstRun::asks
//   shares loops
//   join lanes                                  // and: join parts, join workgroups, join pairs
//   relist
//   no rows "why"
//   rows face[0, 1, 2] of V                     // or: rows sorted of W * H, and lines of places:
//     place %12 adds %13 in if %40 branch 0 of the table, if %41 branch 1
//   lists in runs
//   in tiles                                    // of a reduction: in teams
//   heavy if %40, if %41 by subgroups apart 32  // branches of a second dispatch; `apart 8 sharing loops`
//   heavy if %40 unlikely if %42                // branches of a third dispatch
//   cut loops 8000, watched                     // trips in a dispatch; `cut heavy loops` in the second one
//   skips zeros
//   tells loss                                  // whether it is NaN or Inf
//   gives rows %12                              // of a raster: what a map would read off its bits, word by word
//   walks faces of 64 alone, or of 8 if few, of 4096 by 8 in 8192, others in 4096, watched
//
// Of all shaders, behind the first line:
//
//   code native floats, texel reads, hidden stores, hidden zeros, wide words, layers at once, clears of 31, loops of
//   65535 hidden divisors %4 %9                       // `strict hidden divisors`, `moderate divisors`
//
// `input:` before a value that a pass reads as an input attachment, and `in place`, follow from the rest.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <variant>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/ir/parse.h"

namespace dr::backend {

// Every storage, and the words of it: "half buffer".
inline constexpr std::array kStorages = {
    Resource::Storage::Leaf,       Resource::Storage::StepIndex, Resource::Storage::Buffer,
    Resource::Storage::Halves,     Resource::Storage::Entries,   Resource::Storage::EpochEntries,
    Resource::Storage::Bits,       Resource::Storage::Sums,      Resource::Storage::EmptiedSums,
    Resource::Storage::ListedSums, Resource::Storage::Emptied,   Resource::Storage::Image,
    Resource::Storage::Tile};
std::string_view storage_words(Resource::Storage storage);

// The graph's text and the schedule's.
std::string print_whole(const ir::Graph& graph, const Schedule& schedule);

struct ParsedSchedule {
  ir::Graph graph;
  Schedule schedule;
};

// print_whole(parse_schedule(text)) == text. What it accepts may still fail check_schedule(), which takes anything that
// it accepts.
std::variant<ParsedSchedule, ir::ParseError> parse_schedule(std::string_view text);

}  // namespace dr::backend
