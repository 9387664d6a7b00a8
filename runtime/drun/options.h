// SPDX-License-Identifier: Apache-2.0
// drun's command line.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "runtime/jit/jit.h"

namespace dr::drun {

struct Options {
  std::string file;
  std::vector<std::pair<std::string, std::string>> bindings;  // leaf, source
  std::vector<std::pair<std::string, std::string>> symbols;   // symbol, value
  std::vector<std::pair<std::string, int>> steps;             // step, times; in order
  std::string out;                                            // folder for results, or empty
  std::vector<std::pair<std::string, std::string>>
      meshes;  // file, "position:face[:uv[:uv_face[:texture]]][:part=name ...]"
  std::vector<std::pair<std::string, std::string>> saves;  // output or leaf, file
  std::string dump_raster;                                 // folder for faces, tags and pinned values, or empty
  std::string device;
  int log_every = 10;
  bool validate = false;
  bool trusted = false;            // a bundle of somebody whom the user trusts
  double timeout = 0;              // seconds, 0: none
  double checkpoint_seconds = 60;  // between checkpoints, 0: none
  int checkpoint_runs = 0;         // of a step between checkpoints, 0: none
  bool resume = false;             // from the checkpoint in `out`
  bool timing = false;             // times of the commands of each step's last run
  bool strict_finite = false;      // stop at the first NaN or Inf among what is printed
  bool check_finite = false;       // stop at the first NaN or Inf that a run stores
  int check_runs = 0;              // of each step that are compared with the reference
  bool unchecked = false;          // bound data may hold NaN and Inf
  std::string counters;            // what was done and left out: empty, text or json
  int watch = -1;                  // the port of a page about the run, 0: any; -1: none
  bool cache = true;
  bool commands = true;   // recorded commands are used again
  bool pipelines = true;  // pipelines are kept on disk
  int64_t memory = 0;     // bytes of the device, 0: all that it has
  int64_t buffers = 0;    // bytes of a binding, 0: what the device allows
  bool rebuild = true;    // the program for the leaves that move
  bool list_devices = false;
  bool measure = false;  // the device's profile
  std::string profile_out = "-";
  jit::Options compile;
};

// Parses the command line, or prints help or the mistake and sets `exit_code`: 0 for help, 2 for a mistake.
bool parse_options(int argc, char** argv, Options& options, int& exit_code);

}  // namespace dr::drun
