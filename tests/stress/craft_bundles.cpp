// SPDX-License-Identifier: Apache-2.0
// Writes bundles as somebody who means harm would: one that drc made, each with one thing changed, and the checksum set
// right. usage: craft_bundles BUNDLE FOLDER, of the program in faults.sh
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>

#include "compiler/backend/bundle/bundle.h"

using namespace dr::bundle;

namespace {

struct Craft {
  const char* name;
  std::function<void(BundleT&)> make;
};

CommandT& first(BundleT& b, CommandKind kind) {
  for (const auto& c : b.steps[0]->commands)
    if (c->kind == kind) return *c;
  std::fprintf(stderr, "the program has no such command\n");
  std::exit(1);
}
CommandT& dispatch(BundleT& b) { return first(b, CommandKind::Dispatch); }
CommandT& reduce(BundleT& b) { return first(b, CommandKind::Reduce); }
LeafT& input(BundleT& b) { return *b.leaves[1]; }

void table(BundleT& b, const char* of, int index) {
  input(b).table = of;
  input(b).table_of = index;
}

void extent(BundleT& b, const std::string& w) {
  b.resources.back()->extent->w = w;
  b.resources.back()->extent->h = b.resources.back()->extent->l = "1";
}

template <class T>
void twice(std::vector<std::unique_ptr<T>>& all) {
  all.push_back(std::make_unique<T>(*all.front()));
}

// The loop's way out becomes a way on.
void no_way_out(BundleT& b) {
  for (const auto& shader : b.shaders) {
    auto& words = shader->spirv;
    uint32_t merge = 0;
    for (size_t at = 5; at < words.size(); at += std::max(1u, words[at] >> 16)) {
      if ((words[at] & 0xffff) == 246) merge = words[at + 1];
      if (merge == 0 || (words[at] & 0xffff) != 250) continue;
      if (words[at + 3] == merge) words[at + 3] = words[at + 2];
      if (words[at + 2] == merge) words[at + 2] = words[at + 3];
      merge = 0;
    }
  }
}

std::string nested(int depth) {
  return std::string(static_cast<size_t>(depth), '(') + "W" + std::string(static_cast<size_t>(depth), ')');
}

std::string product(int factors) {
  std::string out = "W";
  for (int k = 0; k < factors; ++k) out += " * (W + " + std::to_string(k) + ")";
  return out;
}

const Craft kCrafts[] = {
    {"absolute_output", [](auto& b) { b.steps[0]->outputs[0]->name = "/nowhere/out"; }},
    {"dotdot_output", [](auto& b) { b.steps[0]->outputs[0]->name = "../../out"; }},
    {"dotdot_leaf", [](auto& b) { b.leaves[0]->name = "../escaped"; }},
    {"step_path", [](auto& b) { b.steps[0]->name = "../step"; }},
    {"escapes_leaf", [](auto& b) { b.leaves[0]->name = "\x1b[2J\x1b]0;pwn\ap"; }},
    {"escapes_label", [](auto& b) { dispatch(b).label = "\x1b[2J"; }},
    {"escapes_resource", [](auto& b) { b.resources[0]->name = "\x1b[2J"; }},
    {"escapes_file", [](auto& b) { b.files = {"\x1b[2J.dr"}; }},
    {"escapes_graph", [](auto& b) { b.graph = "\x1b[2J"; }},
    {"same_leaves", [](auto& b) { input(b).name = b.leaves[0]->name; }},
    {"same_steps", [](auto& b) { twice(b.steps); }},
    {"same_outputs", [](auto& b) { twice(b.steps[0]->outputs); }},
    {"unused_source", [](auto& b) { dispatch(b).source = 5000; }},
    {"unused_source_big", [](auto& b) { dispatch(b).source = 2147483647; }},
    {"unused_target", [](auto& b) { dispatch(b).target = 100000; }},
    {"unused_scratch", [](auto& b) { dispatch(b).scratch_a = dispatch(b).scratch_b = 77777; }},
    {"unused_depth", [](auto& b) { dispatch(b).depth = 12345678; }},
    {"unused_colors", [](auto& b) { dispatch(b).colors = {99999}; }},
    {"unused_vertex", [](auto& b) { dispatch(b).vertex = 5000; }},
    {"unused_next", [](auto& b) { dispatch(b).next = 5000; }},
    {"unused_inputs", [](auto& b) { dispatch(b).inputs = {4000}; }},
    {"raster_of_one",
     [](auto& b) {
       b.steps[0]->rasters.push_back(std::make_unique<RasterResultsT>());
       b.steps[0]->rasters[0]->resources = {dispatch(b).bindings[0]->resource};
     }},
    {"table_of_floats", [](auto& b) { table(b, "edge", 0); }},
    {"table_of_itself", [](auto& b) { table(b, "edge", 1); }},
    {"table_of_nothing", [](auto& b) { table(b, "edge", 77); }},
    {"floats_closed", [](auto& b) { input(b).name = "t.closed"; }},
    {"many_bindings",
     [](auto& b) {
       auto& all = dispatch(b).bindings;
       for (int k = 0; k < 5000; ++k) all.push_back(std::make_unique<BindingT>(*all.front()));
     }},
    {"no_bindings", [](auto& b) { dispatch(b).bindings.clear(); }},
    {"swapped_bindings", [](auto& b) { std::swap(dispatch(b).bindings.front(), dispatch(b).bindings.back()); }},
    {"texels",
     [](auto& b) { dispatch(b).bindings[0]->texel = static_cast<uint8_t>(dispatch(b).bindings[0]->texel == 0); }},
    {"huge_elements", [](auto& b) { dispatch(b).elements = "2000000000"; }},
    {"huge_outs", [](auto& b) { reduce(b).outs = "2000000000"; }},
    {"huge_count", [](auto& b) { reduce(b).count = "2000000000"; }},
    {"huge_both", [](auto& b) { reduce(b).count = reduce(b).outs = "2000000000"; }},
    {"huge_extent", [](auto& b) { extent(b, "2147483647"); }},
    {"tiny_extent", [](auto& b) { extent(b, "1"); }},
    {"zero_extent", [](auto& b) { extent(b, "0"); }},
    {"extent_divides", [](auto& b) { extent(b, "W / (W - 8)"); }},
    {"extent_overflows", [](auto& b) { extent(b, "9223372036854775807 * W * W"); }},
    {"extent_nested", [](auto& b) { extent(b, nested(2000)); }},
    {"extent_product", [](auto& b) { extent(b, product(300)); }},
    {"extent_unknown", [](auto& b) { extent(b, "nosuch"); }},
    {"stage", [](auto& b) { b.shaders[0]->stage = Stage::Fragment; }},
    {"other_shader", [](auto& b) { dispatch(b).compute = static_cast<int>(b.shaders.size()) - 1; }},
    {"reduce_by_itself", [](auto& b) { reduce(b).next = reduce(b).compute = dispatch(b).compute; }},
    {"spirv_cut", [](auto& b) { b.shaders[0]->spirv.resize(b.shaders[0]->spirv.size() / 2); }},
    {"spirv_head", [](auto& b) { b.shaders[0]->spirv.resize(5); }},
    {"spirv_zero", [](auto& b) { std::fill(b.shaders[0]->spirv.begin() + 5, b.shaders[0]->spirv.end(), 0); }},
    {"spirv_loop", no_way_out},
    {"shared_slots",
     [](auto& b) {
       for (const auto& r : b.resources) r->slot = 0;
     }},
    {"no_leaves_in_step", [](auto& b) { b.steps[0]->leaves.clear(); }},
    {"unknown_symbol", [](auto& b) { b.steps[0]->symbols = {"nosuch"}; }},
    {"unknown_feature", [](auto& b) { b.features = {static_cast<dr::bundle::Feature>(200)}; }},
    {"junk_graph", [](auto& b) { b.graph = std::string(1 << 20, '('); }},
    {"no_graph", [](auto& b) { b.graph.clear(); }},
    {"initial_nan", [](auto& b) { b.leaves[0]->initial = {1e300}; }},
    {"version", [](auto& b) { b.version = 9; }},
    {"many_commands",
     [](auto& b) {
       auto& all = b.steps[0]->commands;
       for (int k = 0; k < 20000; ++k) all.push_back(std::make_unique<CommandT>(*all.front()));
     }},
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  std::ifstream file(argv[1], std::ios::binary);
  const std::vector<uint8_t> bytes(std::istreambuf_iterator<char>(file), {});
  for (const Craft& craft : kCrafts) {
    auto bundle = read(bytes);
    if (const auto* problem = std::get_if<std::string>(&bundle)) {
      std::fprintf(stderr, "%s: %s\n", argv[1], problem->c_str());
      return 1;
    }
    craft.make(std::get<BundleT>(bundle));
    const auto crafted = write(std::get<BundleT>(bundle));
    std::ofstream(std::filesystem::path(argv[2]) / (std::string(craft.name) + ".drb"), std::ios::binary)
        .write(reinterpret_cast<const char*>(crafted.data()), static_cast<std::streamsize>(crafted.size()));
  }
}
