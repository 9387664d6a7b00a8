// SPDX-License-Identifier: Apache-2.0
// What a user binds to a leaf: takes `file:selector` apart, calls the reader, and checks the element it gives. Also the
// way back, saving an array by extension.

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "compiler/io/array/array.h"
#include "compiler/io/array/npy.h"
#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"
#include "compiler/io/mesh/bind.h"
#include "compiler/io/mesh/strands.h"
#include "compiler/io/picture/image.h"

namespace dr::io {
namespace {

struct Source {
  std::string path;
  std::vector<std::string_view> selectors;
};

// "a/b.png:raw:r": the selectors start at the first ':' of the last part of the path.
constexpr std::string_view kBindable[] = {".obj", ".gltf", ".glb",  ".png", ".jpg", ".jpeg",
                                          ".hdr", ".tfx",  ".hair", ".npy", ".csv", ".json"};

// The first ':' behind a file's extension, since names that selectors hold may have a '/', and those of files a ':'; or
// else the first one of the last part of the path.
size_t selectors_of(std::string_view text) {
  for (size_t colon = text.find(':'); colon != std::string_view::npos; colon = text.find(':', colon + 1))
    if (std::ranges::count(kBindable, extension_of(text.substr(0, colon))) > 0) return colon;
  if (std::ranges::count(kBindable, extension_of(text)) > 0) return std::string_view::npos;
  return text.find(':', text.size() - file_name_of(text).size());
}

Source split_source(std::string_view text) {
  size_t colon = selectors_of(text);
  Source source{std::string(text.substr(0, colon)), {}};
  while (colon != std::string_view::npos) {
    const size_t begin = colon + 1;
    colon = text.find(':', begin);
    source.selectors.push_back(text.substr(begin, colon - begin));
  }
  return source;
}

Array image_binding(const Source& source, int expected_components) {
  const ImageOptions options = image_options(source.selectors, {.expected_components = expected_components});
  std::vector<std::string> paths = {source.path};
  if (source.path.find_first_of("*?") != std::string::npos) {
    paths = files_matching(source.path);
    if (paths.empty()) fail("no file matches");
  }
  return read_images(paths, options);
}

bool looks_like_literal(std::string_view text) {
  if (text.empty()) return false;
  if (text == "true" || text == "false") return true;
  if (text.front() == '[') return text.back() == ']';
  // A number all through; "3d.obj" and "2.png" are files.
  return text.find_first_not_of("0123456789+-.eE") == std::string_view::npos &&
         text.find_first_of("0123456789") != std::string_view::npos;
}

Array load(std::string_view text, int expected_components) {
  const Source source = split_source(text);
  const std::string extension = extension_of(source.path);
  const bool pattern = source.path.find_first_of("*?") != std::string::npos;
  if (is_image_extension(extension)) return image_binding(source, expected_components);
  if (pattern) fail("only pictures are stacked by a pattern, found the extension ", in_quotes(extension));
  if (extension == ".obj" || extension == ".gltf" || extension == ".glb") {
    return bind_mesh(source.path, source.selectors, expected_components);
  }
  if (extension == ".tfx" || extension == ".hair") return bind_strands(source.path, source.selectors);
  if (extension == ".npy") {
    if (!source.selectors.empty()) fail("a .npy file has no selectors, found ", in_quotes(source.selectors.front()));
    return parse_npy(read_file(source.path), expected_components);
  }
  if (extension == ".csv") {
    if (!source.selectors.empty()) fail("a .csv file has no selectors, found ", in_quotes(source.selectors.front()));
    const auto bytes = read_file(source.path);
    return parse_csv(as_text(bytes), expected_components);
  }
  if (extension == ".json") {
    if (!source.selectors.empty()) fail("a .json file has no selectors, found ", in_quotes(source.selectors.front()));
    const auto bytes = read_file(source.path);
    return parse_literal({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, expected_components);
  }
  fail(extension.empty() ? std::string("there is no extension") : cat("unknown extension ", in_quotes(extension)),
       did_you_mean(extension, kBindable),
       ", expected a .obj, .gltf, .glb, .tfx, .hair, .png, .jpg, .hdr, .npy, .csv or .json file or a number or list "
       "after '='");
}

void check_expected(const Array& array, int expected_components) {
  if (expected_components > 0 && array.components != expected_components) {
    fail("it has ", counted(array.components, "component", "components"), " an element, expected ",
         expected_components);
  }
}

}  // namespace

bool is_bindable(std::string_view path) {
  return std::ranges::find(kBindable, extension_of(path)) != std::end(kBindable);
}

Result<Array> load_binding(std::string_view source, int expected_components) {
  assert(expected_components >= 0);
  const bool marked = source.starts_with('=');
  if (marked || looks_like_literal(source)) {
    const std::string_view text = marked ? source.substr(1) : source;
    return guarded(cat("cannot read the value ", in_quotes(text), ": "), [&] {
      Array array = parse_literal(text, expected_components);
      check_expected(array, expected_components);
      return array;
    });
  }
  if (source.empty()) return Error{"expected a file, or a number or list, after '='"};
  return guarded(cat("cannot read ", path_in_quotes(source), ": "), [&] {
    Array array = load(source, expected_components);
    check_expected(array, expected_components);
    return array;
  });
}

// The texels of a normal map are unit vectors that look up, as a half of themselves and a half; the curve of sRGB bends
// them, and nothing that follows says so.
std::optional<std::string> doubt_about(std::string_view source, const Array& array) {
  if (source.starts_with('=') || looks_like_literal(source)) return std::nullopt;
  const Source file = split_source(source);
  const std::string extension = extension_of(file.path);
  const bool has_curve = extension == ".png" || extension == ".jpg" || extension == ".jpeg";
  if (!has_curve || array.components < 3 || array.kind != ElementKind::Float32) return std::nullopt;
  if (std::ranges::find(file.selectors, "raw") != file.selectors.end()) return std::nullopt;
  constexpr int64_t kLooks = 4096;
  constexpr double kOff = 0.08, kMost = 0.7;
  const int64_t step = std::max<int64_t>(1, array.size() / kLooks);
  int64_t looked = 0, unit = 0;
  for (int64_t k = 0; k < array.size(); k += step, ++looked) {
    double square = 0, up = 0;
    for (int c = 0; c < 3; ++c) {
      up = 2 * linear_to_srgb(array.scalar(k * array.components + c)) - 1;
      square += up * up;
    }
    if (up > 0 && std::abs(std::sqrt(square) - 1) < kOff) ++unit;
  }
  if (static_cast<double>(unit) < kMost * static_cast<double>(looked)) return std::nullopt;
  return cat(path_in_quotes(file.path), " looks like a normal map, whose texels were bent as colours are: bind '",
             file.path, ":raw'");
}

Result<void> save_array(const std::string& path, const Array& array) {
  return guarded(cat("cannot write ", path_in_quotes(path), ": "), [&] {
    if (!array.consistent()) fail("the array's extent and bytes do not agree, or it is empty");
    const std::string extension = extension_of(path);
    if (extension == ".npy") return write_file(path, encode_npy(array));
    if (extension == ".csv") return write_file(path, encode_csv(array));
    if (extension != ".png") {
      constexpr std::string_view kExtensions[] = {".png", ".npy", ".csv"};
      fail(extension.empty() ? std::string("there is no extension") : cat("unknown extension ", in_quotes(extension)),
           did_you_mean(extension, kExtensions), ", an array is saved as .png, .npy or .csv");
    }
    std::vector<OutputFile> files;
    for (int64_t layer = 0; layer < array.layers; ++layer)
      files.push_back({layer_path(path, layer, array.layers), encode_png(array, layer)});
    write_files(files);
  });
}

std::string layer_path(const std::string& path, int64_t layer, int64_t layers) {
  if (layers == 1) return path;
  const std::string stem = path.substr(0, path.size() - extension_of(path).size());
  std::string number = cat(layer);
  number.insert(0, cat(layers - 1).size() - number.size(), '0');
  return cat(stem, "_", number, path.substr(stem.size()));
}

}  // namespace dr::io
