// each_target.h - a kernel's tests on every kind of processor that this one can be.
#pragma once
#include <cstdint>
#include <functional>

#include "hwy/highway.h"

namespace mtsm::test {

inline void onEachTarget(const std::function<void(const char* name)>& body) {
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
        hwy::GetChosenTarget().Update(target);
        body(hwy::TargetName(target));
    }
    hwy::GetChosenTarget().DeInit();
}

}  // namespace mtsm::test
