// SPDX-License-Identifier: Apache-2.0
// Strands: two small binary formats, and the lines of glTF files. Each count and offset of a header is checked against
// the file's size before anything is read by it.
#include "compiler/io/mesh/strands.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "compiler/io/array/checked.h"
#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"
#include "compiler/io/mesh/gltf/lines.h"
#include "compiler/io/mesh/mesh.h"

namespace dr::io {
namespace {

// Both formats are little endian.
static_assert(std::endian::native == std::endian::little);

// A file's bytes; what is read must lie in them.
class Fields {
 public:
  explicit Fields(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  template <class T>
  T at(uint64_t offset, std::string_view field) const {
    T value;
    std::memcpy(&value, part(offset, sizeof value, field).data(), sizeof value);
    return value;
  }

  // `count` elements; `kept` floats out of each `stride`, all of which are finite.
  std::vector<float> floats(uint64_t offset, uint64_t count, uint64_t kept, uint64_t stride,
                            std::string_view field) const {
    const std::span<const uint8_t> bytes = part(offset, count * stride * sizeof(float), field);
    std::vector<float> values(count * kept);
    for (uint64_t i = 0; i < count; ++i) {
      std::memcpy(&values[i * kept], &bytes[i * stride * sizeof(float)], kept * sizeof(float));
      for (uint64_t k = i * kept; k < (i + 1) * kept; ++k) {
        if (!std::isfinite(values[k])) fail(field, " ", i, " is not finite");
      }
    }
    return values;
  }

  // The offset behind `count` elements of `size` bytes.
  uint64_t behind(uint64_t offset, uint64_t count, uint64_t size) const { return offset + count * size; }

  std::span<const uint8_t> part(uint64_t offset, uint64_t size, std::string_view field) const {
    if (offset > bytes_.size() || size > bytes_.size() - offset) {
      fail("'", field, "' takes ", size, " bytes from byte ", offset, " on, the file has ", bytes_.size());
    }
    return bytes_.subspan(offset, size);
  }

 private:
  std::span<const uint8_t> bytes_;
};

// A count of a header: from `least` to the most vertices of a mesh.
uint64_t count_at(const Fields& file, uint64_t offset, uint64_t least, std::string_view field) {
  const auto count = file.at<uint32_t>(offset, field);
  if (count < least || count > static_cast<uint64_t>(kMaxVertices)) {
    fail("'", field, "' is ", count, ", expected ", least, " to ", kMaxVertices);
  }
  return count;
}

void check_vertices(uint64_t count) {
  if (count > static_cast<uint64_t>(kMaxVertices)) fail("the strands have more than ", kMaxVertices, " vertices");
}

void check_opacities(const std::vector<float>& values) {
  for (size_t i = 0; i < values.size(); ++i) {
    if (!(values[i] >= 0 && values[i] <= 1)) fail("transparency ", i, " is ", 1 - values[i], ", expected 0 to 1");
  }
}

enum class StrandPart : uint8_t { Position, Segments, Strand, Width, Opacity, Color, RootUv };
constexpr std::pair<std::string_view, StrandPart> kParts[] = {
    {"position", StrandPart::Position}, {"segments", StrandPart::Segments}, {"strand", StrandPart::Strand},
    {"width", StrandPart::Width},       {"opacity", StrandPart::Opacity},   {"color", StrandPart::Color},
    {"root_uv", StrandPart::RootUv}};

Array floats_of(const std::vector<float>& values, int components, std::string_view what) {
  if (values.empty()) fail("the file has no ", what);
  return Array::from_floats(values, components);
}

// Vertices of each segment, or the strand that it belongs to.
Array segments_of(const Strands& strands, bool ends) {
  std::vector<int32_t> values;
  int32_t first = 0;
  for (size_t s = 0; s < strands.vertices.size(); ++s) {
    const int32_t count = strands.vertices[s];
    for (int32_t k = 0; k + 1 < count; ++k) {
      if (!ends) {
        values.push_back(static_cast<int32_t>(s));
        continue;
      }
      values.push_back(first + k);
      values.push_back(first + k + 1);
    }
    first += count;
  }
  return Array::from_ints(values, ends ? 2 : 1);
}

}  // namespace

Strands parse_tfx(std::span<const uint8_t> bytes) {
  const Fields file(bytes);
  const auto version = file.at<float>(0, "version");
  if (version != 3 && version != 4) fail("'version' is ", double{version}, ", expected 3 or 4");
  const bool old = version == 3;
  const uint64_t strands = count_at(file, 4, 1, "numHairStrands");
  const uint64_t each = count_at(file, 8, 2, "numVerticesPerStrand");
  check_vertices(strands * each);
  // Of version 3 three floats a vertex, of version 4 a fourth, the inverse mass.
  const uint64_t start = file.at<uint32_t>(old ? 144 : 12, "offsetVertexPosition");
  const uint64_t header = old ? 148 : 160;
  if (start < header) fail("'offsetVertexPosition' is ", start, ", which lies in the header");
  Strands out;
  out.positions = file.floats(start, strands * each, 3, old ? 3 : 4, "vertex position");
  out.vertices.assign(strands, static_cast<int32_t>(each));
  const uint64_t uv = old ? 0 : file.at<uint32_t>(16, "offsetStrandUV");
  if (uv != 0) {
    if (uv < header) fail("'offsetStrandUV' is ", uv, ", which lies in the header");
    out.root_uv = file.floats(uv, strands, 2, 2, "strand uv");
  }
  return out;
}

Strands parse_hair(std::span<const uint8_t> bytes) {
  const Fields file(bytes);
  if (as_text(file.part(0, 4, "signature")) != "HAIR") fail("the first four bytes are not 'HAIR'");
  const uint64_t strands = count_at(file, 4, 1, "hair_count");
  const uint64_t points = count_at(file, 8, 2, "point_count");
  const auto arrays = file.at<uint32_t>(12, "arrays");
  const auto has = [&](int bit) { return (arrays >> bit & 1u) != 0; };
  if (!has(1)) fail("'arrays' is ", arrays, ": the file has no points");
  const auto segments = file.at<uint32_t>(16, "d_segments");
  const std::vector<float> common = file.floats(20, 5, 1, 1, "the header's default");
  uint64_t at = 128;
  Strands out;
  uint64_t total = 0;
  if (!has(0) && segments > uint64_t{1} << 24) fail("'d_segments' is ", segments, ", expected 1 to 16777216");
  // Together they must be `points`, so that a strand too long is found before memory is taken for it.
  if (has(0)) file.part(at, strands * 2, "segments");
  out.vertices.reserve(strands);
  for (uint64_t s = 0; s < strands; ++s) {
    const uint64_t count = has(0) ? file.at<uint16_t>(at + 2 * s, "segments") : segments;
    if (count < 1) fail("strand ", s, " has no segment");
    total += count + 1;
    if (total > points) fail("strands 0 to ", s, " have ", total, " vertices, 'point_count' is ", points);
    out.vertices.push_back(static_cast<int32_t>(count + 1));
  }
  if (total != points) fail("the strands have ", total, " vertices, 'point_count' is ", points);
  if (has(0)) at = file.behind(at, strands, 2);
  const auto next = [&](uint64_t components, std::string_view field) {
    std::vector<float> values = file.floats(at, points, components, components, field);
    at = file.behind(at, points * components, sizeof(float));
    return values;
  };
  out.positions = next(3, "point");
  if (has(2)) out.widths = next(1, "thickness");
  if (has(3)) out.opacities = next(1, "transparency");
  if (has(4)) out.colors = next(3, "colour");
  if (!has(2)) out.widths.assign(points, common[0]);
  if (!has(3)) out.opacities.assign(points, common[1]);
  for (float& value : out.opacities) value = 1 - value;
  check_opacities(out.opacities);
  if (!has(4)) {
    for (uint64_t i = 0; i < points; ++i) out.colors.insert(out.colors.end(), common.begin() + 2, common.end());
  }
  return out;
}

namespace {

Strands read_strands(const std::string& path) {
  const Bytes bytes = read_file(path);
  const std::string extension = extension_of(path);
  if (extension == ".tfx") return parse_tfx(bytes);
  if (extension == ".hair") return parse_hair(bytes);
  return gltf::read_lines(gltf::load_document(bytes, path));
}

}  // namespace

Array bind_strands(const std::string& path, std::span<const std::string_view> selectors) {
  std::vector<std::string_view> names;
  for (const auto& [name, part] : kParts) names.push_back(name);
  if (selectors.size() != 1) {
    fail(
        "say which part of the strands: add ':position', ':segments', ':strand', ':width', ':opacity', ':color' or "
        "':root_uv'");
  }
  const auto* found = std::find_if(std::begin(kParts), std::end(kParts),
                                   [&](const auto& entry) { return entry.first == selectors[0]; });
  if (found == std::end(kParts)) {
    const std::string hint = did_you_mean(selectors[0], names);
    fail("unknown selector ", in_quotes(selectors[0]), hint,
         hint.empty() ? ", expected ':position', ':segments', ':strand', ':width', ':opacity', ':color' or ':root_uv'"
                      : "");
  }
  const Strands strands = read_strands(path);
  switch (found->second) {
    case StrandPart::Position: return Array::from_floats(strands.positions, 3);
    case StrandPart::Segments: return segments_of(strands, true);
    case StrandPart::Strand: return segments_of(strands, false);
    case StrandPart::Width: return floats_of(strands.widths, 1, "widths");
    case StrandPart::Opacity: return floats_of(strands.opacities, 1, "opacities");
    case StrandPart::Color: return floats_of(strands.colors, 3, "colours");
    case StrandPart::RootUv: break;
  }
  return floats_of(strands.root_uv, 2, "texture coordinates of roots");
}

}  // namespace dr::io
