// SPDX-License-Identifier: Apache-2.0
// The lines of a glTF file, as strands.
#include "compiler/io/mesh/gltf/lines.h"

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/gltf/accessors.h"
#include "compiler/io/mesh/gltf/transform.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io::gltf {
namespace {

enum LineMode : int { kLines = 1, kLineLoop = 2, kLineStrip = 3 };

// The vertices of each polyline. Pairs of a list make one where a pair begins with the vertex that the one before ends
// with.
std::vector<std::vector<uint32_t>> polylines(const std::vector<uint32_t>& order, int mode, const std::string& where) {
  if (order.size() < 2) fail(where, ": ", order.size(), " indices make no line");
  if (mode != kLines) {
    std::vector<std::vector<uint32_t>> one = {order};
    if (mode == kLineLoop) one[0].push_back(order[0]);
    return one;
  }
  if (order.size() % 2 != 0) fail(where, ": ", order.size(), " indices are not a multiple of 2");
  std::vector<std::vector<uint32_t>> lines;
  for (size_t i = 0; i < order.size(); i += 2) {
    if (lines.empty() || lines.back().back() != order[i]) lines.push_back({order[i]});
    lines.back().push_back(order[i + 1]);
  }
  return lines;
}

class LineReader {
 public:
  explicit LineReader(const Document& document) : document_(document) {}

  Strands read() {
    for (const PlacedNode& placed : placed_nodes(document_)) {
      const int mesh = document_.model.nodes[static_cast<size_t>(placed.node)].mesh;
      if (mesh < 0) continue;
      const auto& primitives = document_.model.meshes[static_cast<size_t>(mesh)].primitives;
      for (size_t k = 0; k < primitives.size(); ++k) {
        if (primitives[k].mode < kLines || primitives[k].mode > kLineStrip) continue;
        add(primitives[k], placed.world, cat("meshes[", mesh, "].primitives[", k, "]"));
      }
    }
    if (strands_.vertices.empty()) fail("the scene has no lines");
    if (!colored_) strands_.colors.clear();
    return std::move(strands_);
  }

 private:
  Floats attribute(const tinygltf::Primitive& primitive, const char* name, const Expected& expected,
                   const std::string& where) const {
    const auto found = primitive.attributes.find(name);
    if (found == primitive.attributes.end()) return {};
    return read_floats(document_, static_cast<uint64_t>(found->second), expected, kMaxVertices,
                       cat(where, ".attributes.", name));
  }

  void add(const tinygltf::Primitive& primitive, const glm::dmat4& transform, const std::string& where) {
    const Floats positions = attribute(primitive, "POSITION", {3, 3}, where);
    if (positions.values.empty()) fail(where, ": there is no POSITION");
    const uint64_t count = positions.values.size() / 3;
    const Floats colors = attribute(primitive, "COLOR_0", {3, 4, Integers::NormalizedUnsigned, count}, where);
    colored_ = colored_ || !colors.values.empty();
    for (const auto& line : polylines(read_order(document_, primitive, count, where), primitive.mode, where)) {
      strands_.vertices.push_back(static_cast<int32_t>(line.size()));
      if (strands_.positions.size() / 3 + line.size() > static_cast<uint64_t>(kMaxVertices)) {
        fail("the lines have more than ", kMaxVertices, " vertices");
      }
      for (const uint32_t vertex : line) {
        add_placed(strands_.positions, transform, &positions.values[vertex * size_t{3}], vertex, where);
        for (size_t k = 0; k < 3; ++k) {
          strands_.colors.push_back(colors.values.empty() ? 1.0f : colors.values[vertex * colors.components + k]);
        }
      }
    }
  }

  const Document& document_;
  Strands strands_;
  bool colored_ = false;
};

}  // namespace

Strands read_lines(const Document& document) { return LineReader(document).read(); }

}  // namespace dr::io::gltf
