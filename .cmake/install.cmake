# SPDX-License-Identifier: Apache-2.0
# `cmake --install`: the commands, and for C++ hosts the headers, the static libraries and a package:
# find_package(dressi), then link dressi::runtime (bundles), dressi::jit (program text, too) or dressi::c.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

install(TARGETS drc RUNTIME)
if(NOT TARGET dr_jit)
  return()
endif()
install(TARGETS drun RUNTIME)

# dr_runtime and dr_jit, and what they link.
set(libraries dr_include dr_warnings dr_runtime dr_jit dr_io dr_bundle dr_dim dr_topology dr_dsl dr_ir dr_ops dr_target
  dr_stdlib dr_lower dr_passes dr_reference dr_analysis dr_schedule dr_cost dr_pack dr_lowering dr_glsl dr_plan dr_emit dr_spirv
  dr_backend dr_driver)
foreach(library IN LISTS libraries)
  string(REGEX REPLACE "^dr_" "" name ${library})
  set_target_properties(${library} PROPERTIES EXPORT_NAME ${name})
endforeach()
# Their file names are the targets' (libdr_io.a); a folder of their own keeps them apart from other packages' anyway.
install(TARGETS ${libraries} EXPORT dressi ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}/dressi)

# Headers keep the paths that they include each other by.
set(headers runtime/runtime.h compiler/io/array/array.h compiler/io/mesh/mesh.h compiler/io/file/result.h compiler/driver/options.h runtime/jit/jit.h
  runtime/jit/measure.h runtime/jit/rebuild.h runtime/jit/reference_program.h)
foreach(header IN LISTS headers)
  cmake_path(GET header PARENT_PATH folder)
  install(FILES ${PROJECT_SOURCE_DIR}/${header} DESTINATION include/dressi/${folder})
endforeach()

set(package ${CMAKE_INSTALL_LIBDIR}/cmake/dressi)
install(EXPORT dressi NAMESPACE dressi:: FILE dressi-targets.cmake DESTINATION ${package})
# The shared library of the C interface has all in it: who links dressi::c needs none of what the static ones do.
if(NOT SKBUILD)
  install(EXPORT dressi-c NAMESPACE dressi:: FILE dressi-c-targets.cmake DESTINATION ${package})
endif()
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/dressi-config.cmake.in
  ${PROJECT_BINARY_DIR}/dressi-config.cmake INSTALL_DESTINATION ${package})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/dressi-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/dressi-config.cmake ${PROJECT_BINARY_DIR}/dressi-config-version.cmake
  DESTINATION ${package})
