// SPDX-License-Identifier: Apache-2.0
// The material of a mesh that is written: what `--mesh` says after the mesh, PART=NAME, under the names by which
// `--bind FILE:material:PART` reads the parts again.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <string>

#include "compiler/io/mesh/mesh.h"

namespace dr::drun {

class MeshMaterial {
 public:
  // Values of so many components by the name of a leaf or output.
  using Values = std::function<io::Array(const std::string& name, int components)>;

  // Of a part's value: floats. Like the next, throws Mistake, which names `file`.
  static int components_of(const std::string& file, const std::string& part);
  MeshMaterial(const std::string& file, const std::map<std::string, std::string>& parts, const Values& values);

  // Gives `view` the material. Precondition: this outlives it.
  void show(io::MeshView& view) const;

 private:
  const io::Array* keep(io::Array array) { return &kept_.emplace_back(std::move(array)); }

  std::deque<io::Array> kept_;
  const io::Array* texture_ = nullptr;
  io::MaterialView material_;
};

}  // namespace dr::drun
