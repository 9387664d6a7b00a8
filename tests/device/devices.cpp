// SPDX-License-Identifier: Apache-2.0
// Finding the software devices.
#include "tests/device/devices.h"

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>

#include "compiler/target/profile.h"
#include "tests/catch.h"

namespace dr::test {

std::vector<NamedDevice> devices() {
  const std::pair<const char*, const char*> known[] = {{"lavapipe", "DR_LAVAPIPE_ICD"},
                                                       {"swiftshader", "DR_SWIFTSHADER_ICD"}};
  std::vector<NamedDevice> out;
  for (const auto& [name, variable] : known) {
    const char* icd = std::getenv(variable);
    if (icd == nullptr) {
      if (std::getenv("CI") != nullptr) FAIL(std::string(variable) + " is not set: CI tests on every device");
      std::printf("%s is not set: tests on %s are left out\n", variable, name);
      continue;
    }
    // The loader reads this for each instance.
    setenv("VK_ICD_FILENAMES", icd, 1);
    setenv("VK_DRIVER_FILES", icd, 1);
    auto device = runtime::Device::open({name, true});
    if (!device) FAIL(std::string("cannot open ") + name + ": " + device.error());
    out.push_back({name, std::move(device).value()});
  }
  if (const char* wanted = std::getenv("DR_TEST_DEVICE")) {
    auto device = runtime::Device::open({wanted, false});
    if (!device) FAIL("cannot open " + std::string(wanted) + ": " + device.error());
    const std::string profile = device->profile_name();
    out.push_back({profile, std::move(device).value()});
  }
  return out;
}

std::string profile_of_subpasses(const std::string& device) {
  target::Profile profile = std::get<target::Profile>(target::load_profile(device));
  profile.costs.subpass_ns = 1;
  // Of this process alone: tests run beside each other.
  struct File {
    std::filesystem::path path;
    ~File() {
      std::error_code ignored;
      std::filesystem::remove(path, ignored);
    }
  };
  static std::map<std::string, File> files;
  File& file = files[device];
  file.path = std::filesystem::temp_directory_path() / (device + "_subpasses_" + std::to_string(getpid()) + ".json");
  std::ofstream(file.path) << target::write_profile(profile);
  return file.path.string();
}

}  // namespace dr::test
