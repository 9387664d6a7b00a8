// SPDX-License-Identifier: Apache-2.0
// glslang keeps each name of a shader in a variable. Where it is known what a variable holds, because it was stored in
// the same block or is stored once, and before, the value stands for what reads it. Then what nothing needs goes.
#include <algorithm>
#include <unordered_map>
#include <utility>

#include "compiler/backend/spirv/module.h"

namespace dr::backend::spirv {

namespace {

// Without an effect: nothing changes if nothing uses the result and it is left out.
bool is_pure(const Instruction& in) {
  const uint16_t op = in.opcode();
  const auto within = [op](uint16_t first, uint16_t last) { return first <= op && op <= last; };
  if (op == kExtInst) return in.words[4] != 35 && in.words[4] != 51;  // Modf and Frexp store
  return op == 1 ||                                                   // OpUndef
         op == kLoad || op == 65 || op == 66 || op == 68 ||           // places in memory, the length of an array
         within(77, 87) || op == 95 || op == 98 || op == 100 ||       // parts of values; what images hold
         within(103, 104) || within(109, 152) || within(154, 191) || within(194, 205) || op == kPhi;
}

class Cleaner {
 public:
  Cleaner(Function& function, uint32_t bound) : f_(function), bound_(bound), variable_(bound, kNone), value_(bound) {}

  void process() {
    for_each_instruction(f_.variables, [&](const Instruction& in) {
      variable_[in.result()] = static_cast<uint32_t>(variables_.size());
      variables_.emplace_back().has_initial = in.words.size() > 4;
    });
    look();
    find_dominators();
    forward();
    keep_what_is_needed();
  }

 private:
  static constexpr uint32_t kNone = ~0u;
  struct Variable {
    bool has_initial = false;
    bool whole = true;  // it is loaded and stored, and nothing else
    uint32_t stores = 0;
    uint32_t stored = 0;      // what the last store on the way stored; 0: nothing yet
    uint32_t block = kNone;   // where
    size_t store = 0;         // its place
    std::vector<size_t> all;  // places of the stores that stay
  };

  Variable* whole_variable(uint32_t pointer) {
    if (variable_[pointer] == kNone) return nullptr;
    Variable& v = variables_[variable_[pointer]];
    return v.whole ? &v : nullptr;
  }

  // Blocks in order, and how variables are used.
  void look() {
    for_each_instruction(f_.body, [&](const Instruction& in) {
      const uint16_t op = in.opcode();
      if (op == kLabel) {
        block_of_[in.words[1]] = static_cast<uint32_t>(blocks_.size());
        blocks_.emplace_back();
      }
      if (op == kLoopMerge) blocks_.back().is_loop = true;
      const size_t pointer = op == kLoad ? 3 : op == kStore ? 1 : 0;
      for (size_t k = 1; k < in.words.size(); ++k) {
        if (in.kinds[k] != Word::Id || variable_[in.words[k]] == kNone) continue;
        Variable& v = variables_[variable_[in.words[k]]];
        if (k != pointer) v.whole = false;
        if (k == pointer && op == kStore) ++v.stores;
      }
    });
    uint32_t block = 0;
    for_each_instruction(f_.body, [&](const Instruction& in) {
      const uint16_t op = in.opcode();
      if (op == kLabel) block = block_of_.at(in.words[1]);
      if (op != kBranch && op != kBranchConditional && op != kSwitch) return;
      for (size_t k = 1; k < in.words.size(); ++k)
        if (const auto to = in.kinds[k] == Word::Id ? block_of_.find(in.words[k]) : block_of_.end();
            to != block_of_.end())
          blocks_[to->second].before.push_back(block);
    });
  }

  // Blocks stand in an order in which all that lead to one come before it, but for the ways back of loops, and those
  // lead to what dominates where they come from.
  void find_dominators() {
    for (uint32_t k = 1; k < blocks_.size(); ++k) {
      Block& block = blocks_[k];
      uint32_t found = kNone;
      for (uint32_t p : block.before) {
        if (p >= k) {
          ordered_ = ordered_ && block.is_loop;
          continue;
        }
        while (found != kNone && found != p) {
          if (found > p)
            found = blocks_[found].dominator;
          else
            p = blocks_[p].dominator;
        }
        found = p;
      }
      block.dominator = found == kNone ? 0 : found;  // what nothing leads to is never run
    }
    // Numbers of a walk over the tree tell at once what dominates what.
    std::vector<uint32_t> size(blocks_.size(), 1), next(blocks_.size());
    for (size_t k = blocks_.size(); k-- > 1;) size[blocks_[k].dominator] += size[k];
    for (uint32_t k = 0; k < blocks_.size(); ++k) {
      uint32_t& from = next[blocks_[k].dominator];
      blocks_[k].first = k == 0 ? 0 : from;
      if (k > 0) from += size[k];
      blocks_[k].last = blocks_[k].first + size[k];
      next[k] = blocks_[k].first + 1;
    }
  }
  bool dominates(uint32_t a, uint32_t b) const {
    return blocks_[a].first <= blocks_[b].first && blocks_[b].first < blocks_[a].last;
  }

  uint32_t resolved(uint32_t id) const { return value_[id] == 0 ? id : value_[id]; }

  void forward() {
    gone_.resize(f_.body.words.size());
    uint32_t block = 0;
    std::vector<size_t> phis;
    for_each_instruction(f_.body, [&](const Instruction& in) {
      for (size_t k = 1; k < in.words.size(); ++k)
        if (in.kinds[k] == Word::Id) f_.body.words[in.at + k] = resolved(in.words[k]);
      const uint16_t op = in.opcode();
      if (op == kLabel) block = block_of_.at(in.words[1]);
      if (op == kPhi) phis.push_back(in.at);
      if (op != kLoad && op != kStore) return;
      Variable* v = whole_variable(in.words[op == kLoad ? 3 : 1]);
      if (v == nullptr) return;
      const bool here = v->stored != 0 && v->block == block;
      if (op == kStore) {
        if (here && v->store != kLoaded) gone_[v->store] = true;  // before anything has read it
        v->stored = in.words[2], v->block = block, v->store = in.at;
        return;
      }
      const bool once = v->stores == 1 && !v->has_initial && v->stored != 0 && v->store != kLoaded && ordered_;
      if (here || (once && dominates(v->block, block))) {
        value_[in.result()] = v->stored;
        gone_[in.at] = true;
      } else if (v->stores != 1) {
        v->stored = in.result(), v->block = block, v->store = kLoaded;
      }
    });
    for (const size_t at : phis)
      for (size_t k = at + 3; k < at + (f_.body.words[at] >> 16); k += 2) f_.body.words[k] = resolved(f_.body.words[k]);
  }

  void keep_what_is_needed() {
    std::vector<size_t> place(bound_, 0);  // 1 + where an id is defined
    std::vector<size_t> work;
    std::vector<bool> needed(f_.body.words.size()), read(variables_.size());
    const auto need = [&](size_t at) {
      if (!gone_[at] && !needed[at]) needed[at] = true, work.push_back(at);
    };
    for_each_instruction(f_.body, [&](const Instruction& in) {
      if (gone_[in.at]) return;
      place[in.result()] = in.at + 1;
      if (in.opcode() == kStore) {
        if (Variable* v = whole_variable(in.words[1])) {
          v->all.push_back(in.at);
          return;
        }
      }
      if (!is_pure(in)) need(in.at);
    });
    while (!work.empty()) {
      const size_t at = work.back();
      work.pop_back();
      const size_t length = f_.body.words[at] >> 16;
      for (size_t k = at + 1; k < at + length; ++k) {
        if (f_.body.kinds[k] != Word::Id) continue;
        const uint32_t id = f_.body.words[k];
        if (place[id] != 0) need(place[id] - 1);
        if (variable_[id] == kNone || read[variable_[id]]) continue;
        read[variable_[id]] = true;
        for (const size_t store : variables_[variable_[id]].all) need(store);
      }
    }
    Stream body, variables;
    for_each_instruction(f_.body, [&](const Instruction& in) {
      if (needed[in.at]) body.add(in.words, in.kinds);
    });
    for_each_instruction(f_.variables, [&](const Instruction& in) {
      if (read[variable_[in.result()]]) variables.add(in.words, in.kinds);
    });
    f_.body = std::move(body);
    f_.variables = std::move(variables);
  }

  static constexpr size_t kLoaded = ~size_t{0};
  struct Block {
    std::vector<uint32_t> before;
    bool is_loop = false;
    uint32_t dominator = 0;
    uint32_t first = 0, last = 0;  // those that it dominates, itself first, in the walk's numbers
  };

  Function& f_;
  uint32_t bound_;
  std::vector<uint32_t> variable_;  // by id: index of the variable
  std::vector<uint32_t> value_;     // by id: what stands for a load that is gone; 0: itself
  std::vector<Variable> variables_;
  std::unordered_map<uint32_t, uint32_t> block_of_;  // by label
  std::vector<Block> blocks_;
  std::vector<bool> gone_;  // by place
  bool ordered_ = true;
};

}  // namespace

void remove_variables(Module& module) {
  for (Function& f : module.functions) Cleaner(f, module.bound()).process();
}

}  // namespace dr::backend::spirv
