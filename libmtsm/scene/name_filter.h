// name_filter.h - which meshes cast, by the names of what they belong to.
#pragma once
#include <set>
#include <span>
#include <string>
#include <vector>

namespace mtsm::scene {

/// Shell patterns as fnmatch(3) reads them, in the caller's locale; `/` and a leading dot
/// are letters like any other.
class NameFilter {
  public:
    NameFilter(std::vector<std::string> include, std::vector<std::string> exclude)
        : include_(std::move(include)), exclude_(std::move(exclude)) {}

    /// True if `include` is empty or matches one of the names, and `exclude` matches
    /// none.
    [[nodiscard]] bool passes(std::span<const char* const> names) const;

    /// The patterns that match none of the names seen by passes(): a slip, perhaps.
    [[nodiscard]] std::vector<std::string> unmatched() const;

  private:
    std::vector<std::string> include_, exclude_;
    mutable std::set<std::string> matched_;  // patterns
};

}  // namespace mtsm::scene
