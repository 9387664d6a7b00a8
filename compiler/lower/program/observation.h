// SPDX-License-Identifier: Apache-2.0
// What a tool that shows a program to a person learns while the program is lowered: the files that were read, and what
// the names of the root file came to. A program that does not parse is then elaborated all the same, as far as it goes.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::lower {

// What may stand behind the dot after a value.
struct Member {
  enum class Kind : uint8_t { Field, Method, Function, Constant, Type, Module, Step };
  std::string name;
  Kind kind = Kind::Field;
  std::string type;    // in words, or empty
  dsl::Span declared;  // need not be there
};

// Of a number or an image of an element type: "vec3". None where that is no such type.
std::vector<Member> members_of_type(std::string_view type);

struct Observation {
  // Asked before lowering.
  std::function<std::optional<std::string>(const std::string& path)> read;  // a text that stands for a file's
  std::function<bool()> stop;        // whether to end early; asked every now and then
  uint32_t members_at = UINT32_MAX;  // where a name behind a dot begins in the root file: `members` are wanted

  // A file that was read; the root is the first.
  struct File {
    dsl::FileId file;
    bool is_library = false;
    dsl::Module syntax;
    std::map<std::string, size_t, std::less<>> imports;  // the name that is bound, and the file's place in `files`
  };
  // What a name of the root file is, where it is declared or used first.
  struct Known {
    std::string type;    // in words, or empty: "vec3[W, H]"
    dsl::Span declared;  // need not be there
  };

  std::deque<File> files;
  std::map<uint32_t, Known> names;  // by where they begin
  std::vector<Member> members;
  bool stopped = false;
  // How many messages there were when the program had been read: those behind them are of a tree with holes. None if
  // it was read without errors.
  std::optional<size_t> messages_of_text;
};

}  // namespace dr::lower
