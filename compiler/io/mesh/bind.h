// SPDX-License-Identifier: Apache-2.0
// What `--bind NAME=mesh.glb:SELECTOR` takes out of a mesh or a scene. Private to compiler/io; every function throws
// Failure.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "compiler/io/array/array.h"

namespace dr::io {

// `selectors` are the words after each ':' behind the file's name; docs/reference/files.md lists them.
Array bind_mesh(const std::string& path, std::span<const std::string_view> selectors, int expected_components);

// The selectors of glTF that name no attribute of the triangles: cameras, lamps, materials, pictures, skins,
// animations. Precondition: selectors[0] is one of kSceneKinds.
inline constexpr std::string_view kSceneKinds[] = {"animation", "camera", "image", "light",
                                                   "material",  "node",   "skin",  "texture"};
Array bind_scene(const std::string& path, std::span<const std::string_view> selectors, int expected_components);

}  // namespace dr::io
