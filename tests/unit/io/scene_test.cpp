// SPDX-License-Identifier: Apache-2.0
// What a glTF scene holds besides triangles: read into structs, and bound by selectors.

#include "compiler/io/mesh/scene.h"

#include <cmath>
#include <filesystem>

#include "compiler/io/mesh/mesh.h"
#include "tests/catch.h"
#include "tests/unit/io/support.h"

namespace dr::io {
namespace {

using namespace test;

class Bound {
 public:
  Bound() { path_ = folder_.write("scene.glb", SceneFile().glb()); }
  // Of the file with other JSON in one place.
  Bound(std::string_view from, std::string_view to) { path_ = folder_.write("scene.glb", SceneFile().glb(from, to)); }

  Array array(std::string_view selector, int components = 0) const {
    const Result<Array> result = load_binding(path_ + ":" + std::string(selector), components);
    INFO(selector << ": " << (result.ok() ? std::string() : result.error()));
    REQUIRE(result.ok());
    return *result;
  }
  std::vector<double> operator()(std::string_view selector) const { return array(selector).to_doubles(); }
  std::string error(std::string_view selector, int components = 0) const {
    const Result<Array> result = load_binding(path_ + ":" + std::string(selector), components);
    REQUIRE_FALSE(result.ok());
    return replaced(result.error(), "cannot read '" + path_ + ":" + std::string(selector) + "': ", "");
  }
  const std::string& path() const { return path_; }

 private:
  TemporaryFolder folder_;
  std::string path_;
};

void check_near(const std::vector<double>& found, const std::vector<double>& expected) {
  REQUIRE(found.size() == expected.size());
  for (size_t i = 0; i < found.size(); ++i) {
    INFO("number " << i);
    CHECK(found[i] == Approx(expected[i]).margin(1e-6));
  }
}

TEST_CASE("a scene's attributes are bound", "[io][scene]") {
  const Bound bound;
  // A skinned vertex stays where its joints expect it.
  check_near(bound("position"), {0, 0, 0, 1, 0, 0, 0, 1, 0});
  check_near(bound("joints"), {0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0});
  check_near(bound("weights"), {1, 0, 0, 0, 0.5, 0.5, 0, 0, 1, 0, 0, 0});
  check_near(bound("uv1"), {0, 0, 1, 0, 0, 1});
  check_near(bound("tangent"), {1, 0, 0, -1, 1, 0, 0, -1, 1, 0, 0, -1});
  check_near(bound("materials"), {1});
  const Array morph = bound.array("morph:position", 3);
  CHECK(morph.width == 3);
  CHECK(morph.height == 1);
  check_near(morph.to_doubles(), {0, 0, 0, 0, 0, 2, 0, 0, 0});
  CHECK(bound("node:Body:morph_weights") == std::vector<double>{0.25});
}

TEST_CASE("cameras are bound as this library's matrices", "[io][scene]") {
  const Bound bound;
  // At (0, 1, 5), unturned; the scale of its node is not its own.
  check_near(bound("camera:view"), {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -1, -5, 1});
  check_near(bound("camera:Eye:position"), {0, 1, 5});
  check_near(bound("camera:0:field_of_view"), {60});
  check_near(bound("camera:aspect"), {1.5});
  // The numbers of std.camera.perspective(60, 1.5, 0.5, 50).
  const double f = std::sqrt(3.0);
  const double z = 50 / (0.5 - 50);
  check_near(bound("camera:projection"), {f / 1.5, 0, 0, 0, 0, -f, 0, 0, 0, 0, z, -1, 0, 0, 0.5 * z, 0});
  CHECK(bound.error("camera:height") == "camera 0 is perspective");
  CHECK(bound.error("camera:veiw").starts_with("a camera has no part 'veiw' (did you mean 'view'?), it has ':view', "));
  CHECK(bound.error("camera:Eyes:view") ==
        "there is no camera named 'Eyes' (did you mean 'Eye'?), the file has 1: 'Eye', which are also named by their "
        "numbers "
        "from 0");
  CHECK(bound.error("camera:1:view") == "there is no camera 1, the file has 1, counted from 0");
}

TEST_CASE("lamps are bound one by one or all together", "[io][scene]") {
  const Bound bound;
  check_near(bound("light:kind"), {2, 0});
  check_near(bound("light:Lamp:direction"), {0, -1, 0});
  check_near(bound("light:Sun:direction"), {0, 0, -1});
  check_near(bound("light:color"), {1, 0.5, 0, 1, 1, 1});
  check_near(bound("light:intensity"), {7, 1});
  check_near(bound("light:range"), {9, 0});
  check_near(bound("light:0:outer_angle"), {30});
  CHECK(bound.array("light:position", 3).width == 2);
}

TEST_CASE("materials and their textures are bound", "[io][scene]") {
  const Bound bound;
  check_near(bound("material:base_color"), {1, 1, 1, 1, 0.1, 0.2, 0.3, 0.4});
  check_near(bound("material:Metal:metallic"), {0.75});
  check_near(bound("material:roughness"), {1, 0.25});
  check_near(bound("material:1:emissive"), {0, 2, 4});
  check_near(bound("material:ior"), {1.5, 1.25});
  check_near(bound("material:specular"), {1, 0.5});
  check_near(bound("material:1:specular_color"), {1, 2, 3});
  check_near(bound("material:unlit"), {0, 1});
  check_near(bound("material:alpha_mode"), {0, 1});
  check_near(bound("material:double_sided"), {0, 1});
  check_near(bound("material:normal_scale"), {1, 0.5});
  // Colour is made linear, numbers are not; a part of a picture is picked by what it means.
  const double half = std::pow((128 / 255.0 + 0.055) / 1.055, 2.4);
  check_near(bound("material:base_color_texture"), {1, half, 0, 0, 0, 1});
  check_near(bound("material:Metal:base_color_texture:r"), {1, 0});
  check_near(bound("material:roughness_texture"), {128 / 255.0, 0});
  check_near(bound("material:metallic_texture"), {0, 1});
  check_near(bound("material:normal_texture"), {1, 128 / 255.0, 0, 0, 0, 1});
  CHECK(bound.array("material:base_color_texture", 4).components == 4);
  CHECK(bound("image:dots:raw") == bound("material:normal_texture"));
  check_near(bound("texture:sampler"), {9728, -1, 33071, 10497});
  CHECK(bound.error("material:0:base_color_texture") == "the material has no base_color_texture");
  CHECK(bound.error("material:occlusion_texture") == "no material has an occlusion_texture");
}

TEST_CASE("a mirror turns bitangents with all else", "[io][scene]") {
  const Bound bound(R"({"name": "Body", "mesh": 0, "skin": 0})", R"({"name": "Body", "mesh": 0, "scale": [1, -1, 1]})");
  check_near(bound("tangent"), {1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1});
  check_near(bound("normal"), {0, 0, 1, 0, 0, 1, 0, 0, 1});
}

TEST_CASE("a camera within unlike scales is turned and not skewed", "[io][scene]") {
  const std::string_view eye = R"("translation": [0, 0, 5], "scale": [2, 2, 2]})";
  const std::string_view root = R"("translation": [0, 1, 0], "children")";
  const std::string turned(R"("rotation": [0, 0, 0.3826834323650898, 0.9238795325112867]})");
  const TemporaryFolder folder;
  // As long as what it replaces: the file says how long its JSON is.
  const std::string json = replaced(SceneFile().glb(eye, turned), root, R"("scale":       [1, 2, 1], "children")");
  const Result<Array> view = load_binding(folder.write("a.glb", json) + ":camera:view", 0);
  REQUIRE(view.ok());
  const std::vector<double> m = view->to_doubles();
  std::vector<double> products;  // of columns, which are orthogonal and of length 1
  for (size_t a = 0; a < 3; ++a)
    for (size_t b = 0; b < 3; ++b)
      products.push_back(m[4 * a] * m[4 * b] + m[4 * a + 1] * m[4 * b + 1] + m[4 * a + 2] * m[4 * b + 2]);
  check_near(products, {1, 0, 0, 0, 1, 0, 0, 0, 1});
  CHECK(Bound(eye, R"("scale": [0, 0, 0]})").error("camera:view") ==
        "a node on the way to it is scaled to nothing, it looks nowhere");
}

TEST_CASE("names may hold colons and strokes", "[io][scene]") {
  check_near(Bound(R"("name": "Hip")", R"("name": "rig:Hips/left")")("node:rig:Hips/left:position"), {1, 1, 0});
  check_near(Bound(R"("name": "Metal")", R"("name": "a:b")")("material:a:b:metallic"), {0.75});
  const Bound walk(R"("name": "Walk")", R"("name": "rig:Walk")");
  check_near(walk("animation:rig:Walk:0:times"), {0, 2});
  check_near(walk("animation:rig:Walk:Knee.rotation:times"), {0, 2});
  CHECK(Bound(R"("name": "dots")", R"("name": "a:dots")").array("image:a:dots:r").components == 1);
}

TEST_CASE("what is not asked for may be of another kind", "[io][scene]") {
  // A part of lines beside triangles, and a part without joints beside one with them.
  constexpr std::string_view kFirst = R"("primitives": [{"material": 1,)";
  const Bound lines(kFirst, R"("primitives": [{"mode": 3, "attributes": {"POSITION": 0}}, {"material": 1,)");
  check_near(lines("indices"), {0, 1, 2});
  check_near(lines("lines:segments"), {0, 1, 1, 2});
  const Bound still(kFirst, R"("primitives": [{"attributes": {"POSITION": 0}}, {"material": 1,)");
  check_near(still("weights"), {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0.5, 0.5, 0, 0, 1, 0, 0, 0});
  CHECK(still.array("joints").width == 6);
  CHECK(still.array("morph:position", 3).width == 6);
  CHECK(still.error("color") == "meshes[0].primitives[0]: there is no COLOR_0");
  const Bound limp(R"("JOINTS_0": )", R"("_JOINTS": )");
  CHECK(limp.error("joints") == "meshes[0].primitives[0]: there is no JOINTS_0");
  CHECK(still.error("tangent") == "meshes[0].primitives[0]: there is no TANGENT");
}

TEST_CASE("vertices have the joints of their node's skin, four of them", "[io][scene]") {
  const Bound whole(R"("mesh": 0, "skin": 0)", R"("mesh": 0)");
  check_near(whole("weights"), std::vector<double>(12));
  check_near(whole("joints"), std::vector<double>(12));
  const Bound beyond(R"("joints": [4, 5], "inverseBindMatrices": 7)", R"("joints": [4])");
  CHECK(beyond.error("joints") ==
        "meshes[0].primitives[0].attributes.JOINTS_0: element 1 names joint 1, skins[0] has 1");
  const Bound more(R"("WEIGHTS_0": 3)", R"("WEIGHTS_0": 3, "JOINTS_1": 2, "WEIGHTS_1": 3)");
  CHECK(more.error("weights") ==
        "meshes[0].primitives[0].attributes.WEIGHTS_1: element 0 has more than four joints, of which four are read");
}

TEST_CASE("a material's textures say by which coordinates they are looked up", "[io][scene]") {
  const Bound bound(R"("baseColorTexture": {"index": 0})", R"("baseColorTexture": {"index": 0, "texCoord": 1})");
  check_near(bound("material:Metal:base_color_texture_uv"), {1});
  check_near(bound("material:Metal:normal_texture_uv"), {0});
  check_near(bound("material:Metal:base_color_texture_number"), {0});
  check_near(bound("material:Metal:emissive_texture_number"), {-1});
}

TEST_CASE("a right angle that is rounded to a float is one", "[io][scene]") {
  CHECK(Bound("0.5235987755982988", "1.5707963705062866").array("light:0:outer_angle").width == 1);
}

TEST_CASE("skins and animations are bound", "[io][scene]") {
  const Bound bound;
  const Array bind = bound.array("skin:inverse_bind", 16);
  CHECK(bind.width == 2);
  // At rest the joints stand where the inverse bind matrices come from: (1, 1, 0) and (1, 3, 0).
  const std::vector<double> rest = bound("skin:joint_matrices");
  for (size_t i = 0; i < 32; ++i) CHECK(rest[i] == Approx(i % 16 % 5 == 0 ? 1 : 0).margin(1e-6));
  check_near(bound("skin:parents"), {-1, 0});
  check_near(bound("animation:Walk:Knee.rotation:times"), {0, 2});
  CHECK(bound.array("animation:0:0:values", 4).height == 2);

  const Array frames = bound.array("animation:Walk:joint_matrices:3", 16);
  CHECK(frames.width == 2);
  CHECK(frames.height == 3);
  const std::vector<double> all = frames.to_doubles();
  CHECK(std::vector<double>(all.begin(), all.begin() + 32) == rest);
  // Half way the knee has turned by 45 degrees about (1, 3, 0).
  const double h = std::sqrt(0.5);
  check_near({all.begin() + 48, all.begin() + 64},
             {h, h, 0, 0, -h, h, 0, 0, 0, 0, 1, 0, 1 - h + 3 * h, 3 - h - 3 * h, 0, 1});
  CHECK(bound.error("animation:Walk:joint_matrices:0") == "':joint_matrices:FRAMES' takes 1 to 4096 frames, found '0'");
}

TEST_CASE("ways between joints lead by nodes that are none", "[io][scene]") {
  // The hip, which stands between, is no joint.
  const Bound bound(R"("joints": [4, 5])", R"("joints": [0, 5])");
  check_near(bound("skin:0:parents"), {-1, 0});
  check_near(bound("skin:0:local"), {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 1,  //
                                     1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 0, 1});
  // A root's way leads to the world, by the node above it.
  const std::vector<double> local = Bound()("skin:0:local");
  check_near({local.begin() + 12, local.begin() + 15}, {1, 1, 0});
  const Bound two(R"("skins": [{)", R"("skins": [{"joints": [4, 5]}, {)");
  check_near(two("skin:parents"), {-1, 0, -1, 2});
  check_near(two("skin:1:parents"), {-1, 0});
}

TEST_CASE("a time just before a float of a key is before the key", "[io][scene]") {
  Result<Scene> scene = load_scene(Bound().path());
  REQUIRE(scene.ok());
  Scene::Channel& knee = scene->animations[0].channels[0];
  knee.times = {0, 0.3F};  // which is more than 0.3
  REQUIRE(double{knee.times[1]} > 0.3);
  // Keys of any length are turns: a mixture of 0 and 90 degrees.
  for (float& x : knee.values) x *= 3;
  const Matrix end = pose_at(*scene, 0, 0.3)[5], half = pose_at(*scene, 0, 0.15)[5];
  check_near({end.begin(), end.begin() + 4}, {0, 1, 0, 0});
  check_near({half.begin(), half.begin() + 4}, {std::sqrt(0.5), std::sqrt(0.5), 0, 0});
  std::fill(knee.values.begin(), knee.values.begin() + 4, 0.0F);
  knee.values[3] = 0.1F;
  const Matrix unlike = pose_at(*scene, 0, 0.15)[5];
  check_near({unlike.begin(), unlike.begin() + 4}, {std::sqrt(0.5), std::sqrt(0.5), 0, 0});
}

TEST_CASE("a scene is read as structs", "[io][scene]") {
  const Bound bound;
  const Result<Scene> scene = load_scene(bound.path());
  REQUIRE(scene.ok());
  CHECK(scene->nodes.size() == 7);
  CHECK(scene->nodes[5].parent == 4);
  CHECK(scene->cameras[0].far == 50);
  CHECK(scene->lights[1].range == std::nullopt);
  CHECK(scene->materials[1].base_color_texture.texture == 0);
  CHECK(scene->animations[0].channels[0].values.size() == 8);
  CHECK(pose_at(*scene, 0, -5)[5] == scene->nodes[5].world);
}

TEST_CASE("wrong fields of a scene are named", "[io][scene][malformed]") {
  const SceneFile file;
  const TemporaryFolder folder;
  // What tinygltf would take for absent or drop.
  const auto error = [&](std::string_view from, std::string_view to) {
    const std::string path = folder.write("a.glb", file.glb(from, to));
    const Result<Scene> scene = load_scene(path);
    REQUIRE_FALSE(scene.ok());
    return replaced(scene.error(), "cannot read '" + path + "': ", "");
  };
  CHECK(error(R"("metallicFactor": 0.75)", R"("metallicFactor": "0.75")") ==
        "materials[1].pbrMetallicRoughness.metallicFactor: expected a number, found '\"0.75\"'");
  CHECK(error(R"("roughnessFactor": 0.25)", R"("roughnessFactor": 2)") ==
        "materials[1].pbrMetallicRoughness.roughnessFactor: 2 is not in 0 to 1");
  CHECK(error(R"("baseColorTexture": {"index": 0})", R"("baseColorTexture": {"index": 3})") ==
        "materials[1].pbrMetallicRoughness.baseColorTexture.index: there is no textures[3], the file has 1");
  CHECK(error(R"("emissiveFactor": [0, 0.5, 1])", R"("emissiveFactor": [0, 0.5])") ==
        "materials[1].emissiveFactor: expected 3 numbers, found 2");
  CHECK(error(R"("doubleSided": true)", R"("doubleSided": 1)") ==
        "materials[1].doubleSided: expected a boolean, found '1'");
  CHECK(error(R"("ior": 1.25)", R"("ior": 0.5)") ==
        "materials[1].extensions.KHR_materials_ior.ior: 0.5 is neither 0 nor 1 or more");
  CHECK(error(R"("light": 1)", R"("light": 2)") ==
        "nodes[6].extensions.KHR_lights_punctual.light: there is no lights[2], the file has 2");
  CHECK(error(R"("type": "spot")", R"("type": "area")") ==
        "extensions.KHR_lights_punctual.lights[0].type: 'area' is not one of directional, point, spot");
  CHECK(error(R"("znear": 0.5)", R"("znear": 0)") == "cameras[0].perspective.znear: 0 is not above 0");
  CHECK(error(R"("yfov": 1.0471975511965976, )", "") == "cameras[0].perspective: 'yfov' is missing");
  CHECK(error(R"("joints": [4, 5])", R"("joints": [4, 9])") == "skins[0].joints: there is no nodes[9], the file has 7");
  CHECK(error(R"("joints": [4, 5])", R"("joints": [4, 5, 1])") ==
        "skins[0].inverseBindMatrices: 2 matrices for 3 joints");
  CHECK(error(R"("path": "rotation")", R"("path": "rotate")") ==
        "animations[0].channels[0].target.path: 'rotate' is not one of translation, rotation, scale, weights, pointer");
  // An accessor of no view holds zeros.
  CHECK(error(R"("bufferView": 9, )", "") == "animations[0].samplers[0].output: key 0 is not a unit quaternion");
  CHECK(error(R"("path": "rotation")", R"("path": "scale")") ==
        "animations[0].samplers[0].output: 4 components, expected 3");
  CHECK(error(R"("sampler": 0, "target")", R"("sampler": 1, "target")") ==
        "animations[0].channels[0].sampler: there is no samplers[1], the animation has 1");
  CHECK(error(R"("magFilter": 9728)", R"("magFilter": 9729.5)") ==
        "samplers[0].magFilter: expected a non-negative integer, found '9729.5'");
  CHECK(error(R"("images": [{)", R"("images": [{"bufferView": 0, )") ==
        "images[0]: expected one of 'uri' and 'bufferView', found both");
  // A lamp's whole number may be written with a point.
  const std::string path = folder.write("b.glb", file.glb(R"("light": 1)", R"("light": 1.0)"));
  CHECK(load_scene(path).ok());
}

TEST_CASE("a picture of a scene stays in its folder", "[io][scene]") {
  const SceneFile file;
  const TemporaryFolder folder;
  const std::string png = png_file(2, 1, 8, 2, std::string("\0\xff\x80\0\0\0\xff", 7));
  const size_t begin = file.glb().find("data:image");
  const std::string uri = file.glb().substr(begin, file.glb().find('"', begin) - begin);
  folder.write("secret.png", png);
  folder.write("sub/own.png", png);
  const std::string out = folder.write("sub/a.glb", file.glb(uri, "../secret.png"));
  CHECK(load_binding(out + ":image:0").error() ==
        "cannot read '" + out + ":image:0': images[0].uri: '../secret.png' leads out of the folder of the glTF file");
  const std::string in = folder.write("sub/b.glb", file.glb(uri, "own.png"));
  CHECK(load_binding(in + ":image:0")->width == 2);
  // A picture that is not there costs only those who ask for it.
  const std::string none = folder.write("sub/c.glb", file.glb(uri, "none.png"));
  CHECK(load_binding(none + ":position").ok());
  CHECK_FALSE(load_binding(none + ":image:0").ok());
}

TEST_CASE("elements that stand for nothing are few", "[io][scene]") {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.glb", glb_file(R"({"asset": {"version": "2.0"},
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"componentType": 5126, "count": 16000000, "type": "VEC3",
      "sparse": {"count": 1, "indices": {"bufferView": 0, "componentType": 5121}, "values": {"bufferView": 0}}}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36}]})",
                                                          std::string(36, '\0')));
  CHECK(load_mesh(path).error() == "cannot read '" + path +
                                       "': accessors[0].count: 16000000 elements without a buffer view, more than the "
                                       "36 bytes of all buffers");
}

}  // namespace
}  // namespace dr::io
