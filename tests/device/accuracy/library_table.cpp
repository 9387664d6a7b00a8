// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/library_table.h"

namespace dr::accuracy::library {

std::vector<Function> functions() {
  std::vector<Function> all;
  for (auto&& part :
       {point_functions(), material_functions(), environment_functions(), shadow_functions(), hair_functions(),
        rig_functions(), strand_functions(), skin_functions(), number_functions(), image_functions(), mesh_functions(),
        picture_functions(), filter_functions(), network_functions()})
    all.insert(all.end(), part.begin(), part.end());
  return all;
}

std::vector<Elsewhere> elsewhere() {
  return {
      {"hair.shade", "scatter_far times the lamp's colour"},
      {"strands.segments", "integers"},
      {"strands.strand_of", "integers"},
      {"strands.interpolate", "the row of strands.blend draws with it"},
      {"mesh.inside_out", "another sign of an integer"},
      {"mesh.neighbours", "integers of `topology`"},
      {"mesh.neighbours_of", "integers; a golden test holds them to those of `topology`"},
      {"mesh.beyond", "integers of `topology`"},
      {"mesh.icosphere_cell", "a part of icosphere_face"},
      {"mesh.rhomb_vertex", "a part of icosphere_face"},
      {"mesh.rhomb_point", "a part of icosphere_position"},
      {"mesh.ring_corner", "a part of icosphere_position"},
      {"shadow.map",
       "`raster.rasterize` and `coverage.silhouette`, which have rows; a golden test holds their shadows to closed "
       "forms"},
      {"raster.nearest",
       "integers; `raster.rasterize` is made of it, and orders are compared in `small_programs_test`"},
      {"shadow.map_of", "a map of given numbers; `shadow.lit` reads it in its row"},
      {"shadow.plain_map", "`raster.rasterize`, which has rows; a golden test holds its shadows to those of `map`"},
      {"random.directions", "numbers known when a program is compiled; `combined` reads them"},
      {"points.nearest", "a decision; `nearest_square` has what comes of it"},
      {"solve.levenberg_marquardt",
       "`gauss_newton` of four dampings and the best of them; a golden test fits what is known"},
      {"tiles.touched", "decisions: which tiles a box reaches"},
      {"texture.inverse_uv",
       "integers: which texel a pixel is given to is decided by rounding where it lies between two"},
      {"texture.sobol_turn", "integers of `random.sobol_bits`"},
      {"texture.shuffled", "integers; a golden test takes them there and back"},
      {"texture.unshuffled", "integers; a golden test takes them there and back"},
      {"texture.below_2_30", "a part of shuffled"},
  };
}

}  // namespace dr::accuracy::library
