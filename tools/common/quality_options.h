// quality_options.h - --quality and --target-error, which mean the same when a map is
// baked and when it is asked.
#pragma once
#include <CLI/CLI.hpp>
#include <optional>
#include <string>

#include "mtsm/quality.h"

namespace mtsm::tools {

struct QualityOptions {
    std::optional<std::size_t> quality;  ///< Quality, by its place
    std::optional<double> targetError;

    /// The mean error that was asked for, in one way or the other.
    [[nodiscard]] std::optional<float> meanError() const;
};

/// `chosen`: what they choose, for --quality's help.
void addQualityOptions(CLI::App& app, QualityOptions& options, const std::string& chosen,
                       const std::string& group);

/// The mean error that "draft", "preview" and "final" stand for; nothing of other words.
[[nodiscard]] std::optional<float> errorOfQuality(const std::string& word);

/// The mean error that a map was baked for, told from the settings that it remembers;
/// nothing if they name none.
[[nodiscard]] std::optional<float> bakedFor(const std::string& settings);

/// An error as people read it: two digits, "0.0012".
[[nodiscard]] std::string errorText(double error);

}  // namespace mtsm::tools
