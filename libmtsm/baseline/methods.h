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
[[nodiscard]] MethodInfo mtsmMethod();    ///< mtsm_method.cpp
[[nodiscard]] MethodInfo embreeMethod();  ///< embree_method.h

}  // namespace mtsm::baseline
