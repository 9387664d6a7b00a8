// SPDX-License-Identifier: Apache-2.0
// Raster by enumeration: the pixels of the box around each face's corners are its candidates, `keep` decides. The
// picture is cut into bands of rows; each goes through all faces in order, so that a pixel's faces arrive by number.
#include "compiler/reference/raster.h"

#include <algorithm>
#include <cmath>

#include "compiler/ir/raster.h"

namespace dr::reference {
namespace {

using ir::Op;

constexpr int64_t kBandRows = 16;
// A corner may lie exactly on a pixel's centre, and `keep` may find that centre inside by a rounding error. So much
// room is left around the corners, in pixels.
constexpr double kMargin = 1.0 / 64;

struct Box {
  int32_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;  // half open; empty for a face that is never proposed
  bool holds(int32_t x, int32_t y) const { return x >= x0 && x < x1 && y >= y0 && y < y1; }
};

// Whether a point lies in a triangle of either winding, or within kMargin of it.
bool in_triangle(const double (&corner)[3][2], double x, double y) {
  bool left = false, right = false;  // of an edge
  for (size_t k = 0; k < 3; ++k) {
    const double *a = corner[k], *b = corner[(k + 1) % 3];
    const double side = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
    left |= side < 0;
    right |= side > 0;
  }
  if (left != right) return true;
  for (size_t k = 0; k < 3; ++k) {
    const double *a = corner[k], *b = corner[(k + 1) % 3];
    const double dx = b[0] - a[0], dy = b[1] - a[1], px = x - a[0], py = y - a[1];
    const double t = std::clamp((px * dx + py * dy) / std::max(dx * dx + dy * dy, 1e-300), 0.0, 1.0);
    const double ex = px - t * dx, ey = py - t * dy;
    if (ex * ex + ey * ey <= kMargin * kMargin) return true;
  }
  return false;
}

// Pixels of one axis whose centres may lie between low and high.
void cover(double low, double high, int64_t size, int32_t& first, int32_t& end) {
  const auto limit = static_cast<double>(size);
  first = static_cast<int32_t>(std::clamp(std::ceil(low - kMargin - 0.5), 0.0, limit));
  end = static_cast<int32_t>(std::clamp(std::floor(high + kMargin - 0.5) + 1, 0.0, limit));
}

// The nearest faces of a band's pixels, best first: rank r of pixel p is at [r * pixels + p].
class Nearest {
 public:
  Nearest(size_t ranks, size_t pixels) : ranks_(ranks), pixels_(pixels), entries_(ranks * pixels) {}

  struct Entry {
    int32_t key = -1;  // -1: none
    int32_t face = -1;
    int32_t tag = 0;
  };
  const Entry& at(size_t rank, size_t pixel) const { return entries_[rank * pixels_ + pixel]; }

  void insert(size_t pixel, Entry entry) {
    for (size_t rank = 0; rank < ranks_; ++rank) {
      Entry& here = entries_[rank * pixels_ + pixel];
      if (here.key >= 0 && (here.key < entry.key || (here.key == entry.key && here.face < entry.face))) continue;
      std::swap(here, entry);
      if (entry.key < 0) return;
    }
  }

 private:
  size_t ranks_, pixels_;
  std::vector<Entry> entries_;
};

class Raster {
 public:
  Raster(const Context& context, const Op& op)
      : context_(context),
        ranks_(static_cast<size_t>(op.attrs.ints[0])),
        each_(ir::results_a_rank(op.attrs)),
        listed_(ir::lists_faces(op.attrs)),
        depth_(context.graph, op.regions[0]),
        keep_(context.graph, op.regions[1]),
        tag_(context.graph, op.regions[2]) {
    const auto extent = [&](size_t k) { return op.attrs.dims[k].evaluate(context.symbols).value(); };
    size_ = {extent(0), extent(1), extent(2)};
    faces_ = extent(3);
    const auto fields = static_cast<size_t>(op.attrs.ints[1]), corners = static_cast<size_t>(op.attrs.ints[2]);
    for (size_t k = 0; k < fields + corners + 1; ++k) {
      const Image* image = context.images[op.operands[k].index];
      (k < fields ? fields_ : k < fields + corners ? corners_ : cull_).push_back(image);
    }
  }

  RasterFindings run(std::span<Image* const> results, Workers& workers) {
    boxes_.resize(static_cast<size_t>(faces_ * size_.l));
    constexpr size_t kFaces = 4096;
    workers.run((boxes_.size() + kFaces - 1) / kFaces, [&](size_t task, size_t) {
      for (size_t i = task * kFaces; i < std::min(boxes_.size(), (task + 1) * kFaces); ++i) {
        boxes_[i] = box(static_cast<int64_t>(i) % faces_, static_cast<int64_t>(i) / faces_);
      }
    });
    const int64_t bands = (size_.h + kBandRows - 1) / kBandRows;
    std::vector<RegionRunner> runners;
    for (size_t k = 0; k < workers.count(); ++k) runners.emplace_back(context_);
    const auto tasks = static_cast<size_t>(bands * size_.l);
    std::vector<RasterFindings> found(tasks);
    workers.run(tasks, [&](size_t task, size_t worker) {
      const auto t = static_cast<int64_t>(task);
      band(t / bands, t % bands * kBandRows, results, runners[worker], found[task]);
      found[task].first = runners[worker].take_first();
    });
    RasterFindings all;
    for (const RasterFindings& one : found) {
      Origin first = all.first.valid() ? all.first : one.first;
      const int64_t outside = all.outside + one.outside;
      if (all.outside == 0) all = one;
      all.first = std::move(first);
      all.outside = outside;
    }
    return all;
  }

  // How the faces of the results are ordered.
  void order(std::span<Image* const> results) const {
    RegionRunner runner(context_);
    for (size_t rank = 0; rank < ranks_; ++rank) {
      const Image& faces = *results[each_ * rank];
      Image& orders = *results[each_ * rank + 2];
      std::ranges::fill(orders.data, ir::kLastOrder);
      Candidates list;
      const auto flush = [&] {
        if (list.faces.empty()) return;
        call(depth_, list, runner, [&](size_t i, double depth) {
          if (!std::isnan(depth)) orders.at(list.places.x[i], list.places.y[i], list.places.l[i], 0) = key_of(depth);
        });
        list.clear();
      };
      for (int32_t l = 0; l < size_.l; ++l)
        for (int32_t y = 0; y < size_.h; ++y)
          for (int32_t x = 0; x < size_.w; ++x) {
            const double face = faces.at(x, y, l, 0);
            if (face >= 0 && face < static_cast<double>(faces_)) list.push(x, y, l, static_cast<int32_t>(face));
            if (list.faces.size() == kBatch) flush();
          }
      flush();
    }
  }

 private:
  struct Candidates {
    Places places;
    std::vector<int32_t> faces;

    void push(int32_t x, int32_t y, int32_t l, int32_t face) {
      places.x.push_back(x);
      places.y.push_back(y);
      places.l.push_back(l);
      faces.push_back(face);
    }
    void clear() {
      places.x.clear();
      places.y.clear();
      places.l.clear();
      faces.clear();
    }
  };

  // One of the op's three functions, and which of its parameters it reads.
  struct Function {
    Plan plan;
    std::vector<bool> reads;  // by slot

    Function(const ir::Graph& graph, ir::RegionId region)
        : plan(plan_raster_region(graph, region)), reads(plan.slots.size()) {
      for (const OpPlan& inner : plan.ops) {
        for (uint32_t slot : inner.operands) reads[slot] = true;
        for (const Plan& nested : inner.regions) {
          for (const Slot& slot : nested.slots) {
            if (slot.source == Slot::Source::Parent) reads[slot.parent_slot] = true;
          }
        }
      }
      reads[plan.yields[0].value] = true;
    }
  };

  // Where in a record image a face stands.
  static size_t record(const Image& image, int64_t face, int64_t layer) {
    const Strides strides(image);
    return static_cast<size_t>(face) * strides.x + static_cast<size_t>(layer) * strides.l;
  }

  Box box(int64_t face, int64_t layer) const {
    if (cull_[0]->data[record(*cull_[0], face, layer)] != 0) return {};
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (const Image* corner : corners_) {
      const size_t at = record(*corner, face, layer), count = size_of(*corner).count();
      for (size_t c = 0; c < 2; ++c) {
        const double v = corner->data[c * count + at];
        if (std::isnan(v)) return {};  // no hull
        low[c] = std::min(low[c], v);
        high[c] = std::max(high[c], v);
      }
    }
    Box b;
    if (std::isinf(low[0]) || std::isinf(low[1]) || std::isinf(high[0]) || std::isinf(high[1])) {
      // Where the hull of a point at infinity lies is a matter of taste; the whole picture is a superset.
      b.x1 = static_cast<int32_t>(size_.w);
      b.y1 = static_cast<int32_t>(size_.h);
      return b;
    }
    cover(low[0], high[0], size_.w, b.x0, b.x1);
    cover(low[1], high[1], size_.h, b.y0, b.y1);
    return b;
  }

  // Whether the pixel's centre lies in one of the hull's triangles.
  bool in_hull(int32_t face, int32_t x, int32_t y, int32_t layer) const {
    for (size_t first = 0; first < corners_.size(); first += 3) {
      double corner[3][2];
      bool finite = true;
      for (size_t k = 0; k < 3; ++k) {
        const Image& image = *corners_[first + k];
        const size_t at = record(image, face, layer), count = size_of(image).count();
        for (size_t c = 0; c < 2; ++c) {
          corner[k][c] = image.data[c * count + at];
          finite &= std::isfinite(corner[k][c]);
        }
      }
      if (!finite || in_triangle(corner, x + 0.5, y + 0.5)) return true;
    }
    return false;
  }

  // The box and a pixel around it, where a hull that is too small shows.
  Box wider(const Box& b) const {
    if (b.x0 >= b.x1 || b.y0 >= b.y1) return b;
    return {.x0 = std::max(b.x0 - 1, 0),
            .y0 = std::max(b.y0 - 1, 0),
            .x1 = std::min(b.x1 + 1, static_cast<int32_t>(size_.w)),
            .y1 = std::min(b.y1 + 1, static_cast<int32_t>(size_.h))};
  }

  void band(int64_t layer, int64_t y0, std::span<Image* const> results, RegionRunner& runner,
            RasterFindings& findings) const {
    const int64_t y1 = std::min(size_.h, y0 + kBandRows);
    Nearest nearest(ranks_, static_cast<size_t>((y1 - y0) * size_.w));
    Candidates list;
    for (int64_t face = 0; face < faces_; ++face) {
      const Box b = wider(boxes_[static_cast<size_t>(layer * faces_ + face)]);
      const auto from = std::max(b.y0, static_cast<int32_t>(y0)), to = std::min(b.y1, static_cast<int32_t>(y1));
      for (int32_t y = from; y < to; ++y) {
        for (int32_t x = b.x0; x < b.x1; ++x) {
          list.push(x, y, static_cast<int32_t>(layer), static_cast<int32_t>(face));
          if (list.faces.size() == kBatch) decide(list, y0, nearest, runner, findings);
        }
      }
    }
    decide(list, y0, nearest, runner, findings);

    for (int64_t y = y0; y < y1; ++y) {
      for (int64_t x = 0; x < size_.w; ++x) {
        for (size_t rank = 0; rank < ranks_; ++rank) {
          const Nearest::Entry& entry = nearest.at(rank, static_cast<size_t>((y - y0) * size_.w + x));
          if (listed_) {
            const auto place = static_cast<int64_t>(rank) * size_.l + layer;
            results[0]->at(x, y, place, 0) = entry.face < 0 ? -1 : 16.0 * entry.face + entry.tag;
          } else {
            results[each_ * rank]->at(x, y, layer, 0) = entry.face;
            results[each_ * rank + 1]->at(x, y, layer, 0) = entry.tag;
            if (each_ == 3) results[each_ * rank + 2]->at(x, y, layer, 0) = entry.face < 0 ? ir::kLastOrder : entry.key;
          }
        }
      }
    }
  }

  // Calls a function for a list of candidates; `use(i, number)` gets its value for each.
  template <class Use>
  void call(const Function& function, const Candidates& list, RegionRunner& runner, const Use& use) const {
    const Plan& plan = function.plan;
    const size_t n = list.faces.size();
    Frame frame = runner.outermost(plan, list.places);
    for (size_t k = 0; k < fields_.size(); ++k) {
      if (!function.reads[plan.params[k]]) continue;
      const Image& field = *fields_[k];
      const size_t count = size_of(field).count(), planes = components(field.type);
      double* out = runner.make(frame, plan.params[k], n);
      for (size_t i = 0; i < n; ++i) {
        const size_t at = record(field, list.faces[i], list.places.l[i]);
        for (size_t c = 0; c < planes; ++c) out[c * n + i] = field.data[c * count + at];
      }
    }
    double* p = runner.make(frame, plan.params[fields_.size()], n);
    for (size_t i = 0; i < n; ++i) {
      p[i] = list.places.x[i] + 0.5;
      p[n + i] = list.places.y[i] + 0.5;
    }
    runner.run(frame);
    const Lanes& value = runner.get(frame, plan.yields[0].value);
    for (size_t i = 0; i < n; ++i) use(i, value.at(0, i));
    runner.clear(frame);
  }

  int32_t key_of(double depth) const {
    double key = std::clamp(depth, 0.0, 1.0) * ir::kLastOrder;
    if (context_.float32) round_to_float(&key, 1);
    return static_cast<int32_t>(std::floor(key));
  }

  void decide(Candidates& list, int64_t y0, Nearest& nearest, RegionRunner& runner, RasterFindings& findings) const {
    const auto push_from = [](Candidates& to, const Candidates& from, size_t i) {
      to.push(from.places.x[i], from.places.y[i], from.places.l[i], from.faces[i]);
    };
    if (list.faces.empty()) return;
    Candidates kept, seen;
    std::vector<int32_t> keys;
    call(keep_, list, runner, [&](size_t i, double keep) {
      if (keep == 0) return;
      const int32_t x = list.places.x[i], y = list.places.y[i], l = list.places.l[i], face = list.faces[i];
      if (!in_hull(face, x, y, l) && findings.outside++ == 0) {
        findings.face = face;
        findings.x = x;
        findings.y = y;
        findings.layer = l;
      }
      if (boxes_[static_cast<size_t>(l * faces_ + face)].holds(x, y)) push_from(kept, list, i);
    });
    list.clear();
    if (kept.faces.empty()) return;
    call(depth_, kept, runner, [&](size_t i, double depth) {
      if (std::isnan(depth)) return;
      push_from(seen, kept, i);
      keys.push_back(key_of(depth));
    });
    if (seen.faces.empty()) return;
    call(tag_, seen, runner, [&](size_t i, double tag) {
      const int64_t pixel = (seen.places.y[i] - y0) * size_.w + seen.places.x[i];
      // A tag has four bits, wherever it is stored.
      nearest.insert(static_cast<size_t>(pixel),
                     {.key = keys[i], .face = seen.faces[i], .tag = static_cast<int32_t>(tag) & 15});
    });
  }

  const Context& context_;
  size_t ranks_, each_;
  bool listed_;
  Function depth_, keep_, tag_;
  Size size_;
  int64_t faces_ = 0;
  std::vector<const Image*> fields_, corners_, cull_;
  std::vector<Box> boxes_;  // [layer * faces + face]
};

}  // namespace

void order_faces(const Context& context, const Op& op, std::span<Image* const> results) {
  if (ir::results_a_rank(op.attrs) == 3) Raster(context, op).order(results);
}

RasterFindings run_raster(const Context& context, const Op& op, std::span<Image* const> results, Workers& workers) {
  return Raster(context, op).run(results, workers);
}

}  // namespace dr::reference
