// SPDX-License-Identifier: Apache-2.0
// Small files of every format, for the fuzz targets of the readers to start from. usage: fuzz_reader_seeds FOLDER
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "tests/unit/io/support.h"

int main(int argc, char** argv) {
  using namespace dr::io::test;
  if (argc != 2) {
    std::fputs("usage: fuzz_reader_seeds FOLDER\n", stderr);
    return 2;
  }
  const std::pair<const char*, std::string> files[] = {
      {"text.gltf", quad_gltf()},
      {"chunks.glb", quad_glb()},
      {"scene.glb", SceneFile().glb()},
      {"a.obj", "v 0 0 0\nv 1 0 0 # c\nv 0 1 \\\n 0\nvt 0 0.5\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf -1 -2 -3\n"},
      {"grey.png", png_file(4, 2, 8, 0, std::string(10, '\x40'))},
      {"colour.png", png_file(4, 2, 8, 2, std::string(26, '\x41'))},
      {"deep.png", png_file(2, 2, 16, 6, std::string(34, '\x02'))},
      {"a.jpg", jpeg_file()},
      {"a.hdr", hdr_file()},
      {"float.npy", npy_file("<f4", "(2, 3)", f32({1, 2, 3, 4, 5, 6}))},
      {"whole.npy", npy_file("<i8", "(1,)", u32({1, 0}))},
      {"a.csv", "x,y\n1,2.5\n-3,4e5\n"},
      {"four.tfx", tfx_file(4, 2, 3)},
      {"three.tfx", tfx_file(3, 2, 3)},
      {"a.hair", hair_file(31)},
      {"b.hair", hair_file(2)},
      {"a.json", "[[1, 2.5, -3e4], [4, 5, 6]]"},
      {"truth.json", "[true, false]"},
      {"cameras.json", "[[[[2.7, 0, 0, 0, 0, -2.4, -0.4, -0.4, 0, 1.1, -0.9, -0.9, 0, 0, 3.9, 4]]]]"},
      {"a.checkpoint",
       R"({"folder": "checkpoint-0", "steps": [["fit", 100], ["look", 1]], "entry": 0, "done": 7, "runs": {"fit": 7},)"
       R"( "leaves": [{"name": "p", "components": 1}]})"}};
  std::filesystem::create_directories(argv[1]);
  for (const auto& [name, content] : files) {
    std::ofstream file(std::filesystem::path(argv[1]) / name, std::ios::binary);
    if (!(file << content).flush()) return 1;
  }
  return 0;
}
