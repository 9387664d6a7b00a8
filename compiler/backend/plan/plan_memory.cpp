// SPDX-License-Identifier: Apache-2.0
// Memory planning on the bundle's commands.
#include "compiler/backend/plan/plan_memory.h"

#include <algorithm>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include "compiler/backend/plan/dependencies.h"

namespace dr::backend {

using bundle::BundleT;
using bundle::CommandKind;

namespace {

// Whether two commands of a step always run together; past the end stands what happens after every run.
bool together(const bundle::StepT& step, int a, int b) {
  const auto end = static_cast<int>(step.commands.size());
  if (a < end && b < end)
    return run_together(*step.commands[static_cast<size_t>(a)], *step.commands[static_cast<size_t>(b)]);
  const int other = std::min(a, b);
  return other == end || step.commands[static_cast<size_t>(other)]->steady;
}

}  // namespace

std::vector<Lifetime> lifetimes(const BundleT& bundle) {
  std::vector<Lifetime> out(bundle.resources.size());
  std::set<uint32_t> forever;
  for (uint32_t k = 0; k < bundle.resources.size(); ++k)
    if (stays(*bundle.resources[k])) forever.insert(k);
  for (int s = 0; s < static_cast<int>(bundle.steps.size()); ++s) {
    const bundle::StepT& step = *bundle.steps[static_cast<size_t>(s)];
    const int end = static_cast<int>(step.commands.size());
    // `at` = `end` is what the host reads when the step has run, whether all of it ran or not.
    auto touch = [&](uint32_t resource, int at) {
      Lifetime& life = out[resource];
      if (!life.used)
        life = {s, at, at, true};
      else if (life.step != s || !together(step, life.last, at))
        forever.insert(resource);
      else
        life.last = at;
    };
    // A render pass holds all its attachments from its first subpass to its last.
    for (int begin = 0, next; begin < end; begin = next) {
      next = begin + 1;
      while (next < end && step.commands[static_cast<size_t>(next)]->joins) ++next;
      for (int at = begin; at < next; ++at)
        for_each_access(*step.commands[static_cast<size_t>(at)], [&](uint32_t r, bundle::Access) {
          touch(r, begin);
          touch(r, next - 1);
        });
    }
    for (const auto& raster : step.rasters)
      for (uint32_t r : raster->resources) touch(r, end);
    for (const auto& pin : step.pins) touch(pin->resource, end);
    for (const auto& output : step.outputs) forever.insert(output->resource);
  }
  for (uint32_t r : forever) out[r].step = -1;
  return out;
}

std::optional<int64_t> resource_bytes(const bundle::ResourceT& r, const ir::SymbolValues& symbols) {
  auto axis = [&](const std::string& text) {
    const auto dim = ir::Dim::parse(text);
    return dim ? dim->evaluate(symbols) : std::nullopt;
  };
  if (const auto room = r.room.empty() ? std::nullopt : axis(r.room); room && *room <= 0) return 4;
  const auto w = axis(r.extent->w), h = axis(r.extent->h), l = axis(r.extent->l);
  if (!w || !h || !l) return std::nullopt;
  int64_t bytes = 4;
  const int64_t behind = elements_behind(r) * 4 * r.type->rows * r.type->cols;
  if (!is_words(r) && r.storage != bundle::Storage::Depth) bytes *= r.type->rows * r.type->cols;
  if ((r.storage == bundle::Storage::Image || r.storage == bundle::Storage::Tile) && r.type->rows == 3) bytes = 16;
  for (int64_t n : {*w, *h, *l})
    if (__builtin_mul_overflow(bytes, std::max<int64_t>(n, 0), &bytes)) return std::nullopt;
  if (__builtin_add_overflow(bytes, behind, &bytes)) return std::nullopt;
  return bytes;
}

void plan_memory(BundleT& bundle) {
  constexpr int64_t kLarge = 512;  // cubes of it leave room for products in 64 bits
  ir::SymbolValues nominal;
  for (const std::string& symbol : bundle.symbols) nominal[symbol] = kLarge;
  const std::vector<Lifetime> lives = lifetimes(bundle);
  std::vector<int64_t> bytes;
  for (const auto& r : bundle.resources)
    bytes.push_back(resource_bytes(*r, nominal).value_or(std::numeric_limits<int64_t>::max()));

  std::vector<uint32_t> order(bundle.resources.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return bytes[a] > bytes[b]; });
  struct Slot {
    bundle::Storage storage;
    int64_t bytes;
    std::vector<uint32_t> members;  // empty: shared by none
  };
  std::vector<Slot> slots;
  auto fits = [&](const Slot& slot, uint32_t r) {
    return slot.storage == bundle.resources[r]->storage && !slot.members.empty() &&
           std::none_of(slot.members.begin(), slot.members.end(), [&](uint32_t other) {
             return lives[other].step == lives[r].step && lives[other].first <= lives[r].last &&
                    lives[r].first <= lives[other].last;
           });
  };
  for (uint32_t r : order) {
    size_t best = slots.size();
    if (lives[r].transient())
      for (size_t k = 0; k < slots.size(); ++k)
        if (fits(slots[k], r) && (best == slots.size() || slots[k].bytes < slots[best].bytes)) best = k;
    if (best == slots.size()) slots.push_back({bundle.resources[r]->storage, bytes[r], {}});
    if (lives[r].transient()) slots[best].members.push_back(r);
    bundle.resources[r]->slot = static_cast<uint32_t>(best);
  }
}

std::vector<std::string> check_memory(const BundleT& bundle) {
  const std::vector<Lifetime> lives = lifetimes(bundle);
  std::vector<std::string> problems;
  for (uint32_t a = 0; a < bundle.resources.size(); ++a)
    for (uint32_t b = 0; b < a; ++b) {
      const bundle::ResourceT &x = *bundle.resources[a], &y = *bundle.resources[b];
      if (x.slot != y.slot) continue;
      const bool apart =
          lives[a].transient() && lives[b].transient() &&
          (lives[a].step != lives[b].step || lives[a].last < lives[b].first || lives[b].last < lives[a].first);
      if (!apart) problems.push_back("'" + y.name + "' and '" + x.name + "' share memory while both are needed");
    }
  // What shares memory finds anything in it: the first command that touches it must write it. What is kept of loops is
  // written by the first of the dispatches of its command.
  for (const auto& step : bundle.steps) {
    std::set<uint32_t> seen;
    for (const auto& command : step->commands)
      for_each_access(*command, [&](uint32_t r, bundle::Access access) {
        if (seen.insert(r).second && lives[r].transient() && access != bundle::Access::Write &&
            bundle.resources[r]->room.empty())
          problems.push_back("'" + bundle.resources[r]->name + "' is read before it is written");
      });
  }
  return problems;
}

std::optional<MemoryUse> memory_use(const BundleT& bundle, const ir::SymbolValues& symbols) {
  const std::vector<Lifetime> lives = lifetimes(bundle);
  MemoryUse out;
  std::map<uint32_t, int64_t> slots;
  std::map<std::pair<int, int>, int64_t> alive;  // step, command
  for (uint32_t k = 0; k < bundle.resources.size(); ++k) {
    const auto bytes = resource_bytes(*bundle.resources[k], symbols);
    if (!bytes) return std::nullopt;
    out.unshared += *bytes;
    int64_t& slot = slots[bundle.resources[k]->slot];
    slot = std::max(slot, *bytes);
    if (!lives[k].transient()) {
      out.persistent += *bytes;
      continue;
    }
    for (int at = lives[k].first; at <= lives[k].last; ++at) alive[{lives[k].step, at}] += *bytes;
  }
  for (const auto& [slot, bytes] : slots) out.planned += bytes;
  int64_t most = 0;
  for (const auto& [at, bytes] : alive) most = std::max(most, bytes);
  out.lower_bound = out.persistent + most;
  return out;
}

}  // namespace dr::backend
