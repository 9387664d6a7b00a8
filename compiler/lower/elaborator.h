// SPDX-License-Identifier: Apache-2.0
// The elaborator's class, private to compiler/lower: it walks the syntax of a program once, computes what is known at
// compile time, inlines calls, and appends ops for the rest. Every emission goes through `apply` or a function that has
// checked types and extents before, so that a user's mistake becomes a diagnostic and never an internal error.
//
// An expression that failed has been reported and gives Error; whoever meets an Error gives Error and says nothing.
#pragma once

#include <array>
#include <initializer_list>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/lower/builtins/builtin.h"
#include "compiler/lower/lower.h"
#include "compiler/lower/program/observation.h"
#include "compiler/lower/program/zeros.h"
#include "compiler/lower/value.h"
#include "compiler/ops/op.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"
#include "dsl/syntax/ast.h"

namespace dr::topology {
struct Table;
}

namespace dr::lower {

using dsl::Code;
using dsl::Expr;
using dsl::Span;
using ir::Dim;
using ir::Extent;
using ir::OpKind;
using ir::Scalar;
using ir::Type;
using ir::ValueId;

// Limits of a program, all of them errors when reached.
inline constexpr int64_t kMaxTrips = 4096;  // of one `for`, or items of one array
inline constexpr size_t kMaxCalls = 64;     // calls inside each other
inline constexpr size_t kMaxDepth = 2000;   // expressions inside each other, through calls
inline constexpr size_t kMaxCallNotes = 4;  // notes "in the call of 'f' here" of one message

// How a declared type is held against a value.
struct TypeMatch {
  Code code{};                                       // of a mismatch
  std::string part = {};                             // "element 0 of ", where it is a part of what was given
  std::string_view role;                             // "the result of ", or empty
  std::string_view name;                             // "x"; empty: it has none
  Span span;                                         // of the value
  Span declared;                                     // where the type stands, for a note; need not be there
  std::vector<dsl::Name> const* generics = nullptr;  // names that the value may bind
  bool bind_extents = false;                         // names in extents may be bound by the value
  bool parameter = false;                            // `vec3` is one element
  bool stretch = false;                              // extents of 1 are stretched to those written
  bool ignore_extents = false;                       // somebody else looks at them

  // Words are made when there is something to say, which is seldom.
  std::string subject() const;  // "'x'", "the result of 'f'"
  std::vector<dsl::Note> notes() const;
};

class Elaborator {
 public:
  Elaborator(dsl::SourceManager& sources, const Options& options, dsl::DiagnosticList& diagnostics)
      : sources_(sources), options_(options), diagnostics_(diagnostics), observation_(options.observation) {}
  ~Elaborator() {
    if (observation_) give_files();
  }
  Elaborator(const Elaborator&) = delete;
  Elaborator& operator=(const Elaborator&) = delete;
  std::optional<ir::Graph> run(dsl::FileId root);
  // Inputs that were held to be fixed, of which a gradient is asked for, as run() found.
  const std::vector<std::string>& inputs_to_open() const { return inputs_to_open_; }
  static std::vector<std::string> builtin_names();

 private:
  friend struct BuiltinTable;

  // A call that is being elaborated.
  struct Frame {
    const dsl::FnDecl* fn = nullptr;
    std::string name;
    Span call;
    const Scope* scope = nullptr;  // the names that it sees
    size_t creator = 0;            // of a lambda: the frames below which it was made
    bool is_lambda = false;
  };
  struct RegionFrame {
    std::string_view what;  // "'if'"
    Span span;
    size_t frame = 0;  // calls that were open
    ir::RegionId region;
  };
  // Who gives a leaf its next value in the step.
  struct Writer {
    Span span;
    size_t update = SIZE_MAX;  // index into Step::updates
    bool minimized = false;    // a projection may follow
  };
  struct StepFrame {
    ir::Step* step = nullptr;
    std::map<uint32_t, Writer> writers;
    std::map<std::string, Span, std::less<>> outputs;
  };
  // An optimizer's update that is being inlined.
  struct OptimizerFrame {
    size_t frame = 0;  // of the update function
    std::map<std::string, std::pair<uint32_t, Span>, std::less<>> states;
    std::string name;
  };

  // Switch a member for the time of a block.
  template <class T>
  class Switched {
   public:
    Switched(T& place, T now) : place_(place), before_(place) { place_ = now; }
    ~Switched() { place_ = before_; }
    Switched(const Switched&) = delete;
    Switched& operator=(const Switched&) = delete;

   private:
    T& place_;
    T before_;
  };
  class SpanScope {
   public:
    SpanScope(Elaborator& e, const Span& span) : e_(e), before_(e.span_) { e.set_span(span); }
    ~SpanScope() { e_.set_span(before_); }
    SpanScope(const SpanScope&) = delete;
    SpanScope& operator=(const SpanScope&) = delete;

   private:
    Elaborator& e_;
    Span before_;
  };

  // Messages (messages.cpp). `fail` reports and gives Error.
  bool is_of_library(const Span& span) const { return library_files_.count(span.file.index) > 0; }
  void report(Code code, const Span& span, std::string message, std::vector<dsl::Note> notes = {},
              std::string help = {});
  Error fail(Code code, const Span& span, std::string message, std::vector<dsl::Note> notes = {},
             std::string help = {});
  void set_span(const Span& span);
  bool over_budget(const Span& span, size_t cost = 1);
  bool has_room(const Value& part, size_t& parts, const Span& span);
  static std::string suggestion(std::string_view name, const std::vector<std::string>& known);
  // "x, y or z"
  static std::string one_of(const std::vector<std::string>& words);
  static std::string no_field(const StructType& type, const std::string& found);

  // The program (lower.cpp).
  void declare_leaves(ModuleInfo& module);
  void declare_leaf(ModuleInfo& module, const dsl::LeafDecl& decl);
  void begin_leaf(ModuleInfo& module, const dsl::LeafDecl& decl);
  void fix_input(uint32_t leaf);
  // Components known at compile time, or, where `computed` takes one, an image that fills the leaf.
  std::vector<double> initial_value(const dsl::LeafDecl& decl, const Type& type, bool& ok, Value* computed = nullptr);
  void run_program(ModuleInfo& module);
  void declare_symbols(ModuleInfo& module, const Expr& extent, bool& ok);
  ValueId add_leaf(ir::Leaf leaf);
  void warn_of_shared_counts();
  void apply_defines(ModuleInfo& root);

  // Instances of modules, and what steps leave behind (instances.cpp).
  Value instantiate_module(ModuleInfo& base, const Expr& call);
  bool bind_module_params(ModuleInfo& instance, std::vector<Argument> args, const Span& span, const std::string& name);
  Value step_count(const Expr& expr);
  void count_steps();
  std::optional<ValueId> computed_initial(const dsl::LeafDecl& decl, const Value& value, const ir::Leaf& leaf);
  void add_initial_steps();

  // Modules and names (modules.cpp).
  ModuleInfo* load_module(dsl::FileId file, std::string path, std::string folder);
  void load_import(ModuleInfo& importer, const dsl::ImportDecl& import);
  void collect_items(ModuleInfo& module);
  void add_item(ModuleInfo& module, const dsl::Name& name, ModuleItem item);
  Value item_value(ModuleInfo& module, std::string_view name, ModuleItem& item, const Span& use);
  Value name_value(const std::string& name, const Span& span);
  Value found_name(const std::string& name, const Span& span, Span& declared);
  Value seed_value(const Span& span);
  Value module_field(ModuleInfo& module, const std::string& name, const Span& span);
  const Binding* find_binding(std::string_view name) const;
  std::optional<uint32_t> find_leaf(std::string_view name) const;
  std::optional<uint32_t> find_leaf(const Expr& path);
  ModuleInfo* module_of(const Expr& path) const;
  Scope* new_scope(Scope* parent);
  void define(Scope& scope, const dsl::Name& name, Value value, Binding::Kind kind = Binding::Kind::Let);
  void define_inner(Scope& scope, std::string_view name, Value value, const Span& declared,
                    Binding::Kind kind = Binding::Kind::Var);

  // What to write instead of a name that is not known (unknown_names.cpp).
  std::vector<std::string> visible_names() const;
  std::string help_for(const std::string& name, const Span& span) const;
  std::string help_for(const ModuleInfo& module, const std::string& name, const Span& span) const;
  std::string optimizers_here() const;
  bool is_inside(const ModuleInfo& module) const;  // whether what is private there is for this file

  // For those who show programs (observe.cpp).
  std::string words_for_reader(const Value& value) const;
  void observe(const Span& span, const Value& value, const Span& declared);
  void observe_field(const Value& base, const std::string& name, const Span& span, const Value& value);
  void observe_members(const Value& base);
  void observe_step(const Expr& path, const ModuleInfo& module);
  void give_files();

  // What values are, in words (emission.cpp).
  std::string describe(const Value& value) const;          // "vec3[V]", "Triangle"
  std::string describe_element(const Value& value) const;  // without extents
  std::string describe(const TypeValue& type) const;
  TypeValue type_of(const Value& value) const;
  Type element_type(const Value& value) const;  // of a numeric value
  Extent extent_of(const Value& value) const;
  std::string label(const Value& value, std::string_view otherwise) const;  // "'photo'" or `otherwise`

  // Emission (emission.cpp).
  ValueId materialize(const Value& value);
  Image image(ValueId id, std::initializer_list<const Value*> from) const;
  uint32_t element_depth(std::span<const Value> values) const;
  Value apply(OpKind kind, std::vector<Value> operands, ir::Attrs attrs = {});
  bool convert_known_int(Value& value, Scalar to);
  bool unify_scalars(std::vector<Value>& values);  // ints known at compile time become what the others are
  bool unify_rows(std::vector<Value>& values);     // scalars become vectors
  bool check_extents(std::span<const Value> values, const Span& span);
  Value to_float(const Value& value);
  Value convert_scalar(const Value& value, Scalar to);
  Value splat(const Value& value, const Type& type);
  Value component(const Value& value, int index);
  Value compose(std::vector<Value> parts, const Type& type);
  Value swizzle(const Value& value, std::span<const int> indices);
  Value broadcast(const Value& value, const Extent& extent);
  Value select(const Value& condition, const Value& a, const Value& b);
  Value add(const Value& a, const Value& b) { return arithmetic(OpKind::Add, a, b); }
  Value sub(const Value& a, const Value& b) { return arithmetic(OpKind::Sub, a, b); }
  Value mul(const Value& a, const Value& b) { return arithmetic(OpKind::Mul, a, b); }
  Value arithmetic(OpKind kind, const Value& a, const Value& b);  // of agreeing kinds; scalars splat
  Value dot(const Value& a, const Value& b);
  void set_name(const Value& value, const std::string& name);
  bool in_region() const { return !regions_.empty(); }
  bool refuse_in_region(std::string_view what, const Span& span);
  bool refuse_element(const Value& value, std::string_view what, const Span& span);
  // The extent that everything inside a region stretches to, or an error.
  std::optional<Extent> region_domain(Extent domain, std::span<const ir::RegionId> regions, const Span& span);

  // Expressions (expressions.cpp).
  Value evaluate(const Expr& expr);
  Value evaluate_any(const Expr& expr);
  Value evaluate_number(const Expr& expr);
  Value evaluate_field(const Expr& expr);
  Value field_of(const Value& base, const std::string& name, const Span& span, const Expr* base_expr);
  Value found_field(const Value& base, const std::string& name, const Span& span, const Expr* base_expr);
  Value numeric_field(const Value& base, const std::string& name, const Span& span, const Expr* base_expr);
  std::optional<std::vector<int>> swizzle_indices(const Type& type, const std::string& name, const Span& span);
  Value evaluate_index(const Expr& expr);
  Value index_value(const Value& base, const Value& index, const Expr& expr);
  std::optional<int64_t> checked_index(int64_t index, int64_t count, std::string_view what, const Span& span);
  Value evaluate_array(const Expr& expr);
  Value unify_items(std::vector<Value> items, std::span<const Span> spans);
  Value evaluate_lambda(const Expr& expr);
  bool is_image_value(const Value& value, const Span& span, std::string_view what);
  std::optional<int64_t> evaluate_known_int(const Expr& expr, std::string_view what);
  std::optional<Dim> evaluate_dim(const Expr& expr, std::string_view what);

  // Operators (operators.cpp, matrix.cpp).
  Value evaluate_unary(const Expr& expr);
  Value evaluate_binary(const Expr& expr);
  Value binary(std::string_view op, Value a, Value b, const Span& span);
  Value dim_arithmetic(std::string_view op, const Dim& a, const Dim& b, const Span& span, bool& done);
  Value checked_dim(const Dim& dim, const Span& span);
  Value compare(std::string_view op, const Value& a, const Value& b, const Span& span);
  Value logic(std::string_view op, const Value& a, const Value& b, const Span& span);
  Value bits(std::string_view op, const Value& a, const Value& b, const Span& span);
  Value matrix_product(const Value& a, const Value& b, const Span& span, bool& done);
  Value matrix_scalar(OpKind kind, const Value& a, const Value& b);
  Value map_columns(const Value& m, const std::function<Value(const Value&)>& f);
  Value matrix_vector(const Value& m, const Value& v);
  using Entries = std::vector<std::vector<Value>>;
  Entries entries(const Value& m);
  Value minor_determinant(const Entries& m, const std::vector<size_t>& columns, const std::vector<size_t>& rows);
  Value transpose(const Value& m);

  // Types (types.cpp).
  std::optional<Value> match(const Value& value, const dsl::TypeExpr& type, TypeMatch& how);
  std::optional<Value> match_named(const Value& value, const dsl::TypeExpr& type, TypeMatch& how);
  std::optional<Value> match_array(const Value& value, const dsl::TypeExpr& type, TypeMatch& how);
  std::optional<Value> match_tuple(const Value& value, const dsl::TypeExpr& type, TypeMatch& how);
  std::optional<Value> match_type_value(const Value& value, const TypeValue& wanted, const dsl::TypeExpr& type,
                                        TypeMatch& how);
  std::optional<Value> match_element(const Value& value, const Type& wanted, const dsl::TypeExpr& type, TypeMatch& how);
  bool match_generics(const StructValue& value, const dsl::TypeExpr& type, TypeMatch& how);
  bool match_generic_arg(const Value& actual, const dsl::TypeExpr* type, const Expr* expr, TypeMatch& how);
  bool match_extent(const Dim& actual, const Expr& wanted, int axis, TypeMatch& how, Dim* stretched);
  bool mismatch(const Value& value, const std::string& wanted, TypeMatch& how);
  bool may_bind(std::string_view name, const TypeMatch& how) const;
  static bool is_any_extent(const Expr& extent);
  std::optional<Value> type_name(const dsl::TypeExpr& type);  // a TypeValue, or a generic that is not bound
  std::optional<Value> declared(const Value& value, const dsl::TypeExpr& type, std::string_view name, const Span& span);

  // Calls (calls.cpp, constructors.cpp).
  Value evaluate_call(const Expr& expr);
  std::vector<Argument> evaluate_args(const std::vector<dsl::Arg>& args);
  Value call(const Value& callee, std::vector<Argument> args, const Span& span);
  Value call_with(const Value& callee, std::vector<Value> args, const Span& span);
  Value inline_function(const FunctionValue& fn, std::vector<Argument> args, const Span& span);
  bool check_recursion(const FunctionValue& fn, const Span& span);
  bool bind_params(const std::vector<dsl::Param>& params, const std::vector<dsl::Name>& generics,
                   std::vector<Argument> args, Scope& scope, const Span& call, const std::string& name,
                   const Span& declared, bool element_params);
  std::optional<std::vector<std::optional<Argument>>> order_arguments(const std::vector<dsl::Param>& params,
                                                                      std::vector<Argument> args, const Span& call,
                                                                      const std::string& name, const Span& declared);
  Value leave_call(const Value& value, size_t depth) const;

  // Gradients that the program gives (vjp.cpp).
  void collect_vjps(ModuleInfo& module);
  const dsl::FnDecl* vjp_of(const FunctionValue& fn) const;
  Value for_each_element(const dsl::FnDecl& f, const Value& y, const std::vector<Value>& args);
  Value with_vjp(const FunctionValue& fn, const dsl::FnDecl& vjp, Value y, std::vector<Value> args, const Span& span);

  Value call_builtin(const BuiltinValue& builtin, std::vector<Argument> args, const Expr* syntax, const Span& span);
  Value construct(const TypeValue& type, std::vector<Argument> args, const Span& span);
  Value construct_struct(const TypeValue& type, std::vector<Argument> args, const Span& span);
  Value construct_vector(const Type& type, std::span<const Value> args, const Span& span);
  Value construct_matrix(const Type& type, std::span<const Value> args, const Span& span);
  Value call_optimizer(const OptimizerValue& optimizer, std::vector<Argument> args, const Span& span);

  // Statements (statements.cpp).
  Value evaluate_block(const dsl::Block& block);
  Value run_statements(const dsl::Block& block);
  bool run_statement(const dsl::Stmt& stmt);
  void run_let(const dsl::Stmt& stmt);
  void bind_pattern(const dsl::Pattern& pattern, const Value& value, const Span& span, Binding::Kind kind);
  void run_assign(const dsl::Stmt& stmt);
  Value assigned(const Value& current, std::span<const Expr* const> path, const Value& value, const dsl::Stmt& stmt);
  Value assigned_components(const Value& current, std::span<const int> indices, const Value& value,
                            const dsl::Stmt& stmt);
  Value fit_assignment(const Value& current, const Value& value, const dsl::Stmt& stmt);
  const Binding* assignable(const Expr& place);
  void run_for(const dsl::Stmt& stmt);
  void run_const_if(const dsl::Stmt& stmt);
  std::optional<bool> known_condition(const Expr& expr);

  // Regions (regions.cpp).
  using LeafPair = std::function<Value(const Value&, const Value&)>;
  Value evaluate_if(const Expr& expr);
  using Branch = std::function<Value()>;
  Value emit_if(const Value& condition, const Span& span, const Branch& then, const Branch& otherwise);
  // The same for each element of `extent`: what is chosen whichever way has an element for each that chooses. What is
  // known stays so. In a region it is one element's anyway.
  Value stretched(const Value& value, const ir::Extent& extent);
  Value select_branches(const Value& condition, const Value& a, const Value& b, const Span& span);
  Value merge_branches(const Value& a, const Value& b, const ir::Extent& by, const Span& span, const LeafPair& leaf);
  std::optional<Type> branch_type(const Value& a, const Value& b, const Span& span);
  bool is_cheap(const dsl::Block& block) const;
  Value evaluate_reduce(const Expr& expr);
  bool loop_range(const Value& value, const Expr& expr, std::string_view loop);
  std::optional<int64_t> loop_bound(const Expr* promise, const Value& begin, const Value& end);

  // Loops that carry values, and statements that change them (loops.cpp).
  struct Range {
    Value begin, end;
    int64_t bound = -1;
    std::string_view loop;  // "'for'"
    Span span;
    bool scans = false;  // what the states are after each trip is wanted, not after the last one
  };
  // What a loop carries: the states of a trip and its number in, whether it is the last one and the next states out.
  using Trip = std::function<std::pair<Value, std::vector<Value>>(const Value& i, const std::vector<Value>& states)>;
  std::optional<Range> evaluate_range(const Expr& begin, const Expr& end, const Expr* max, std::string_view loop,
                                      const Span& span);
  std::vector<Value> emit_fold(const Range& range, const std::vector<Value>& starts, const Span& span,
                               const Trip& trip);
  bool keep_trips(const Range& range, Extent domain, const std::vector<ValueId>& next, ir::Attrs& attrs,
                  std::vector<ValueId>& yields);
  Value fit_state(const Value& state, const Value& next, const Span& span);
  Value evaluate_fold(const Expr& expr);
  void run_loop(const dsl::Stmt& stmt);
  void run_if(const dsl::Stmt& stmt);
  void run_break(const dsl::Stmt& stmt);
  bool is_unrolled(const dsl::Stmt& stmt, const Value& begin, const Value& end) const;
  // Statements of a loop's body, those behind a break only where it is not taken.
  void run_breakable(std::span<const dsl::StmtPtr> statements, const std::function<void()>& rest);
  // Changes of variables by one of two blocks.
  void run_branches(const Value& condition, const Span& span, const std::set<std::string>& assigned,
                    const std::function<void()>& then, const std::function<void()>& otherwise);
  std::vector<std::string> variables_of(const std::set<std::string>& names) const;
  void set_variable(std::string_view name, Value value);

  // Raster (raster.cpp).
  struct RasterCall;
  using RasterBody = std::function<Value(std::span<const Value> fields, const Value& p)>;
  Value evaluate_raster(const Expr& expr);
  bool raster_arguments(const Expr& expr, RasterCall& call);
  bool raster_functions(const Expr& expr, RasterCall& call);
  bool raster_record(RasterCall& call);
  Value call_raster_fn(const dsl::FnDecl& fn, std::vector<Value> args, const Type& type);
  bool check_record(const Value& value, const RasterCall& call, const dsl::FnDecl& fn);
  std::optional<ir::RegionId> raster_region(const RasterCall& call, const RasterBody& body);
  Value coverage_edge(const Value& a, const Value& b);
  Value coverage_tie(const Value& edge);
  Value coverage(std::span<const Value> edges, const Value& p);

  // Steps and gradients (steps.cpp).
  void run_step(const dsl::StepDecl& decl);
  bool in_step(std::string_view what, const Span& span);
  void run_output(const dsl::Stmt& stmt);
  void add_output(const std::string& name, const Value& value, const Span& span);
  void run_update(const dsl::Stmt& stmt);
  void run_optimizer_update(const dsl::Stmt& stmt);
  std::optional<Image> fit_leaf(const Value& value, uint32_t leaf, const Span& span, std::string_view what);
  void run_minimize(const dsl::Stmt& stmt);
  Value instantiate(const OptimizerValue& optimizer, uint32_t leaf, const Value& x, const Value& g,
                    const dsl::Stmt& stmt);
  std::vector<ValueId> emit_grad(const Value& y, const Value& seed, std::span<const ValueId> targets);
  // What `x` is made of, where `y` can be differentiated by it.
  std::optional<std::vector<ValueId>> grad_targets(const Value& y, const Value& x, const Span& y_span,
                                                   const Span& x_span);
  Value jvp(const Value& y, const Value& x, const Value& direction, const BuiltinCall& call);

  // Built-in functions (builtins.cpp, builtins_vector.cpp, builtins_image.cpp).
  static const Builtin* find_builtin(std::string_view name);
  static const Builtin* find_method(std::string_view name);
  bool floats(BuiltinCall& call, bool splat_scalars = true);
  bool numbers(BuiltinCall& call, bool splat_scalars = true);
  bool vectors(BuiltinCall& call, size_t count);
  Value wrong_type(const BuiltinCall& call, size_t arg, std::string_view wanted);
  Value float_function(BuiltinCall& call);
  Value number_function(BuiltinCall& call);
  Value builtin_mod(BuiltinCall& call);
  Value builtin_abs(BuiltinCall& call);
  Value builtin_min_max(BuiltinCall& call);
  Value builtin_atan(BuiltinCall& call);
  Value builtin_mix(BuiltinCall& call);
  Value builtin_step(BuiltinCall& call);
  Value builtin_smoothstep(BuiltinCall& call);
  Value builtin_saturate(BuiltinCall& call);
  Value builtin_angle(BuiltinCall& call);
  Value builtin_select(BuiltinCall& call);
  Value builtin_dot(BuiltinCall& call);
  Value builtin_cross(BuiltinCall& call);
  Value builtin_length(BuiltinCall& call);
  Value builtin_distance(BuiltinCall& call);
  Value builtin_normalize(BuiltinCall& call);
  Value builtin_reflect(BuiltinCall& call);
  Value builtin_refract(BuiltinCall& call);
  Value builtin_faceforward(BuiltinCall& call);
  Value builtin_matrix_comp_mult(BuiltinCall& call);
  Value builtin_fma(BuiltinCall& call);
  Value builtin_any_all(BuiltinCall& call);
  Value builtin_not(BuiltinCall& call);
  Value builtin_unlikely(BuiltinCall& call);
  Value builtin_compare(BuiltinCall& call);
  Value builtin_transpose(BuiltinCall& call);
  Value builtin_inverse(BuiltinCall& call);
  Value builtin_determinant(BuiltinCall& call);
  Value builtin_outer_product(BuiltinCall& call);
  // Bits (builtins_bits.cpp).
  bool integers(BuiltinCall& call, bool splat_scalars = true);
  Value integer_function(BuiltinCall& call);
  Value bitcast(const Value& value, Scalar to);
  Value magnitude_bits(const Value& x);
  Value bits_and(const Value& x, uint32_t mask);
  Value is_nan(const Value& x);
  Value times_power_of_two(Value x, Value n);
  std::optional<std::pair<Value, Value>> bit_field(BuiltinCall& call, size_t first);
  Value shifted(OpKind kind, const Value& x, const Value& by);
  Value builtin_bitcast(BuiltinCall& call);
  Value builtin_is_nan(BuiltinCall& call);
  Value builtin_is_inf(BuiltinCall& call);
  Value builtin_ldexp(BuiltinCall& call);
  Value builtin_frexp(BuiltinCall& call);
  Value builtin_modf(BuiltinCall& call);
  Value builtin_mul_extended(BuiltinCall& call);
  Value builtin_carry(BuiltinCall& call);
  Value builtin_bitfield_extract(BuiltinCall& call);
  Value builtin_bitfield_insert(BuiltinCall& call);
  Value builtin_pack(BuiltinCall& call);
  Value builtin_unpack(BuiltinCall& call);
  // Textures (builtins_sample.cpp).
  std::optional<size_t> chosen_word(const BuiltinCall& call, std::string_view name,
                                    const std::vector<std::string>& words);
  Value builtin_sample(BuiltinCall& call);
  Value builtin_at(BuiltinCall& call);
  Value builtin_layer(BuiltinCall& call);
  Value builtin_shift(BuiltinCall& call);
  Value builtin_scatter(BuiltinCall& call);
  Value builtin_reduction(BuiltinCall& call);
  Value builtin_coord(BuiltinCall& call);
  Value builtin_known(BuiltinCall& call);
  Value builtin_known_zero(BuiltinCall& call);
  Value builtin_require(BuiltinCall& call);
  Value builtin_barrier(BuiltinCall& call);
  Value builtin_grad(BuiltinCall& call);
  Value builtin_jvp(BuiltinCall& call);
  Value builtin_array(BuiltinCall& call);
  Value builtin_topology(BuiltinCall& call);  // topology.cpp
  static const StructType& topology_type(bool with_vertices);
  static const StructType& fragment_type();  // raster.cpp
  const ir::Leaf* topology_faces(const BuiltinCall& call);
  Value topology_table(const std::string& faces, const topology::Table& table, const Dim& face_count,
                       const Dim& vertices);
  Value gather(const Value& base, const Value& index, const Span& base_span, const Span& index_span,
               std::string_view where = "before '.at'");
  ValueId outside(ValueId value);
  void forget_outside(ir::RegionId region);
  bool is_index(const Value& value) const;
  Value image_op(OpKind kind, std::span<const Value> operands, ir::Attrs attrs, std::span<const Value> elements_of);
  std::optional<std::array<bool, 3>> reduction_axes(const BuiltinCall& call);
  Value grad(const Value& y, const Value& x, const std::optional<Argument>& seed, const Span& y_span,
             const Span& x_span);

  dsl::SourceManager& sources_;
  const Options& options_;
  dsl::DiagnosticList& diagnostics_;
  Observation* observation_;
  ir::Builder b_;
  Zeros zeros_{b_.graph()};
  std::vector<std::string> inputs_to_open_;
  Span span_;

  std::deque<ModuleInfo> modules_;
  std::deque<Scope> scopes_;
  Scope* scope_ = nullptr;
  ModuleInfo* root_ = nullptr;
  const ModuleInfo* running_ = nullptr;  // whose top level is being elaborated: the root's, or an instance's
  Value seed_ = Nothing{};               // the leaf 'seed' once something has read it

  std::vector<Frame> frames_;
  std::set<uint32_t> library_files_;  // by FileId, those of the library that comes with the compiler
  std::vector<RegionFrame> regions_;
  StepFrame* step_ = nullptr;
  OptimizerFrame* optimizer_ = nullptr;
  std::set<const dsl::FnDecl*> open_vjps_;  // functions whose @vjp is being elaborated: in it they are plain
  int64_t cotangents_ = 0;
  Span let_;                 // the top-level `let` that is being elaborated
  bool in_initial_ = false;  // while a leaf's initial value is evaluated
  Span before_dot_;          // what stands before the last '.'
  Span optimizer_at_;        // what `minimize` names after `with`
  // Uses of `step_index` there.
  struct Count {
    ir::OpId op;
    Span let;
    std::string prefix;  // of the instance
  };
  std::vector<Count> counts_;
  // The counts of steps that a program asks for by name, each a state of its own.
  struct StepCount {
    uint32_t leaf;
    ValueId value;
  };
  std::map<std::string, StepCount, std::less<>> step_counts_;  // by the step's whole name
  std::vector<std::pair<uint32_t, ValueId>> initials_;         // leaves and the images that fill them
  std::map<uint32_t, Value> leaf_values_;                      // of declared leaves
  std::map<ValueId, ValueId> outside_;                         // of outside()
  // The expression of a top-level `let` that may make an instance, and the name that it gets.
  std::pair<const Expr*, const dsl::Name*> instance_let_{};
  std::vector<std::pair<std::string, Span>> instances_;  // that are being elaborated, for notes
  std::pair<const ModuleItem*, Value> projected_{};      // the param of an instance that a projection names

  bool parsed_ = true;  // all files
  size_t depth_ = 0;
  size_t steps_ = 0;
  size_t mistakes_ = 0;  // calls of report(), with those of a place that has been told
  bool exhausted_ = false;
  std::set<std::tuple<uint32_t, uint32_t, uint32_t, Code>>
      reported_;  // a place is told once, however often it is unrolled
};

}  // namespace dr::lower
