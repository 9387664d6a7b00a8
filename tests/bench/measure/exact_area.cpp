// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/measure/exact_area.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace dr::benchmark {

namespace {

double cross(Point a, Point b) { return a.x * b.y - a.y * b.x; }
Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }

struct Box {
  int left, top, right, bottom;  // the last ones belong to it
};

Box box_of(const Scene& scene, int32_t face) {
  double low_x = 1e30, low_y = 1e30, high_x = -1e30, high_y = -1e30;
  for (const int32_t i : scene.faces[static_cast<size_t>(face)]) {
    const Point p = scene.points[static_cast<size_t>(i)];
    low_x = std::min(low_x, p.x), low_y = std::min(low_y, p.y);
    high_x = std::max(high_x, p.x), high_y = std::max(high_y, p.y);
  }
  const auto held = [](double v, int n) {
    return static_cast<int>(std::clamp(std::floor(v), -1.0, static_cast<double>(n)));
  };
  return {std::max(held(low_x, scene.width), 0), std::max(held(low_y, scene.height), 0),
          std::min(held(high_x, scene.width), scene.width - 1), std::min(held(high_y, scene.height), scene.height - 1)};
}

}  // namespace

ExactArea::ExactArea(Scene scene) : scene_(std::move(scene)), faces_of_(scene_.points.size()) {
  for (size_t f = 0; f < scene_.faces.size(); ++f)
    for (const int32_t i : scene_.faces[f]) faces_of_[static_cast<size_t>(i)].push_back(static_cast<int32_t>(f));
}

std::vector<std::vector<int32_t>> ExactArea::faces_by_pixel() const {
  std::vector<std::vector<int32_t>> found(static_cast<size_t>(scene_.width) * static_cast<size_t>(scene_.height));
  for (size_t f = 0; f < scene_.faces.size(); ++f) {
    const Box b = box_of(scene_, static_cast<int32_t>(f));
    for (int y = b.top; y <= b.bottom; ++y)
      for (int x = b.left; x <= b.right; ++x)
        found[static_cast<size_t>(y) * static_cast<size_t>(scene_.width) + static_cast<size_t>(x)].push_back(
            static_cast<int32_t>(f));
  }
  return found;
}

std::vector<double> ExactArea::picture() const {
  const auto faces = faces_by_pixel();
  std::vector<double> result(faces.size(), scene_.background);
  for (size_t i = 0; i < faces.size(); ++i)
    if (!faces[i].empty())
      result[i] = pixel(static_cast<int>(i) % scene_.width, static_cast<int>(i) / scene_.width, faces[i]);
  return result;
}

double ExactArea::pixel(int x, int y, const std::vector<int32_t>& faces) const {
  std::vector<Cut> cuts;
  for (const int32_t f : faces)
    if (Cut c = cut(f, x, y); c.corner.size() > 2) cuts.push_back(std::move(c));
  return strips(cuts, x, y, nullptr);
}

std::vector<Point> ExactArea::gradient(std::span<const double> adjoint) const {
  std::vector<Point> result(scene_.points.size());
  const auto faces = faces_by_pixel();
  std::vector<Sweep> sweeps;
  for (size_t i = 0; i < faces.size(); ++i) {
    if (adjoint[i] == 0 || faces[i].empty()) continue;
    const int x = static_cast<int>(i) % scene_.width, y = static_cast<int>(i) / scene_.width;
    std::vector<Cut> cuts;
    for (const int32_t f : faces[i])
      if (Cut c = cut(f, x, y); c.corner.size() > 2) cuts.push_back(std::move(c));
    sweeps.clear();
    strips(cuts, x, y, &sweeps);
    for (const Sweep& s : sweeps) {
      Point &a = result[static_cast<size_t>(s.a)], &b = result[static_cast<size_t>(s.b)];
      a.x += adjoint[i] * s.to_a.x, a.y += adjoint[i] * s.to_a.y;
      b.x += adjoint[i] * s.to_b.x, b.y += adjoint[i] * s.to_b.y;
    }
  }
  return result;
}

Point ExactArea::difference(std::span<const double> adjoint, size_t point, double step) {
  const Point start = scene_.points[point];
  // All pixels that the faces around reach before or after, and all faces there.
  Box around{scene_.width, scene_.height, -1, -1};
  const auto reach = [&] {
    for (const int32_t f : faces_of_[point]) {
      const Box b = box_of(scene_, f);
      if (b.left > b.right || b.top > b.bottom) continue;
      around = {std::min(around.left, b.left), std::min(around.top, b.top), std::max(around.right, b.right),
                std::max(around.bottom, b.bottom)};
    }
  };
  for (const double d : {-step, step}) {
    move(point, {start.x + d, start.y});
    reach();
    move(point, {start.x, start.y + d});
    reach();
  }
  move(point, start);
  if (around.left > around.right) return {};
  const int across = around.right - around.left + 1;
  std::vector<std::vector<int32_t>> faces(static_cast<size_t>(across) *
                                          static_cast<size_t>(around.bottom - around.top + 1));
  for (size_t f = 0; f < scene_.faces.size(); ++f) {
    Box b = box_of(scene_, static_cast<int32_t>(f));
    const auto& corners = scene_.faces[f];
    if (std::find(corners.begin(), corners.end(), static_cast<int32_t>(point)) != corners.end())
      b = around;  // it moves
    for (int y = std::max(b.top, around.top); y <= std::min(b.bottom, around.bottom); ++y)
      for (int x = std::max(b.left, around.left); x <= std::min(b.right, around.right); ++x)
        faces[static_cast<size_t>((y - around.top) * across + x - around.left)].push_back(static_cast<int32_t>(f));
  }
  const auto sum = [&](Point at) {
    move(point, at);
    double total = 0;
    for (int y = around.top; y <= around.bottom; ++y)
      for (int x = around.left; x <= around.right; ++x) {
        const double g = adjoint[static_cast<size_t>(y) * static_cast<size_t>(scene_.width) + static_cast<size_t>(x)];
        if (g != 0) total += g * pixel(x, y, faces[static_cast<size_t>((y - around.top) * across + x - around.left)]);
      }
    return total;
  };
  const Point result{(sum({start.x + step, start.y}) - sum({start.x - step, start.y})) / (2 * step),
                     (sum({start.x, start.y + step}) - sum({start.x, start.y - step})) / (2 * step)};
  move(point, start);
  return result;
}

ExactArea::Cut ExactArea::cut(int32_t face, int x, int y) const {
  Cut c{face, {}, {}};
  const auto& i = scene_.faces[static_cast<size_t>(face)];
  for (int32_t k = 0; k < 3; ++k) {
    c.corner.push_back(scene_.points[static_cast<size_t>(i[static_cast<size_t>(k)])]);
    c.side.push_back(3 * face + k);
  }
  if (cross(c.corner[1] - c.corner[0], c.corner[2] - c.corner[0]) == 0) return {face, {}, {}};
  // How far inside of each of the pixel's sides.
  const double borders[4] = {static_cast<double>(x), static_cast<double>(x) + 1, static_cast<double>(y),
                             static_cast<double>(y) + 1};
  for (int border = 0; border < 4 && !c.corner.empty(); ++border) {
    const auto inside = [&](Point p) {
      const double d = (border < 2 ? p.x : p.y) - borders[border];
      return border % 2 == 0 ? d : -d;
    };
    Cut next{face, {}, {}};
    for (size_t k = 0; k < c.corner.size(); ++k) {
      const Point a = c.corner[k], b = c.corner[(k + 1) % c.corner.size()];
      const double from = inside(a), to = inside(b);
      if (from >= 0) next.corner.push_back(a), next.side.push_back(c.side[k]);
      if ((from >= 0) == (to >= 0)) continue;
      const double t = from / (from - to);
      Point p{a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)};
      (border < 2 ? p.x : p.y) = borders[border];
      next.corner.push_back(p), next.side.push_back(from >= 0 ? -1 : c.side[k]);
    }
    c = std::move(next);
  }
  return c;
}

double ExactArea::strips(const std::vector<Cut>& cuts, int x, int y, std::vector<Sweep>* sweeps) const {
  const double left = x, right = x + 1.0;
  std::vector<double> at{left, right};
  struct Segment {
    Point a, b;
  };
  std::vector<Segment> segments;
  for (const Cut& c : cuts)
    for (size_t k = 0; k < c.corner.size(); ++k) {
      at.push_back(c.corner[k].x);
      if (c.side[k] >= 0) segments.push_back({c.corner[k], c.corner[(k + 1) % c.corner.size()]});
    }
  for (size_t i = 0; i < segments.size(); ++i)
    for (size_t j = 0; j < i; ++j) {
      const Point d = segments[i].b - segments[i].a, e = segments[j].b - segments[j].a,
                  o = segments[j].a - segments[i].a;
      const double slope = cross(d, e);
      if (slope == 0) continue;
      const double t = cross(o, e) / slope, u = cross(o, d) / slope;
      if (t > 0 && t < 1 && u > 0 && u < 1) at.push_back(segments[i].a.x + t * d.x);
    }
  std::sort(at.begin(), at.end());
  double total = 0;
  for (size_t k = 0; k + 1 < at.size(); ++k) {
    const double from = std::clamp(at[k], left, right), to = std::clamp(at[k + 1], left, right);
    if (to > from) total += strip(cuts, from, to, sweeps);
  }
  (void)y;
  // What no face covers shows the background.
  return total + scene_.background;
}

double ExactArea::strip(const std::vector<Cut>& cuts, double from, double to, std::vector<Sweep>* sweeps) const {
  struct Border {
    double y;
    int32_t face, side;
    bool begins;
  };
  const double x = 0.5 * (from + to), wide = to - from;
  std::vector<Border> borders;
  for (const Cut& c : cuts) {
    double low = 1e30, high = -1e30;
    int32_t low_side = -1, high_side = -1;
    for (size_t k = 0; k < c.corner.size(); ++k) {
      const Point a = c.corner[k], b = c.corner[(k + 1) % c.corner.size()];
      if (std::min(a.x, b.x) > x || std::max(a.x, b.x) < x || a.x == b.x) continue;
      const double y = a.y + (x - a.x) / (b.x - a.x) * (b.y - a.y);
      if (y < low) low = y, low_side = c.side[k];
      if (y > high) high = y, high_side = c.side[k];
    }
    if (low > high) continue;
    borders.push_back({low, c.face, low_side, true});
    borders.push_back({high, c.face, high_side, false});
  }
  std::sort(borders.begin(), borders.end(), [](const Border& p, const Border& q) { return p.y < q.y; });
  std::vector<int32_t> there;
  double total = 0, seen = scene_.background;
  for (size_t k = 0; k < borders.size(); ++k) {
    const Border& border = borders[k];
    if (border.begins)
      there.push_back(border.face);
    else
      there.erase(std::remove(there.begin(), there.end(), border.face), there.end());
    const double next_y = k + 1 < borders.size() ? borders[k + 1].y : border.y;
    double next = scene_.background, nearest = 1e300;
    if (scene_.depth.empty()) {
      if (!there.empty()) next = 1;
    } else {
      for (const int32_t f : there)
        if (const double z = depth_at(f, {x, 0.5 * (border.y + next_y)}); z < nearest) nearest = z, next = color_of(f);
    }
    total += (next - scene_.background) * (next_y - border.y) * wide;
    if (sweeps != nullptr && border.side >= 0 && next != seen) {
      const auto& face = scene_.faces[static_cast<size_t>(border.side / 3)];
      const int32_t a = face[static_cast<size_t>(border.side % 3)],
                    b = face[static_cast<size_t>((border.side % 3 + 1) % 3)];
      const Point p = scene_.points[static_cast<size_t>(a)], d = scene_.points[static_cast<size_t>(b)] - p;
      const double of_b = (x - p.x) / d.x, slope = d.y / d.x, gain = (seen - next) * wide;
      sweeps->push_back({a, b, {-slope * gain * (1 - of_b), gain * (1 - of_b)}, {-slope * gain * of_b, gain * of_b}});
    }
    seen = next;
  }
  return total;
}

double ExactArea::depth_at(int32_t face, Point p) const {
  const auto& i = scene_.faces[static_cast<size_t>(face)];
  const auto point = [&](size_t k) { return scene_.points[static_cast<size_t>(i[k])]; };
  const auto depth = [&](size_t k) { return scene_.depth[static_cast<size_t>(i[k])]; };
  const Point e = point(1) - point(0), f = point(2) - point(0), d = p - point(0);
  const double area = cross(e, f);
  return depth(0) + (cross(d, f) * (depth(1) - depth(0)) + cross(e, d) * (depth(2) - depth(0))) / area;
}

}  // namespace dr::benchmark
