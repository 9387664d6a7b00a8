// SPDX-License-Identifier: Apache-2.0
// Files that are read by name: DR_FILE 0 is a scene, of which every selector is bound, cameras and lamps among them;
// 1 is the file of a checkpoint, beside its folder.
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"
#if DR_FILE == 1
#include "runtime/drun/checkpoint.h"
#include "runtime/drun/target.h"
#endif

namespace {

namespace fs = std::filesystem;
using namespace dr;

constexpr size_t kMaxInput = size_t{1} << 16;

// A folder of this process, removed at its end. In memory where the system has such a place.
struct Folder {
  fs::path path;
  Folder() {
    const fs::path memory = "/dev/shm";
    const fs::path root = fs::is_directory(memory) ? memory : fs::temp_directory_path();
    path = root / ("dr_fuzz_" + std::to_string(getpid()));
    fs::create_directories(path / "checkpoint-0");
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
};

void write(const fs::path& path, const uint8_t* data, size_t size) {
  std::ofstream file(path, std::ios::binary);
  file.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
}

}  // namespace

#if DR_FILE == 0
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > kMaxInput) return 0;
  static const Folder folder;
  const fs::path file = folder.path / (size > 4 && data[0] == 'g' ? "a.glb" : "a.gltf");
  write(file, data, size);
  for (const char* selector :
       {"position", "indices", "camera:view", "camera:projection", "camera:field_of_view", "light:position",
        "light:kind", "light:direction", "material:base_color", "material:0:base_color_texture",
        "skin:0:joint_matrices", "node:pose", "node:0:morph_weights", "animation:0:joint_matrices:3",
        "animation:0:0:values", "image:0", "texture:sampler", "joints", "morph:position"}) {
    const auto bound = io::load_binding(file.string() + ":" + selector, 0);
    if (bound && !bound->consistent()) std::abort();
  }
  return 0;
}
#else
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > kMaxInput) return 0;
  static const Folder folder;
  static const bool ready = [] {
    const std::string leaf = (folder.path / "checkpoint-0" / "p.npy").string();
    const auto saved = io::save_array(leaf, io::Array::from_floats(std::vector<float>{1, 2, 3}));
    std::ofstream(folder.path / "checkpoint-0" / "log.jsonl") << "{}\n";
    return static_cast<bool>(saved);
  }();
  if (!ready) std::abort();
  write(folder.path / "checkpoint.json", data, size);
  try {
    const drun::Checkpoint checkpoint = drun::load_checkpoint(folder.path.string());
    if (checkpoint.entry >= checkpoint.steps.size() || checkpoint.done < 0) std::abort();
    for (const auto& [name, leaf] : checkpoint.leaves)
      if (!leaf.consistent()) std::abort();
    drun::save_checkpoint(folder.path.string() + "/again", checkpoint);
  } catch (const drun::Mistake& mistake) {
    if (mistake.message.empty()) std::abort();
  }
  return 0;
}
#endif
