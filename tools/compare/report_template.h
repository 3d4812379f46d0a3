// report_template.h - report.html as the build embeds it (embed.cmake).
#pragma once
#include <cstddef>

namespace mtsm::tools {

extern const unsigned char kReportTemplate[];
extern const std::size_t kReportTemplateSize;

}  // namespace mtsm::tools
