// SPDX-License-Identifier: Apache-2.0
// Leaves, symbols and memory of a program.
#include "runtime/program/state.h"

#include <algorithm>
#include <cstring>
#include <sstream>
#include <utility>

#include "compiler/ir/initial_step.h"
#include "runtime/data/topology.h"

namespace dr::runtime {

bool is_users(const bundle::LeafT& leaf) { return leaf.table_of < 0; }
bool is_users(const bundle::StepT& step) { return ir::leaf_of_initial_step(step.name).empty(); }

bool only_writes(const bundle::BundleT& bundle, const bundle::StepT& step, uint32_t leaf) {
  const uint32_t r = bundle.leaves[leaf]->resource;
  const auto reads = [r](const auto& c) {
    return c->depth == static_cast<int>(r) || c->source == static_cast<int>(r) ||
           std::ranges::any_of(c->bindings,
                               [r](const auto& b) { return b->resource == r && b->access != bundle::Access::Write; });
  };
  return std::ranges::find(step.changes, leaf) != step.changes.end() && std::ranges::none_of(step.commands, reads) &&
         std::ranges::none_of(step.outputs, [r](const auto& o) { return o->resource == r; });
}

namespace {

std::string extent_text(const bundle::ExtentT& e) { return "[" + e.w + ", " + e.h + ", " + e.l + "]"; }

// What a command touches, in memory of its own.
void collect(const bundle::CommandT& c, std::set<uint32_t>& out) {
  for (const auto& b : c.bindings) out.insert(b->resource);
  out.insert(c.colors.begin(), c.colors.end());
  for (const int index : {c.depth, c.source, c.target, c.scratch_a, c.scratch_b})
    if (index >= 0) out.insert(static_cast<uint32_t>(index));
}

// "step 'fit'"
std::string title_of(const bundle::StepT& step) {
  const std::string_view leaf = ir::leaf_of_initial_step(step.name);
  return leaf.empty() ? "step '" + step.name + "'" : "the initial value of leaf '" + std::string(leaf) + "'";
}

template <class Tables>
std::optional<size_t> index_of(const Tables& tables, const std::string& name) {
  for (size_t k = 0; k < tables.size(); ++k)
    if (tables[k]->name == name) return k;
  return std::nullopt;
}

template <class Tables>
Failure none_of(const Tables& tables, const char* what, const std::string& name) {
  std::string all;
  for (const auto& table : tables)
    if (is_users(*table)) all += (all.empty() ? "" : ", ") + table->name;
  return {std::string("there is no ") + what + " '" + name + "'; there are: " + all};
}

// Whether it is what the compiler knew of the leaf, in whatever kind of numbers.
bool holds_initial(const bundle::LeafT& leaf, const io::Array& data) {
  const auto floats = data.converted(io::ElementKind::Float32);
  return floats && std::ranges::equal(floats->as<float>(), leaf.initial,
                                      [](float x, double initial) { return x == static_cast<float>(initial); });
}

}  // namespace

size_t Program::State::leaf_index(const std::string& name) const {
  if (const auto index = index_of(bundle.leaves, name)) return *index;
  throw none_of(bundle.leaves, "leaf", name);
}

size_t Program::State::step_index(const std::string& name) const {
  if (const auto index = any_step(name); index && is_users(*bundle.steps[*index])) return *index;
  throw none_of(bundle.steps, "step", name);
}

std::optional<size_t> Program::State::any_step(const std::string& name) const { return index_of(bundle.steps, name); }

void Program::State::bind(const std::string& name, const io::Array& data) {
  const auto index = leaf_index(name);
  const bundle::LeafT& leaf = *bundle.leaves[index];
  if (leaf.table_of >= 0)
    throw Failure{"leaf '" + name + "' is made from '" + bundle.leaves[static_cast<size_t>(leaf.table_of)]->name +
                  "'; bind that instead"};
  if (leaf.is_fixed && data.consistent() && !holds_initial(leaf, data)) {
    std::ostringstream value;
    for (size_t k = 0; k < leaf.initial.size(); ++k) value << (k == 0 ? "" : ", ") << leaf.initial[k];
    throw Failure{
        "leaf '" + name + "' was given as " + value.str() +
        " when the program was compiled, which left out what that makes zero; compile it without for other values"};
  }
  assign(index, data);
}

void Program::State::make_tables() {
  // What waits for sizes waits until another symbol has a value; symbols keep theirs.
  if (const size_t known = sizes.symbols().size(); known != symbols_of_tables) {
    new_faces.merge(waiting_faces);
    symbols_of_tables = known;
  }
  // A table may have tables of its own.
  while (!new_faces.empty()) {
    const auto [leaf, faces] = *new_faces.begin();
    const auto tables = topology_tables(bundle, leaf, faces, sizes.symbols());
    if (!tables) throw Failure{tables.error()};  // and again, until others are bound
    for (const auto& [table, numbers] : *tables) assign(table, numbers);
    new_faces.erase(leaf);
    for (size_t k = 0; k < bundle.leaves.size(); ++k)
      if (bundle.leaves[k]->table_of == static_cast<int>(leaf) && !tables->contains(k))
        waiting_faces.emplace(leaf, faces);
  }
}

template <class Array>
Sizes Program::State::sizes_with(size_t index, const Array& data) const {
  const bundle::LeafT& leaf = *bundle.leaves[index];
  const std::string origin = "leaf '" + leaf.name + "'";
  if (data.components != components_of(*leaf.type))
    throw Failure{origin + " has " + std::to_string(components_of(*leaf.type)) +
                  " components an element, the data has " + std::to_string(data.components)};
  const std::pair<const std::string*, int64_t> axes[] = {
      {&leaf.extent->w, data.width}, {&leaf.extent->h, data.height}, {&leaf.extent->l, data.layers}};
  const char* const axis_names[] = {"width", "height", "number of layers"};
  Sizes agreed = sizes;
  for (size_t a = 0; a < 3; ++a) {
    const auto dim = ir::Dim::parse(*axes[a].first);
    for (size_t b = 0; b < a; ++b)
      if (dim->as_symbol() && *axes[b].first == *axes[a].first && axes[b].second != axes[a].second)
        throw Failure{origin + " has a " + axis_names[b] + " of " + std::to_string(axes[b].second) + " and a " +
                      axis_names[a] + " of " + std::to_string(axes[a].second) + ", and both are '" + *axes[a].first +
                      "'"};
    if (const auto symbol = dim->as_symbol())
      agreed.set(*symbol, axes[a].second, origin);
    else if (const auto value = dim->evaluate(agreed.symbols()); value && *value != axes[a].second)
      throw Failure{origin + " has a " + axis_names[a] + " of " + std::to_string(axes[a].second) + ", expected " +
                    (dim->is_constant() ? "" : *axes[a].first + " = ") + std::to_string(*value)};
  }
  return agreed;
}
template Sizes Program::State::sizes_with(size_t index, const HostArray& data) const;

// A mesh that is bound anew has as many edges as the one before, as all leaves keep their sizes.
void Program::State::check_tables(size_t faces, const io::Array& data) const {
  const auto has_data = [&](const auto& leaf) {
    return leaf->table_of == static_cast<int>(faces) &&
           (pending[static_cast<size_t>(&leaf - bundle.leaves.data())] || has_memory(leaf->resource));
  };
  if (std::ranges::none_of(bundle.leaves, has_data)) return;
  const auto tables = topology_tables(bundle, faces, data, sizes.symbols());
  if (!tables) return;  // told when they are made
  for (const auto& [table, numbers] : *tables) {
    const auto had = ir::Dim::parse(bundle.leaves[table]->extent->w)->evaluate(sizes.symbols());
    if (had && *had != numbers.width)
      throw Failure{"leaf '" + bundle.leaves[faces]->name + "' has a topology of " + std::to_string(numbers.width) +
                    " for '" + bundle.leaves[table]->table + "', and had one of " + std::to_string(*had) +
                    " when it was first bound: a run keeps its sizes, so a mesh with others takes another run"};
  }
}

void Program::State::assign(size_t index, const io::Array& data) {
  const bundle::LeafT& leaf = *bundle.leaves[index];
  const std::string origin = "leaf '" + leaf.name + "'";
  if (!data.consistent())
    throw Failure{origin + ": the array's extent of " + std::to_string(data.width) + " x " +
                  std::to_string(data.height) + " x " + std::to_string(data.layers) + " elements of " +
                  std::to_string(data.components) + " components and its " + std::to_string(data.bytes.size()) +
                  " bytes do not agree, or it is empty"};
  Sizes agreed = sizes_with(index, data);  // taken over when all is well
  auto converted = data.converted(kind_of(*leaf.type));
  if (!converted) throw Failure{origin + ": " + converted.error()};
  if (has_tables(index)) check_tables(index, *converted);
  sizes = std::move(agreed);
  if (has_tables(index)) {
    new_faces.insert_or_assign(index, *converted);
    waiting_faces.erase(index);
  }
  ++versions[index];
  spoiled.erase(index);
  keep_outputs(leaf.resource);
  if (has_memory(leaf.resource))
    on_device->transfer.upload(leaf.resource, *converted);
  else
    pending[index] = std::move(converted).value();
}

const io::Array* Program::State::kept_output(size_t step, const std::string& name) const {
  const auto of_step = kept.find(step);
  if (of_step == kept.end()) return nullptr;
  const auto it = of_step->second.find(name);
  return it == of_step->second.end() ? nullptr : &it->second;
}

void Program::State::keep_outputs(uint32_t resource) {
  if (!on_device) return;
  for (size_t step = 0; step < bundle.steps.size(); ++step)
    for (const auto& o : bundle.steps[step]->outputs)
      if (o->resource == resource && on_device->steps[step].has_outputs() && kept_output(step, o->name) == nullptr)
        kept[step].emplace(o->name, on_device->transfer.download(resource));
}

bool Program::State::write(size_t index, const HostArray& data) {
  const bundle::LeafT& leaf = *bundle.leaves[index];
  if (!has_memory(leaf.resource) || leaf.is_fixed || leaf.table_of >= 0 || has_tables(index)) return false;
  std::byte* to = on_device->memory.buffer(leaf.resource).host;
  if (to == nullptr || data.kind != kind_of(*leaf.type) || data.kind == io::ElementKind::Bool ||
      data.components != components_of(*leaf.type))
    return false;
  const Size size = sizes.size_of(*leaf.extent, leaf.name);
  if (data.width != size.w || data.height != size.h || data.layers != size.l) return false;
  on_device->queue.finish();
  keep_outputs(leaf.resource);
  // From a view of the same leaf there is nothing to copy.
  std::memmove(to, data.data, static_cast<size_t>(size.count() * data.components) * 4);
  ++versions[index];
  spoiled.erase(index);
  return true;
}

std::optional<HostArray> Program::State::view(size_t resource, size_t holder) {
  const bundle::ResourceT& r = *bundle.resources[resource];
  if (r.storage != bundle::Storage::Buffer || is_words(r)) return std::nullopt;
  std::byte* data = on_device->memory.buffer(resource).host;
  // A bool takes a word there. Tables follow their leaf when it is bound.
  const bool is_leaf = holder < bundle.leaves.size();
  if (data == nullptr || kind_of(*r.type) == io::ElementKind::Bool || (is_leaf && has_tables(holder)))
    return std::nullopt;
  on_device->queue.finish();
  const Size size = sizes.size_of(*r.extent, r.name);
  HostArray out{kind_of(*r.type), components_of(*r.type), size.w, size.h, size.l, data, views[holder].held.lock()};
  if (!out.held) views[holder].held = out.held = std::make_shared<char>();
  views[holder].lent = true;
  return out;
}

bool Program::State::is_leaf(size_t resource) const {
  return std::ranges::any_of(bundle.leaves, [&](const auto& leaf) { return leaf->resource == resource; });
}

bool Program::State::has_views() const {
  return std::ranges::any_of(views, [](const Views& view) { return !view.held.expired(); });
}

bool Program::State::has_tables(size_t leaf) const {
  return std::ranges::any_of(bundle.leaves, [&](const auto& l) { return l->table_of == static_cast<int>(leaf); });
}

std::optional<size_t> Program::State::initial_step(size_t leaf) const {
  if (pending[leaf] || has_memory(bundle.leaves[leaf]->resource)) return std::nullopt;
  return any_step(ir::initial_step_of(bundle.leaves[leaf]->name));
}

bool Program::State::is_bound(size_t leaf) const {
  const bundle::LeafT& l = *bundle.leaves[leaf];
  return pending[leaf] || has_memory(l.resource) || !l.initial.empty() || l.kind == bundle::LeafKind::State;
}

uint32_t Program::State::bound_for(uint32_t leaf) const {
  while (bundle.leaves[leaf]->table_of >= 0) leaf = static_cast<uint32_t>(bundle.leaves[leaf]->table_of);
  return leaf;
}

std::optional<uint32_t> Program::State::faces_of(const std::string& symbol) const {
  for (uint32_t k = 0; k < bundle.leaves.size(); ++k)
    if (const uint32_t faces = bound_for(k);
        faces != k && bundle.leaves[k]->extent->w == symbol && bundle.leaves[faces]->extent->w != symbol)
      return faces;
  return std::nullopt;
}

void Program::State::collect_needs(const bundle::StepT& step, Needs& needs) const {
  for (const std::string& symbol : step.symbols) {
    needs.symbols.insert(symbol);
    if (const auto faces = faces_of(symbol); faces && !sizes.symbols().contains(symbol)) needs.leaves.insert(*faces);
  }
  needs.resources.merge(resources_of(step));
  for (const uint32_t k : step.leaves) {
    if (only_writes(bundle, step, k) || !needs.leaves.insert(k).second) continue;
    if (const auto initial = initial_step(k)) collect_needs(*bundle.steps[*initial], needs);
  }
}

// Memory and contents for a step: what only other steps need may stay unbound. What is missing is told before anything
// is computed.
void Program::State::prepare(const bundle::StepT& step) {
  objects();
  Needs needs;
  collect_needs(step, needs);
  std::string missing, written;
  size_t count = 0;
  for (const uint32_t k : needs.leaves)
    if (!is_bound(k) && !initial_step(k)) {
      const bundle::LeafT& leaf = *bundle.leaves[bound_for(k)];
      if (missing.find("'" + leaf.name + "' ") != std::string::npos) continue;
      missing += (count++ == 0 ? "" : ", ") + ("'" + leaf.name + "' " + extent_text(*leaf.extent));
      for (const auto& other : bundle.steps)
        if (only_writes(bundle, *other, k) && is_users(*other))
          written += "; step '" + other->name + "' writes '" + leaf.name + "': run it before";
    }
  if (count > 0)
    throw Failure{title_of(step) + " needs data for " + (count == 1 ? "leaf " : "leaves ") + missing +
                  (count == 1 ? ", which is not bound" : ", which are not bound") + written};
  for (const std::string& symbol : needs.symbols)
    if (sizes.symbols().count(symbol) == 0)
      throw Failure{"symbol '" + symbol +
                    "' has no value: bind a leaf that has it, or the symbol itself (drun: --symbol " + symbol + "=N)"};
  check_memory(needs.resources);
  for (const uint32_t k : step.leaves)
    if (!only_writes(bundle, step, k)) fill(k);
  give_memory(resources_of(step));
}

std::set<uint32_t> Program::State::resources_of(const bundle::StepT& step) const {
  std::set<uint32_t> resources;
  for (const auto& c : step.commands) collect(*c, resources);
  for (const auto& o : step.outputs) resources.insert(o->resource);
  for (const auto& p : step.pins) resources.insert(p->resource);
  for (const auto& r : step.rasters) resources.insert(r->resources.begin(), r->resources.end());
  for (const uint32_t k : step.leaves) resources.insert(bundle.leaves[k]->resource);
  if (step.step_index >= 0) resources.insert(static_cast<uint32_t>(step.step_index));
  return resources;
}

void Program::State::prepare_leaf(size_t leaf) {
  objects();
  require_whole(leaf);
  fill(leaf);
  if (!is_bound(leaf)) throw Failure{"leaf '" + bundle.leaves[leaf]->name + "' is not bound"};
  give_memory({bundle.leaves[leaf]->resource});
}

// Those that have no memory yet can have it, and data that was bound fits the leaves among them.
std::vector<uint32_t> Program::State::check_memory(const std::set<uint32_t>& wanted) const {
  std::vector<uint32_t> resources;
  for (const uint32_t r : wanted)
    if (!on_device->memory.has(r)) resources.push_back(r);
  for (size_t k = 0; k < bundle.leaves.size(); ++k)
    if (pending[k] && std::ranges::find(resources, bundle.leaves[k]->resource) != resources.end()) {
      const Size s = sizes.size_of(*bundle.leaves[k]->extent, "leaf '" + bundle.leaves[k]->name + "'");
      const io::Array& data = *pending[k];
      if (data.width != s.w || data.height != s.h || data.layers != s.l)
        throw Failure{"leaf '" + bundle.leaves[k]->name + "' has data of " + std::to_string(data.width) + " x " +
                      std::to_string(data.height) + " x " + std::to_string(data.layers) + ", expected " +
                      std::to_string(s.w) + " x " + std::to_string(s.h) + " x " + std::to_string(s.l)};
    }
  on_device->memory.check_sizes(resources);
  return resources;
}

// Allocates those that have no memory yet, and fills the leaves among them.
void Program::State::give_memory(const std::set<uint32_t>& wanted) {
  const std::vector<uint32_t> resources = check_memory(wanted);
  std::vector<size_t> leaves;
  for (size_t k = 0; k < bundle.leaves.size(); ++k)
    if (std::ranges::find(resources, bundle.leaves[k]->resource) != resources.end()) leaves.push_back(k);
  std::map<size_t, io::Array> initial;
  for (const size_t k : leaves)
    if (!pending[k]) initial.emplace(k, initial_value(k));
  on_device->memory.allocate(resources);
  for (const size_t k : leaves) {
    on_device->transfer.upload(bundle.leaves[k]->resource, pending[k] ? *pending[k] : initial.at(k));
    pending[k].reset();
  }
}

io::Array Program::State::initial_value(size_t index) const {
  const bundle::LeafT& leaf = *bundle.leaves[index];
  const Size s = sizes.size_of(*leaf.extent, "leaf '" + leaf.name + "'");
  const int n = components_of(*leaf.type);
  const std::vector<double> values =
      leaf.initial.empty() ? std::vector<double>(static_cast<size_t>(n), 0.0) : leaf.initial;
  const auto element = io::Array::from_doubles(values, n, 1, 1, 1).converted(kind_of(*leaf.type));
  if (!element) throw Failure{"leaf '" + leaf.name + "': " + element.error()};
  io::Array out = io::Array::zeros(element->kind, n, s.w, s.h, s.l);
  for (size_t at = 0; at < out.bytes.size(); at += element->bytes.size())
    std::ranges::copy(element->bytes, out.bytes.begin() + static_cast<std::ptrdiff_t>(at));
  return out;
}

OnDevice& Program::State::objects() {
  if (!device) throw Failure{"the program was loaded without a device"};
  if (!on_device) on_device.emplace(device, bundle, sizes, options, tally);
  return *on_device;
}

}  // namespace dr::runtime
