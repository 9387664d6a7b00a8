// SPDX-License-Identifier: Apache-2.0
// Memory: what a program says that it holds is what it asked of the driver, and one that the device is too small for
// reads its inputs from the host's, with the same bits.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>

#include "runtime/jit/jit.h"
#include "runtime/jit/rebuild.h"
#include "runtime/runtime.h"
#include "runtime/vk/device.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using io::Array;
using runtime::Program;
using test::must;

namespace {

// Stands between a device and its driver, and counts.
class Driver {
 public:
  explicit Driver(const runtime::Device& device) : table_(const_cast<Table&>(*device.state()->device.getDispatcher())) {
    real_allocate = table_.vkAllocateMemory;
    real_free = table_.vkFreeMemory;
    now = peak = 0;
    sizes.clear();
    table_.vkAllocateMemory = allocate;
    table_.vkFreeMemory = release;
  }
  ~Driver() {
    table_.vkAllocateMemory = real_allocate;
    table_.vkFreeMemory = real_free;
  }
  static inline int64_t now, peak;

 private:
  using Table = std::remove_cvref_t<decltype(*std::declval<vk::raii::Device>().getDispatcher())>;
  static VkResult VKAPI_CALL allocate(VkDevice device, const VkMemoryAllocateInfo* info,
                                      const VkAllocationCallbacks* callbacks, VkDeviceMemory* memory) {
    const VkResult result = real_allocate(device, info, callbacks, memory);
    if (result == VK_SUCCESS) {
      sizes[*memory] = static_cast<int64_t>(info->allocationSize);
      now += sizes[*memory];
      peak = std::max(peak, now);
    }
    return result;
  }
  static void VKAPI_CALL release(VkDevice device, VkDeviceMemory memory, const VkAllocationCallbacks* callbacks) {
    now -= sizes[memory];
    sizes.erase(memory);
    real_free(device, memory, callbacks);
  }
  static inline PFN_vkAllocateMemory real_allocate;
  static inline PFN_vkFreeMemory real_free;
  static inline std::map<VkDeviceMemory, int64_t> sizes;
  Table& table_;
};

std::vector<uint8_t> compile_text(const std::string& text, const std::string& profile) {
  return test::compile_text("memory_test.dr", "edition 1;\n" + text, profile);
}

const char* const kProgram = R"(
  input photos : vec3[W, H, N];
  input mask : float[W, H];
  input view : float;
  param tone : vec3[W, H] = vec3(0.5);
  let seen = sin(exp(sin(photos) * view));
  let error = mean(dot(tone - seen, tone - seen) * mask);
  let blurred = shift(seen, 1, 0) + seen;
  step fit { tone <- tone - grad(error, tone); output error; }
  step look { output blurred; })";

constexpr int64_t kW = 64, kH = 48, kN = 6;

void bind_all(Program& p) {
  std::vector<float> photos(kW * kH * kN * 3), mask(kW * kH);
  for (size_t k = 0; k < photos.size(); ++k) photos[k] = static_cast<float>(k * 37 % 101) / 101;
  for (size_t k = 0; k < mask.size(); ++k) mask[k] = static_cast<float>(k % 3) / 2;
  must(p.bind("photos", Array::from_floats(photos, 3, kW, kH, kN)));
  must(p.bind("mask", Array::from_floats(mask, 1, kW, kH)));
  must(p.bind("view", Array::from_floats(std::vector<float>{1}, 1)));
}

void check_equal(const runtime::MemoryUse& use) {
  CHECK(use.device + use.host == Driver::now);
  CHECK(use.peak == Driver::peak);
}

}  // namespace

TEST_CASE("what is held is what was allocated") {
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const Driver driver(device);
    {
      const auto bundle = compile_text(kProgram, name);
      Program p = must(Program::load(device, bundle,
                                     {.rebuild = jit::rebuilder(bundle), .rebuild_after = 2, .rebuild_beside = false}));
      CHECK(p.memory_use().peak == 0);
      bind_all(p);
      must(p.run("fit", 2));
      check_equal(p.memory_use());
      CHECK(Driver::now > kW * kH * kN * 3 * 4);
      must(p.run("look"));
      check_equal(p.memory_use());
      must(p.output("look", "blurred"));
      check_equal(p.memory_use());
      for (int k = 0; k < 4; ++k) {
        must(p.bind("view", Array::from_floats(std::vector<float>{static_cast<float>(k)}, 1)));
        must(p.run("fit"));
      }
      check_equal(p.memory_use());
    }
    CHECK(Driver::now == 0);
  }
}

TEST_CASE("inputs that the device has no room for stay with the host") {
  constexpr int64_t kPhotos = kW * kH * kN * 3 * 4;
  for (const auto& [name, device] : test::devices()) {
    INFO(name);
    const auto bundle = compile_text(kProgram, name);
    Program all = must(Program::load(device, bundle));
    bind_all(all);
    must(all.run("fit", 3));
    CHECK(all.memory_use().host_leaves.empty());
    const int64_t whole = all.memory_use().device;

    Program less = must(Program::load(device, bundle, {.memory_limit = whole - kPhotos / 2}));
    bind_all(less);
    must(less.run("fit", 3));
    const auto use = less.memory_use();
    CHECK(use.host_leaves == std::vector<std::string>{"photos"});
    CHECK(use.device <= whole - kPhotos / 2);
    CHECK(use.host >= kPhotos);
    for (const char* leaf : {"tone", "photos"}) CHECK(must(less.leaf(leaf)).bytes == must(all.leaf(leaf)).bytes);
    CHECK(must(less.output("fit", "error")).bytes == must(all.output("fit", "error")).bytes);

    Program none = must(Program::load(device, bundle, {.memory_limit = 1000}));
    bind_all(none);
    const auto refused = none.run("look");
    REQUIRE_FALSE(refused);
    CHECK(refused.error().find("more than the limit of 1000; the largest values are ") != std::string::npos);
    CHECK(refused.error().find("photos (" + std::to_string(kPhotos) + ")") != std::string::npos);
    for (const std::string& message : device.validation_messages()) FAIL("validation: " << message);
  }
}
