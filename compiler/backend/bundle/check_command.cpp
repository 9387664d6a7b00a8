// SPDX-License-Identifier: Apache-2.0
// Verification of a step's commands.
#include <algorithm>

#include "compiler/backend/bundle/checker.h"
#include "compiler/backend/bundle/touched.h"

namespace dr::bundle {

namespace {

constexpr unsigned bit(CommandKind kind) { return 1u << static_cast<unsigned>(kind); }

constexpr unsigned kDispatch = bit(CommandKind::Dispatch), kDraw = bit(CommandKind::Draw),
                   kFill = bit(CommandKind::Fill), kCopy = bit(CommandKind::Copy), kReduce = bit(CommandKind::Reduce);

}  // namespace

std::vector<Touched> touched_by(const CommandT& c) {
  std::vector<Touched> out;
  for (const auto& b : c.bindings) {
    if (b->access != Access::Write) out.push_back({b->resource, false});
    if (b->access != Access::Read) out.push_back({b->resource, true});
  }
  for (const uint32_t color : c.colors) out.push_back({color, true});
  for (const int read : {c.source, c.indirect})
    if (read >= 0) out.push_back({static_cast<uint32_t>(read), false});
  for (const int written : {c.depth, c.target, c.scratch_a, c.scratch_b})
    if (written >= 0) out.push_back({static_cast<uint32_t>(written), true});
  return out;
}

// What a command's kind does not use is not there: nothing that nobody looked at reaches who walks over all fields.
bool Checker::only_own_fields(const CommandT& c, const std::string& where) {
  const struct {
    const char* field;
    bool given;
    unsigned kinds;
  } fields[] = {
      {"compute", c.compute != -1, kDispatch | kReduce},
      {"next", c.next != -1, kReduce},
      {"vertex", c.vertex != -1, kDraw},
      {"fragment", c.fragment != -1, kDraw},
      {"bindings", !c.bindings.empty(), kDispatch | kDraw | kReduce},
      {"elements", !c.elements.empty(), kDispatch | kDraw | kFill},
      {"indirect", c.indirect != -1, kDispatch},
      {"extent", c.extent != nullptr, kDraw},
      {"push", !c.push.empty(), kDispatch | kDraw | kReduce},
      {"trips", !c.trips.empty(), kDispatch},
      {"most_trips", c.most_trips != 0, kDispatch},
      {"part_trips", c.part_trips != 0, kDispatch},
      {"watch", c.watch != -1, kDispatch},
      {"left", c.left != -1, kDispatch},
      {"finite", c.finite != -1, kDispatch},
      {"group", c.group != 0, kDispatch | kReduce},
      {"each", c.each != 0, kDispatch},
      {"faces", !c.faces.empty(), kDispatch},
      {"colors", !c.colors.empty(), kDraw},
      {"clear", !c.clear.empty(), kDraw},
      {"joins", c.joins, kDraw},
      {"inputs", !c.inputs.empty(), kDraw},
      {"depth", c.depth != -1, kDraw},
      {"value", c.value != 0, kFill},
      {"source", c.source != -1, kCopy},
      {"target", c.target != -1, kFill | kCopy | kReduce},
      {"outs", !c.outs.empty(), kReduce},
      {"count", !c.count.empty(), kDispatch | kReduce},
      {"scratch_a", c.scratch_a != -1, kReduce},
      {"scratch_b", c.scratch_b != -1, kReduce},
  };
  for (const auto& f : fields)
    if (f.given && (f.kinds & bit(c.kind)) == 0)
      return fail(where + " has '" + f.field + "', which commands of its kind do not use");
  return true;
}

bool Checker::bindings(const CommandT& c, const std::string& where) {
  for (const auto& binding : c.bindings) {
    if (!binding || !resource(binding->resource, where)) return fail(where + " has an empty binding");
    if (binding->access > Access::MAX) return fail(where + " has an unknown access");
    const ResourceT& r = *b_.resources[binding->resource];
    if (r.storage == Storage::Depth || (r.storage != Storage::Buffer && binding->access != Access::Read))
      return fail(where + " binds an attachment for writing");
    // Fragment shaders store nothing but attachments: barriers know of no other writes of draws.
    if (c.kind == CommandKind::Draw && binding->access != Access::Read)
      return fail(where + " writes a buffer by a draw");
    // The host clears the words that a command names, and no others.
    const auto word = static_cast<int>(binding->resource);
    if (r.role == Role::Watch && word != c.watch && word != c.finite)
      return fail(where + " binds a watch that it does not name");
    if (!r.room.empty() && binding->access != Access::ReadWrite)
      return fail(where + " reads what loops keep between parts, and does not write it");
    if (binding->texel > 4 ||
        (binding->texel != 0 && (r.storage != Storage::Buffer || binding->access != Access::Read)))
      return fail(where + " binds as texels what cannot be");
  }
  return true;
}

// In how many dispatches a command's loops run, and where they say that they did not come to their end.
bool Checker::trips(const CommandT& c, const std::string& where) {
  if (!c.trips.empty() && (!expression(c.trips, where) || c.most_trips == 0)) return fail(where + " takes no trips");
  if (c.most_trips != 0 && c.most_trips != b_.loop_trips)
    return fail(where + " takes other trips at most than the bundle says");
  return left(c, where) && watched(c, c.watch, where) && watched(c, c.finite, where);
}

// Dispatches that go on are as large as scratch memory says that the command binds, so that its use is known.
bool Checker::left(const CommandT& c, const std::string& where) {
  if ((c.left == -1) != (c.part_trips == 0)) return fail(where + " does not say how it goes on");
  if (c.left == -1) return true;
  for (const auto& binding : c.bindings)
    if (c.left >= 0 && binding->resource == static_cast<uint32_t>(c.left))
      return (b_.resources[binding->resource]->role == Role::Scratch && binding->access == Access::ReadWrite) ||
             fail(where + " goes on as a value says");
  return fail(where + " goes on as a resource says that it does not bind");
}

bool Checker::watched(const CommandT& c, int word, const std::string& where) {
  if (word < 0) return word == -1 || fail(where + " is watched by no resource");
  for (const auto& binding : c.bindings)
    if (binding->resource == static_cast<uint32_t>(word))
      return b_.resources[binding->resource]->role == Role::Watch || fail(where + " is watched by what is no watch");
  return fail(where + " is watched by a resource that it does not bind");
}

bool Checker::dispatch(const CommandT& c, const std::string& where) {
  if (!shader(c.compute, Stage::Compute, where) || !expression(c.elements, where) || !trips(c, where)) return false;
  if (!c.count.empty() && !expression(c.count, where)) return false;
  if (!c.faces.empty() && !expression(c.faces, where)) return false;
  for (const auto& binding : c.bindings)
    if (b_.resources[binding->resource]->storage == Storage::Tile) return kept(binding->resource, where);
  if (c.group != 0 && c.indirect != -1) return fail(where + " is as large as a resource says, which counts in 64");
  if (c.indirect < 0) return c.indirect == -1 || fail(where + " is as large as no resource says");
  // Numbers of workgroups come from scratch memory that the command binds, so that its use is known.
  for (const auto& binding : c.bindings)
    if (binding->resource == static_cast<uint32_t>(c.indirect))
      return b_.resources[binding->resource]->role == Role::Scratch || fail(where + " is as large as a value says");
  return fail(where + " is as large as a resource says that it does not bind");
}

bool Checker::draw(const CommandT& c, const std::string& where) {
  if (!shader(c.vertex, Stage::Vertex, where) || !shader(c.fragment, Stage::Fragment, where)) return false;
  if (!expression(c.elements, where) || !extent(c.extent, where)) return false;
  if (c.colors.empty() || c.colors.size() != c.clear.size())
    return fail(where + " has no clear value for each colour attachment");
  for (const uint32_t color : c.colors) {
    const bool tile = color < b_.resources.size() && b_.resources[color]->storage == Storage::Tile;
    if (!tile && !storage(color, Storage::Image, where)) return false;
    if (std::ranges::count(c.colors, color) != 1) return fail(where + " writes an attachment a second time");
  }
  return c.depth == -1 || storage(c.depth, Storage::Depth, where);
}

bool Checker::copy(const CommandT& c, const std::string& where) {
  if (!kept(c.source, where) || !storage(c.target, Storage::Buffer, where)) return false;
  const ResourceT &from = *b_.resources[static_cast<size_t>(c.source)],
                  &to = *b_.resources[static_cast<size_t>(c.target)];
  if (from.storage == Storage::Depth) return fail(where + " copies a depth image");
  if (!is_value(from) || !is_value(to) || from.type->rows != to.type->rows || from.type->cols != to.type->cols ||
      from.extent->w != to.extent->w || from.extent->h != to.extent->h || from.extent->l != to.extent->l)
    return fail(where + " copies between unlike resources");
  return c.source != c.target || fail(where + " copies a resource to itself");
}

bool Checker::reduce(const CommandT& c, const std::string& where) {
  if (!shader(c.compute, Stage::Compute, where) || !shader(c.next, Stage::Compute, where) ||
      !storage(c.target, Storage::Buffer, where) || !storage(c.scratch_a, Storage::Buffer, where) ||
      !storage(c.scratch_b, Storage::Buffer, where) || !expression(c.outs, where) || !expression(c.count, where))
    return false;
  if (c.scratch_a == c.scratch_b || c.scratch_a == c.target || c.scratch_b == c.target)
    return fail(where + " reads partial results where it writes others");
  for (const int scratch : {c.scratch_a, c.scratch_b})
    if (b_.resources[static_cast<size_t>(scratch)]->role != Role::Scratch)
      return fail(where + " has partial results in what is no scratch memory");
  for (const auto& binding : c.bindings) {
    const int index = static_cast<int>(binding->resource);
    if (binding->access != Access::Read || index == c.target || index == c.scratch_a || index == c.scratch_b)
      return fail(where + " writes what it reads");
    if (!kept(index, where)) return false;
  }
  return true;
}

bool Checker::attachments(const StepT& step, size_t index, std::set<uint32_t>& written, const std::string& where) {
  const CommandT& c = *step.commands[index];
  for (size_t k = index; k-- > 0;) {
    const CommandT& before = *step.commands[k];
    const bool alike = c.kind == CommandKind::Draw && before.kind == CommandKind::Draw && c.depth < 0 &&
                       before.depth < 0 && before.extent->w == c.extent->w && before.extent->h == c.extent->h &&
                       before.extent->l == c.extent->l;
    if (!alike) return fail(where + " joins a render pass of another kind");
    if (before.steady != c.steady || before.foresees != c.foresees || before.leaves != c.leaves)
      return fail(where + " depends on other leaves than the render pass that it joins");
    written.insert(before.colors.begin(), before.colors.end());
    if (!before.joins) return true;
  }
  return fail(where + " joins no render pass");
}

bool Checker::subpass(const StepT& step, size_t index, const std::string& where) {
  const CommandT& c = *step.commands[index];
  const auto is_input = [&](uint32_t resource) { return std::ranges::find(c.inputs, resource) != c.inputs.end(); };
  for (const auto& bound : c.bindings) {
    if (!is_input(bound->resource) && !kept(bound->resource, where)) return false;
    if (std::ranges::find(c.colors, bound->resource) != c.colors.end())
      return fail(where + " reads an attachment that it writes");
  }
  if (!c.joins) return c.inputs.empty() || fail(where + " has input attachments, but no subpass before it");
  std::set<uint32_t> written;
  if (!attachments(step, index, written, where)) return false;
  for (const uint32_t input : c.inputs) {
    const auto bound = std::ranges::count_if(c.bindings, [&](const auto& own) { return own->resource == input; });
    if (written.count(input) == 0 || bound != 1 || std::ranges::count(c.inputs, input) != 1)
      return fail(where + " has an input attachment that no subpass wrote");
  }
  for (const auto& bound : c.bindings)
    if (written.count(bound->resource) != 0 && !is_input(bound->resource))
      return fail(where + " samples an attachment of its render pass");
  for (const uint32_t color : c.colors)
    if (written.count(color) != 0) return fail(where + " writes an attachment a second time");
  return true;
}

bool Checker::touches(const StepT& step, const CommandT& c, const std::string& where) {
  const std::vector<Touched> all = touched_by(c);
  for (const auto& [index, written] : all) {
    const ResourceT& r = *b_.resources[index];
    if (!r.room.empty() && c.part_trips == 0)
      return fail(where + " has no loops that go on, and touches '" + r.name + "', where such keep their state");
    if (r.role == Role::EpochEntries && c.kind != CommandKind::Dispatch && c.kind != CommandKind::Draw)
      return fail(where + " touches '" + r.name + "', whose epochs only shaders know");
    if (r.role == Role::StepIndex && static_cast<int64_t>(index) != step.step_index)
      return fail(where + " counts for another step");
    if (r.role == Role::Leaf) {
      const auto leaf = static_cast<uint32_t>(leaf_of_[index]);
      if (!std::ranges::binary_search(written ? step.changes : step.leaves, leaf))
        return fail(where + (written ? " changes" : " reads") + " leaf '" + r.name + "', which its step does not name");
    }
  }
  // Before the command, and still when it writes: what shares memory with a result is not read beside it.
  const auto reads_hold = [&](const std::string& what) {
    for (const auto& [index, written] : all)
      if (!written && !holds(index)) return fail(where + " reads '" + b_.resources[index]->name + "', " + what);
    return true;
  };
  if (!reads_hold("which no command before it writes")) return false;
  for (const auto& [index, written] : all)
    if (written) holder_[b_.resources[index]->slot] = index;
  return reads_hold("and writes what shares its memory");
}

// Values and scratch memory are fresh memory, or what another resource left there, until a command of the step writes
// them; the host fills all else. What loops keep between the parts of a command is written by its first part.
bool Checker::holds(uint32_t index) const {
  const ResourceT& r = *b_.resources[index];
  if (stays(r) || !r.room.empty()) return true;
  const auto holder = holder_.find(r.slot);
  return holder != holder_.end() && holder->second == index;
}

bool Checker::command(const CommandT& c, const std::string& where) {
  if (c.kind > CommandKind::MAX) return fail(where + " is of an unknown kind");
  if (!only_own_fields(c, where) || !indices(c.leaves, b_.leaves.size(), "leaf", where) || !bindings(c, where))
    return false;
  for (const Line& l : c.lines)
    if (!line(l, where)) return false;
  if (c.ops > INT32_MAX) return fail(where + " computes too many ops");
  if (c.push.size() > 3) return fail(where + " pushes more than three constants");
  switch (c.kind) {
    case CommandKind::Dispatch: return dispatch(c, where);
    case CommandKind::Draw: return draw(c, where);
    case CommandKind::Fill:
      return storage(c.target, Storage::Buffer, where) && (c.elements.empty() || expression(c.elements, where));
    case CommandKind::Copy: return copy(c, where);
    case CommandKind::Reduce: return reduce(c, where);
  }
  return false;
}

bool Checker::commands(const StepT& step) {
  holder_.clear();
  for (size_t k = 0; k < step.commands.size(); ++k) {
    if (!step.commands[k]) return fail("a command is empty");
    const CommandT& c = *step.commands[k];
    if (!title(c.label, "a command")) return false;
    const std::string where = "command '" + c.label + "'";
    if (!command(c, where)) return false;
    for (const uint32_t leaf : c.leaves)
      if (!std::ranges::binary_search(step.leaves, leaf))
        return fail(where + " depends on a leaf that its step does not name");
    if (c.kind == CommandKind::Draw ? !subpass(step, k, where) : c.joins) return false;
    if (!touches(step, c, where)) return false;
  }
  return true;
}

}  // namespace dr::bundle
