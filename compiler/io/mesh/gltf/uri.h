// SPDX-License-Identifier: Apache-2.0
// What the URIs of a glTF file name: base64 text, or files in its folder and nowhere else. Private to compiler/io;
// every function throws Failure.
#pragma once

#include <string>

#include "compiler/io/file/file.h"

namespace dr::io::gltf {

// `gltf_path` is the file that holds the URI; `where` names the place in it for messages.
Bytes load_uri(const std::string& uri, const std::string& gltf_path, const std::string& where);

}  // namespace dr::io::gltf
