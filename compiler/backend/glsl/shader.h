// SPDX-License-Identifier: Apache-2.0
// One GLSL shader under construction: its resources, the helper functions they need, and the statements of one
// element's computation. The printer decides nothing: packing has chosen ops, reads and writes.
#pragma once

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "compiler/backend/analysis/alike_branches.h"
#include "compiler/backend/analysis/axes.h"
#include "compiler/backend/analysis/read_part.h"
#include "compiler/backend/analysis/value_numbers.h"
#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/glsl/cut_loops.h"
#include "compiler/backend/glsl/text.h"
#include "compiler/backend/schedule/schedule.h"

namespace dr::backend::glsl {

// Where the contributions of a Scatter result go.
struct Accumulator {
  std::string name;  // suffix of its functions: scatter_<name>(ivec3 place, T value)
  ir::Type type;
  ir::Extent extent;      // of the result
  std::string site = {};  // a third argument, unless empty
};

class Shader {
 public:
  // GLSL of a function of that name which gives an element of a value whose resource holds fixed point sums.
  using SumsReader = std::function<std::string(Shader&, ir::ValueId, const std::string& function)>;

  // `symbols` and `numbers` are the bundle's, which gets the numbers that the shader takes. `native`: of that float
  // profile.
  Shader(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step,
         const std::vector<std::string>& symbols, std::vector<std::string>& numbers, bool native,
         SumsReader sums_reader);

  // Binds a resource of the bundle; further calls return the same name, and widen the access. Scratch is an array of
  // uint (or uint64_t) words, of a storage buffer.
  std::string bind(ResourceId id, bundle::Access access);
  std::string bind_words(uint32_t bundle_resource, const std::string& name, bundle::Access access,
                         const char* word = "uint");
  // Binds one whose words are only read, and returns the function that reads a word by its index.
  std::string read_words(uint32_t bundle_resource, const std::string& name, const char* word = "uint");
  // A sampled image that only the bundle knows; `prefix` is "", "i" or "u".
  std::string bind_image(uint32_t bundle_resource, const std::string& name, const char* prefix);
  // Makes a stored value an input attachment: load() then reads the invocation's own pixel, whatever the place.
  void read_as_input(ir::ValueId value);
  std::vector<std::unique_ptr<bundle::BindingT>> take_bindings();
  size_t bindings() const { return bindings_.size(); }

  // Expressions that read a stored value: at a place inside its extent (coordinates on axes of extent 1 are ignored),
  // or at any place (zero outside). `place` is an ivec3 expression.
  std::string load(ir::ValueId value, const std::string& place);
  std::string gather(ir::ValueId value, const std::string& place);
  // A statement that stores an element in a buffer resource.
  void store(ir::ValueId value, const std::string& place, const std::string& expression);
  // An expression for a buffer's memory, computed for all lanes at once (Code::hidden_stores).
  std::string at_once(const ir::Type& type, const std::string& expression) const;
  // Index of an element in a buffer of that extent.
  static std::string element_index(const ir::Extent& extent, const std::string& place);
  static std::string in_range(const ir::Extent& extent, const std::string& place);

  // Zero, of which the driver's compiler cannot know: what it knows times an Inf it takes for zero.
  std::string hidden_zero(const ir::Type& type);
  // The same of each component that is 0.
  std::string hiding_zeros(const ir::Type& type, std::span<const double> components);

  // Element computation. The variable `at` (ivec3) holds the element's place, or that of its member.
  void element_ops(const std::vector<ir::OpId>& ops);      // root ops of a pass in order
  std::string use(ir::ValueId value);                      // the expression of a value at the current element
  bool is_defined(ir::ValueId value) const;                // whether it is computed here
  void define(ir::ValueId value, std::string expression);  // region parameters
  // Runs a region's ops in the current scope and returns the expressions of its yields.
  std::vector<std::string> region(ir::RegionId id);
  void push_scope() {
    scopes_.emplace_back();
    if (common_) common_->known.emplace_back();
  }
  void pop_scope() {
    scopes_.pop_back();
    if (common_) common_->known.pop_back();
  }
  // Until end_sharing(), in the current scope, ops and these regions share what they compute (shader_common.cpp). Not
  // where they have loops.
  void begin_sharing(const std::vector<ir::OpId>& ops, std::span<const ir::RegionId> regions);
  // What the regions compute of values that are there, also in branches that nobody may take.
  void compute_ahead(std::span<const ir::RegionId> regions);
  void end_sharing() { common_.reset(); }
  // Runs a region that yields a Bool, and the statement `otherwise`, which leaves the scope, where it is false.
  // `holds`: a condition in it that is known to be true, and is not computed.
  void leave_unless(ir::RegionId id, const std::string& otherwise, std::optional<ir::ValueId> holds = {});
  void accumulate_into(ir::ValueId scatter_result, Accumulator accumulator) {
    accumulators_[scatter_result] = std::move(accumulator);
  }
  // Four scalars at a time of a value that this shader only reads: a function whose value for k are elements 4 k to
  // 4 k + 3, as a vector. What it gives beyond the last element means nothing. Reads by texels may do so, of scalars
  // that lie in memory as they are.
  bool may_read_fours(ir::ValueId value) const;
  std::string read_fours(ir::ValueId value);
  // A statement that adds a value at an index to a result.
  std::string scatter(const Accumulator& accumulator, ir::ValueId index_value, const std::string& index,
                      const std::string& value) const;
  // The ivec3 place that an index expression names in an image of that extent.
  std::string place_of(ir::ValueId index_value, const std::string& index, const ir::Extent& extent) const;

  // From here on the shader computes several elements side by side, its members: what is the same for some of them is
  // written once, and one loop takes the trips of all (shader_members.cpp).
  struct Member {
    std::string at;            // a variable that holds its place
    std::string in_group;      // and where that lies among the elements of the workgroup
    std::array<int, 3> place;  // by which axes it differs from the others
  };
  void set_members(ChangingAxes& changing, std::vector<Member> members);
  size_t member_count() const { return members_.size(); }
  // What follows is of one member, or of all of them.
  void only_member(size_t member);
  void all_members();
  const std::string& at() const { return at_; }
  // Reads in a loop that the invocations of a workgroup do together, for so many trips at a time. `group`: how many
  // there are, whose number is `lane`; `origin`: a variable that holds the first place of their elements.
  struct SharedReads {
    ir::OpId loop;
    int trips = 0;
    int group = 0;
    std::string lane, origin;
    std::vector<std::pair<ir::OpId, ReadPart>> reads;
  };
  void read_together(SharedReads reads);

  // From here on the invocations of an element share the trips of loops that only scatter: `share` is the number of
  // one, of `shares`. What else is scattered the first one scatters. `combine`: they also share those that combine
  // integers, which shuffles then join; a power of two of lanes beside each other have an element.
  void share_loops(std::string share, std::string shares, bool combine = false) {
    sharing_ = {std::move(share), std::move(shares), combine, false};
  }
  void share_no_more() { sharing_.reset(); }

  // From here on loops may stop and go on later, see cut_loops.h.
  CutLoops& cut_loops() { return cut_ ? *cut_ : cut_.emplace(); }

  // Of an `if` among the element ops: its second branch runs whatever the condition.
  void leave_out_branch(ir::OpId op) { left_out_.insert(graph_.op(op).results[0]); }

  Writer& body() { return body_; }
  void extension(const std::string& name) { extensions_.insert(name); }
  const std::set<std::string>& extensions() const { return extensions_; }
  void declare(const std::string& text) { declarations_ += text; }  // functions and interface variables
  // What all invocations of a workgroup do when they are done with their elements, those that had none too: statements.
  void do_together(std::string statements) { together_at_end_ += std::move(statements); }
  void prelude(std::string_view text);
  bool native() const { return native_; }
  const ir::Graph& graph() const { return graph_; }
  std::string unique(std::string_view base);

  // The whole text; `layout` are the stage's layout lines.
  std::string finish(const std::string& layout);

 private:
  struct Bound {
    std::string name;
    size_t binding = 0;
  };
  struct Declared {
    std::string text;  // without layout and rights
    int texel;         // the components of a fetch, if it may be a texel buffer of these words, else 0
    std::string word;
  };
  struct Words {
    Bound bound;
    std::string function;
  };
  // The name a bundle resource has here, after widening its access; null if it is not bound yet.
  const std::string* find_bound(uint32_t bundle_resource, bundle::Access access);
  std::string add_binding(uint32_t bundle_resource, const std::string& name, bundle::Access access, Declared declared);
  std::string buffer(uint32_t bundle_resource, const std::string& name, bundle::Access access, const char* word,
                     int texel);
  // The stem of the names of functions that read a value: of its resource, or of the part of it that the value is.
  std::string part_name(ir::ValueId value) const;
  bool is_bit(ir::ValueId value) const;  // of a raster's bits
  std::string load_function(const Resource& resource, const Bound& bound) const;
  void choose_texels();
  std::string functions_and_main();
  size_t number_of(const ir::Dim& dim);
  const Resource& resource(ir::ValueId v) const { return schedule_.resources[step_.stored.at(v).index]; }
  void op(const ir::Op& op);
  void elementwise_op(const ir::Op& op);
  bool is_hidden(ir::ValueId divisor) const;
  // Whether the device's own quotient by it is right, however large it is.
  bool divides_as_is(ir::ValueId divisor) const {
    return schedule_.code.divides_by_any || schedule_.code.moderate_divisors.contains(divisor);
  }
  void otherwise(const std::string& condition);
  void if_op(const ir::Op& op);
  // shader_common.cpp
  struct Common {
    ValueNumbers numbers;
    std::vector<std::map<uint32_t, std::string>> known;  // expressions by number, a map a scope
    const std::set<ir::ValueId>* needed = nullptr;       // null: all
  };
  void know(ir::ValueId value, const std::string& expression);
  const std::string* known(ir::ValueId value);
  bool common_op(const ir::Op& op);
  bool is_known(ir::ValueId value) { return is_defined(value) || known(value) != nullptr; }
  // shader_alike.cpp
  bool may_loop(const Together& together) const;
  void alike_ops(const Together& together);
  std::string choice(const std::string& which, const std::vector<std::string>& values) const;
  void reduce_op(const ir::Op& op);
  std::vector<std::string> reduce_variables(const ir::Op& op, const std::string& begin,
                                            std::vector<std::string>& enter);
  // shader_members.cpp
  void enter_member(size_t member);
  std::vector<std::vector<size_t>> alike(Axes axes) const;
  void op_of_all(const ir::Op& op);
  void load_for_all(const ir::Op& op);
  std::string open_together(const std::string& begin, const std::string& end);
  std::string first_place(const ReadPart& part, const std::string& trip);
  std::optional<std::string> shared_read(const ir::Op& op);
  void loop_variable(std::vector<std::string>& enter, const ir::Type& type, const std::string& name,
                     const std::string& first);
  void open_loop(const std::vector<std::string>& enter, const std::string& goes_on, const std::string& advance);
  void close_loop();
  // shader_fold.cpp
  struct FoldLoops;
  void fold_op(const ir::Op& op);
  std::string fold_goes_on(const FoldLoops& loops, const std::string& count) const;
  void loop_statement(std::vector<std::string>& enter, std::string statement);
  std::string kept_array(const ir::Type& type, int64_t count);
  std::string kept_item(const std::string& array, const std::string& index) const;
  std::string keep_item(const std::string& array, const std::string& index, const std::string& value) const;
  void fold_storing(FoldLoops& loops, const std::vector<std::string>& results);
  void fold_parameters(const FoldLoops& loops, size_t sweep, const std::string& trip);
  void fold_trip(const FoldLoops& loops, size_t sweep, const std::string& trip,
                 const std::vector<std::string>& results);
  void fold_advance(const FoldLoops& loops, size_t sweep);
  void fold_count_trips(FoldLoops& loops, const std::vector<std::string>& results);
  void fold_from_checkpoints(FoldLoops& loops, int64_t slots, const std::vector<std::string>& results);
  // A statement that takes effect outside of the shader.
  void effect(const std::string& statement) { body_.line(cut_ ? cut_->once(statement) : by_one(statement)); }
  std::string by_one(const std::string& statement) const {
    return sharing_ && !sharing_->in_loop ? "if (" + sharing_->share + " == 0) " + statement : statement;
  }
  // Of share_loops().
  struct Sharing {
    std::string share, shares;
    bool combine = false;
    bool in_loop = false;  // in one that is shared
  };
  bool begin_shared(const ir::Op& op);
  // `names`: what a Reduce combines.
  void end_shared(const ir::Op& op, const std::vector<std::string>& names);
  struct Part {
    std::string index, value;
    ir::ValueId of;  // the index, where it scatters
  };
  std::vector<Part> parts(const ir::Op& op, ir::RegionId region);
  void yields(const ir::Op& op, ir::RegionId region, const std::vector<std::string>& names, const std::string& trip);
  void combine(const ir::Op& op, const std::vector<std::string>& names, const std::string& trip,
               const std::vector<Part>& all);
  void forward_accumulators(const ir::Op& op, ir::RegionId region);
  std::string result(ir::ValueId value, const std::string& expression);

  const ir::Graph& graph_;
  const Schedule& schedule_;
  const StepSchedule& step_;
  const std::vector<std::string>& symbols_;
  std::vector<std::string>& numbers_;
  Writer body_{1};
  std::string declarations_;
  std::vector<Declared> declared_;  // by binding
  std::vector<std::string> preludes_;
  std::string together_at_end_;
  std::set<std::string> extensions_;
  std::unordered_map<std::string, int> names_;  // how many names each stem has
  std::set<std::string> functions_;
  std::vector<std::unique_ptr<bundle::BindingT>> bindings_;
  std::map<uint32_t, Bound> bound_;
  bool native_;
  bool hides_ = false;  // a value from the driver's compiler
  SumsReader sums_reader_;
  // Functions that read; how is known when all writes are.
  std::vector<uint32_t> loaded_;  // resources of the schedule
  std::vector<Words> words_;
  std::vector<uint32_t> inputs_;  // resources, by input attachment index
  using Scopes = std::vector<std::map<ir::ValueId, std::string>>;
  Scopes scopes_{1};
  std::map<ir::ValueId, Accumulator> accumulators_;
  std::set<ir::ValueId> left_out_;  // first results
  std::optional<CutLoops> cut_;
  std::optional<Common> common_;
  std::optional<Sharing> sharing_;
  // Members; without any, there is one.
  ChangingAxes* changing_ = nullptr;
  std::vector<Member> members_;
  std::vector<Scopes> waiting_;     // of the members, but for the one in scopes_
  size_t member_ = 0;               // whose scopes are in scopes_
  std::vector<size_t> running_{0};  // for which ops are written now
  std::string at_ = "at";
  std::optional<SharedReads> together_;
  std::map<ir::OpId, std::string> shared_;    // arrays, by gather
  std::map<ir::ValueId, std::string> since_;  // of the trip of a loop, how many came before it in its part
};

}  // namespace dr::backend::glsl
