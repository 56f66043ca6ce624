# The ROS 2 wheels' CMake exports name include folders of the machine they were built on. CMake refuses imported targets
# with include folders that do not exist, so they are dropped once the project's own CMakeLists.txt has been read.
# Passed as CMAKE_PROJECT_INCLUDE by build.sh; never needed with an installed ROS 2.
function(dgs_fix_imported_includes)
  get_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT folders)
      continue()
    endif()
    set(existing "")
    foreach(folder IN LISTS folders)
      if(folder MATCHES "\\$<" OR EXISTS "${folder}")
        list(APPEND existing "${folder}")
      endif()
    endforeach()
    set_property(TARGET "${target}" PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${existing}")
  endforeach()
endfunction()

cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL dgs_fix_imported_includes)
