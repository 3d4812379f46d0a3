// recommend.h - the cheapest way to what a user asks for, and how to get it.
#pragma once
#include <nlohmann/json.hpp>
#include <string>

#include "compare/results.h"

namespace mtsm::tools {

/// What is asked for: a mean error, or a time for the first picture.
struct Wish {
    bool isTime = false;
    double value = 0.0;  ///< error, or seconds
};

/// "error=0.005", "time=2s" (ms, s, min); UsageError if it is neither.
Wish parseWish(const std::string& text);

/// For each light what meets the wish with the least time (for a wish of time: with the
/// least error) on all threads, and for maps the command lines that make them. `input` is
/// what stands for the casters on mtsm-bake's command line.
std::string recommendation(const nlohmann::ordered_json& results, const Wish& wish,
                           ErrorKind error, const std::string& input,
                           const std::string& positionPass,
                           const std::string& normalPass);

}  // namespace mtsm::tools
