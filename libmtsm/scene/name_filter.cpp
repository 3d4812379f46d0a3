#include "scene/name_filter.h"

#include <fnmatch.h>

#include <algorithm>

namespace mtsm::scene {
namespace {

bool anyMatches(const std::vector<std::string>& patterns,
                std::span<const char* const> names) {
    return std::any_of(patterns.begin(), patterns.end(), [&](const std::string& p) {
        return std::any_of(names.begin(), names.end(), [&](const char* name) {
            return fnmatch(p.c_str(), name, 0) == 0;
        });
    });
}

}  // namespace

bool NameFilter::passes(std::span<const char* const> names) const {
    return (include_.empty() || anyMatches(include_, names)) &&
           !anyMatches(exclude_, names);
}

}  // namespace mtsm::scene
