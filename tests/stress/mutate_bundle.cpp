// SPDX-License-Identifier: Apache-2.0
#include "tests/stress/mutate_bundle.h"

#include <functional>
#include <string>

namespace dr::test {

namespace {

using namespace bundle;

// Makes changes, each of the field that it is called with.
struct Mutator {
  Random& random;

  size_t below(size_t count) { return count == 0 ? 0 : static_cast<size_t>(random() % count); }
  bool chance(unsigned one_in) { return random() % one_in == 0; }

  template <class T>
  void number(T& value) {
    const int64_t odd[] = {0, 1, 2, 3, 7, 64, 255, 256, 65535, 65536, 2147483647, 4294967295, -1, -2, -2147483648LL};
    switch (random() % 4) {
      case 0: value = static_cast<T>(odd[below(std::size(odd))]); break;
      case 1: value = static_cast<T>(static_cast<uint64_t>(value) + 1); break;
      case 2: value = static_cast<T>(static_cast<uint64_t>(value) - 1); break;
      default: value = static_cast<T>(random() % 16); break;
    }
  }
  // The underlying number, also past the last one that has a name.
  template <class E>
  void one_of(E& value) {
    value = static_cast<E>(random() % (static_cast<unsigned>(E::MAX) + 2));
  }
  void text(std::string& value) {
    const char* const odd[] = {"",         "/abs",          "../up",   "W",       "H", "1",  "2",     "x",
                               "64",       "2147483647",    "W * H",   "W - 7",   "0", "-1", "W / 4", "1048576",
                               "33554432", "(W + 63) / 64", "\x1b[2J", "W * 4096"};
    value = odd[below(std::size(odd))];
  }
  template <class T>
  void numbers(std::vector<T>& all) {
    switch (random() % 5) {
      case 0: all.push_back(static_cast<T>(random() % 16)); break;
      case 1:
        if (!all.empty()) all.pop_back();
        break;
      case 2: std::shuffle(all.begin(), all.end(), random); break;
      default:
        if (!all.empty()) number(all[below(all.size())]);
        break;
    }
  }
  // Another order, one less, one twice, or one changed by `change`.
  template <class T>
  void list(std::vector<std::unique_ptr<T>>& all, const std::function<void(T&)>& change) {
    if (all.empty()) return;
    const size_t k = below(all.size());
    switch (random() % 12) {
      case 0: std::swap(all[k], all[below(all.size())]); break;
      case 1: all.erase(all.begin() + static_cast<ptrdiff_t>(k)); break;
      case 2: all.push_back(std::make_unique<T>(*all[k])); break;
      case 3: *all[k] = T(*all[below(all.size())]); break;
      default: change(*all[k]);
    }
  }
  void type(std::unique_ptr<TypeT>& t) {
    switch (random() % 3) {
      case 0: one_of(t->scalar); break;
      case 1: number(t->rows); break;
      default: number(t->cols); break;
    }
  }
  void extent(std::unique_ptr<ExtentT>& e) {
    if (!e) e = std::make_unique<ExtentT>();
    std::string* const axes[] = {&e->w, &e->h, &e->l};
    text(*axes[below(3)]);
  }
  void command(CommandT& c);
  void step(StepT& s);
  void leaf(LeafT& l);
  void resource(ResourceT& r);
  void bundle(BundleT& b);
};

void Mutator::command(CommandT& c) {
  const auto binding = [&](BindingT& b) {
    switch (random() % 3) {
      case 0: number(b.resource); break;
      case 1: one_of(b.access); break;
      default: number(b.texel); break;
    }
  };
  int* const indices[] = {&c.compute, &c.next,   &c.vertex, &c.fragment,  &c.indirect,
                          &c.depth,   &c.source, &c.target, &c.scratch_a, &c.scratch_b};
  switch (random() % 18) {
    case 0: one_of(c.kind); break;
    case 1: c.steady = !c.steady; break;
    case 2: numbers(c.leaves); break;
    case 3: text(c.elements); break;
    case 4: extent(c.extent); break;
    case 5: numbers(c.push); break;
    case 6: numbers(c.colors); break;
    case 7: numbers(c.clear); break;
    case 8: c.joins = !c.joins; break;
    case 9: numbers(c.inputs); break;
    case 10: number(c.value); break;
    case 11: text(c.outs); break;
    case 12: text(c.count); break;
    case 13: number(c.ops); break;
    case 14:
    case 15: number(*indices[below(std::size(indices))]); break;
    default: list<BindingT>(c.bindings, binding); break;
  }
}

void Mutator::step(StepT& s) {
  const auto output = [&](OutputT& o) { chance(2) ? text(o.name) : number(o.resource); };
  switch (random() % 16) {
    case 0: number(s.step_index); break;
    case 1: numbers(s.leaves); break;
    case 2: numbers(s.changes); break;
    case 3: list<OutputT>(s.outputs, output); break;
    case 4: list<OutputT>(s.pins, output); break;
    case 5: list<RasterResultsT>(s.rasters, [&](RasterResultsT& r) { numbers(r.resources); }); break;
    case 6:
      if (!s.symbols.empty()) text(s.symbols[below(s.symbols.size())]);
      break;
    case 7: text(s.name); break;
    default: list<CommandT>(s.commands, [&](CommandT& c) { command(c); }); break;
  }
}

void Mutator::leaf(LeafT& l) {
  switch (random() % 8) {
    case 0: one_of(l.kind); break;
    case 1: type(l.type); break;
    case 2: extent(l.extent); break;
    case 3: number(l.resource); break;
    case 4: text(l.table); break;
    case 5: number(l.table_of); break;
    case 6: l.initial.assign(below(4), 1e30); break;
    default: text(l.name); break;
  }
}

void Mutator::resource(ResourceT& r) {
  switch (random() % 7) {
    case 0: one_of(r.storage); break;
    case 1: one_of(r.role); break;
    case 2: type(r.type); break;
    case 3: number(r.slot); break;
    case 4: r.partial = !r.partial; break;
    case 5: text(r.name); break;
    default: extent(r.extent); break;
  }
}

void Mutator::bundle(BundleT& b) {
  switch (random() % 12) {
    case 0: list<LeafT>(b.leaves, [&](LeafT& l) { leaf(l); }); break;
    case 1:
    case 2:
    case 3: list<ResourceT>(b.resources, [&](ResourceT& r) { resource(r); }); break;
    case 4:
      list<ShaderT>(b.shaders,
                    [&](ShaderT& s) { chance(2) ? one_of(s.stage) : s.spirv.resize(below(s.spirv.size())); });
      break;
    case 5:
      if (!b.symbols.empty()) text(b.symbols[below(b.symbols.size())]);
      break;
    default: list<StepT>(b.steps, [&](StepT& s) { step(s); }); break;
  }
}

}  // namespace

void mutate_tables(BundleT& bundle, Random& random) {
  Mutator mutator{random};
  for (uint64_t n = random() % 4 + 1; n > 0; --n) mutator.bundle(bundle);
}

void mutate_spirv(BundleT& bundle, Random& random) {
  Mutator mutator{random};
  auto& words = bundle.shaders[mutator.below(bundle.shaders.size())]->spirv;
  uint32_t& word = words[mutator.below(words.size())];
  switch (random() % 5) {
    case 0: word ^= 1u << random() % 32; break;
    case 1: word = static_cast<uint32_t>(random()); break;
    case 2: word = words[mutator.below(words.size())]; break;
    case 3: word += static_cast<uint32_t>(random() % 5) - 2; break;
    default: word = static_cast<uint32_t>(random() % 256); break;
  }
}

}  // namespace dr::test
