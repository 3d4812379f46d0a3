// report.h - a comparison as one page: report.html of mtsm-compare.
//
//     auto page = mtsm::tools::makeReport(results, "out");  // what out/results.json
//     holds if (!page) return page.error(); write("out/report.html", *page);
//
// The page needs nothing but a browser: pictures are embedded, script and style are
// inline, and its own policy forbids it to load anything. Texts of the results (names of
// casters, labels, reasons) come from files and are never taken for HTML.
#pragma once
#include <nlohmann/json.hpp>
#include <string>

#include "mtsm/result.h"

namespace mtsm::tools {

/// The page of `results`, with every picture that they name read from `folder`. What the
/// results lack is left out of the page. io if a picture is missing, badFile if it is no
/// PNG; the message names it.
[[nodiscard]] Result<std::string> makeReport(const nlohmann::ordered_json& results,
                                             const std::string& folder);

}  // namespace mtsm::tools
