// SPDX-License-Identifier: Apache-2.0
// What a driver keeps of its pipelines comes back as it was or not at all.
#include "runtime/cache/pipeline_file.h"

#include <fstream>

#include "tests/catch.h"

using dr::runtime::PipelineFile;
namespace fs = std::filesystem;

namespace {

struct Folder {
  fs::path path = fs::path(DR_BUILD_DIR) / "pipeline_file_test" / "deep";
  Folder() { fs::remove_all(path.parent_path()); }
  ~Folder() { fs::remove_all(path.parent_path()); }
};

std::string content(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write(const fs::path& path, const std::string& text) { std::ofstream(path, std::ios::binary) << text; }

}  // namespace

TEST_CASE("pipelines come back by their key") {
  const Folder folder;
  const PipelineFile file(folder.path, "device 1 shaders 2");
  CHECK(file.read().empty());
  const std::vector<uint8_t> data{1, 2, 0, 255, 7};
  file.write(data);
  CHECK(file.read() == data);
  CHECK(PipelineFile(folder.path, "device 1 shaders 3").read().empty());
  file.write(std::vector<uint8_t>{9});
  CHECK(file.read() == std::vector<uint8_t>{9});
  CHECK(std::distance(fs::directory_iterator(folder.path), {}) == 1);
}

TEST_CASE("a damaged file of pipelines is none") {
  const Folder folder;
  const PipelineFile file(folder.path, "key");
  file.write(std::vector<uint8_t>{1, 2, 3, 4, 5, 6, 7, 8, 9});
  const std::string whole = content(file.path());
  for (size_t k = 0; k < whole.size(); ++k) {
    std::string broken = whole;
    broken[k] = static_cast<char>(broken[k] ^ 0x10);
    write(file.path(), broken);
    CHECK(file.read().empty());
    write(file.path(), whole.substr(0, k));
    CHECK(file.read().empty());
  }
  write(file.path(), whole + "x");
  CHECK(file.read().empty());
  write(file.path(), whole);
  CHECK(file.read().size() == 9);
}

TEST_CASE("without a folder nothing is kept") {
  const PipelineFile file({}, "key");
  file.write(std::vector<uint8_t>{1});
  CHECK(file.read().empty());
}
