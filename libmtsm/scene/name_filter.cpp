#include "scene/name_filter.h"

#include <fnmatch.h>

#include <algorithm>

namespace mtsm::scene {
namespace {

bool matches(const std::string& pattern, std::span<const char* const> names) {
    return std::any_of(names.begin(), names.end(), [&](const char* name) {
        return fnmatch(pattern.c_str(), name, 0) == 0;
    });
}

}  // namespace

bool NameFilter::passes(std::span<const char* const> names) const {
    const auto anyMatches = [&](const std::vector<std::string>& patterns) {
        bool any = false;
        for (const std::string& pattern : patterns) {
            if (!matches(pattern, names)) continue;
            matched_.insert(pattern);
            any = true;
        }
        return any;
    };
    const bool included = anyMatches(include_) || include_.empty();
    const bool excluded = anyMatches(exclude_);
    return included && !excluded;
}

std::vector<std::string> NameFilter::unmatched() const {
    std::vector<std::string> patterns;
    for (const auto* list : {&include_, &exclude_}) {
        for (const std::string& pattern : *list) {
            if (matched_.count(pattern) == 0) patterns.push_back(pattern);
        }
    }
    return patterns;
}

}  // namespace mtsm::scene
