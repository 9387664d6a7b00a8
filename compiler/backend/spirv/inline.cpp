// SPDX-License-Identifier: Apache-2.0
// Functions that have one exit, at their end, go where they are called: what is called first, so that each body is
// copied as it stays. A call costs what its copy has of words, and nothing that depends on the function around it.
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "compiler/backend/spirv/module.h"

namespace dr::backend::spirv {

namespace {

constexpr Word kId = Word::Id, kResult = Word::Result, kLiteral = Word::Literal;

class Inliner {
 public:
  explicit Inliner(Module& module)
      : module_(module),
        done_(module.functions.size()),
        can_inline_(module.functions.size()),
        block_count_(module.functions.size()),
        stands_for_(module.bound()),
        owner_(module.bound()),
        copy_(module.bound()),
        copied_in_(module.bound()),
        exact_(module.bound()),
        decorated_(module.bound()),
        exit_(module.bound()) {}

  void process() {
    for_each_instruction(module_.globals, [&](const Instruction& in) {
      if (in.opcode() != kDecorate) return;
      const bool exact = in.words[2] == kNoContraction;
      (exact ? exact_ : decorated_)[in.words[1]] = true;
    });
    for (size_t k = 0; k < module_.functions.size(); ++k) index_of_[module_.functions[k].id] = k;
    inline_into(index_of_.at(module_.entry));
    std::vector<Function> kept;
    for (size_t k = 0; k < module_.functions.size(); ++k)
      if (called_.contains(module_.functions[k].id) || module_.functions[k].id == module_.entry)
        kept.push_back(std::move(module_.functions[k]));
    module_.functions = std::move(kept);
    decorate();
  }

 private:
  uint32_t resolved(uint32_t id) const { return stands_for_[id] == 0 ? id : stands_for_[id]; }

  uint32_t new_id(uint32_t like, uint32_t owner) {
    const uint32_t id = module_.bound()++;
    stands_for_.push_back(0);
    owner_.push_back(owner);
    copy_.push_back(0);
    copied_in_.push_back(0);
    exact_.push_back(exact_[like]);
    decorated_.push_back(false);
    exit_.push_back(0);
    if (exact_[like]) new_exact_.push_back(id);
    return id;
  }

  // Whether a function ends where it returns, and has nothing that a copy could not have.
  bool ends_once(const Function& f) const {
    size_t returns = 0, last = 0;
    bool plain = true;
    for_each_instruction(f.body, [&](const Instruction& in) {
      if (in.opcode() == kReturn || in.opcode() == kReturnValue) ++returns, last = in.at + in.words.size();
      plain = plain && !decorated_[in.result()];
    });
    return plain && returns == 1 && last == f.body.words.size();
  }

  void inline_into(size_t index) {
    if (done_[index]) return;
    done_[index] = true;
    // Functions do not call themselves, so those of the calls are never `f`.
    Stream old = std::move(module_.functions[index].body);
    for_each_instruction(old, [&](const Instruction& in) {
      if (in.opcode() == kFunctionCall) inline_into(index_of_.at(in.words[3]));
    });
    Function& f = module_.functions[index];
    f.body = {};
    const auto own = static_cast<uint32_t>(index + 1);
    for (const uint32_t id : f.parameters) owner_[id] = own;
    for_each_instruction(f.variables, [&](const Instruction& in) { owner_[in.result()] = own; });
    uint32_t first = 0;  // the label of the block that is being read; block_ is the one that is being written
    std::vector<size_t> phis;
    std::unordered_set<uint32_t> loop_headers;
    uint32_t label = 0;
    for_each_instruction(old, [&](const Instruction& in) {
      if (in.opcode() == kLabel) label = in.words[1];
      if (in.opcode() == kLoopMerge) loop_headers.insert(label);
    });
    for_each_instruction(old, [&](const Instruction& in) {
      if (in.opcode() == kLabel) first = block_ = in.words[1];
      if (in.opcode() == kFunctionCall) {
        const size_t callee = index_of_.at(in.words[3]);
        if (can_inline_[callee] && (!loop_headers.contains(first) || block_count_[callee] == 1)) {
          splice(module_.functions[callee], static_cast<uint32_t>(callee + 1), f, own, in);
          return;
        }
        called_.insert(in.words[3]);
      }
      if (in.opcode() == kPhi) phis.push_back(f.body.words.size());
      const size_t at = f.body.words.size();
      f.body.add(in.words, in.kinds);
      for (size_t k = 1; k < in.words.size(); ++k)
        if (in.kinds[k] == kId) f.body.words[at + k] = resolved(in.words[k]);
      if (const uint32_t id = in.result(); id != 0) owner_[id] = own;
      exit_[first] = block_;
    });
    // A block that calls have been put into ends as another one.
    for (const size_t at : phis)
      for (size_t k = at + 3; k + 1 < at + (f.body.words[at] >> 16); k += 2) {
        f.body.words[k] = resolved(f.body.words[k]);
        f.body.words[k + 1] = exit_[f.body.words[k + 1]];
      }
    can_inline_[index] = ends_once(f);
    size_t blocks = 0;
    for_each_instruction(f.body, [&](const Instruction& in) { blocks += in.opcode() == kLabel ? 1 : 0; });
    block_count_[index] = blocks;
  }

  // What stands for an id of the callee in this copy; ids from outside of it stand for themselves.
  uint32_t copied(uint32_t id, uint32_t callee, uint32_t own) {
    if (owner_[id] != callee) return id;
    if (copied_in_[id] != copies_) {
      const uint32_t fresh = new_id(id, own);
      copied_in_[id] = copies_;
      copy_[id] = fresh;
    }
    return copy_[id];
  }

  void splice(const Function& callee, uint32_t callee_owner, Function& f, uint32_t own, const Instruction& call) {
    ++copies_;
    const auto is = [&](uint32_t id, uint32_t what) { copy_[id] = what, copied_in_[id] = copies_; };
    for (size_t k = 0; k < callee.parameters.size(); ++k) is(callee.parameters[k], resolved(call.words[4 + k]));
    is(callee.body.words[1], block_);
    for_each_instruction(callee.variables, [&](const Instruction& in) {
      const uint32_t id = copied(in.result(), callee_owner, own);
      const uint32_t words[] = {(4u << 16) | kVariable, in.words[1], id, in.words[3]};
      const Word kinds[] = {kLiteral, kId, kResult, kLiteral};
      f.variables.add(words, kinds);
      if (in.words.size() < 5) return;
      const uint32_t store[] = {(3u << 16) | kStore, id, in.words[4]};  // each time it is called
      const Word store_kinds[] = {kLiteral, kId, kId};
      f.body.add(store, store_kinds);
    });
    for_each_instruction(callee.body, [&](const Instruction& in) {
      if (in.at == 0 || in.opcode() == kReturn) return;
      if (in.opcode() == kReturnValue) {
        stands_for_[call.result()] = copied(in.words[1], callee_owner, own);
        return;
      }
      const size_t at = f.body.words.size();
      f.body.add(in.words, in.kinds);
      for (size_t k = 1; k < in.words.size(); ++k)
        if (in.kinds[k] != kLiteral) f.body.words[at + k] = copied(in.words[k], callee_owner, own);
      if (in.opcode() == kLabel) block_ = f.body.words[at + 1];
    });
  }

  // Copies are as exact as what they are copies of.
  void decorate() {
    Stream with;
    bool done = false;
    for_each_instruction(module_.globals, [&](const Instruction& in) {
      if (!std::exchange(done, done || in.opcode() == kDecorate) && done)
        for (const uint32_t id : new_exact_) {
          const uint32_t words[] = {(3u << 16) | kDecorate, id, kNoContraction};
          const Word kinds[] = {kLiteral, kId, kLiteral};
          with.add(words, kinds);
        }
      with.add(in.words, in.kinds);
    });
    module_.globals = std::move(with);
  }

  Module& module_;
  std::unordered_map<uint32_t, size_t> index_of_;
  std::unordered_set<uint32_t> called_;  // functions that stay
  // By index of the function.
  std::vector<bool> done_, can_inline_;
  std::vector<size_t> block_count_;
  // By id.
  std::vector<uint32_t> stands_for_;  // the result of a call that is gone; 0: itself
  std::vector<uint32_t> owner_;       // 1 + the index of the function that defines it; 0: it is global
  std::vector<uint32_t> copy_, copied_in_;
  std::vector<bool> exact_, decorated_;  // NoContraction; by anything else
  std::vector<uint32_t> exit_;           // of a label: that of the block where its block ends now
  std::vector<uint32_t> new_exact_;
  uint32_t copies_ = 0, block_ = 0;
};

}  // namespace

void inline_calls(Module& module) { Inliner(module).process(); }

}  // namespace dr::backend::spirv
