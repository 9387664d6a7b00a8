// SPDX-License-Identifier: Apache-2.0
// Instance, device choice and features.
#include "runtime/vk/device.h"

#include <algorithm>
#include <cctype>

#include "runtime/vk/cuda.h"

namespace dr::runtime {

namespace {

std::string lower_case(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                                          const VkDebugUtilsMessengerCallbackDataEXT* data, void* user) {
  auto* state = static_cast<DeviceState*>(user);
  const std::lock_guard lock(state->messages_lock);
  state->messages.emplace_back(data->pMessage);
  return VK_FALSE;
}

// Vulkan-Hpp allocates the table of an object's calls when the object is there already: where that fails, nobody else
// destroys it.
template <class Object, class From, class Handle>
Object owned(const From& from, Handle handle, PFN_vkVoidFunction destroy) {
  try {
    return Object(from, handle);
  } catch (...) {
    reinterpret_cast<void(VKAPI_PTR*)(Handle, const VkAllocationCallbacks*)>(destroy)(handle, nullptr);
    throw;
  }
}

void expect_success(VkResult result, const char* call) {
  if (result != VK_SUCCESS) throw vk::SystemError(make_error_code(static_cast<vk::Result>(result)), call);
}

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";

void make_instance(DeviceState& state, bool validation) {
  vk::ApplicationInfo application;
  application.pApplicationName = "dressi";
  application.apiVersion = VK_API_VERSION_1_1;
  vk::InstanceCreateInfo info;
  info.pApplicationInfo = &application;
  std::vector<const char*> layers, extensions;
  const auto have = state.context.enumerateInstanceLayerProperties();
  auto has_layer = [&](const char* name) {
    return std::any_of(have.begin(), have.end(),
                       [&](const auto& l) { return std::string_view(l.layerName.data()) == name; });
  };
  const vk::ValidationFeatureEnableEXT enabled[] = {vk::ValidationFeatureEnableEXT::eSynchronizationValidation};
  vk::ValidationFeaturesEXT features;
  features.setEnabledValidationFeatures(enabled);
  // Names of objects and labels of commands, for the validation layer and for capture tools. The loader offers the
  // extension where nobody listens, too: names are given once an object, labels once a recording.
  const auto offered = state.context.enumerateInstanceExtensionProperties();
  const bool offers_names = std::any_of(offered.begin(), offered.end(), [](const auto& e) {
    return std::string_view(e.extensionName.data()) == VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
  });
  if (validation || offers_names) {
    extensions.push_back(VK_EXT_DEBUG_UTILS_EXTENSION_NAME);
    state.debug_names = true;
  }
  if (validation) {
    if (!has_layer(kValidationLayer))
      throw DeviceFailure{"the Vulkan validation layer is not installed (Debian: vulkan-validationlayers)"};
    layers.push_back(kValidationLayer);
    info.pNext = &features;
  }
  info.setPEnabledLayerNames(layers);
  info.setPEnabledExtensionNames(extensions);
  VkInstance instance = VK_NULL_HANDLE;
  const auto& calls = *state.context.getDispatcher();
  const VkResult made =
      calls.vkCreateInstance(reinterpret_cast<const VkInstanceCreateInfo*>(&info), nullptr, &instance);
  if (made == VK_ERROR_INCOMPATIBLE_DRIVER)
    throw DeviceFailure{
        "there is no Vulkan driver (Debian: mesa-vulkan-drivers), or VK_DRIVER_FILES or VK_ICD_FILENAMES names none"};
  expect_success(made, "vkCreateInstance");
  state.instance =
      owned<vk::raii::Instance>(state.context, instance, calls.vkGetInstanceProcAddr(instance, "vkDestroyInstance"));
  if (validation) {
    vk::DebugUtilsMessengerCreateInfoEXT messenger;
    messenger.messageSeverity =
        vk::DebugUtilsMessageSeverityFlagBitsEXT::eError | vk::DebugUtilsMessageSeverityFlagBitsEXT::eWarning;
    messenger.messageType = vk::DebugUtilsMessageTypeFlagBitsEXT::eValidation;
    messenger.pfnUserCallback = on_message;
    messenger.pUserData = &state;
    state.messenger = vk::raii::DebugUtilsMessengerEXT(state.instance, messenger);
  }
}

std::string version_text(uint32_t v) {
  return std::to_string(VK_API_VERSION_MAJOR(v)) + "." + std::to_string(VK_API_VERSION_MINOR(v)) + "." +
         std::to_string(VK_API_VERSION_PATCH(v));
}

// The driver's name and version in its own words, "llvmpipe Mesa 22.3.6 (LLVM 15.0.6)"; where those are missing, its
// number, whose parts mean something else with each vendor.
std::string driver_text(const vk::raii::PhysicalDevice& device) {
  std::string number = version_text(device.getProperties().driverVersion);
  for (const vk::ExtensionProperties& extension : device.enumerateDeviceExtensionProperties()) {
    if (std::string_view(extension.extensionName.data()) != VK_KHR_DRIVER_PROPERTIES_EXTENSION_NAME) continue;
    const auto chain = device.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceDriverProperties>();
    const auto& driver = chain.get<vk::PhysicalDeviceDriverProperties>();
    const std::string version = driver.driverInfo.data();
    return std::string(driver.driverName.data()) + " " + (version.empty() ? number : version);
  }
  return number;
}

DeviceInfo describe(const vk::raii::PhysicalDevice& device) {
  const vk::PhysicalDeviceProperties p = device.getProperties();
  DeviceInfo info;
  info.name = p.deviceName.data();
  switch (p.deviceType) {
    case vk::PhysicalDeviceType::eCpu: info.kind = "cpu"; break;
    case vk::PhysicalDeviceType::eDiscreteGpu: info.kind = "discrete gpu"; break;
    case vk::PhysicalDeviceType::eIntegratedGpu: info.kind = "integrated gpu"; break;
    case vk::PhysicalDeviceType::eVirtualGpu: info.kind = "virtual gpu"; break;
    case vk::PhysicalDeviceType::eOther: info.kind = "other"; break;
  }
  info.api_version = version_text(p.apiVersion);
  info.driver = driver_text(device);
  return info;
}

bool matches(const DeviceInfo& info, size_t number, const std::string& wanted) {
  if (wanted.empty() || wanted == std::to_string(number)) return true;
  const std::string name = lower_case(info.name), want = lower_case(wanted);
  return name.find(want) != std::string::npos || (want == "lavapipe" && name.find("llvmpipe") != std::string::npos);
}

// Names what sharing memory and semaphores with CUDA takes, where the device is NVIDIA's and has all of it.
void share_with_cuda(DeviceState& state, const std::vector<vk::ExtensionProperties>& offered,
                     std::vector<const char*>& extensions) {
  constexpr uint32_t kNvidia = 0x10de;
  if (state.properties.vendorID != kNvidia) return;
  const auto wanted = {VK_KHR_EXTERNAL_MEMORY_FD_EXTENSION_NAME, VK_KHR_EXTERNAL_SEMAPHORE_FD_EXTENSION_NAME,
                       VK_KHR_TIMELINE_SEMAPHORE_EXTENSION_NAME};
  for (const std::string_view name : wanted)
    if (std::ranges::none_of(offered, [&](const auto& e) { return name == e.extensionName.data(); })) return;
  if (!state.physical.getFeatures2<vk::PhysicalDeviceFeatures2, vk::PhysicalDeviceTimelineSemaphoreFeatures>()
           .get<vk::PhysicalDeviceTimelineSemaphoreFeatures>()
           .timelineSemaphore)
    return;
  extensions.insert(extensions.end(), wanted.begin(), wanted.end());
  state.uuid = state.physical.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceIDProperties>()
                   .get<vk::PhysicalDeviceIDProperties>()
                   .deviceUUID;
  state.shares_memory = true;
}

}  // namespace

bool DeviceState::is_host_memory(uint32_t type) const {
  const auto direct = vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
  return properties.deviceType == vk::PhysicalDeviceType::eCpu &&
         (memory.memoryTypes[type].propertyFlags & direct) == direct;
}

uint32_t DeviceState::memory_type(uint32_t allowed, vk::MemoryPropertyFlags wanted,
                                  vk::MemoryPropertyFlags preferred) const {
  for (const vk::MemoryPropertyFlags flags : {wanted | preferred, wanted})
    for (uint32_t t = 0; t < memory.memoryTypeCount; ++t)
      if ((allowed & (1u << t)) != 0 && (memory.memoryTypes[t].propertyFlags & flags) == flags) return t;
  throw DeviceFailure{"the device offers no memory of the kind " + vk::to_string(wanted)};
}

bool DeviceState::has_lazy_memory(uint32_t allowed) const {
  for (uint32_t t = 0; t < memory.memoryTypeCount; ++t)
    if ((allowed & (1u << t)) != 0 &&
        (memory.memoryTypes[t].propertyFlags & vk::MemoryPropertyFlagBits::eLazilyAllocated))
      return true;
  return false;
}

std::optional<uint32_t> DeviceState::host_memory_type(uint32_t allowed) const {
  const auto wanted = vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
  std::optional<uint32_t> any;
  for (uint32_t t = 0; t < memory.memoryTypeCount; ++t) {
    const vk::MemoryPropertyFlags flags = memory.memoryTypes[t].propertyFlags;
    if ((allowed & (1u << t)) == 0 || (flags & wanted) != wanted) continue;
    if (!(flags & vk::MemoryPropertyFlagBits::eDeviceLocal)) return t;
    if (!any) any = t;  // where host and device share it
  }
  return any;
}

void choose_families(DeviceState& state) {
  const auto families = state.physical.getQueueFamilyProperties();
  const auto first = [&](const auto& fits) {
    const auto family = std::ranges::find_if(families, fits);
    return family == families.end() ? std::nullopt : std::optional(static_cast<uint32_t>(family - families.begin()));
  };
  constexpr auto kBoth = vk::QueueFlagBits::eGraphics | vk::QueueFlagBits::eCompute;
  const auto graphics = first([&](const auto& f) { return (f.queueFlags & kBoth) == kBoth; });
  if (!graphics) throw DeviceFailure{"the device has no queue for graphics and compute"};
  state.graphics.family = *graphics;
  state.compute.family = first([&](const auto& f) {
                           return (f.queueFlags & kBoth) == vk::QueueFlagBits::eCompute && f.timestampValidBits > 0;
                         }).value_or(*graphics);
  for (DeviceQueue* q : {&state.graphics, &state.compute}) q->timestamp_bits = families[q->family].timestampValidBits;
}

std::shared_ptr<DeviceState> open_device(const DeviceOptions& options) {
  auto state = std::make_shared<DeviceState>();
  make_instance(*state, options.validation);
  vk::raii::PhysicalDevices devices(state->instance);
  std::string names;
  bool found = false;
  for (size_t k = 0; k < devices.size() && !found; ++k) {
    const DeviceInfo info = describe(devices[k]);
    names += (k ? ", " : "") + info.name;
    if (!matches(info, k, options.name)) continue;
    state->physical = std::move(devices[k]);
    found = true;
  }
  if (!found)
    throw DeviceFailure{names.empty() ? "there is no Vulkan device"
                                      : "no Vulkan device matches '" + options.name + "'; there are: " + names};
  state->properties = state->physical.getProperties();
  state->memory = state->physical.getMemoryProperties();
  if (state->properties.apiVersion < VK_API_VERSION_1_1)
    throw DeviceFailure{"device '" + std::string(state->properties.deviceName.data()) + "' has Vulkan " +
                        version_text(state->properties.apiVersion) + ", 1.1 is needed"};
  state->largest_block =
      state->physical.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceMaintenance3Properties>()
          .get<vk::PhysicalDeviceMaintenance3Properties>()
          .maxMemoryAllocationSize;
  choose_families(*state);

  std::vector<const char*> extensions;
  const auto offered = state->physical.enumerateDeviceExtensionProperties();
  auto has_extension = [&](const char* name) {
    return std::any_of(offered.begin(), offered.end(),
                       [&](const auto& e) { return std::string_view(e.extensionName.data()) == name; });
  };
  state->memory_budget = has_extension(VK_EXT_MEMORY_BUDGET_EXTENSION_NAME);
  vk::PhysicalDeviceFeatures2 features;
  vk::PhysicalDeviceShaderAtomicInt64Features atomics;
  const bool atomics_known = has_extension(VK_KHR_SHADER_ATOMIC_INT64_EXTENSION_NAME);
  if (atomics_known) features.pNext = &atomics;
  vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT float_atomics;
  const bool float_atomics_known = has_extension(VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME);
  if (float_atomics_known) {
    float_atomics.pNext = features.pNext;
    features.pNext = &float_atomics;
  }
  auto get =
      reinterpret_cast<PFN_vkGetPhysicalDeviceFeatures2>(state->instance.getProcAddr("vkGetPhysicalDeviceFeatures2"));
  vk::PhysicalDeviceMultiviewFeatures multiview;
  multiview.pNext = features.pNext;
  features.pNext = &multiview;
  get(*state->physical, reinterpret_cast<VkPhysicalDeviceFeatures2*>(&features));
  if (multiview.multiview)
    state->multiview_views =
        state->physical.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceMultiviewProperties>()
            .get<vk::PhysicalDeviceMultiviewProperties>()
            .maxMultiviewViewCount;
  // lavapipe (Mesa 22.3) draws the first of several views only.
  if (std::string_view(state->properties.deviceName).starts_with("llvmpipe"))
    state->multiview_views = std::min(state->multiview_views, 1u);
  state->int64 = features.features.shaderInt64 != 0;
  state->int64_atomics = state->int64 && atomics_known && atomics.shaderBufferInt64Atomics != 0;
  const auto subgroup =
      state->physical.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceSubgroupProperties>()
          .get<vk::PhysicalDeviceSubgroupProperties>();
  constexpr auto kSums = vk::SubgroupFeatureFlagBits::eBallot | vk::SubgroupFeatureFlagBits::eArithmetic;
  state->subgroup_arithmetic =
      (subgroup.supportedOperations & kSums) == kSums && (subgroup.supportedStages & vk::ShaderStageFlagBits::eCompute);
  state->subgroup_shuffle =
      state->subgroup_arithmetic && (subgroup.supportedOperations & vk::SubgroupFeatureFlagBits::eShuffle);
  state->float_atomics = float_atomics_known && float_atomics.shaderBufferFloat32AtomicAdd != 0;
  vk::PhysicalDeviceFeatures enable;
  enable.robustBufferAccess = features.features.robustBufferAccess;
  enable.shaderInt64 = state->int64;
  enable.vertexPipelineStoresAndAtomics = features.features.vertexPipelineStoresAndAtomics;
  enable.pipelineStatisticsQuery = features.features.pipelineStatisticsQuery;
  state->pipeline_statistics = features.features.pipelineStatisticsQuery != 0;
  enable.fragmentStoresAndAtomics = features.features.fragmentStoresAndAtomics;
  vk::PhysicalDeviceShaderAtomicInt64Features enable_atomics;
  enable_atomics.shaderBufferInt64Atomics = VK_TRUE;
  if (state->int64_atomics) extensions.push_back(VK_KHR_SHADER_ATOMIC_INT64_EXTENSION_NAME);
  vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT enable_float_atomics;
  enable_float_atomics.shaderBufferFloat32AtomicAdd = VK_TRUE;
  if (state->float_atomics) extensions.push_back(VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME);
  share_with_cuda(*state, offered, extensions);
  state->shader_statistics =
      options.shader_statistics && has_extension(VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME);
  vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR enable_statistics;
  enable_statistics.pipelineExecutableInfo = VK_TRUE;
  if (state->shader_statistics) extensions.push_back(VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME);
  const float priority = 1;
  std::vector<vk::DeviceQueueCreateInfo> queues = {{{}, state->graphics.family, 1, &priority}};
  if (state->compute.family != state->graphics.family)
    queues.emplace_back(vk::DeviceQueueCreateFlags(), state->compute.family, 1, &priority);
  vk::DeviceCreateInfo info;
  info.setQueueCreateInfos(queues);
  info.setPEnabledExtensionNames(extensions);
  info.pEnabledFeatures = &enable;
  if (state->int64_atomics) info.pNext = &enable_atomics;
  if (state->float_atomics) {
    enable_float_atomics.pNext = const_cast<void*>(info.pNext);
    info.pNext = &enable_float_atomics;
  }
  vk::PhysicalDeviceMultiviewFeatures enable_multiview;
  enable_multiview.multiview = VK_TRUE;
  if (state->multiview_views > 0) {
    enable_multiview.pNext = const_cast<void*>(info.pNext);
    info.pNext = &enable_multiview;
  }
  vk::PhysicalDeviceTimelineSemaphoreFeatures enable_timeline;
  enable_timeline.timelineSemaphore = VK_TRUE;
  if (state->shares_memory) {
    enable_timeline.pNext = const_cast<void*>(info.pNext);
    info.pNext = &enable_timeline;
  }
  if (state->shader_statistics) {
    enable_statistics.pNext = const_cast<void*>(info.pNext);
    info.pNext = &enable_statistics;
  }
  VkDevice device = VK_NULL_HANDLE;
  const auto& calls = *state->physical.getDispatcher();
  expect_success(
      calls.vkCreateDevice(*state->physical, reinterpret_cast<const VkDeviceCreateInfo*>(&info), nullptr, &device),
      "vkCreateDevice");
  state->device =
      owned<vk::raii::Device>(state->physical, device, calls.vkGetDeviceProcAddr(device, "vkDestroyDevice"));
  for (DeviceQueue* q : {&state->graphics, &state->compute}) q->queue = state->device.getQueue(q->family, 0);
  return state;
}

Result<std::vector<DeviceInfo>> Device::list() {
  try {
    DeviceState state;
    make_instance(state, false);
    vk::raii::PhysicalDevices devices(state.instance);
    std::vector<DeviceInfo> out;
    for (const auto& d : devices) out.push_back(describe(d));
    return out;
  } catch (const Failure& failure) {
    return failure.error();
  } catch (const std::exception& e) {
    return io::Error{std::string("cannot list Vulkan devices: ") + e.what(), io::Blame::Device};
  }
}

Result<Device> Device::open(const DeviceOptions& options) {
  try {
    Device device;
    device.state_ = open_device(options);
    return device;
  } catch (const Failure& failure) {
    return failure.error();
  } catch (const std::exception& e) {
    return io::Error{std::string("cannot open a Vulkan device: ") + e.what(), io::Blame::Device};
  }
}

DeviceInfo Device::info() const { return state_ ? describe(state_->physical) : DeviceInfo{}; }

DeviceLimits Device::limits() const {
  if (!state_) return {};
  const auto& physical = state_->physical;
  const auto properties = physical.getProperties2<vk::PhysicalDeviceProperties2, vk::PhysicalDeviceSubgroupProperties,
                                                  vk::PhysicalDeviceMultiviewProperties>();
  const vk::PhysicalDeviceLimits& l = state_->properties.limits;
  const vk::PhysicalDeviceFeatures f = physical.getFeatures();
  const auto offered = physical.enumerateDeviceExtensionProperties();
  const bool float_atomics_known = std::any_of(offered.begin(), offered.end(), [](const auto& e) {
    return std::string_view(e.extensionName.data()) == VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME;
  });
  bool float_atomics = false;
  if (float_atomics_known)
    float_atomics = physical.getFeatures2<vk::PhysicalDeviceFeatures2, vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT>()
                        .get<vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT>()
                        .shaderBufferFloat32AtomicAdd != 0;
  return {.max_color_attachments = l.maxColorAttachments,
          .max_per_stage_descriptor_storage_buffers = l.maxPerStageDescriptorStorageBuffers,
          .max_per_stage_descriptor_sampled_images = l.maxPerStageDescriptorSampledImages,
          .max_per_stage_descriptor_input_attachments = l.maxPerStageDescriptorInputAttachments,
          .max_per_stage_resources = l.maxPerStageResources,
          .max_fragment_combined_output_resources = l.maxFragmentCombinedOutputResources,
          .max_push_constants_size = l.maxPushConstantsSize,
          .max_image_dimension_2d = l.maxImageDimension2D,
          .max_compute_work_group_invocations = l.maxComputeWorkGroupInvocations,
          .max_compute_work_group_count_x = l.maxComputeWorkGroupCount[0],
          .max_compute_shared_memory_size = l.maxComputeSharedMemorySize,
          .max_multiview_view_count = properties.get<vk::PhysicalDeviceMultiviewProperties>().maxMultiviewViewCount,
          .subgroup_size = properties.get<vk::PhysicalDeviceSubgroupProperties>().subgroupSize,
          .max_storage_buffer_range = l.maxStorageBufferRange,
          .subgroup_arithmetic = state_->subgroup_arithmetic,
          .subgroup_shuffle = state_->subgroup_shuffle,
          .shader_int64 = state_->int64,
          .shader_buffer_int64_atomics = state_->int64_atomics,
          .shader_buffer_float32_atomic_add = float_atomics,
          .fragment_stores_and_atomics = f.fragmentStoresAndAtomics != 0,
          .geometry_shader = f.geometryShader != 0};
}

std::string Device::profile_name() const {
  constexpr std::pair<std::string_view, std::string_view> kProfiles[] = {
      {"llvmpipe", "lavapipe"},
      {"swiftshader", "swiftshader"},
      {"rtx 2080", "nvidia-rtx2080"},
      {"h200", "nvidia-h200"},
      {"h100", "nvidia-h200"},
      {"r9 m360", "amd-r9m360"},
      {"uhd graphics 620", "intel-uhd620"},
      {"mali-g76", "arm-mali-g76"},
  };
  const std::string name = lower_case(info().name);
  for (const auto& [part, profile] : kProfiles)
    if (name.find(part) != std::string::npos) return std::string(profile);
  return {};
}

std::vector<std::string> Device::validation_messages() const {
  if (!state_) return {};
  const std::lock_guard lock(state_->messages_lock);
  return state_->messages;
}

bool Device::shares_memory() const { return state_ && state_->shares_memory; }

Result<int> Device::cuda_device() const {
  if (!state_) return io::Error{"the device is empty: it was moved from"};
  try {
    return Cuda::of(*state_)->ordinal();
  } catch (const Failure& failure) {
    return failure.error();
  }
}

bool Device::validating() const { return state_ && *state_->messenger != vk::DebugUtilsMessengerEXT{}; }

}  // namespace dr::runtime
