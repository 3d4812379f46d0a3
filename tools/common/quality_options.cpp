#include "common/quality_options.h"

#include <cstdio>

#include "common/arguments.h"

namespace mtsm::tools {

std::optional<float> QualityOptions::meanError() const {
    if (targetError) return float(*targetError);
    if (quality) return mtsm::meanError(static_cast<Quality>(*quality));
    return std::nullopt;
}

void addQualityOptions(CLI::App& app, QualityOptions& options, const std::string& chosen,
                       const std::string& group) {
    addChoice(app, "--quality", options.quality, {"draft", "preview", "final"},
              "choose " + chosen +
                  "\nfor a mean error of 0.02, 0.005 or 0.001;\n"
                  "options that are given stay as they are")
        ->group(group);
    addNumber(app, "--target-error", options.targetError, {0.0001, 1.0}, "E",
              "the same for a mean error of the shadow factor over\n"
              "the picture's points of your own, such as 0.002")
        ->group(group)
        ->excludes(app.get_option("--quality"));
}

std::string errorText(double error) {
    char text[32];
    std::snprintf(text, sizeof text, "%.2g", error);
    return text;
}

}  // namespace mtsm::tools
