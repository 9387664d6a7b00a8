// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/array/decisions.h"

#include <filesystem>
#include <system_error>

#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

namespace fs = std::filesystem;

fs::path folder_of(const std::string& dir, const std::string& step, int64_t run) {
  return fs::path(dir) / step / std::to_string(run);
}

std::string file_of(size_t raster, size_t result) {
  return cat("raster", raster, result % 2 == 0 ? ".face" : ".tag", result / 2, ".npy");
}

Array must_load(const fs::path& file, int components) {
  auto array = load_binding(file.string(), components);
  if (!array) fail(array.error());
  return std::move(*array);
}

}  // namespace

Result<void> save_decisions(const std::string& dir, const std::string& step, int64_t run, const Decisions& decisions) {
  const fs::path folder = folder_of(dir, step, run);
  return guarded("", [&] {
    std::error_code error;
    fs::create_directories(folder, error);
    if (error) fail("cannot make the folder ", path_in_quotes(folder.string()));
    const auto save = [&](const std::string& name, const Array& array) {
      if (auto saved = save_array((folder / name).string(), array); !saved) fail(saved.error());
    };
    for (size_t k = 0; k < decisions.rasters.size(); ++k) {
      for (size_t r = 0; r < decisions.rasters[k].size(); ++r) save(file_of(k, r), decisions.rasters[k][r]);
    }
    for (const auto& [name, value] : decisions.pins) save("pin." + name + ".npy", value);
  });
}

Result<Decisions> load_decisions(const std::string& dir, const std::string& step, int64_t run,
                                 const std::map<std::string, int>& pins) {
  const fs::path folder = folder_of(dir, step, run);
  return guarded("", [&] {
    std::error_code error;
    if (!fs::is_directory(folder, error))
      fail("there are no decisions for run ", run, " of step ", in_quotes(step), ": no folder ",
           path_in_quotes(folder.string()));
    Decisions decisions;
    for (size_t k = 0; fs::exists(folder / file_of(k, 0), error); ++k) {
      std::vector<Array>& raster = decisions.rasters.emplace_back();
      // Faces and tags of each rank, or one array that lists faces with their tags.
      for (size_t r = 0; (r % 2 == 1 && r > 1) || fs::exists(folder / file_of(k, r), error); ++r)
        raster.push_back(must_load(folder / file_of(k, r), 1));
    }
    for (const auto& [name, components] : pins) {
      const fs::path file = folder / ("pin." + name + ".npy");
      if (fs::exists(file, error)) decisions.pins.emplace_back(name, must_load(file, components));
    }
    return decisions;
  });
}

}  // namespace dr::io
