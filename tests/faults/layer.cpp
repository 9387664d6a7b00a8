// SPDX-License-Identifier: Apache-2.0
// A layer of Vulkan's loader in which calls that give a VkResult fail on order, and which counts the objects that are
// alive. One driver at a time.
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#include <atomic>
#include <cstring>
#include <string_view>

#include "tests/faults/shim.h"

namespace {

using dr::faults::is_due;
using dr::faults::Kind;

VkResult error_of(std::string_view call) {
  for (const char* device : {"vkQueueSubmit", "vkWaitForFences", "vkGetFenceStatus", "vkQueueWaitIdle",
                             "vkDeviceWaitIdle", "vkGetQueryPoolResults"})
    if (call == device) return VK_ERROR_DEVICE_LOST;
  if (call == "vkAllocateMemory") return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  if (call == "vkMapMemory") return VK_ERROR_MEMORY_MAP_FAILED;
  if (call == "vkAllocateDescriptorSets") return VK_ERROR_OUT_OF_POOL_MEMORY;
  return VK_ERROR_OUT_OF_HOST_MEMORY;
}

// Lists of a macro's uses are no statements.
// clang-format off

// How many of each kind of object there are.
#define DR_OBJECTS(X)                                                                                   \
  X(Buffer)                                                                                             \
  X(BufferView)                                                                                         \
  X(Image) X(ImageView) X(Fence) X(Semaphore) X(Event) X(CommandPool) X(ShaderModule) X(PipelineLayout) \
      X(DescriptorSetLayout) X(DescriptorPool) X(PipelineCache) X(RenderPass) X(Framebuffer) X(QueryPool) X(Sampler)
// Other calls that may fail.
#define DR_CALLS(X)                                                                                               \
  X(MapMemory)                                                                                                    \
  X(BindBufferMemory)                                                                                             \
  X(BindImageMemory) X(ResetFences) X(WaitForFences) X(GetFenceStatus) X(QueueSubmit) X(QueueWaitIdle)            \
      X(DeviceWaitIdle) X(AllocateCommandBuffers) X(BeginCommandBuffer) X(EndCommandBuffer) X(ResetCommandBuffer) \
          X(ResetCommandPool) X(AllocateDescriptorSets) X(GetPipelineCacheData) X(MergePipelineCaches)            \
              X(GetQueryPoolResults) X(FlushMappedMemoryRanges) X(InvalidateMappedMemoryRanges)                   \
                  X(SetDebugUtilsObjectNameEXT) X(FreeDescriptorSets)
#define DR_INSTANCE_CALLS(X) X(EnumeratePhysicalDevices) X(EnumerateDeviceExtensionProperties)

std::atomic<long> instances, devices, memories, pipelines;
#define X(name) std::atomic<long> name##s;
DR_OBJECTS(X)
#undef X

// A call, its next in the chain, and whether its success makes an object.
#define DR_TAG(name, live)                             \
  struct name {                                        \
    static constexpr const char* text = "vk" #name;    \
    static inline PFN_vk##name next = nullptr;         \
    static std::atomic<long>* alive() { return live; } \
  };
namespace call {
#define X(name) DR_TAG(Create##name, &name##s) DR_TAG(Destroy##name, &name##s)
DR_OBJECTS(X)
#undef X
#define X(name) DR_TAG(name, nullptr)
DR_CALLS(X)
DR_INSTANCE_CALLS(X)
#undef X
DR_TAG(AllocateMemory, &memories)
DR_TAG(FreeMemory, &memories) DR_TAG(CreateComputePipelines, &pipelines) DR_TAG(CreateGraphicsPipelines, &pipelines)
    DR_TAG(DestroyPipeline, &pipelines) DR_TAG(DestroyInstance, &instances) DR_TAG(DestroyDevice, &devices)
}  // namespace call
// clang-format on

template <class Tag, class F>
struct Hook;
template <class Tag, class... A>
struct Hook<Tag, VkResult(VKAPI_PTR*)(A...)> {
  static VKAPI_ATTR VkResult VKAPI_CALL go(A... a) {
    if (is_due(Kind::Vulkan, Tag::text)) return error_of(Tag::text);
    const VkResult result = Tag::next(a...);
    if (result >= 0 && Tag::alive() != nullptr) ++*Tag::alive();
    return result;
  }
};
template <class Tag, class Parent, class Handle, class Allocator>
struct Hook<Tag, void(VKAPI_PTR*)(Parent, Handle, Allocator)> {
  static VKAPI_ATTR void VKAPI_CALL go(Parent parent, Handle handle, Allocator allocator) {
    if (handle != VK_NULL_HANDLE) --*Tag::alive();
    Tag::next(parent, handle, allocator);
  }
};
template <class Tag, class Handle, class Allocator>
struct Hook<Tag, void(VKAPI_PTR*)(Handle, Allocator)> {
  static VKAPI_ATTR void VKAPI_CALL go(Handle handle, Allocator allocator) {
    if (handle != VK_NULL_HANDLE) --*Tag::alive();
    Tag::next(handle, allocator);
  }
};

PFN_vkGetInstanceProcAddr next_instance_call = nullptr;
PFN_vkGetDeviceProcAddr next_device_call = nullptr;

template <class Info>
Info* link_of(const void* chain, VkStructureType type) {
  auto* info = static_cast<Info*>(const_cast<void*>(chain));
  while (info != nullptr && !(info->sType == type && info->function == VK_LAYER_LINK_INFO))
    info = static_cast<Info*>(const_cast<void*>(info->pNext));
  return info;
}

VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info, const VkAllocationCallbacks* allocator,
                                               VkInstance* instance) {
  auto* chain = link_of<VkLayerInstanceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
  if (chain == nullptr) return VK_ERROR_INITIALIZATION_FAILED;
  if (is_due(Kind::Vulkan, "vkCreateInstance")) return VK_ERROR_OUT_OF_HOST_MEMORY;
  const auto get = chain->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  chain->u.pLayerInfo = chain->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(get(nullptr, "vkCreateInstance"));
  const VkResult result = create(info, allocator, instance);
  if (result != VK_SUCCESS) return result;
  ++instances;
  next_instance_call = get;
  // clang-format off
#define X(name) call::name::next = reinterpret_cast<PFN_vk##name>(get(*instance, "vk" #name));
  DR_INSTANCE_CALLS(X)
  X(DestroyInstance)
#undef X
  // clang-format on
  return result;
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* device) {
  auto* chain = link_of<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
  if (chain == nullptr) return VK_ERROR_INITIALIZATION_FAILED;
  if (is_due(Kind::Vulkan, "vkCreateDevice")) return VK_ERROR_OUT_OF_HOST_MEMORY;
  const auto get_instance_call = chain->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  const auto get = chain->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  chain->u.pLayerInfo = chain->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateDevice>(get_instance_call(nullptr, "vkCreateDevice"));
  const VkResult result = create(physical, info, allocator, device);
  if (result != VK_SUCCESS) return result;
  ++devices;
  next_device_call = get;
  // clang-format off
#define X(name) call::name::next = reinterpret_cast<PFN_vk##name>(get(*device, "vk" #name));
  DR_CALLS(X)
  X(AllocateMemory)
  X(FreeMemory)
  X(CreateComputePipelines)
  X(CreateGraphicsPipelines)
  X(DestroyPipeline)
  X(DestroyDevice)
#undef X
#define X(name)                                                                                    \
  call::Create##name::next = reinterpret_cast<PFN_vkCreate##name>(get(*device, "vkCreate" #name)); \
  call::Destroy##name::next = reinterpret_cast<PFN_vkDestroy##name>(get(*device, "vkDestroy" #name));
  DR_OBJECTS(X)
#undef X
  // clang-format on
  return result;
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_device_call(VkDevice device, const char* name);
VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_instance_call(VkInstance instance, const char* name);

template <class F>
PFN_vkVoidFunction as_call(F* function) {
  return reinterpret_cast<PFN_vkVoidFunction>(function);
}

PFN_vkVoidFunction hook_of(std::string_view name, bool of_device) {
  // clang-format off
#define X(tag) \
  if (name == "vk" #tag && (call::tag::next != nullptr || !of_device)) return as_call(Hook<call::tag, PFN_vk##tag>::go);
  DR_CALLS(X)
  X(AllocateMemory)
  X(FreeMemory)
  X(CreateComputePipelines)
  X(CreateGraphicsPipelines)
  X(DestroyPipeline)
  X(DestroyDevice)
  if (!of_device) {
    DR_INSTANCE_CALLS(X)
    X(DestroyInstance)
  }
#undef X
#define X(object)                                                                                       \
  if (name == "vkCreate" #object) return as_call(Hook<call::Create##object, PFN_vkCreate##object>::go); \
  if (name == "vkDestroy" #object) return as_call(Hook<call::Destroy##object, PFN_vkDestroy##object>::go);
  DR_OBJECTS(X)
#undef X
  // clang-format on
  if (name == "vkGetDeviceProcAddr") return as_call(get_device_call);
  if (of_device) return nullptr;
  if (name == "vkGetInstanceProcAddr") return as_call(get_instance_call);
  if (name == "vkCreateInstance") return as_call(create_instance);
  if (name == "vkCreateDevice") return as_call(create_device);
  return nullptr;
}

PFN_vkVoidFunction VKAPI_CALL get_device_call(VkDevice device, const char* name) {
  const auto hook = hook_of(name, true);
  return hook != nullptr ? hook : next_device_call(device, name);
}

PFN_vkVoidFunction VKAPI_CALL get_instance_call(VkInstance instance, const char* name) {
  const auto hook = hook_of(name, false);
  if (hook != nullptr) return hook;
  return next_instance_call == nullptr ? nullptr : next_instance_call(instance, name);
}

}  // namespace

namespace dr::faults {

std::string alive() {
  std::string out;
  const auto tell = [&](const char* name, long count) {
    if (count != 0) out += (out.empty() ? "" : ", ") + std::to_string(count) + " " + name;
  };
  tell("Instance", instances);
  tell("Device", devices);
  tell("DeviceMemory", memories);
  tell("Pipeline", pipelines);
  // clang-format off
#define X(name) tell(#name, name##s);
  DR_OBJECTS(X)
#undef X
  // clang-format on
  return out;
}

}  // namespace dr::faults

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR VkResult VKAPI_CALL
vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface* version) {
  version->loaderLayerInterfaceVersion = 2;
  version->pfnGetInstanceProcAddr = get_instance_call;
  version->pfnGetDeviceProcAddr = get_device_call;
  version->pfnGetPhysicalDeviceProcAddr = nullptr;
  return VK_SUCCESS;
}
