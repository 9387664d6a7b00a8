// SPDX-License-Identifier: Apache-2.0
// Loops of a shader that may stop before their end and go on in a later dispatch, each from the trip that it had come
// to, so that order and bits are those of one run. What loops combine and where they are is kept in variables of their
// own beside the loops, an element's in a buffer between dispatches; all else is computed again, which gives the same,
// as graphs are pure.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "compiler/backend/glsl/text.h"

namespace dr::backend::glsl {

class CutLoops {
 public:
  // A variable of the element, kept; its name comes back. `from_zero`: it starts as zero, otherwise a loop sets it.
  std::string keep(const ir::Type& type, std::string name, bool from_zero = false);
  // An array of the element, kept: an expression of an item, and a statement that sets one.
  std::string keep_array(const ir::Type& type, std::string name, int64_t count);
  static std::string item(const std::string& array, const std::string& index);
  static std::string set_item(const std::string& array, const std::string& index, const std::string& value);
  // A statement that takes effect once an element, or once a trip of the loop that it stands in.
  std::string once(const std::string& statement);

  // A loop: `enter` are the statements that set what it keeps, `goes_on` and `advance` those of its head. Behind its
  // body comes finish_trip(), then what a trip that is complete combines, then close().
  void open(Writer& body, const std::vector<std::string>& enter, const std::string& goes_on,
            const std::string& advance);
  void finish_trip(Writer& body);
  void close(Writer& body);

  // Where the words of all elements are kept.
  void set_state(std::string buffer) { state_ = std::move(buffer); }
  // `part_trips` is a constant that says how many trips a dispatch may take, 0 for all that there are: then a driver's
  // compiler finds plain loops. `paused` is true where loops of the element stop before their end, `unfinished` where
  // the driver ended one.
  std::string variables() const;
  //   bool resume_loops(int element)   takes the variables from the words; false where the element's loops are done
  //   void keep_loops(int element)     puts them there; arrays are there all the time
  std::string functions() const;
  int64_t words() const;  // of an element

 private:
  struct Variable {
    ir::Type type;
    std::string name;
    bool from_zero = false;
    int64_t count = 0;  // of an array's items
    int64_t words() const { return std::max<int64_t>(count, 1) * type.components(); }
  };
  std::string array_functions(const Variable& array, int64_t at) const;
  struct Loop {
    std::string goes_on;
    std::vector<int> bits;  // of what stands in its body
    bool has_loops = false;
  };
  int new_bit();
  static std::string word(int bit);
  static std::string mask(int bit);

  std::vector<Variable> kept_;
  std::vector<Loop> open_;
  std::string state_;
  int bits_ = 1;  // the first: the element is done
  int loops_ = 0;
};

}  // namespace dr::backend::glsl
