#include "common/quality_options.h"

#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "common/arguments.h"

namespace mtsm::tools {

namespace {
const std::vector<std::string> kQualities = {"draft", "preview", "final"};
}  // namespace

std::optional<float> QualityOptions::meanError() const {
    if (targetError) return float(*targetError);
    if (quality) return mtsm::meanError(static_cast<Quality>(*quality));
    return std::nullopt;
}

void addQualityOptions(CLI::App& app, QualityOptions& options, const std::string& chosen,
                       const std::string& group) {
    addChoice(app, "--quality", options.quality, kQualities,
              "choose " + chosen +
                  ",\nfor a mean error of 0.02, 0.005 or 0.001;\n"
                  "options that are given stay as they are")
        ->group(group);
    addNumber(app, "--target-error", options.targetError, {0.0001, 1.0}, "E",
              "the same for a mean error of your own, 0.0001 to 1,\n"
              "of the shadow factor over the picture's points")
        ->group(group)
        ->excludes(app.get_option("--quality"));
}

std::optional<float> bakedFor(const std::string& settings) {
    const auto valueOf = [&](const std::string& option) {
        const auto at = settings.find(" " + option + " ");
        if (at == std::string::npos) return std::string();
        const auto start = at + option.size() + 2;
        return settings.substr(start, settings.find(' ', start) - start);
    };
    const std::string error = valueOf("--target-error"), quality = valueOf("--quality");
    if (const float asked = std::strtof(error.c_str(), nullptr); asked > 0.0f)
        return asked;
    return errorOfQuality(quality);
}

std::optional<float> errorOfQuality(const std::string& word) {
    for (std::size_t i = 0; i < kQualities.size(); ++i)
        if (word == kQualities[i]) return mtsm::meanError(static_cast<Quality>(i));
    return std::nullopt;
}

std::string errorText(double error) {
    char text[32];
    std::snprintf(text, sizeof text, "%.2g", error);
    return text;
}

}  // namespace mtsm::tools
