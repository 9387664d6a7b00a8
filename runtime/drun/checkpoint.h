// SPDX-License-Identifier: Apache-2.0
// Where a run stopped, so that it can go on: OUT/checkpoint.json, and beside it the folder that it names, with the
// params and states as .npy files. The folder is complete, and on the disk, before the file points to it: whenever a
// run is killed, the checkpoint before or after is there whole.
#pragma once

#include <cstddef>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "compiler/io/array/array.h"

namespace dr::drun {

using Outputs = std::vector<std::pair<std::string, io::Array>>;  // of a step, by name

struct Checkpoint {
  std::vector<std::pair<std::string, int>> steps;  // of the command line, and how often
  size_t entry = 0;                                // of these: those before it are done
  int done = 0;                                    // runs of that entry
  std::map<std::string, int64_t> runs;             // of each step, in all
  std::vector<std::pair<std::string, io::Array>> leaves;
  std::map<std::string, Outputs> outputs;   // of steps that are done, and whose results are not written yet
  std::string log;                          // lines so far
  std::string program;                      // checksum of the bundle; empty of an older drun
  std::map<std::string, std::string> data;  // and of what was bound, by leaf
};

// Of what a file holds, against accidents: a run must not go on from numbers that nobody computed.
std::string checksum_of(std::span<const std::byte> bytes);

// Folders of checkpoints are called so, and by a number.
inline constexpr std::string_view kCheckpoint = "checkpoint-";

// Both throw Mistake.
void save_checkpoint(const std::string& out, const Checkpoint& checkpoint);
Checkpoint load_checkpoint(const std::string& out);
// The folder in `out` that holds the checkpoint, or nothing.
std::string checkpoint_folder(const std::string& out);

// Writes the file whole or not at all.
void write_text(const std::string& path, const std::string& text);

}  // namespace dr::drun
