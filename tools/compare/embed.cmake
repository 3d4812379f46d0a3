# Turns report.html into a source file: cmake -DINPUT=... -DOUTPUT=... -P embed.cmake
# Bytes and not a string literal: some compilers end those at 64 KB.
file(READ ${INPUT} bytes HEX)
string(REGEX REPLACE "(................................)" "\\1\n" bytes "${bytes}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
file(WRITE ${OUTPUT}
"// Made from report.html by embed.cmake.
#include \"compare/report_template.h\"
namespace mtsm::tools {
const unsigned char kReportTemplate[] = {
${bytes}};
const std::size_t kReportTemplateSize = sizeof kReportTemplate;
}  // namespace mtsm::tools
")
