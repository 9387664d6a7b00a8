// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/mesh/gltf/check.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "compiler/io/file/failure.h"
#include "compiler/io/file/file.h"
#include "compiler/io/mesh/gltf/fields.h"

namespace dr::io::gltf {
namespace {

class Checker {
 public:
  explicit Checker(Json& root) : root_(root) {}

  void run() {
    if (!root_.is_object()) fail("the root of the JSON is not an object");
    asset();
    extensions();
    each("buffers", [](Fields f) { buffer(f); });
    each("bufferViews", [&](Fields f) { buffer_view(f); });
    each("accessors", [&](Fields f) { accessor(f); });
    each("meshes", [&](Fields f) { mesh(f); });
    if (size("nodes") > kMaxNodes) fail("nodes: ", size("nodes"), " of them, the limit is ", kMaxNodes);
    lights_ = lights();
    each("nodes", [&](Fields f) { node(f); });
    each("scenes", [&](Fields f) { references(f, "nodes", "nodes"); });
    scene();
    each("samplers", [](Fields f) { sampler(f); });
    each("images", [&](Fields f) { image(f); });
    each("textures", [&](Fields f) {
      f.reference("sampler", "samplers", size("samplers"));
      f.reference("source", "images", size("images"));
    });
    each("materials", [&](Fields f) { material(f); });
    each("skins", [&](Fields f) { skin(f); });
    each("cameras", [](Fields f) { camera(f); });
    each("animations", [&](Fields f) { animation(f); });
  }

 private:
  // Lists at the root.

  Json* list(const char* key) { return Fields(root_, kRoot).list(key); }
  size_t size(const char* key) {
    const Json* items = list(key);
    return items ? items->size() : 0;
  }

  template <class Check>
  void each(const char* key, const Check& check) {
    Json* items = list(key);
    if (!items) return;
    const Where all = kRoot.at(key);
    items_of(*items, all, check);
  }

  template <class Check>
  static void items_of(Json& items, const Where& all, const Check& check) {
    for (size_t i = 0; i < items.size(); ++i) {
      const Where where = all.item(i);
      Fields fields(items[i], where);
      fields.text("name");
      check(fields);
    }
  }

  // The objects of the list `key` of another object.
  template <class Check>
  static void parts(const Fields& f, const char* key, const Check& check) {
    Json* items = f.list(key);
    if (!items) return;
    const Where all = f.where().at(key);
    items_of(*items, all, check);
  }

  // The object under `key`, if there is one.
  template <class Check>
  static bool part(const Fields& f, const char* key, const Check& check) {
    Json* value = f.find(key);
    if (!value) return false;
    const Where where = f.where().at(key);
    check(Fields(*value, where));
    return true;
  }

  template <class Check>
  static void extension(const Fields& f, const char* name, const Check& check) {
    part(f, "extensions", [&](const Fields& all) { part(all, name, check); });
  }

  void references(const Fields& f, const char* key, const char* of) {
    Json* items = f.list(key);
    if (!items) return;
    const Where where = f.where().at(key);
    for (Json& item : *items) check_reference(to_whole(item, where), of, size(of), where);
  }

  // The parts of the file.

  void asset() {
    const Fields root(root_, kRoot);
    root.require("asset");
    part(root, "asset", [](const Fields& f) {
      f.require("version");
      const std::string* version = f.text("version");
      if (!version->starts_with("2.")) fail("asset.version: ", in_quotes(*version), ", only 2.x is read");
      const std::string* least = f.text("minVersion");
      if (least && *least != "2.0") fail("asset.minVersion: ", in_quotes(*least), ", only 2.0 is read");
    });
  }

  void extensions() {
    // Those that are read, and those that change looks, not triangles.
    constexpr std::string_view kHarmless[] = {"KHR_materials_", "KHR_lights_punctual",   "KHR_texture_basisu",
                                              "KHR_xmp",        "KHR_animation_pointer", "EXT_texture_"};
    for (const char* key : {"extensionsUsed", "extensionsRequired"}) {
      const Json* names = list(key);
      if (!names) continue;
      for (const Json& name : *names) {
        if (!name.is_string()) fail(key, ": expected strings, found ", found(name));
        const auto& text = name.get_ref<const std::string&>();
        const bool harmless = std::any_of(std::begin(kHarmless), std::end(kHarmless),
                                          [&](std::string_view prefix) { return text.starts_with(prefix); });
        if (!harmless && names == list("extensionsRequired")) {
          fail("it requires the extension ", in_quotes(text), ", which is not read");
        }
      }
    }
  }

  void scene() {
    Json* value = Fields(root_, kRoot).find("scene");
    if (!value) return;
    const Where named = kRoot.at("the file.scene");
    check_reference(to_whole(*value, named), "scenes", size("scenes"), kRoot.at("scene"));
  }

  static void buffer(const Fields& f) {
    f.required_whole("byteLength", 1, kMaxFileBytes);
    f.text("uri");
  }

  void buffer_view(const Fields& f) {
    f.require("buffer");
    const uint64_t index = *f.reference("buffer", "buffers", size("buffers"));
    const uint64_t offset = f.whole("byteOffset").value_or(0);
    const uint64_t length = f.required_whole("byteLength", 1);
    const auto stride = f.whole("byteStride", 4, 252);
    if (stride && *stride % 4 != 0) {
      fail(f.where().at("byteStride").text(), ": ", *stride, " is not a multiple of 4");
    }
    constexpr uint64_t kTargets[] = {34962, 34963};
    f.code("target", kTargets);
    const auto room = (*list("buffers"))[static_cast<size_t>(index)]["byteLength"].get<uint64_t>();
    if (offset > room || length > room - offset) {
      fail(f.where().text(), ": ", length, " bytes from byte ", offset, " do not fit the buffer of ", room);
    }
  }

  void accessor(const Fields& f) {
    constexpr uint64_t kTypes[] = {kByte, kUByte, kShort, kUShort, kUInt, kFloat};
    constexpr std::string_view kForms[] = {"SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"};
    f.reference("bufferView", "bufferViews", size("bufferViews"));
    f.whole("byteOffset");
    f.require("componentType");
    f.code("componentType", kTypes);
    f.boolean("normalized");
    const uint64_t count = f.required_whole("count", 1);
    f.require("type");
    const std::string* form = f.text("type");
    if (std::ranges::find(kForms, *form) == std::end(kForms)) {
      fail(f.where().at("type").text(), ": ", in_quotes(*form), " is not an accessor type");
    }
    f.numbers("min", 0, -kAny, kAny);
    f.numbers("max", 0, -kAny, kAny);
    part(f, "sparse", [&](const Fields& s) { substitution(s, count); });
  }

  void substitution(const Fields& f, uint64_t elements) {
    constexpr uint64_t kTypes[] = {kUByte, kUShort, kUInt};
    // Offsets that tinygltf holds in 32 bits; no buffer is longer.
    const auto place = [&](const Fields& p) {
      p.require("bufferView");
      p.reference("bufferView", "bufferViews", size("bufferViews"));
      p.whole("byteOffset", 0, kMaxFileBytes);
    };
    const uint64_t count = f.required_whole("count");
    if (count == 0 || count > elements) {
      fail(f.where().at("count").text(), ": ", count, " is not in 1 to the accessor's ", elements);
    }
    if (count > kMaxFileBytes) fail(f.where().at("count").text(), ": ", count, " is over the limit of ", kMaxFileBytes);
    f.require("indices");
    f.require("values");
    part(f, "indices", [&](const Fields& indices) {
      place(indices);
      indices.require("componentType");
      indices.code("componentType", kTypes);
    });
    part(f, "values", place);
  }

  // Attributes by name, each the index of an accessor.
  void attributes(const Fields& f, Json& all) {
    if (!all.is_object()) fail(f.where().text(), ": expected an object, found ", found(all));
    for (auto it = all.begin(); it != all.end(); ++it) {
      const Where where = f.where().at(it.key());
      check_reference(to_whole(it.value(), where), "accessors", size("accessors"), where);
    }
  }

  void mesh(const Fields& f) {
    f.numbers("weights", 0, -kAny, kAny);
    const Json* primitives = f.list("primitives");
    if (!primitives || primitives->empty()) fail(f.where().text(), ": it has no primitives");
    parts(f, "primitives", [&](const Fields& p) {
      const uint64_t mode = p.whole("mode").value_or(kTriangles);
      if (mode > kFan) fail(p.where().at("mode").text(), ": ", mode, " is not in 0 to 6");
      p.require("attributes");
      part(p, "attributes", [&](const Fields& a) { attributes(a, *p.find("attributes")); });
      const auto indices = p.reference("indices", "accessors", size("accessors"));
      if (indices && !(*list("accessors"))[static_cast<size_t>(*indices)].contains("bufferView")) {
        fail(p.where().at("indices").text(), ": accessors[", *indices, "] has no 'bufferView'");
      }
      p.reference("material", "materials", size("materials"));
      Json* targets = p.list("targets");
      for (size_t i = 0; targets && i < targets->size(); ++i) {
        const Where all = p.where().at("targets");
        const Where where = all.item(i);
        attributes(Fields((*targets)[i], where), (*targets)[i]);
      }
    });
  }

  void node(const Fields& f) {
    f.reference("mesh", "meshes", size("meshes"));
    f.reference("skin", "skins", size("skins"));
    f.reference("camera", "cameras", size("cameras"));
    references(f, "children", "nodes");
    f.numbers("matrix", 16, -kAny, kAny);
    f.numbers("translation", 3, -kAny, kAny);
    f.numbers("scale", 3, -kAny, kAny);
    f.numbers("rotation", 4, -kAny, kAny);
    f.numbers("weights", 0, -kAny, kAny);
    if (const Json* m = f.find("matrix")) {
      for (const auto& [at, value] : {std::pair{3, 0}, {7, 0}, {11, 0}, {15, 1}}) {
        if ((*m)[static_cast<size_t>(at)] != value) {
          fail(f.where().at("matrix").text(), ": the last row is not 0 0 0 1");
        }
      }
    }
    if (const Json* q = f.find("rotation")) {
      double square = 0;
      for (const Json& part : *q) square += part.get<double>() * part.get<double>();
      if (!(square > 1e-12) || !std::isfinite(square)) {
        fail(f.where().at("rotation").text(), ": not a unit quaternion");
      }
    }
    extension(f, "KHR_lights_punctual", [&](const Fields& e) {
      e.require("light");
      e.reference("light", "lights", lights_);
    });
  }

  // Returns how many there are.
  size_t lights() {
    size_t count = 0;
    extension(Fields(root_, kRoot), "KHR_lights_punctual", [&](const Fields& e) {
      constexpr std::string_view kKinds[] = {"directional", "point", "spot"};
      parts(e, "lights", [&](const Fields& f) {
        ++count;
        f.require("type");
        const bool spot = *f.choice("type", kKinds) == "spot";
        f.numbers("color", 3, 0, kAny);
        f.number("intensity", 0, kAny);
        f.number("range", kAboveZero, kAny);
        const bool has_cone = part(f, "spot", [](const Fields& s) {
          // Rounded to a float, a right angle is a little more.
          constexpr double kWidest = kRightAngle * (1 + 1e-7);
          const double inner = s.number("innerConeAngle", 0, kWidest).value_or(0);
          const double outer = s.number("outerConeAngle", 0, kWidest).value_or(kRightAngle / 2);
          if (inner >= outer)
            fail(s.where().text(), ": innerConeAngle ", inner, " is not below outerConeAngle ", outer);
        });
        if (spot && !has_cone) f.require("spot");
      });
    });
    return count;
  }

  static void sampler(const Fields& f) {
    constexpr uint64_t kMag[] = {9728, 9729};
    constexpr uint64_t kMin[] = {9728, 9729, 9984, 9985, 9986, 9987};
    constexpr uint64_t kWrap[] = {33071, 33648, 10497};
    f.code("magFilter", kMag);
    f.code("minFilter", kMin);
    f.code("wrapS", kWrap);
    f.code("wrapT", kWrap);
  }

  void image(const Fields& f) {
    const bool view = f.reference("bufferView", "bufferViews", size("bufferViews")).has_value();
    const bool uri = f.text("uri") != nullptr;
    f.text("mimeType");
    if (view == uri) fail(f.where().text(), ": expected one of 'uri' and 'bufferView', found ", view ? "both" : "none");
  }

  // A texture's use under `key`, with a factor of its own.
  void texture(const Fields& f, const char* key, const char* factor = nullptr) {
    part(f, key, [&](const Fields& t) {
      t.require("index");
      t.reference("index", "textures", size("textures"));
      t.whole("texCoord", 0, 15);
      if (factor) t.number(factor, -kAny, kAny);
    });
  }

  void material(const Fields& f) {
    constexpr std::string_view kModes[] = {"OPAQUE", "MASK", "BLEND"};
    part(f, "pbrMetallicRoughness", [&](const Fields& p) {
      p.numbers("baseColorFactor", 4, 0, 1);
      p.number("metallicFactor", 0, 1);
      p.number("roughnessFactor", 0, 1);
      texture(p, "baseColorTexture");
      texture(p, "metallicRoughnessTexture");
    });
    texture(f, "normalTexture", "scale");
    texture(f, "occlusionTexture", "strength");
    texture(f, "emissiveTexture");
    f.numbers("emissiveFactor", 3, 0, 1);
    f.choice("alphaMode", kModes);
    f.number("alphaCutoff", 0, kAny);
    f.boolean("doubleSided");
    extension(f, "KHR_materials_ior", [](const Fields& e) {
      const double ior = e.number("ior", 0, kAny).value_or(1.5);
      if (ior != 0 && ior < 1) fail(e.where().at("ior").text(), ": ", ior, " is neither 0 nor 1 or more");
    });
    extension(f, "KHR_materials_specular", [&](const Fields& e) {
      e.number("specularFactor", 0, 1);
      e.numbers("specularColorFactor", 3, 0, kAny);
      texture(e, "specularTexture");
      texture(e, "specularColorTexture");
    });
    extension(f, "KHR_materials_emissive_strength", [](const Fields& e) { e.number("emissiveStrength", 0, kAny); });
    extension(f, "KHR_materials_unlit", [](const Fields&) {});
  }

  void skin(const Fields& f) {
    f.reference("inverseBindMatrices", "accessors", size("accessors"));
    f.reference("skeleton", "nodes", size("nodes"));
    const Json* joints = f.list("joints");
    if (!joints || joints->empty()) fail(f.where().text(), ": it has no joints");
    references(f, "joints", "nodes");
  }

  static void camera(const Fields& f) {
    constexpr std::string_view kKinds[] = {"perspective", "orthographic"};
    f.require("type");
    const std::string kind = *f.choice("type", kKinds);
    f.require(kind.c_str());
    part(f, "perspective", [](const Fields& p) {
      for (const char* key : {"yfov", "znear"}) p.require(key);
      p.number("yfov", kAboveZero, 2 * kRightAngle);
      p.number("aspectRatio", kAboveZero, kAny);
      const double near = *p.number("znear", kAboveZero, kAny);
      const auto far = p.number("zfar", kAboveZero, kAny);
      if (far && *far <= near) fail(p.where().text(), ": zfar ", *far, " is not above znear ", near);
    });
    part(f, "orthographic", [](const Fields& o) {
      for (const char* key : {"xmag", "ymag", "zfar", "znear"}) o.require(key);
      o.number("xmag", kAboveZero, kAny);
      o.number("ymag", kAboveZero, kAny);
      const double near = *o.number("znear", 0, kAny);
      const double far = *o.number("zfar", kAboveZero, kAny);
      if (far <= near) fail(o.where().text(), ": zfar ", far, " is not above znear ", near);
    });
  }

  void animation(const Fields& f) {
    constexpr std::string_view kPaths[] = {"translation", "rotation", "scale", "weights", "pointer"};
    constexpr std::string_view kInterpolations[] = {"LINEAR", "STEP", "CUBICSPLINE"};
    f.require("samplers");
    f.require("channels");
    parts(f, "samplers", [&](const Fields& s) {
      for (const char* key : {"input", "output"}) {
        s.require(key);
        s.reference(key, "accessors", size("accessors"));
      }
      s.choice("interpolation", kInterpolations);
    });
    const Json* samplers = f.list("samplers");
    parts(f, "channels", [&](const Fields& c) {
      const uint64_t sampler = c.required_whole("sampler");
      if (sampler >= samplers->size()) {
        fail(c.where().at("sampler").text(), ": there is no samplers[", sampler, "], the animation has ",
             samplers->size());
      }
      c.require("target");
      part(c, "target", [&](const Fields& t) {
        t.reference("node", "nodes", size("nodes"));
        t.require("path");
        t.choice("path", kPaths);
      });
    });
  }

  static constexpr double kRightAngle = 1.5707963267948966;

  Json& root_;
  const Where kRoot;
  size_t lights_ = 0;
};

}  // namespace

void check_document(Json& root) { Checker(root).run(); }

}  // namespace dr::io::gltf
