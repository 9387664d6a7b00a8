# SPDX-License-Identifier: Apache-2.0
# Every dependency, found once and for all folders. All of them are Debian packages; whatever is missing is named in one
# message, by the package to install. The Vulkan loader belongs to the runtime alone: drc has to run without it.

set(dr_missing_packages "")

# Finds a CMake package or notes the Debian package that holds it.
macro(dr_find name debian_package)
  find_package(${name} QUIET ${ARGN})
  if(NOT ${name}_FOUND)
    list(APPEND dr_missing_packages ${debian_package})
  endif()
endmacro()

find_package(Threads REQUIRED)  # glslang's package names Threads::Threads without looking for it
dr_find(glslang "glslang-dev;glslang-tools" CONFIG)
dr_find(SPIRV-Tools spirv-tools CONFIG)
dr_find(SPIRV-Tools-opt spirv-tools CONFIG)
dr_find(FlatBuffers libflatbuffers-dev CONFIG)
dr_find(nlohmann_json nlohmann-json3-dev CONFIG)
dr_find(CLI11 libcli11-dev CONFIG)
dr_find(glm libglm-dev CONFIG)
dr_find(TinyGLTF libtinygltf-dev CONFIG)
dr_find(JPEG libjpeg-dev MODULE)
if(FlatBuffers_FOUND AND NOT TARGET flatbuffers::flatc)
  list(APPEND dr_missing_packages flatbuffers-compiler)
endif()

if(DR_BUILD_RUNTIME)
  dr_find(Vulkan libvulkan-dev MODULE)

  # stb comes without a CMake package: headers in /usr/include/stb, their code in one library.
  find_path(DR_STB_INCLUDE_DIR stb/stb_image.h)
  find_library(DR_STB_LIBRARY stb)
  mark_as_advanced(DR_STB_INCLUDE_DIR DR_STB_LIBRARY)
  if(DR_STB_INCLUDE_DIR AND DR_STB_LIBRARY)
    add_library(stb::stb UNKNOWN IMPORTED)
    set_target_properties(stb::stb PROPERTIES
      IMPORTED_LOCATION ${DR_STB_LIBRARY}
      INTERFACE_INCLUDE_DIRECTORIES ${DR_STB_INCLUDE_DIR})
  else()
    list(APPEND dr_missing_packages libstb-dev)
  endif()
endif()

if(DR_BUILD_TESTS)
  dr_find(Catch2 catch2 2.13 CONFIG)
endif()

if(dr_missing_packages)
  list(REMOVE_DUPLICATES dr_missing_packages)
  list(JOIN dr_missing_packages " " dr_missing_packages)
  message(FATAL_ERROR "Dependencies are missing. On Debian:\n  apt-get install ${dr_missing_packages}")
endif()

# An allocator for the commands, if there is one.
find_package(mimalloc 2 QUIET CONFIG)

# A compiler cache is used where there is one, unless the user has chosen a launcher.
find_program(DR_CCACHE ccache)
mark_as_advanced(DR_CCACHE)
if(DR_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${DR_CCACHE})
endif()
