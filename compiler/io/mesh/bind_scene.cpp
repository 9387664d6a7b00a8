// SPDX-License-Identifier: Apache-2.0
// Selectors of a scene: KIND:PART gives one element for each object of a kind, KIND:WHICH:PART that of one object,
// which is named by its name or number.

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <numbers>

#include "compiler/io/file/failure.h"
#include "compiler/io/mesh/bind.h"
#include "compiler/io/mesh/gltf/document.h"
#include "compiler/io/mesh/mesh_readers.h"
#include "compiler/io/mesh/scene.h"
#include "compiler/io/picture/image.h"

namespace dr::io {
namespace {

using Words = std::span<const std::string_view>;
using Row = std::vector<double>;

constexpr double kDegrees = 180 / std::numbers::pi;

// Something that each object of a kind has: one element or, of a skin, several.
struct Part {
  std::string_view name;
  int components;
  std::function<Row(size_t)> row;
  bool whole = false;  // int
};

std::optional<size_t> number_of(std::string_view word) {
  size_t number = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
  if (word.empty() || error != std::errc() || end != word.data() + word.size()) return std::nullopt;
  return number;
}

// As "2: 'cap', 'sole'".
std::string count_and_names(const std::vector<std::string>& names) {
  constexpr size_t kMost = 8;
  std::string out = std::to_string(names.size()) + ":";
  for (size_t k = 0; k < std::min(names.size(), kMost); ++k) out += (k > 0 ? ", " : " ") + in_quotes(names[k]);
  return names.size() > kMost ? out + ", ..." : out;
}

// The object that `word` names.
size_t object_of(std::string_view kind, std::string_view word, const std::vector<std::string>& names) {
  if (names.empty()) fail("the file has no ", kind);
  if (const auto number = number_of(word)) {
    if (*number < names.size()) return *number;
    fail("there is no ", kind, " ", *number, ", the file has ", names.size(), ", counted from 0");
  }
  const auto found = std::ranges::find(names, word);
  if (found == names.end()) {
    const std::vector<std::string_view> candidates(names.begin(), names.end());
    fail("there is no ", kind, " named ", in_quotes(word), did_you_mean(word, candidates), ", the file has ",
         count_and_names(names), ", which are also named by their numbers from 0");
  }
  if (std::find(found + 1, names.end(), word) != names.end()) {
    fail("several are named ", in_quotes(word), ", take the number of the ", kind);
  }
  return static_cast<size_t>(found - names.begin());
}

std::string part_list(const std::vector<Part>& parts) {
  std::string list;
  for (const Part& part : parts) append(list, cat(list.empty() ? "" : ", ", "':", part.name, "'"));
  return list;
}

// A name of an object may hold colons, as those of rigs do.
std::string joined(Words words) {
  std::string name;
  for (const std::string_view word : words) append(name, cat(name.empty() ? "" : ":", word));
  return name;
}

// How many words the longest name among `names` has that they begin with; 1 where there is none.
size_t words_of_name(Words words, const std::vector<std::string>& names) {
  for (size_t n = words.size(); n > 1; --n)
    if (std::ranges::find(names, joined(words.first(n))) != names.end()) return n;
  return 1;
}

// KIND:PART or KIND:WHICH:PART.
Array bind_parts(std::string_view kind, Words words, const std::vector<std::string>& names,
                 const std::vector<Part>& parts) {
  if (words.empty()) {
    fail("a ", kind, " takes ':", kind, ":PART' for all or ':", kind, ":WHICH:PART' for one, where PART is of ",
         part_list(parts));
  }
  const std::string_view wanted = words.back();
  const auto part = std::ranges::find(parts, wanted, &Part::name);
  if (part == parts.end()) {
    std::vector<std::string_view> candidates;
    for (const Part& known : parts) candidates.push_back(known.name);
    fail("a ", kind, " has no part ", in_quotes(wanted), did_you_mean(wanted, candidates), ", it has ",
         part_list(parts));
  }
  if (names.empty()) fail("the file has no ", kind);
  Row values;
  const auto add = [&](size_t object) {
    const Row row = part->row(object);
    values.insert(values.end(), row.begin(), row.end());
  };
  if (words.size() > 1) {
    add(object_of(kind, joined(words.first(words.size() - 1)), names));
  } else {
    for (size_t i = 0; i < names.size(); ++i) add(i);
  }
  if (values.empty()) fail("the file has no ", kind, " with ", in_quotes(wanted));
  if (!part->whole) return Array::from_doubles(values, part->components);
  const std::vector<int32_t> whole(values.begin(), values.end());
  return Array::from_ints(whole, part->components);
}

template <class Values>
Row row_of(const Values& values) {
  return Row(values.begin(), values.end());
}

template <class Objects>
std::vector<std::string> names_of(const Objects& objects) {
  std::vector<std::string> names;
  for (const auto& object : objects) names.push_back(object.name);
  return names;
}

// Nodes of the scene that hold a camera or a lamp. Such an object is named as its node is, or else as it is itself.
template <class Objects>
struct Held {
  std::vector<const Scene::Node*> nodes;
  std::vector<std::string> names;

  Held(const Scene& scene, const Objects& objects, int Scene::Node::*held) {
    for (const Scene::Node& node : scene.nodes) {
      if (!node.placed || node.*held < 0) continue;
      nodes.push_back(&node);
      const std::string& own = objects[static_cast<size_t>(node.*held)].name;
      names.push_back(node.name.empty() ? own : node.name);
    }
  }
};

Row position_of(const Matrix& world) { return {world[12], world[13], world[14]}; }

// The unit vector along its own -z.
Row direction_of(const Matrix& world) {
  const double length = std::hypot(world[8], world[9], world[10]);
  if (!(length > 0)) fail("a node on the way to it is scaled to nothing, it has no direction");
  return {-world[8] / length, -world[9] / length, -world[10] / length};
}

Array bind_camera(const Scene& scene, Words words) {
  const Held held(scene, scene.cameras, &Scene::Node::camera);
  const auto camera = [&](size_t i) -> const Scene::Camera& {
    return scene.cameras[static_cast<size_t>(held.nodes[i]->camera)];
  };
  const auto given = [](const std::optional<double>& value, std::string_view what) {
    if (!value) fail("the camera has no ", what, " in the file");
    return *value;
  };
  const auto kind_is = [&](size_t i, bool perspective) -> const Scene::Camera& {
    if (camera(i).perspective != perspective) fail("camera ", i, " is ", perspective ? "orthographic" : "perspective");
    return camera(i);
  };
  return bind_parts(
      "camera", words, held.names,
      {{"view", 16, [&](size_t i) { return row_of(view_matrix(held.nodes[i]->world)); }},
       {"projection", 16,
        [&](size_t i) { return row_of(projection_matrix(camera(i), given(camera(i).aspect, "aspectRatio"))); }},
       {"pose", 16, [&](size_t i) { return row_of(held.nodes[i]->world); }},
       {"position", 3, [&](size_t i) { return position_of(held.nodes[i]->world); }},
       {"field_of_view", 1, [&](size_t i) { return Row{kind_is(i, true).field_of_view * kDegrees}; }},
       {"height", 1, [&](size_t i) { return Row{2 * kind_is(i, false).half_height}; }},
       {"aspect", 1, [&](size_t i) { return Row{given(camera(i).aspect, "aspectRatio")}; }},
       {"near", 1, [&](size_t i) { return Row{camera(i).near}; }},
       {"far", 1, [&](size_t i) { return Row{given(camera(i).far, "zfar")}; }}});
}

Array bind_light(const Scene& scene, Words words) {
  const Held held(scene, scene.lights, &Scene::Node::light);
  const auto light = [&](size_t i) -> const Scene::Light& {
    return scene.lights[static_cast<size_t>(held.nodes[i]->light)];
  };
  return bind_parts("light", words, held.names,
                    {{"kind", 1, [&](size_t i) { return Row{static_cast<double>(light(i).kind)}; }, true},
                     {"position", 3, [&](size_t i) { return position_of(held.nodes[i]->world); }},
                     {"direction", 3, [&](size_t i) { return direction_of(held.nodes[i]->world); }},
                     {"color", 3, [&](size_t i) { return row_of(light(i).color); }},
                     {"intensity", 1, [&](size_t i) { return Row{light(i).intensity}; }},
                     {"range", 1, [&](size_t i) { return Row{light(i).range.value_or(0)}; }},
                     {"inner_angle", 1, [&](size_t i) { return Row{light(i).inner_angle * kDegrees}; }},
                     {"outer_angle", 1, [&](size_t i) { return Row{light(i).outer_angle * kDegrees}; }}});
}

// Textures of materials: where they are used, and what they hold.
struct Slot {
  std::string_view name;
  Scene::TextureUse Scene::Material::*use;
  bool colour;             // sRGB, else numbers
  ImageChannels channels;  // of a part of a picture
};
constexpr Slot kSlots[] = {
    {"base_color_texture", &Scene::Material::base_color_texture, true, ImageChannels::AsStored},
    {"metallic_roughness_texture", &Scene::Material::metallic_roughness_texture, false, ImageChannels::AsStored},
    {"roughness_texture", &Scene::Material::metallic_roughness_texture, false, ImageChannels::G},
    {"metallic_texture", &Scene::Material::metallic_roughness_texture, false, ImageChannels::B},
    {"normal_texture", &Scene::Material::normal_texture, false, ImageChannels::Rgb},
    {"occlusion_texture", &Scene::Material::occlusion_texture, false, ImageChannels::R},
    {"emissive_texture", &Scene::Material::emissive_texture, true, ImageChannels::Rgb},
    {"specular_texture", &Scene::Material::specular_texture, false, ImageChannels::A},
    {"specular_color_texture", &Scene::Material::specular_color_texture, true, ImageChannels::Rgb},
};

Array decode_image(const gltf::Document& document, int index, const ImageOptions& options) {
  const auto at = static_cast<size_t>(index);
  const Bytes file = gltf::image_file(document, at);
  try {
    return to_array(decode_png_or_jpeg(file), options);
  } catch (const Failure& failure) {
    fail("images[", index, "]: ", failure.what());
  }
}

Array bind_slot(const gltf::Document& document, const Scene& scene, const Slot& slot, Words words, Words selectors,
                int expected) {
  std::vector<size_t> users;
  for (size_t i = 0; i < scene.materials.size(); ++i) {
    if ((scene.materials[i].*slot.use).texture >= 0) users.push_back(i);
  }
  size_t material = 0;
  if (!words.empty()) {
    material = object_of("material", joined(words), names_of(scene.materials));
  } else if (users.size() > 1) {
    fail(users.size(), " materials have a ", slot.name, ", say which: ':material:WHICH:", slot.name, "'");
  } else if (!users.empty()) {
    material = users.front();
  }
  const Scene::TextureUse use = scene.materials.empty() ? Scene::TextureUse{} : scene.materials[material].*slot.use;
  if (use.texture < 0) {
    if (!words.empty()) fail("the material has no ", slot.name);
    fail("no material has ", slot.name.starts_with('e') || slot.name.starts_with('o') ? "an " : "a ", slot.name);
  }
  const int image = scene.textures[static_cast<size_t>(use.texture)].image;
  if (image < 0) fail("textures[", use.texture, "] has no picture that is read ('source')");
  ImageOptions options{
      .channels = slot.channels, .raw = !slot.colour, .of_material = true, .expected_components = expected};
  // A colour is a colour where the picture stores grey, too.
  if (slot.channels == ImageChannels::AsStored && expected == 3) options.channels = ImageChannels::Rgb;
  if (slot.channels == ImageChannels::AsStored && expected == 4) options.channels = ImageChannels::Rgba;
  return decode_image(document, image, image_options(selectors, options));
}

Array bind_material(const gltf::Document& document, const Scene& scene, Words words, int expected) {
  for (size_t at = 0; at < words.size(); ++at) {
    const auto* slot = std::ranges::find(kSlots, words[at], &Slot::name);
    if (slot != std::end(kSlots)) {
      return bind_slot(document, scene, *slot, words.first(at), words.subspan(at + 1), expected);
    }
  }
  const auto material = [&](size_t i) -> const Scene::Material& { return scene.materials[i]; };
  const auto emissive = [&](size_t i) {
    Row row = row_of(material(i).emissive);
    for (double& value : row) value *= material(i).emissive_strength;
    return row;
  };
  std::vector<Part> parts = {
      {"base_color", 4, [&](size_t i) { return row_of(material(i).base_color); }},
      {"metallic", 1, [&](size_t i) { return Row{material(i).metallic}; }},
      {"roughness", 1, [&](size_t i) { return Row{material(i).roughness}; }},
      {"emissive", 3, emissive},
      {"ior", 1, [&](size_t i) { return Row{material(i).ior}; }},
      {"specular", 1, [&](size_t i) { return Row{material(i).specular}; }},
      {"specular_color", 3, [&](size_t i) { return row_of(material(i).specular_color); }},
      {"normal_scale", 1, [&](size_t i) { return Row{material(i).normal_texture.scale}; }},
      {"occlusion_strength", 1, [&](size_t i) { return Row{material(i).occlusion_texture.scale}; }},
      {"alpha_cutoff", 1, [&](size_t i) { return Row{material(i).alpha_cutoff}; }},
      {"alpha_mode", 1, [&](size_t i) { return Row{static_cast<double>(material(i).alpha)}; }, true},
      {"double_sided", 1, [&](size_t i) { return Row{material(i).double_sided ? 1.0 : 0.0}; }, true},
      {"unlit", 1, [&](size_t i) { return Row{material(i).unlit ? 1.0 : 0.0}; }, true}};
  // The number of each texture, for ':texture:...', and which texture coordinates it is looked up by, ':uv' or ':uv1'.
  // The pictures themselves are bound above, and named here so that a misspelled one is found, too.
  std::vector<std::string> number_names, uv_names;
  for (const Slot& slot : kSlots) {
    number_names.push_back(cat(slot.name, "_number"));
    uv_names.push_back(cat(slot.name, "_uv"));
  }
  for (size_t k = 0; k < uv_names.size(); ++k) {
    const Slot& slot = kSlots[k];
    const auto number = [&](size_t i) { return Row{double((material(i).*slot.use).texture)}; };
    parts.push_back({slot.name, 1, number, true});
    parts.push_back({number_names[k], 1, number, true});
    parts.push_back({uv_names[k], 1, [&](size_t i) { return Row{double((material(i).*slot.use).uv)}; }, true});
  }
  return bind_parts("material", words, names_of(scene.materials), parts);
}

Array bind_texture(const Scene& scene, Words words) {
  const auto texture = [&](size_t i) -> const Scene::Texture& { return scene.textures[i]; };
  const auto sampler = [&](size_t i) {
    const Scene::Texture& t = texture(i);
    return Row{double(t.mag_filter), double(t.min_filter), double(t.wrap_u), double(t.wrap_v)};
  };
  return bind_parts(
      "texture", words, names_of(scene.textures),
      {{"image", 1, [&](size_t i) { return Row{double(texture(i).image)}; }, true}, {"sampler", 4, sampler, true}});
}

Array bind_image(const gltf::Document& document, const Scene& scene, Words words, int expected) {
  if (words.empty()) fail("say which picture: ':image:WHICH', by its name or number");
  const size_t named = words_of_name(words, scene.images);
  const size_t image = object_of("image", joined(words.first(named)), scene.images);
  const ImageOptions options = image_options(words.subspan(named), {.expected_components = expected});
  return decode_image(document, static_cast<int>(image), options);
}

Row all_of(const std::vector<Matrix>& matrices) {
  Row row;
  for (const Matrix& m : matrices) row.insert(row.end(), m.begin(), m.end());
  return row;
}

std::vector<Matrix> rest_pose(const Scene& scene) {
  std::vector<Matrix> world;
  for (const Scene::Node& node : scene.nodes) world.push_back(node.world);
  return world;
}

Array bind_skin(const Scene& scene, Words words) {
  const auto joints = [&](size_t i) -> const std::vector<int>& { return scene.skins[i].joints; };
  const auto node = [&](int index) -> const Scene::Node& { return scene.nodes[static_cast<size_t>(index)]; };
  const auto pose = [&](size_t i) {
    std::vector<Matrix> out;
    for (const int joint : joints(i)) out.push_back(node(joint).world);
    return all_of(out);
  };
  // The joint of its skin that a joint hangs on, -1 if there is none, and the way there, or to the world, by nodes that
  // are no joints, too.
  struct Link {
    int parent = -1;
    Matrix way;
  };
  const auto link = [&](size_t i, int joint) {
    Matrix way = node(joint).local;
    for (int at = node(joint).parent; at >= 0; at = node(at).parent) {
      const auto found = std::ranges::find(joints(i), at);
      if (found != joints(i).end()) return Link{static_cast<int>(found - joints(i).begin()), way};
      way = product(node(at).local, way);
    }
    return Link{-1, way};
  };
  // Where all skins are asked for, joints count through all of them.
  const auto parents = [&](size_t i) {
    size_t first = 0;
    for (size_t k = 0; words.size() == 1 && k < i; ++k) first += joints(k).size();
    Row row;
    for (const int joint : joints(i)) {
      const int parent = link(i, joint).parent;
      row.push_back(parent < 0 ? -1.0 : static_cast<double>(first) + parent);
    }
    return row;
  };
  const auto ways = [&](size_t i) {
    std::vector<Matrix> out;
    for (const int joint : joints(i)) out.push_back(link(i, joint).way);
    return all_of(out);
  };
  return bind_parts(
      "skin", words, names_of(scene.skins),
      {{"inverse_bind", 16, [&](size_t i) { return all_of(scene.skins[i].inverse_bind); }},
       {"joint_matrices", 16, [&](size_t i) { return all_of(joint_matrices(scene, i, rest_pose(scene))); }},
       {"pose", 16, pose},
       {"local", 16, ways},
       {"parents", 1, parents, true}});
}

Array bind_node(const Scene& scene, Words words) {
  const auto node = [&](size_t i) -> const Scene::Node& { return scene.nodes[i]; };
  return bind_parts("node", words, names_of(scene.nodes),
                    {{"pose", 16, [&](size_t i) { return row_of(node(i).world); }},
                     {"local", 16, [&](size_t i) { return row_of(node(i).local); }},
                     {"position", 3, [&](size_t i) { return position_of(node(i).world); }},
                     {"parent", 1, [&](size_t i) { return Row{double(node(i).parent)}; }, true},
                     {"morph_weights", 1, [&](size_t i) { return node(i).morph_weights; }}});
}

// ":animation:WHICH:joint_matrices:FRAMES": a row for each frame, evenly spread from the first key to the last.
Array frames(const Scene& scene, size_t animation, std::string_view count_text) {
  constexpr size_t kMaxFrames = 4096;
  const auto count = number_of(count_text);
  if (!count || *count == 0 || *count > kMaxFrames) {
    fail("':joint_matrices:FRAMES' takes 1 to ", kMaxFrames, " frames, found ", in_quotes(count_text));
  }
  if (scene.skins.empty()) fail("the file has no skin");
  double first = std::numeric_limits<double>::infinity();
  double last = -first;
  for (const Scene::Channel& channel : scene.animations[animation].channels) {
    first = std::min(first, double{channel.times.front()});
    last = std::max(last, double{channel.times.back()});
  }
  Row values;
  for (size_t frame = 0; frame < *count; ++frame) {
    const double part = *count == 1 ? 0 : static_cast<double>(frame) / static_cast<double>(*count - 1);
    const std::vector<Matrix> world = pose_at(scene, animation, first + (last - first) * part);
    for (size_t skin = 0; skin < scene.skins.size(); ++skin) {
      const Row row = all_of(joint_matrices(scene, skin, world));
      if (values.size() + row.size() > (size_t{1} << 26)) fail("that is more than ", size_t{1} << 22, " matrices");
      values.insert(values.end(), row.begin(), row.end());
    }
  }
  return Array::from_doubles(values, 16, 0, static_cast<int64_t>(*count));
}

Array bind_animation(const Scene& scene, Words words) {
  if (words.size() < 3) {
    fail(
        "an animation takes ':animation:WHICH:joint_matrices:FRAMES', or ':animation:WHICH:CHANNEL:times' and "
        "':values', where CHANNEL is a number or NODE.PATH");
  }
  const std::vector<std::string> animations = names_of(scene.animations);
  const size_t named = words_of_name(words.first(words.size() - 2), animations);
  const size_t which = object_of("animation", joined(words.first(named)), animations);
  const std::string what = joined(words.subspan(named, words.size() - named - 1));
  const Scene::Animation& animation = scene.animations[which];
  if (animation.channels.empty()) fail("the animation has no channel that moves a node");
  if (what == "joint_matrices") return frames(scene, which, words.back());
  std::vector<std::string> names;
  for (const Scene::Channel& channel : animation.channels) {
    names.push_back(cat(scene.nodes[static_cast<size_t>(channel.node)].name, ".", channel.path));
  }
  const Scene::Channel& channel = animation.channels[object_of("channel", what, names)];
  if (words.back() == "times") return Array::from_floats(channel.times, 1);
  if (words.back() != "values") fail("a channel has ':times' and ':values', found ", in_quotes(words.back()));
  const int components = channel.path == "rotation" ? 4 : channel.path == "weights" ? 1 : 3;
  // A row for each key.
  return Array::from_floats(channel.values, components, 0, static_cast<int64_t>(channel.times.size()));
}

}  // namespace

Array bind_scene(const std::string& path, Words selectors, int expected_components) {
  const Bytes content = read_file(path);
  const gltf::Document document = gltf::load_document(content, path);
  const Scene scene = gltf::read_scene(document);
  const std::string_view kind = selectors.front();
  const Words words = selectors.subspan(1);
  if (kind == "animation") return bind_animation(scene, words);
  if (kind == "camera") return bind_camera(scene, words);
  if (kind == "image") return bind_image(document, scene, words, expected_components);
  if (kind == "light") return bind_light(scene, words);
  if (kind == "material") return bind_material(document, scene, words, expected_components);
  if (kind == "node") return bind_node(scene, words);
  if (kind == "skin") return bind_skin(scene, words);
  return bind_texture(scene, words);
}

}  // namespace dr::io
