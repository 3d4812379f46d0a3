// equal_error.h - how long one method needs for the error that another one has.
//
// Methods whose error falls with a number of samples are compared between the numbers
// that were run, on the line through two neighbours in the logarithms of error and time
// (what is built once is added to it); all others only at what was run.
#pragma once
#include <optional>
#include <string>
#include <vector>

namespace mtsm::baseline {

/// A way to compute a picture, and what it cost.
struct Measured {
    std::string label;
    double error = 0.0;    ///< >= 0
    double seconds = 0.0;  ///< > 0, for one picture
    double build = 0.0;    ///< to be paid besides; 0 where further pictures count
    /// Runs of one series differ in the number of samples alone and may be interpolated;
    /// empty: this one stands alone.
    std::string series;
    double samples = 0.0;
};

/// The cheapest way to an error.
struct Reached {
    double seconds = 0.0;  ///< build included
    std::string label;     ///< of the run, or "between A and B"
};

/// What reaches `error` in the least time; nothing if none of the runs does.
[[nodiscard]] std::optional<Reached> cheapest(const std::vector<Measured>& runs,
                                              double error);

/// Those runs that no other one beats in both error and time (build included), by time.
[[nodiscard]] std::vector<std::size_t> paretoFront(const std::vector<Measured>& runs);

}  // namespace mtsm::baseline
