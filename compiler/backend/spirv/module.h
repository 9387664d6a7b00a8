// SPDX-License-Identifier: Apache-2.0
// A SPIR-V module as glslang writes it, in a form that can be worked on: words, and of each word whether it is an id.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "compiler/backend/bundle/spirv_numbers.h"

namespace dr::backend::spirv {

using namespace dr::spv;  // the numbers of the specification

enum class Word : uint8_t { Literal, Id, Result };

// Instructions one after the other.
struct Stream {
  std::vector<uint32_t> words;
  std::vector<Word> kinds;  // of each word; the first of an instruction, its length and opcode, is a literal

  void add(std::span<const uint32_t> more, std::span<const Word> kinds_of_more) {
    words.insert(words.end(), more.begin(), more.end());
    kinds.insert(kinds.end(), kinds_of_more.begin(), kinds_of_more.end());
  }
};

// One instruction of a stream.
struct Instruction {
  size_t at = 0;  // of its first word
  std::span<const uint32_t> words;
  std::span<const Word> kinds;

  uint16_t opcode() const { return static_cast<uint16_t>(words[0] & 0xffff); }
  // The id that it defines; 0 if none.
  uint32_t result() const {
    if (kinds.size() > 1 && kinds[1] == Word::Result) return words[1];
    return kinds.size() > 2 && kinds[2] == Word::Result ? words[2] : 0;
  }
};

template <class F>
void for_each_instruction(const Stream& stream, const F& f) {
  for (size_t at = 0; at < stream.words.size();) {
    const size_t length = stream.words[at] >> 16;
    f(Instruction{at, std::span(stream.words).subspan(at, length), std::span(stream.kinds).subspan(at, length)});
    at += length;
  }
}

struct Function {
  uint32_t id = 0;
  Stream head;                       // OpFunction, OpFunctionParameter
  std::vector<uint32_t> parameters;  // ids
  Stream variables;
  Stream body;  // from the first label on, without variables
};

struct Module {
  std::vector<uint32_t> header;  // five words; the fourth is above all ids
  Stream globals;                // all before the first function
  std::vector<Function> functions;
  uint32_t entry = 0;  // the id of the entry point

  uint32_t& bound() { return header[3]; }
};

// Nullopt and what is wrong for words that are no module.
std::optional<Module> parse(std::span<const uint32_t> words, std::string& problem);
// Types, constants and variables that no function needs are left out.
std::vector<uint32_t> write(const Module& module);

// Puts the bodies of functions where they are called, in linear time. A function that leaves before its end stays.
void inline_calls(Module& module);
// Takes away variables whose value is known where they are read, and what nothing needs, in nearly linear time.
void remove_variables(Module& module);

}  // namespace dr::backend::spirv
