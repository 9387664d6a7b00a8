// SPDX-License-Identifier: Apache-2.0
// What names stand for while a program is elaborated, and where names live. Private to compiler/lower.
//
// Only Image is in the graph. Everything else is known to the compiler and is gone when elaboration ends: numbers,
// extents, structs, tuples, arrays, functions, modules, types.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include "compiler/ir/graph.h"
#include "dsl/syntax/ast.h"

namespace dr::lower {

struct Value;
struct Scope;
struct ModuleInfo;
struct Builtin;

// A value of the graph. `element` is the depth of the outermost call (1: called from the top level) in which it is, or
// is computed from, the current element of a parameter such as `x : vec3`; 0 where it is a whole image.
struct Image {
  ir::ValueId id;
  uint32_t element = 0;
};

// A number, vector or matrix known at compile time, the same for each element of `extent`: a choice between two equal
// ones has the extent of what chooses. Never a single int: that is an ir::Dim, which may hold symbols too.
struct Constant {
  ir::Type type;
  std::vector<double> components;
  ir::Extent extent = {};
  friend bool operator==(const Constant&, const Constant&) = default;
};

// A struct as declared; or one of the language's own, then `decl` is null.
struct StructType {
  std::string name;
  std::vector<std::string> fields;
  const dsl::StructDecl* decl = nullptr;
  ModuleInfo* module = nullptr;
};

// A type without extents.
struct TypeValue {
  enum class Kind : uint8_t { Element, Struct, Tuple, Array, Function, Other };
  Kind kind = Kind::Other;
  ir::Type element;
  const StructType* structure = nullptr;
  std::vector<Value> generics;      // Struct: what its generic names stand for, in order
  std::vector<TypeValue> elements;  // Tuple: all; Array: that of the items, if there are any
  int64_t count = 0;                // Array
};

struct StructValue {
  const StructType* type = nullptr;
  std::vector<Value> generics;
  std::vector<Value> fields;
};
struct TupleValue {
  std::vector<Value> items;
};
struct ArrayValue {
  std::vector<Value> items;
};
// A function and the names that it sees; `self` holds the struct of a method.
struct FunctionValue {
  const dsl::FnDecl* decl = nullptr;
  Scope* scope = nullptr;
  size_t creator = 0;  // lambdas: how many calls were open where it was made
  bool is_lambda = false;
  std::vector<Value> self;
};
// A built-in function; `self` holds `x` of `x.at(i)`.
struct BuiltinValue {
  const Builtin* entry = nullptr;
  std::vector<Value> self;
};
struct ModuleValue {
  ModuleInfo* module = nullptr;
};
// An optimizer; `scope` holds its parameters once it has been called.
struct OptimizerValue {
  const dsl::OptimizerDecl* decl = nullptr;
  Scope* scope = nullptr;
  bool called = false;
};
struct StringValue {
  std::string text;
};
struct Nothing {};  // a block without a value
struct Error {};    // already reported: silences what follows

struct Value {
  using Data = std::variant<Error, Nothing, Image, Constant, ir::Dim, StructValue, TupleValue, ArrayValue,
                            FunctionValue, BuiltinValue, ModuleValue, OptimizerValue, TypeValue, StringValue>;
  Data data;

  Value() = default;
  template <class T>
  requires(!std::is_same_v<std::remove_cvref_t<T>, Value>) Value(T&& content)
      : data(std::forward<T>(content)) {}  // NOLINT: each alternative is a value

  template <class T>
  bool is() const {
    return std::holds_alternative<T>(data);
  }
  template <class T>
  const T* get() const {
    return std::get_if<T>(&data);
  }
  template <class T>
  T* get() {
    return std::get_if<T>(&data);
  }
  template <class T>
  const T& as() const {
    return std::get<T>(data);
  }
  template <class T>
  T& as() {
    return std::get<T>(data);
  }

  bool is_error() const { return is<Error>(); }
  // Something with an element type: an image, a constant or an int of the compiler.
  bool is_numeric() const { return is<Image>() || is<Constant>() || is<ir::Dim>(); }
  bool is_composite() const { return is<StructValue>() || is<TupleValue>() || is<ArrayValue>(); }
};

// A constant; an int becomes a Dim.
Value make_constant(ir::Type type, std::vector<double> components);
Value make_float(double number);
Value make_bool(bool truth);

// The number of an int known at compile time, without symbols.
std::optional<int64_t> known_int(const Value& value);
std::optional<bool> known_bool(const Value& value);
bool is_known(const Value& value);  // a number without symbols
// The components of a number known at compile time.
std::optional<std::vector<double>> known_components(const Value& value);

// The parts of a struct, tuple or array, in order; empty for anything else.
const std::vector<Value>& parts_of(const Value& value);
// The same composite with other parts.
Value with_parts(const Value& value, std::vector<Value> parts);
// The name of part `i`: a field's, or the number.
std::string part_name(const Value& value, size_t i);
// Applies `f` to everything that is not a composite, keeping the structure.
Value map_leaves(const Value& value, const std::function<Value(const Value&)>& f);
void for_each_leaf(const Value& value, const std::function<void(const Value&)>& f);
bool contains_error(const Value& value);

// Whether both stand for the same thing without computing anything: equal constants, one and the same value or
// function.
bool same_value(const Value& a, const Value& b);
bool same_type(const TypeValue& a, const TypeValue& b);

// ---- names ----

// What a name stands for.
struct Binding {
  enum class Kind : uint8_t { Let, Var, Parameter, Index, Carried };  // the last two are a loop's
  Value value = {};
  dsl::Span span;  // of the declaration
  Kind kind = Kind::Let;
  size_t frame = 0;  // how many calls and regions were open at the declaration: where a `var` may be assigned
  size_t region = 0;
  std::optional<uint32_t> leaf;  // index into Graph::leaves
};

// The names of a block. Scopes live as long as the elaboration, because function values refer to them.
struct Scope {
  Scope* parent = nullptr;
  ModuleInfo* module = nullptr;
  std::vector<std::pair<std::string, Binding>> names;

  Binding* find(std::string_view name);  // here only
};

// A name at the top level of a module.
struct ModuleItem {
  enum class Kind : uint8_t { Const, Fn, Struct, Optimizer, Import, Parameter, Leaf, Let, Symbol };
  enum class State : uint8_t { Waiting, Busy, Done };
  Kind kind = Kind::Const;
  State state = State::Done;  // Const, Let, Parameter: whether `value` is there
  dsl::Span span = {};
  Value value = {};
  const dsl::ConstDecl* constant = nullptr;
  std::optional<uint32_t> leaf = {};
  bool is_private = false;  // for files of the module's folder alone
};

// The names at the top level of a module, found by std::string_view too.
struct NameHash {
  using is_transparent = void;
  size_t operator()(std::string_view name) const { return std::hash<std::string_view>()(name); }
};
using ModuleItems = std::unordered_map<std::string, ModuleItem, NameHash, std::equal_to<>>;
// The names of those that `which` picks, sorted: the table has no order to rely on.
std::vector<std::string> names_of(const ModuleItems& items, const std::function<bool(const ModuleItem&)>& which);
std::string listed(const std::vector<std::string>& names);  // 'a', 'b' and 'c'

// A file of the program; or an instance of one, which has leaves, `let`s and steps of its own.
struct ModuleInfo {
  std::string path;                     // what identifies it
  std::string folder;                   // where its imports are looked for first; empty for a library module
  std::shared_ptr<dsl::Module> syntax;  // an instance has its module's
  Scope scope;
  ModuleItems items;
  std::deque<StructType> structs;
  std::map<const dsl::FnDecl*, const dsl::FnDecl*> vjps;  // the function that gives the gradient of another one
  bool is_root = false;
  bool is_instance = false;
  std::string prefix = {};  // of the names of an instance's leaves and steps: "studio."
  bool loading = true;      // its imports are being read

  bool runs() const { return is_root || is_instance; }
  // That of its file: "shadow".
  std::string name() const {
    const std::string file = path.substr(path.find_last_of("/:") + 1);
    return file.substr(0, file.rfind(".dr"));
  }
};

}  // namespace dr::lower
