// SPDX-License-Identifier: Apache-2.0
// Schedule -> shaders and commands. One file a kind of pass; this header is private to them.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "compiler/backend/analysis/source_lines.h"
#include "compiler/backend/emit/element_lists.h"
#include "compiler/backend/glsl/fixed_point.h"
#include "compiler/backend/glsl/shader.h"
#include "compiler/backend/glsl/source.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

// Fills the bundle's symbols, leaves, resources and steps, and gives the GLSL of its shaders.
class Generator {
 public:
  // `lines`: of the graph's ops.
  Generator(const ir::Graph& graph, const Schedule& schedule, const SourceLines& lines)
      : graph_(graph), schedule_(schedule), source_lines_(lines) {}
  void process(bundle::BundleT& bundle, std::vector<GlslShader>& shaders);
  // Then, when find_dependencies() has said what runs together: several fills of a step become one dispatch, and each
  // copy one, where the schedule says so (clears.cpp).
  void clear_together();

 private:
  void step(const StepSchedule& step);
  void list_needs(const StepSchedule& schedule);
  // `fills`: places of commands of the step; the dispatch takes that of the first.
  void clear_by_dispatch(const std::vector<size_t>& fills);
  void copy_by_dispatch(bundle::CommandT& copy);
  // A copy of what a resource holds here, for results of the step that its passes change or count on.
  void keep(uint32_t resource);
  // The step's counter goes on, on the device.
  void count_on();
  // Source lines behind the ops of a pass, and of what sets it up; they go into the commands made next.
  void set_lines(const Pass& pass, const Pass* setup);
  void map_pass(const Pass& pass);
  // What the elements of a run share of a map's reads; see same_in_run.h.
  RunReads reads_in_runs(const Pass& pass, const std::set<ir::ValueId>& but = {}) const;
  void listed_map_pass(const Pass& pass, const HeavyBranches& heavy);
  // The dispatch of a list's elements. With `rest` it leaves unlikely branches out, and lists there what takes them.
  void listed_dispatch(const Pass& pass, const HeavyBranches& heavy, const std::string& name, uint32_t list,
                       std::optional<uint32_t> rest);
  // The scatters that a map lists elements for, but those that add nothing without these branches.
  std::vector<const Pass*> listed_without(const Pass& pass, const std::vector<ir::OpId>& branches) const;
  // Elements that do not rest (at_rest.cpp): lists those of an update, given where the rows of its gradient start, or
  // marks their blocks; opens a shader that runs for the list, and gives the number of its element; the update itself.
  // `starts`: of rows; 0: sums that wake elements.
  void list_stepped(const Pass& gradient, const Pass& update, uint32_t starts);
  std::string mark(glsl::Shader& shader, const Pass& update, const std::string& element) const;
  std::string has_bits(glsl::Shader& shader, ir::ValueId v) const;
  std::string stepped_index(glsl::Shader& shader, uint32_t list);
  void stepped_map_pass(const Pass& pass);
  void marked_map_pass(const Pass& pass);
  void look_at_gathers(glsl::Shader& s, const Pass& pass);
  // Several elements an invocation: side by side (block.cpp), one after the other (strides.cpp).
  void block_map_pass(const Pass& pass, const Block& block);
  void strided_map_pass(const Pass& pass);
  // `inputs`: values that it reads as input attachments; `joins`: it goes on in the render pass before.
  void fragment_pass(const Pass& pass, const std::vector<ir::ValueId>& inputs, bool joins);
  // A shader whose loops are cut (cut.cpp). What an element computes stands between open_cut() and close_cut(), what it
  // leaves behind between that and end_cut().
  struct Cut {
    std::optional<LoopCut> how;
    ir::Dim trips;                            // of an invocation
    uint32_t state = 0, watch = 0, left = 0;  // bundle resources
    std::string element;
  };
  // `each`: elements of an invocation, one after the other; `domain`: invocations.
  Cut cut(glsl::Shader& shader, const Pass& pass, const std::optional<LoopCut>& how, const std::string& element,
          int each = 1, const ir::Extent* domain = nullptr);
  // `skip`: is done with the element.
  static void open_cut(glsl::Shader& shader, const Cut& cut, const std::string& skip);
  void close_cut(glsl::Shader& shader, const Cut& cut);
  static void end_cut(glsl::Shader& shader, const Cut& cut);
  void set_trips(bundle::CommandT& command, const Cut& cut) const;
  void reduce_pass(const Pass& pass);  // reduce.cpp
  void scatter_pass(const Pass& pass);
  // Where a sum or maximum of a scatter goes.
  struct Target {
    ScatterSum sum;
    glsl::Accumulator accumulator;
    uint32_t words = 0;   // bundle resource
    int most = 0;         // fixed: contributions from an element, negative: unknown
    bool fixed = false;   // added as fixed point numbers
    bool binned = false;  // added in bins; neither: as they are
    uint32_t terms = 0;   // bundle resource: contributions kept, where the pass keeps them
    uint32_t guess = 0;   // bundle resource: the shift of the run before, where the pass guesses
    // Bundle resource: whether the first run adds a NaN or Inf, where the pass asks whether the second has work. The
    // second then says of which elements.
    uint32_t special = 0;
    int group = 0;                 // invocations of a workgroup that joins what they add; 0: none does
    int run = 0;                   // lanes of a subgroup whose runs join what they add; 0: none does
    bool emptied = false;          // the pass that reads the words leaves zeros; of fixed point numbers
    const Pass* update = nullptr;  // whose elements the sums wake
    std::string list{};            // behind names of the scatter's list in the shader of the map that makes it
    std::string places{};          // of targets that join in a workgroup: the first that has its terms where this has
  };
  // Lists the element that a sum adds to, or marks its block, if `added`, an expression, is not 0 and it is not there.
  std::string wake(glsl::Shader& shader, const Target& target, const std::string& added);
  // Makes the resources, and clears them. `first`: the number of the first.
  std::vector<Target> scatter_targets(const Pass& pass, size_t first = 0);
  // Runs of a scatter by fixed point sums: one finds the largest contribution, one adds. Others need the second only.
  enum class Runs : uint8_t { Both, First, Second };
  // Declares what adds to a target; gives what a shader with a first run does at its end. `lists`: the variable `adds`
  // says whether an element adds anything.
  std::string declare_target(glsl::Shader& shader, const Pass& pass, const Target& target, Runs runs, bool lists);
  // What a shader does for a value that it adds, `value` to `element`, and at its end.
  struct Adding {
    std::string body, finish;
  };
  Adding fixed_adding(glsl::Shader& shader, const Pass& pass, const Target& target, Runs runs, bool lists);
  Adding binned_adding(glsl::Shader& shader, const Pass& pass, const Target& target, Runs runs, bool lists);
  Adding plain_adding(glsl::Shader& shader, const Pass& pass, const Target& target, Runs runs);
  // Parts of fixed_adding(). `buffer` has the sums.
  std::string find_largest(glsl::Shader& shader, const Pass& pass, const Target& target, bool lists);
  void choose_shift(glsl::Shader& shader, const Pass& pass, const Target& target, Runs runs, const std::string& buffer);
  std::string add_fixed(glsl::Shader& shader, const Target& target, Runs runs, bool joins_lanes,
                        const std::string& buffer);
  // A dispatch that says how many workgroups the second run of a scatter has: those of so many invocations if a guess
  // was wrong, or a contribution no number. Returns where that stands.
  uint32_t ask_for_guesses(const Pass& pass, const std::vector<Target>& targets, const ir::Dim& invocations);
  // Adds an element's fixed point numbers to memory, and its flags if it has them.
  std::string add_parts(glsl::Shader& shader, const Target& target, const std::string& buffer, bool flags = true);
  // A component of `value` in fixed point.
  static std::string fixed(glsl::Shader& shader, const Target& target, int c, const std::string& shift);
  // Statements that make a float's fixed point numbers, `part_0` and so on, and `flags` of what is not finite; that add
  // such a number to component `c` of an element; and that set the flags of an element.
  std::string fixed_parts(glsl::Shader& shader, const Target& target, bool flags = true);
  std::string add_to_memory(const Target& target, int c, const std::string& part, const std::string& element,
                            const std::string& buffer) const;
  std::string set_flags(const Target& target, const std::string& buffer) const;
  // Invocations of a workgroup join what they add when they are done (group_sums.cpp): how many bits a limb of a number
  // has; which targets have the same places; what each does with a contribution until then; and what they do together.
  static std::string limb_bits(const Target& target);
  void find_same_places(const std::vector<Target*>& targets) const;
  std::string keep_for_group(glsl::Shader& shader, const Target& target, bool lists);
  void join_in_group(glsl::Shader& shader, const std::vector<const Target*>& targets);
  // Lanes beside each other join what they add when they are done with an element (pair_sums.cpp): what a lane does
  // with a contribution until then, at an element's beginning, and at its end.
  static std::string keep_for_pair(glsl::Shader& shader, const Target& target);
  static std::string begin_pair(const Target& target);
  std::string join_in_pair(glsl::Shader& shader, const Target& target);
  // Of the second run: whether the first one added by the right shift everywhere.
  static std::string guessed_right(const std::vector<Target>& targets);
  const char* sum_word() const { return wide_atomics() ? "uint64_t" : "uint"; }
  // What a map pass does for a scatter that joins it (JoinedRun); gives what the shader does at its end.
  std::string scatter_where_listed(glsl::Shader& shader, const Pass& pass, const Pass& scatter, bool apart);
  // Contributions that the first run of exact sums keeps for the second (JoinedFirstRun), by their place in the list
  // of active elements: words of the buffer; what scatter_<name> does with one, its `value` for `element` at `site`;
  // that an element has none yet; and the add_<name> of them all, a part of which each invocation takes.
  ir::Dim words_of_terms(const Target& target, const ir::Extent& domain) const;
  std::string keep_term(glsl::Shader& shader, const Pass& pass, const Target& target) const;
  void keep_no_terms(glsl::Shader& shader, const Pass& pass, const Target& target) const;
  void add_kept_terms(glsl::Shader& shader, const Pass& pass, const std::vector<Target>& targets) const;
  void scatter_resolve(const Pass& pass, const Target& target);
  void resolve_apart(const Pass& pass, const Target& target);  // unless its reader does
  // Fixed point sums as floats: statements, and an expression a component, for the element `index`.
  struct FloatSums {
    std::string statements;
    std::vector<std::string> components;
  };
  FloatSums float_sums(glsl::Shader& shader, const ir::Type& type, const ir::Extent& extent, uint32_t words, int most,
                       const ir::Extent& domain, bool empties = false) const;
  FloatSums floats_of_bins(glsl::Shader& shader, const ir::Type& type, const ir::Extent& extent, uint32_t words) const;
  // How often an element of a domain adds to a sum at most, as contributions(), and that domain.
  std::pair<int, ir::Extent> added_to(ir::ValueId sum) const;
  // See glsl::Shader::SumsReader.
  std::string sums_reader(glsl::Shader& shader, ir::ValueId value, const std::string& function) const;
  // Of sums by float atomics that their reader leaves zeros.
  std::string floats_reader(glsl::Shader& shader, ir::ValueId value, const std::string& function) const;
  // Takes the sums that the pass reads and leaves zeros, once an element.
  void take_sums(glsl::Shader& shader, const Pass& pass) const;
  // Leaves the exponent of sums, whose scatter guesses, for the next run.
  std::string leave_guess(glsl::Shader& shader, uint32_t words, const std::string& shift) const;
  // The first invocation leaves the exponents of the sums that a scatter reads, which the next run guesses; its
  // elements are listed, and the first one hardly is.
  void leave_guesses(glsl::Shader& shader, const Pass& pass) const;
  // How often an element of the domain adds to a sum at most; negative where a loop decides.
  int contributions(const ScatterSum& sum) const;
  // The scatters of the step that a map pass lists elements for.
  std::vector<const Pass*> listed_for(const Pass& pass) const;
  // What lies behind the names of the list of a scatter where a map makes it.
  std::string list_suffix(const Pass& scatter) const;
  // Of a list, the elements that may add something by values which were not there yet when that was made.
  uint32_t list_nonzero(const Pass& pass, uint32_t listed);
  // A condition: whether an element is active.
  std::string active_condition(glsl::Shader& shader, const Clauses& clauses) const;
  // Stores what a map pass writes at an element and lists it for these scatters; `loop`: that the shader runs, if it
  // does. `apart`: elements beside each other are few, so lanes do not join what they add.
  void store_results(glsl::Shader& shader, const Pass& pass, const std::vector<const Pass*>& scatters = {},
                     ListingLoop* loop = nullptr, bool apart = false);
  // Those that are stored where the scatter is active, and that it reads.
  void store_partial(glsl::Shader& shader, const Pass& pass, const Pass& scatter);
  // Whether a sum in fixed point got anything but zeros.
  std::string anything_added(glsl::Shader& shader, ir::ValueId sum, const std::string& element) const;
  // Zeros in the sums that a scatter reads at an element which the map lists for it.
  void clear_listed(glsl::Shader& shader, const Pass& map, const Pass& scatter);
  void store_changed(glsl::Shader& shader, const Pass& pass, ir::ValueId value);
  // The largest of those that a map tells of, as the bits of a float without its sign; and a statement that says in a
  // word of the pass that it is NaN or Inf.
  std::string largest_bits(glsl::Shader& shader, const std::vector<ir::ValueId>& told) const;
  void tell_not_finite(glsl::Shader& shader, const Pass& pass, const std::string& largest);
  // An empty list of elements of the pass, a scratch buffer; a dispatch can be as large as it is long.
  uint32_t add_list(const Pass& pass, const std::string& name, bundle::ListKind kind);
  // No marked block of elements of an update.
  uint32_t add_marks(const Pass& update);
  uint32_t list_active(const Pass& pass);
  void rows_pass(const Pass& pass);
  // A table of rows in two resources of the bundle: where each row starts, and its items, each with its row.
  struct Table {
    uint32_t starts = 0, items = 0;
  };
  // The host makes it: two leaves.
  Table rows_table(const RowsScatter& rows, const RowsOfLeaf& of);
  // The device makes it, when what its indices depend on changed.
  Table sorted_table(const Pass& pass);
  void key_pass(const Pass& pass, uint32_t keys);
  struct Sort;
  glsl::Shader digit_shader(const Sort& sort, const ir::Dim& lanes) const;
  void sort_by_digit(const Sort& sort, int digit);
  void sum_counts(const Sort& sort, const std::string& name, const std::vector<int>& push);
  void take_sorted_items(const Sort& sort);
  void find_rows(const Sort& sort);
  void sum_blocks(const Pass& pass, const Table& table, const std::vector<ir::OpId>& ops, const ir::Dim& blocks,
                  const ir::Dim& layers, uint32_t sums, int words);
  std::vector<ir::OpId> element_ops(const Pass& pass) const;
  void raster_hardware(const Pass& pass, const ir::Op& op);
  void raster_compute(const Pass& pass, const RasterPass& raster, const ir::Op& op);
  void take_out(const Pass& pass, const ir::Op& op, uint32_t slots);
  void resolve(const Pass& pass, const ir::Op& op, uint32_t keys, uint32_t ids, bool stay);
  // Loops of closures that no part of which can be left to a later dispatch: the run fails where they may take too many
  // trips, or, watched, where the driver ends one.
  void tell_unfinished(glsl::Shader& shader, uint32_t watch);
  void set_walk_trips(bundle::CommandT& command, const WalkTrips& trips, std::optional<uint32_t> watch) const;

  // Where the float profile is `native`, so is the shader, but for those that must agree with each other on a decision.
  glsl::Shader shader() const { return shader(schedule_.code.native); }
  glsl::Shader strict_shader() const { return shader(false); }
  glsl::Shader shader(bool native) const {
    return glsl::Shader(graph_, schedule_, *step_, bundle_->symbols, bundle_->numbers, native,
                        [this](glsl::Shader& s, ir::ValueId value, const std::string& function) {
                          return sums_reader(s, value, function);
                        });
  }
  // The layer that a vertex or fragment shader draws: one of those that a render pass draws at once, counted from the
  // first of them.
  std::string drawn_layer(glsl::Shader& shader, const ir::Dim& layers) const {
    if (!schedule_.code.layers_at_once || layers.is_one()) return "pc.layer";
    shader.extension("GL_EXT_multiview");
    return "pc.layer + gl_ViewIndex";
  }
  // 64 invocations in a workgroup, or as many as the host likes.
  std::string compute_layout(int group) const {
    if (group != 0) return "layout(local_size_x = " + std::to_string(group) + ") in;\n";
    return "layout(local_size_x = 64, local_size_x_id = " + std::to_string(bundle_->symbols.size()) + ") in;\n";
  }
  // Whether shaders may use 64-bit integers and their atomics; those that do say so.
  bool wide_atomics() const { return schedule_.code.wide_words; }
  static void wide_extensions(glsl::Shader& shader) {
    shader.extension("GL_ARB_gpu_shader_int64");
    shader.extension("GL_EXT_shader_atomic_int64");
    shader.prelude(glsl::kWide);
  }

  static void subgroup_extensions(glsl::Shader& shader) {
    shader.extension("GL_KHR_shader_subgroup_basic");
    shader.extension("GL_KHR_shader_subgroup_ballot");
    shader.extension("GL_KHR_shader_subgroup_arithmetic");
  }

  // `group`: the invocations of a workgroup; 0: as the host likes.
  int add_shader(const std::string& name, bundle::Stage stage, glsl::Shader& shader, int group = 0);
  // `type`: of its words, as shaders that only read them see them.
  uint32_t add_scratch(const std::string& name, const std::string& words, const ir::Type& type = ir::kUint);
  // A word that shaders set, and that the host reads when the step has run.
  uint32_t add_watch(const std::string& name);
  bundle::CommandT& command(bundle::CommandKind kind, const std::string& label);
  bundle::CommandT& dispatch(const Pass& pass, const std::string& suffix, glsl::Shader& shader,
                             const std::string& elements, std::vector<int> push = {0, 0, 0}, int group = 0);
  void fill(const std::string& label, uint32_t target, uint32_t value, const std::string& words = "");
  uint32_t resource_index(ir::ValueId value) const { return step_->stored.at(value).index; }
  const Resource& resource(ir::ValueId value) const { return schedule_.resources[resource_index(value)]; }

  const ir::Graph& graph_;
  std::optional<ChangingAxes> changing_;
  const Schedule& schedule_;
  const SourceLines& source_lines_;
  std::vector<bundle::Line> lines_;
  size_t ops_ = 0;   // of the pass, until a command says so
  int finite_ = -1;  // bundle resource of tell_not_finite(), likewise
  std::map<const Pass*, uint32_t> finite_words_;
  bundle::BundleT* bundle_ = nullptr;
  std::vector<GlslShader>* shaders_ = nullptr;
  std::unordered_map<std::string, size_t> shader_of_;  // by its text without names
  const StepSchedule* step_ = nullptr;
  bundle::StepT* out_ = nullptr;
  std::map<uint32_t, uint32_t> guesses_;                // by the resource of sums, where their scatter guesses
  std::map<const Pass*, uint32_t> active_lists_;        // by scatter, of those that a map pass makes
  std::map<const Pass*, uint32_t> stepped_lists_;       // by update
  std::map<const Pass*, uint32_t> woken_;               // by update whose sums wake elements, a word for each
  std::map<const Pass*, std::vector<Target>> targets_;  // of scatters that join the pass before
  struct TableOfLeaves {
    uint32_t leaf = 0;  // the first of two, of the bundle
    Table table;
  };
  std::map<std::string, TableOfLeaves> tables_;
  std::set<uint32_t> step_tables_;     // leaves
  std::map<uint32_t, uint32_t> kept_;  // of the step: resources and their copies
};

// How many elements of a list have room for what they add (JoinedFirstRun): few add something to a sum whose
// elements are listed, and those beyond are computed again.
ir::Dim room_for_terms(const ir::Extent& domain);
// Opens a compute shader's main: computes `index`, returns past `elements` if it says some.
void linear_index(glsl::Shader& shader, const std::string& elements);
// Computes `at`, an element's place.
void place_from_index(glsl::Shader& shader, const ir::Extent& extent, const std::string& index = "index");

// Invocations that look whether the first run guessed right: starting more takes longer than the look.
ir::Dim looking_for_guesses(const ir::Extent& domain);

// Not 0 where a value is anything but zeros; NaN is. Without branches, of which drivers compile many slowly.
std::string any_bits(const ir::Type& type, const std::string& value);

// Words of 32 bits of the sums of values of that type, in fixed point or in bins; `wide`: by 64-bit atomics.
ir::Dim words_of_sums(const ir::Type& type, const ir::Extent& extent, bool wide);
// Bits that tell of what is not finite, for each number of an element; see special_flag (glsl/fixed_point.h). Those of
// number `c` among the element's, as it is a float; and those that begin at bit `shift` of the element's.
inline constexpr int kFlagBits = 2;
std::string flag_of(const std::string& number, int c);
std::string flag_at(const std::string& flags, const std::string& shift);
ir::Dim words_of_bins(const ir::Type& type, const ir::Extent& extent, bool wide);
// Those before the first element's, which each run of a step begins with as zeros.
ir::Dim words_of_head(bool wide);

// The number of elements of an extent, as an extent expression.
ir::Dim element_count(const ir::Extent& extent);
std::unique_ptr<bundle::ExtentT> bundle_extent(const ir::Extent& extent);
std::unique_ptr<bundle::TypeT> bundle_type(const ir::Type& type);

}  // namespace dr::backend
