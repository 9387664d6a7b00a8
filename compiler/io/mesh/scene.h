// SPDX-License-Identifier: Apache-2.0
// What a glTF file holds besides triangles: nodes, cameras, lamps, materials, textures, skins and animations, in plain
// structs. Matrices are in float64, column after column. A camera looks along its own -z, a lamp shines along its own
// -z.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/result.h"

namespace dr::io {

using Matrix = std::array<double, 16>;

struct Scene {
  // Numbers of other objects are places in the lists below, -1 stands for none.
  struct Node {
    std::string name;
    int parent = -1;
    Matrix local;
    Matrix world;
    bool placed = false;  // whether the default scene holds it
    int mesh = -1;
    int skin = -1;
    int camera = -1;
    int light = -1;
    std::vector<double> morph_weights;  // its own, else its mesh's
    // Translation, rotation (x y z w) and scale, which an animation replaces. Empty: the node has a matrix.
    std::vector<double> translation, rotation, scale;
  };

  struct Camera {
    std::string name;
    bool perspective = true;
    double field_of_view = 0;      // perspective: vertical, in radians
    std::optional<double> aspect;  // width / height; a perspective camera may leave it open
    double half_height = 0;        // orthographic: ymag
    double near = 0;
    std::optional<double> far;  // none: infinitely far
  };

  // KHR_lights_punctual.
  struct Light {
    enum class Kind : uint8_t { Directional, Point, Spot };
    std::string name;
    Kind kind = Kind::Point;
    std::array<double, 3> color = {1, 1, 1};  // linear
    double intensity = 1;                     // lux for a directional one, candela for the others
    std::optional<double> range;              // none: it reaches everywhere
    double inner_angle = 0;                   // of a spot, in radians from its axis
    double outer_angle = 0;
  };

  // Where a material uses a texture.
  struct TextureUse {
    int texture = -1;
    int uv = 0;        // TEXCOORD_n
    double scale = 1;  // of normals and of occlusion
  };

  // Metallic-roughness, with KHR_materials_{ior,specular,emissive_strength,unlit}.
  struct Material {
    std::string name;
    std::array<double, 4> base_color = {1, 1, 1, 1};
    double metallic = 1;
    double roughness = 1;
    std::array<double, 3> emissive = {0, 0, 0};  // before its strength
    double emissive_strength = 1;
    double ior = 1.5;
    double specular = 1;
    std::array<double, 3> specular_color = {1, 1, 1};
    double alpha_cutoff = 0.5;
    enum class Alpha : uint8_t { Opaque, Mask, Blend } alpha = Alpha::Opaque;
    bool double_sided = false;
    bool unlit = false;
    TextureUse base_color_texture, metallic_roughness_texture, normal_texture, occlusion_texture, emissive_texture,
        specular_texture, specular_color_texture;
  };

  struct Texture {
    std::string name;
    int image = -1;
    // As OpenGL numbers them; a filter of -1 is left to the viewer.
    int mag_filter = -1, min_filter = -1;
    int wrap_u = 10497, wrap_v = 10497;
  };

  struct Skin {
    std::string name;
    std::vector<int> joints;  // nodes
    std::vector<Matrix> inverse_bind;
    int skeleton = -1;
  };

  struct Channel {
    int node = -1;
    std::string path;           // translation, rotation, scale or weights
    std::string interpolation;  // LINEAR, STEP or CUBICSPLINE
    std::vector<float> times;   // in seconds, increasing
    // For each time as many as the path has: 3, 4 or one a morph target. CUBICSPLINE has three such groups for each
    // time: the tangent in, the value, the tangent out.
    std::vector<float> values;
  };
  struct Animation {
    std::string name;
    std::vector<Channel> channels;
  };

  std::vector<Node> nodes;
  std::vector<Camera> cameras;
  std::vector<Light> lights;
  std::vector<Material> materials;
  std::vector<Texture> textures;
  std::vector<std::string> images;  // their names
  std::vector<Skin> skins;
  std::vector<Animation> animations;
};

// Reads all of it but the triangles and the pictures.
Result<Scene> load_scene(const std::string& path);

// The world matrix of every node at a time of an animation; before its first and after its last time it stands still.
// Precondition: the scene is load_scene's and holds the animation.
// The way of `second` and then that of `first`, as matrices have it.
Matrix product(const Matrix& first, const Matrix& second);

std::vector<Matrix> pose_at(const Scene& scene, size_t animation, double time);

// For each joint of a skin, from the mesh at rest to the world. `world` is of each node, as in Scene or by pose_at.
std::vector<Matrix> joint_matrices(const Scene& scene, size_t skin, const std::vector<Matrix>& world);

// From the world to a camera that stands at `world`, and from there to this library's clip space (`std.camera`: y goes
// down, z from 0 to 1). The aspect must be known.
Matrix view_matrix(const Matrix& world);
Matrix projection_matrix(const Scene::Camera& camera, double aspect);

}  // namespace dr::io
