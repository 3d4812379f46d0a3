// methods.h - every method that there is.
#pragma once
#include <string>
#include <vector>

#include "baseline/method.h"

namespace mtsm::baseline {

/// In the order of the comparison's tables.
[[nodiscard]] const std::vector<MethodInfo>& methods();

/// badArgument if there is none of that name: the message lists them and the nearest.
[[nodiscard]] Result<const MethodInfo*> findMethod(const std::string& name);

// One function per row, beside its implementation.
[[nodiscard]] MethodInfo embreeMethod();        ///< embree_method.cpp
[[nodiscard]] MethodInfo mtsmMethod();          ///< mtsm_method.cpp
[[nodiscard]] MethodInfo slsmMethod();          ///< opaque_map_methods.cpp
[[nodiscard]] MethodInfo mlsmMethod();          ///< opaque_map_methods.cpp
[[nodiscard]] MethodInfo mvsmMethod();          ///< mvsm_method.cpp
[[nodiscard]] MethodInfo pcfMethod();           ///< pcf_method.cpp
[[nodiscard]] MethodInfo deepPcfMethod();       ///< pcf_method.cpp
[[nodiscard]] MethodInfo accumulatedMethod();   ///< accumulated_method.cpp
[[nodiscard]] MethodInfo singleSampleMethod();  ///< single_sample.cpp
[[nodiscard]] MethodInfo sdfMethod();           ///< sdf_march.cpp
[[nodiscard]] MethodInfo radianceMethod();      ///< radiance_method.cpp

}  // namespace mtsm::baseline
