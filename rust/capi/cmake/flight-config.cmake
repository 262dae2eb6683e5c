# Targets of libflight: flight::flight is the shared library, flight::static the archive.
get_filename_component(flight_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
if(NOT TARGET flight::flight)
  add_library(flight::flight SHARED IMPORTED)
  set_target_properties(flight::flight PROPERTIES
    IMPORTED_LOCATION "${flight_prefix}/lib/libflight.so"
    INTERFACE_INCLUDE_DIRECTORIES "${flight_prefix}/include")
  add_library(flight::static STATIC IMPORTED)
  set_target_properties(flight::static PROPERTIES
    IMPORTED_LOCATION "${flight_prefix}/lib/libflight.a"
    INTERFACE_INCLUDE_DIRECTORIES "${flight_prefix}/include"
    INTERFACE_LINK_LIBRARIES "gcc_eh;util;rt;pthread;m;dl")
endif()
