// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/plan/show.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <vector>

#include "compiler/backend/plan/dependencies.h"
#include "compiler/backend/plan/plan_memory.h"
#include "compiler/ir/initial_step.h"

namespace dr::backend {
namespace {

using bundle::BundleT;

// "vec3[V]" as in the language; all resources of a bundle have scalars, vectors or matrices of floats.
std::string type_text(const bundle::TypeT& type, const bundle::ExtentT& extent) {
  const char* const prefixes[] = {"b", "i", "u", ""};
  const auto scalar = static_cast<size_t>(type.scalar);
  std::string out;
  if (type.cols > 1)
    out = "mat" + std::to_string(type.cols) + (type.cols == type.rows ? "" : "x" + std::to_string(type.rows));
  else if (type.rows > 1)
    out = std::string(prefixes[scalar]) + "vec" + std::to_string(type.rows);
  else
    out = bundle::word(bundle::EnumNamesScalar()[scalar]);
  std::string axes = extent.w;
  if (extent.h != "1" || extent.l != "1") axes += ", " + extent.h;
  if (extent.l != "1") axes += ", " + extent.l;
  return out + (axes == "1" ? "" : "[" + axes + "]");
}

class Inspector {
 public:
  explicit Inspector(const BundleT& bundle) : b_(bundle), lives_(lifetimes(bundle)) {}

  nlohmann::ordered_json json() const {
    using nlohmann::ordered_json;
    ordered_json root;
    root["version"] = b_.version;
    root["profile"] = b_.profile;
    root["lowering"] = lowering();
    root["float_profile"] = bundle::word(EnumNameFloatProfile(b_.float_profile));
    auto& features = root["features"] = ordered_json::array();
    for (const bundle::Feature feature : b_.features) features.push_back(bundle::word(EnumNameFeature(feature)));
    root["symbols"] = b_.symbols;
    root["files"] = b_.files;
    auto array = [&](const char* name) -> ordered_json& { return root[name] = ordered_json::array(); };
    auto& leaves = array("leaves");
    for (const auto& l : b_.leaves)
      leaves.push_back({{"name", l->name},
                        {"kind", bundle::word(EnumNameLeafKind(l->kind))},
                        {"type", type_text(*l->type, *l->extent)},
                        {"initial", l->initial}});
    auto& resources = array("resources");
    for (size_t k = 0; k < b_.resources.size(); ++k) {
      const bundle::ResourceT& r = *b_.resources[k];
      resources.push_back({{"name", r.name},
                           {"storage", bundle::word(EnumNameStorage(r.storage))},
                           {"role", bundle::word(EnumNameRole(r.role))},
                           {"type", type_text(*r.type, *r.extent)},
                           {"slot", r.slot},
                           {"alive", lifetime(k)}});
    }
    auto& steps = array("steps");
    for (const auto& s : b_.steps) {
      ordered_json step{{"name", s->name}, {"commands", commands(*s)}, {"outputs", ordered_json::array()}};
      for (const auto& o : s->outputs)
        step["outputs"].push_back({{"name", o->name}, {"resource", b_.resources[o->resource]->name}});
      steps.push_back(std::move(step));
    }
    auto& shaders = array("shaders");
    for (const auto& s : b_.shaders)
      shaders.push_back({{"name", s->name},
                         {"stage", bundle::word(EnumNameStage(s->stage))},
                         {"entry", "main"},
                         {"bytes", s->spirv.size() * 4}});
    return root;
  }

  nlohmann::ordered_json commands(const bundle::StepT& step) const {
    auto out = nlohmann::ordered_json::array();
    for (const auto& c : step.commands)
      out.push_back({{"kind", bundle::word(EnumNameCommandKind(c->kind))},
                     {"label", c->label},
                     {"ops", c->ops},
                     {"elements", elements(*c)},
                     {"shaders", shaders_of(*c)},
                     {"reads", names(*c, false)},
                     {"writes", names(*c, true)},
                     {"joins", c->joins},
                     {"steady", c->steady},
                     {"foresees", c->foresees},
                     {"leaves", leaves_of(*c)},
                     {"lines", lines(*c)}});
    return out;
  }

  std::string text() const {
    const nlohmann::ordered_json root = json();
    auto list = [](const nlohmann::ordered_json& items, const char* between = " ") {
      std::string out;
      for (const auto& item : items) out += (out.empty() ? "" : between) + item.get<std::string>();
      return out;
    };
    auto get = [](const nlohmann::ordered_json& item, const char* key) { return item[key].get<std::string>(); };
    std::string out = "bundle version " + std::to_string(b_.version) + ", profile " + b_.profile + ", " +
                      get(root, "float_profile") + ", " + lowering() + "\n";
    if (!b_.features.empty()) out += "features " + list(root["features"]) + "\n";
    out += "symbols " + list(root["symbols"]) + "\nleaves\n";
    for (const auto& l : root["leaves"]) {
      out += "  " + get(l, "kind") + " " + get(l, "name") + " : " + get(l, "type");
      if (!l["initial"].empty()) out += " = " + l["initial"].dump();
      out += "\n";
    }
    for (const auto& s : root["steps"]) {
      out += ir::step_title(get(s, "name")) + "\n";
      size_t index = 0;
      for (const auto& c : s["commands"]) {
        out += "  " + std::to_string(index++) + " " + get(c, "kind") + " " + get(c, "label");
        if (!get(c, "elements").empty()) out += " [" + get(c, "elements") + "]";
        out += "\n";
        if (!c["shaders"].empty()) out += "    shaders " + list(c["shaders"], ", ") + "\n";
        if (!c["reads"].empty()) out += "    reads " + list(c["reads"]) + "\n";
        if (!c["writes"].empty()) out += "    writes " + list(c["writes"]) + "\n";
        if (!c["lines"].empty()) out += "    from " + list(c["lines"]) + "\n";
      }
      for (const auto& o : s["outputs"]) out += "  output " + get(o, "name") + " = " + get(o, "resource") + "\n";
    }
    out += "memory\n";
    std::map<uint32_t, std::vector<size_t>> slots;
    for (size_t k = 0; k < b_.resources.size(); ++k) slots[b_.resources[k]->slot].push_back(k);
    for (const auto& [slot, members] : slots) {
      out += "  slot " + std::to_string(slot) + " " + get(root["resources"][members[0]], "storage") + "\n";
      for (size_t k : members) {
        const auto& r = root["resources"][k];
        out += "    " + get(r, "role") + " " + get(r, "name") + " : " + get(r, "type") + ", " + get(r, "alive") + "\n";
      }
    }
    out += "shaders\n";
    size_t index = 0;
    for (const auto& s : root["shaders"])
      out += "  " + std::to_string(index++) + " " + get(s, "stage") + " " + get(s, "name") + ", entry main, " +
             std::to_string(s["bytes"].get<size_t>()) + " bytes\n";
    return out;
  }

 private:
  std::string lowering() const {
    return bundle::word(EnumNamePacking(b_.packing)) + "," + bundle::word(EnumNameLowering(b_.lowering)) + "," +
           bundle::word(EnumNameRasterLowering(b_.raster));
  }
  std::string lifetime(size_t resource) const {
    const Lifetime& life = lives_[resource];
    if (!life.transient()) return "always";
    const std::string& step = b_.steps[static_cast<size_t>(life.step)]->name;
    return step + " " + std::to_string(life.first) + " to " + std::to_string(life.last);
  }
  std::string elements(const bundle::CommandT& c) const {
    if (c.kind == bundle::CommandKind::Reduce) return c.outs + " of " + c.count;
    if (c.extent && c.elements == "3") return c.extent->w + ", " + c.extent->h + ", " + c.extent->l;
    return c.elements;
  }
  std::vector<std::string> shaders_of(const bundle::CommandT& c) const {
    std::vector<std::string> out;
    for (int s : {c.compute, c.next, c.vertex, c.fragment})
      if (s >= 0)
        out.push_back(static_cast<size_t>(s) < b_.shaders.size() ? b_.shaders[static_cast<size_t>(s)]->name
                                                                 : std::to_string(s));
    return out;
  }
  std::vector<std::string> names(const bundle::CommandT& c, bool written) const {
    std::vector<std::string> out;
    for_each_access(c, [&](uint32_t r, bundle::Access access) {
      const bool has = access == bundle::Access::ReadWrite || (access == bundle::Access::Write) == written;
      const std::string& name = b_.resources[r]->name;
      if (has && std::ranges::find(out, name) == out.end()) out.push_back(name);
    });
    return out;
  }
  std::vector<std::string> leaves_of(const bundle::CommandT& c) const {
    std::vector<std::string> out;
    for (const uint32_t k : c.leaves) out.push_back(b_.leaves[k]->name);
    return out;
  }
  // "fit.dr:3" and "fit.dr:7-9".
  std::vector<std::string> lines(const bundle::CommandT& c) const {
    std::vector<std::string> out;
    for (size_t k = 0; k < c.lines.size();) {
      size_t end = k + 1;
      while (end < c.lines.size() && c.lines[end].file() == c.lines[k].file() &&
             c.lines[end].line() == c.lines[end - 1].line() + 1)
        ++end;
      std::string text = b_.files[c.lines[k].file()] + ":" + std::to_string(c.lines[k].line());
      if (end > k + 1) text += "-" + std::to_string(c.lines[end - 1].line());
      out.push_back(std::move(text));
      k = end;
    }
    return out;
  }

  const BundleT& b_;
  std::vector<Lifetime> lives_;
};

}  // namespace

std::string show(const bundle::BundleT& bundle) { return Inspector(bundle).text(); }
std::string show_commands(const bundle::BundleT& bundle, const bundle::StepT& step) {
  return Inspector(bundle).commands(step).dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}
std::string show_json(const bundle::BundleT& bundle) { return Inspector(bundle).json().dump(2) + "\n"; }

}  // namespace dr::backend
