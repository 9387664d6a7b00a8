// SPDX-License-Identifier: Apache-2.0
// Meshes by file name: picks the reader, checks what is to be written, and writes OBJ, glTF and GLB.

#include "compiler/io/mesh/mesh.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <unordered_map>

#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"
#include "compiler/io/mesh/gltf/write.h"
#include "compiler/io/mesh/mesh_readers.h"
#include "compiler/io/picture/image.h"

namespace dr::io {
namespace {

void check_finite(std::span<const float> values, size_t components, std::string_view what) {
  for (size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      fail(what, " ", i / components, " holds ", std::isnan(values[i]) ? "NaN" : "an infinite value");
    }
  }
}

void check_indices(std::span<const int32_t> indices, size_t count, std::string_view what) {
  for (size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] < 0 || static_cast<size_t>(indices[i]) >= count) {
      fail(what, " ", i, " is ", indices[i], ", there are ", count, " entries");
    }
  }
}

void check_multiple(size_t size, size_t components, std::string_view what) {
  if (size % components != 0) fail(what, ": ", size, " numbers are not a multiple of ", components);
}

void check_texture(const Array* texture, std::string_view what) {
  if (texture && !texture->consistent()) fail(what, ": the array's extent and bytes do not agree, or it is empty");
  if (texture && (texture->components < 3 || texture->layers != 1)) {
    fail(what, " has 3 or 4 components and one layer, found ", texture->components, " and ", texture->layers);
  }
}

void check_factor(double factor, double high, std::string_view what) {
  if (!(factor >= 0 && factor <= high)) fail("the material's ", what, " is ", factor, ", expected 0 to ", high);
}

void check(const MaterialView& material) {
  for (const double factor : material.base_color) check_factor(factor, 1, "base colour");
  for (const double factor : material.emissive)
    if (!(factor >= 0 && std::isfinite(factor)))
      fail("the material's emissive colour is ", factor, ", expected a number from 0");
  check_factor(material.metallic, 1, "metallic factor");
  check_factor(material.roughness, 1, "roughness");
}

void check(const MeshView& mesh) {
  check(mesh.material);
  check_multiple(mesh.positions.size(), 3, "positions");
  check_multiple(mesh.indices.size(), 3, "indices");
  check_multiple(mesh.uv.size(), 2, "uv");
  if (mesh.positions.empty() || mesh.indices.empty()) fail("the mesh has no triangles");
  if (mesh.positions.size() / 3 > static_cast<size_t>(kMaxVertices)) fail("more than ", kMaxVertices, " vertices");
  if (mesh.indices.size() / 3 > static_cast<size_t>(kMaxTriangles)) fail("more than ", kMaxTriangles, " triangles");
  check_finite(mesh.positions, 3, "position");
  check_finite(mesh.uv, 2, "uv");
  check_finite(mesh.normals, 3, "normal");
  check_indices(mesh.indices, mesh.positions.size() / 3, "index");
  if (!mesh.normals.empty() && mesh.normals.size() != mesh.positions.size()) {
    fail(mesh.normals.size() / 3, " normals for ", mesh.positions.size() / 3, " vertices");
  }
  const std::pair<const Array*, std::string_view> textures[] = {
      {mesh.texture, "a texture"},
      {mesh.material.metallic_roughness, "a metallic-roughness texture"},
      {mesh.material.normal, "a normal texture"},
      {mesh.material.occlusion, "an occlusion texture"},
      {mesh.material.emission, "an emissive texture"}};
  if (mesh.uv.empty()) {
    if (!mesh.uv_indices.empty()) fail("there are uv indices but no uv");
    for (const auto& [texture, what] : textures)
      if (texture) fail("there is ", what, " but no uv");
    return;
  }
  if (mesh.uv.size() / 2 > static_cast<size_t>(kMaxVertices)) fail("more than ", kMaxVertices, " texture coordinates");
  if (mesh.uv_indices.empty()) {
    if (mesh.uv.size() / 2 != mesh.positions.size() / 3) {
      fail(mesh.uv.size() / 2, " uv for ", mesh.positions.size() / 3, " vertices, and no uv indices");
    }
  } else {
    if (mesh.uv_indices.size() != mesh.indices.size()) {
      fail(mesh.uv_indices.size(), " uv indices for ", mesh.indices.size(), " indices");
    }
    check_indices(mesh.uv_indices, mesh.uv.size() / 2, "uv index");
  }
  for (const auto& [texture, what] : textures) check_texture(texture, what);
}

// Given normals at unit length, or smooth ones.
std::vector<float> unit_normals(const MeshView& mesh) {
  std::vector<float> normals = smooth_normals(mesh.positions, mesh.indices);
  for (size_t i = 0; i < mesh.normals.size(); i += 3) {
    const float* n = &mesh.normals[i];
    const double length = std::hypot(double{n[0]}, double{n[1]}, double{n[2]});
    if (!(length > 0)) continue;  // no direction to keep
    // Already unit within rounding: keep the bits, so that a file read and written again stays the same.
    const double factor = std::abs(length - 1) < 1e-6 ? 1 : length;
    for (size_t k = 0; k < 3; ++k) normals[i + k] = static_cast<float>(n[k] / factor);
  }
  return normals;
}

// --- OBJ -------------------------------------------------------------------------------------------------------

class TextWriter {
 public:
  TextWriter& operator<<(std::string_view text) { return add(text.data(), text.data() + text.size()); }
  TextWriter& operator<<(float number) { return add_number(number); }
  TextWriter& operator<<(double number) { return add_number(number); }
  TextWriter& operator<<(int64_t number) { return add_number(number); }
  Bytes take() { return std::move(bytes_); }

 private:
  TextWriter& add(const char* begin, const char* end) {
    bytes_.insert(bytes_.end(), begin, end);
    return *this;
  }
  template <class T>
  TextWriter& add_number(T number) {
    char buffer[40];
    return add(buffer, std::to_chars(buffer, buffer + sizeof buffer, number).ptr);
  }

  Bytes bytes_;
};

Bytes write_obj(const MeshView& mesh, const std::string& material_file) {
  const std::span<const int32_t> uv_indices = mesh.uv_indices.empty() ? mesh.indices : mesh.uv_indices;
  const std::vector<float> normals = unit_normals(mesh);
  TextWriter out;
  if (!material_file.empty()) out << "mtllib " << material_file << "\nusemtl surface\n";
  for (size_t i = 0; i < mesh.positions.size(); i += 3) {
    out << "v " << mesh.positions[i] << " " << mesh.positions[i + 1] << " " << mesh.positions[i + 2] << "\n";
  }
  for (size_t i = 0; i < mesh.uv.size(); i += 2) {
    // In double, where 1 - v loses nothing and reads back to the same float.
    out << "vt " << mesh.uv[i] << " " << 1.0 - double{mesh.uv[i + 1]} << "\n";
  }
  for (size_t i = 0; i < normals.size(); i += 3) {
    out << "vn " << normals[i] << " " << normals[i + 1] << " " << normals[i + 2] << "\n";
  }
  for (size_t i = 0; i < mesh.indices.size(); i += 3) {
    out << "f";
    for (size_t k = i; k < i + 3; ++k) {
      const int64_t vertex = int64_t{mesh.indices[k]} + 1;
      out << " " << vertex << "/";
      if (!mesh.uv.empty()) out << int64_t{uv_indices[k]} + 1;
      out << "/" << vertex;
    }
    out << "\n";
  }
  return out.take();
}

// What the OBJ file calls the file of its material.
std::string material_file_of(const std::string& path) {
  const std::string stem = path.substr(0, path.size() - extension_of(path).size());
  std::string name = std::string(file_name_of(stem)) + ".mtl";
  // The format splits names at blanks and starts comments at '#'.
  if (name.find_first_of(" \t\r\n#\\") != std::string::npos) {
    fail("an OBJ file cannot name ", in_quotes(name), ", choose a name without blanks or '#'");
  }
  return name;
}

void save_obj(const std::string& path, const MeshView& mesh) {
  std::vector<OutputFile> files;
  std::string material_file;
  if (mesh.texture) {
    const std::string stem = path.substr(0, path.size() - extension_of(path).size());
    const std::string texture_path = stem + "_texture.png";
    material_file = material_file_of(path);
    TextWriter material;
    material << "newmtl surface\nKd 1 1 1\nmap_Kd " << file_name_of(texture_path) << "\n";
    files.push_back({texture_path, encode_png(*mesh.texture, 0)});
    files.push_back({stem + ".mtl", material.take()});
  }
  files.push_back({path, write_obj(mesh, material_file)});
  write_files(files);
}

// --- glTF ------------------------------------------------------------------------------------------------------

// One texture coordinate a vertex. Vertex i keeps its number, so that a fitted mesh can be compared with its start.
gltf::WeldedMesh weld(const MeshView& mesh) {
  gltf::WeldedMesh result;
  result.positions.assign(mesh.positions.begin(), mesh.positions.end());
  result.normals = unit_normals(mesh);
  result.indices.assign(mesh.indices.begin(), mesh.indices.end());
  if (mesh.uv.empty()) return result;
  if (mesh.uv_indices.empty()) {
    result.uv.assign(mesh.uv.begin(), mesh.uv.end());
    return result;
  }
  const size_t count = mesh.positions.size() / 3;
  result.uv.resize(count * 2);
  std::vector<int32_t> first_uv(count, -1);
  std::unordered_map<uint64_t, uint32_t> copies;  // (vertex, uv) -> appended vertex
  for (size_t i = 0; i < mesh.indices.size(); ++i) {
    const auto vertex = static_cast<size_t>(mesh.indices[i]);
    const int32_t uv = mesh.uv_indices[i];
    const float* uv_value = &mesh.uv[static_cast<size_t>(uv) * 2];
    if (first_uv[vertex] < 0) {
      first_uv[vertex] = uv;
      std::copy_n(uv_value, 2, &result.uv[vertex * 2]);
    }
    if (first_uv[vertex] == uv) continue;
    const uint64_t key = static_cast<uint64_t>(vertex) << 32 | static_cast<uint32_t>(uv);
    const auto [entry, fresh] = copies.try_emplace(key, static_cast<uint32_t>(result.positions.size() / 3));
    if (fresh) {
      if (result.positions.size() / 3 >= static_cast<size_t>(kMaxVertices)) {
        fail("more than ", kMaxVertices, " vertices with one texture coordinate each");
      }
      for (size_t k = 0; k < 3; ++k) {
        result.positions.push_back(mesh.positions[vertex * 3 + k]);
        result.normals.push_back(result.normals[vertex * 3 + k]);
      }
      result.uv.insert(result.uv.end(), uv_value, uv_value + 2);
    }
    result.indices[i] = entry->second;
  }
  return result;
}

constexpr std::string_view kMeshExtensions[] = {".obj", ".gltf", ".glb"};

[[noreturn]] void fail_extension(const std::string& extension) {
  fail(extension.empty() ? std::string("there is no extension") : cat("unknown extension ", in_quotes(extension)),
       did_you_mean(extension, kMeshExtensions), ", a mesh is .obj, .gltf or .glb");
}

}  // namespace

std::vector<float> smooth_normals(std::span<const float> positions, std::span<const int32_t> indices) {
  std::vector<std::array<double, 3>> sums(positions.size() / 3);
  for (size_t i = 0; i + 2 < indices.size(); i += 3) {
    const float* a = &positions[static_cast<size_t>(indices[i]) * 3];
    const float* b = &positions[static_cast<size_t>(indices[i + 1]) * 3];
    const float* c = &positions[static_cast<size_t>(indices[i + 2]) * 3];
    std::array<double, 3> u;
    std::array<double, 3> v;
    for (size_t k = 0; k < 3; ++k) {
      u[k] = double{b[k]} - a[k];
      v[k] = double{c[k]} - a[k];
    }
    // Twice the area along the normal: large faces count more, slivers hardly.
    const std::array<double, 3> cross = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2],
                                         u[0] * v[1] - u[1] * v[0]};
    for (size_t corner = i; corner < i + 3; ++corner) {
      for (size_t k = 0; k < 3; ++k) sums[static_cast<size_t>(indices[corner])][k] += cross[k];
    }
  }
  std::vector<float> normals(positions.size());
  for (size_t i = 0; i < sums.size(); ++i) {
    const double length = std::hypot(sums[i][0], sums[i][1], sums[i][2]);
    const bool usable = length > 0 && std::isfinite(length);
    for (size_t k = 0; k < 3; ++k) {
      normals[i * 3 + k] = usable ? static_cast<float>(sums[i][k] / length) : (k == 2 ? 1.0f : 0.0f);
    }
  }
  return normals;
}

Mesh read_mesh(const std::string& path, RequiredAttribute required) {
  const std::string extension = extension_of(path);
  if (extension != ".obj" && extension != ".gltf" && extension != ".glb") fail_extension(extension);
  const Bytes content = read_file(path);
  return extension == ".obj" ? parse_obj(as_text(content), required) : parse_gltf(content, path, required);
}

Result<Mesh> load_mesh(const std::string& path) {
  return guarded(cat("cannot read ", path_in_quotes(path), ": "), [&] { return read_mesh(path, std::nullopt); });
}

Result<void> check_material_file(const std::string& path) {
  return guarded(cat("cannot write ", path_in_quotes(path), ": "), [&] { material_file_of(path); });
}

Result<void> save_mesh(const std::string& path, const MeshView& mesh) {
  return guarded(cat("cannot write ", path_in_quotes(path), ": "), [&] {
    const std::string extension = extension_of(path);
    if (extension != ".obj" && extension != ".gltf" && extension != ".glb") fail_extension(extension);
    check(mesh);
    if (extension == ".obj") {
      save_obj(path, mesh);
    } else {
      write_file(path, gltf::write(weld(mesh), mesh.texture, mesh.material, extension == ".glb"));
    }
  });
}

}  // namespace dr::io
