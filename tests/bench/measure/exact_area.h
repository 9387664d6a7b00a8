// SPDX-License-Identifier: Apache-2.0
// The mean of what lies behind each pixel's square, in float64, and its gradient: the judge of pictures and gradients.
// Any mesh will do: open, concave, in front of itself. Nothing is known of outlines here: each pixel takes the faces
// that reach into it, cuts them to its square, and cuts that into strips at every corner and crossing. Within a strip
// faces begin and end along straight lines that do not meet, so areas are products and what moves them is plain.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace dr::benchmark {

struct Point {
  double x = 0, y = 0;
};

// A mesh in pixels, in front of the camera. Faces may be wound either way.
struct Scene {
  std::vector<Point> points;
  std::vector<std::array<int32_t, 3>> faces;
  std::vector<double> depth;  // of each point, linear in the picture; empty: all faces are of one depth and colour 1
  std::vector<double> color;  // of each face; empty: 1
  double background = 0;
  int width = 0, height = 0;
};

// Pictures are row after row from the top.
class ExactArea {
 public:
  explicit ExactArea(Scene scene);

  const Scene& scene() const { return scene_; }
  void move(size_t point, Point to) { scene_.points[point] = to; }

  std::vector<double> picture() const;
  double pixel(int x, int y, const std::vector<int32_t>& faces) const;

  // Of sum(adjoint * picture) to each point, by what moving each border sweeps over.
  std::vector<Point> gradient(std::span<const double> adjoint) const;
  // Of one point, by central differences of the pixels that its faces reach; `step` in pixels.
  Point difference(std::span<const double> adjoint, size_t point, double step);

 private:
  struct Side {
    int32_t a, b;
  };
  // A face cut to the pixel: convex. `side` of the piece from each corner to the next: 3 * face + corner, or -1 for the
  // pixel's own.
  struct Cut {
    int32_t face;
    std::vector<Point> corner;
    std::vector<int32_t> side;
  };
  struct Sweep {  // what a pixel adds to the gradient of the ends of a side
    int32_t a, b;
    Point to_a, to_b;
  };
  Cut cut(int32_t face, int x, int y) const;
  double strips(const std::vector<Cut>& cuts, int x, int y, std::vector<Sweep>* sweeps) const;
  double strip(const std::vector<Cut>& cuts, double from, double to, std::vector<Sweep>* sweeps) const;
  double depth_at(int32_t face, Point p) const;
  double color_of(int32_t face) const { return scene_.color.empty() ? 1 : scene_.color[static_cast<size_t>(face)]; }
  std::vector<std::vector<int32_t>> faces_by_pixel() const;

  Scene scene_;
  std::vector<std::vector<int32_t>> faces_of_;  // of each point
};

}  // namespace dr::benchmark
