// SPDX-License-Identifier: Apache-2.0
// A folder of decisions: what a device, or the evaluator, chose in each run of a step, so that another can take it
// over.
//
//   DIR/STEP/RUN/raster0.face0.npy    the face of rank 0 of the step's first raster, int32 [L, H, W], -1 for none
//   DIR/STEP/RUN/raster0.tag0.npy     its tag
//   DIR/STEP/RUN/pin.NAME.npy         the value that the program pins as NAME
//
// RUN counts from 0 for each step. A pinned value that is not there is computed by whoever replays the folder.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "compiler/io/array/array.h"

namespace dr::io {

struct Decisions {
  std::vector<std::vector<Array>> rasters;          // for each raster: face 0, tag 0, face 1, ...
  std::vector<std::pair<std::string, Array>> pins;  // by name
};

// Makes the folders that are missing.
Result<void> save_decisions(const std::string& dir, const std::string& step, int64_t run, const Decisions& decisions);
// `pins` are the values that the program pins, with the components of their elements. An error when there is no folder
// for the run, or a raster has a face without a tag.
Result<Decisions> load_decisions(const std::string& dir, const std::string& step, int64_t run,
                                 const std::map<std::string, int>& pins);

}  // namespace dr::io
