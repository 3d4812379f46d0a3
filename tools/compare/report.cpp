// The report page: the template with the results and the pictures put in.
#include "compare/report.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <set>
#include <string_view>
#include <system_error>
#include <vector>

#include "compare/report_template.h"
#include "mtsm/describe.h"

namespace mtsm::tools {
namespace {

using Json = nlohmann::ordered_json;

// Where the template takes what; each stands in it once, in this order.
constexpr std::string_view kResultsMark = "@RESULTS@";
constexpr std::string_view kPicturesMark = "@PICTURES@";

/// For a <script> element. JSON has "<" in strings alone, and without it there is neither
/// an end tag nor a comment for the browser to find.
std::string jsonForScript(const Json& json) {
    std::string out;
    for (const char c : json.dump(-1, ' ', true, Json::error_handler_t::replace)) {
        if (c == '<')
            out += "\\u003c";
        else
            out += c;
    }
    return out;
}

std::string escapedAttribute(const std::string& text) {
    std::string out;
    for (const char c : text) {
        if (c == '&')
            out += "&amp;";
        else if (c == '<')
            out += "&lt;";
        else if (c == '"')
            out += "&quot;";
        else
            out += c;
    }
    return out;
}

std::string base64(std::string_view bytes) {
    static constexpr char kDigits[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    out.reserve((bytes.size() + 2) / 3 * 4);
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
        std::uint32_t group = 0;
        for (std::size_t k = 0; k < 3; ++k)
            group = group << 8 | (k < n ? std::uint8_t(bytes[i + k]) : 0u);
        for (std::size_t k = 0; k < 4; ++k)
            out += k <= n ? kDigits[group >> (18 - 6 * k) & 63] : '=';
    }
    return out;
}

/// The member as text; empty if there is none, or it is null or no text.
std::string textOf(const Json& object, const char* name) {
    const auto found = object.is_object() ? object.find(name) : object.end();
    return found != object.end() && found->is_string() ? found->get<std::string>() : "";
}

Json memberOf(const Json& object, const char* name) {
    const auto found = object.is_object() ? object.find(name) : object.end();
    return found != object.end() ? *found : Json();
}

/// File names of the pictures, each once, in the order in which the results name them.
std::vector<std::string> pictureNames(const Json& results) {
    std::vector<std::string> names;
    std::set<std::string> known;
    const auto add = [&](const std::string& name) {
        if (!name.empty() && known.insert(name).second) names.push_back(name);
    };
    for (const Json& light : memberOf(results, "lights"))
        add(textOf(memberOf(light, "truth"), "image"));
    for (const Json& run : memberOf(results, "runs")) {
        add(textOf(run, "image"));
        add(textOf(run, "difference"));
    }
    return names;
}

Result<std::string> readPicture(const std::string& path) {
    static constexpr std::string_view kPng = "\x89PNG\r\n\x1a\n";
    std::error_code problem;
    const auto size = std::filesystem::file_size(path, problem);
    std::string bytes(problem ? 0 : size, '\0');
    std::ifstream in(path, std::ios::binary);
    if (problem || !in.read(bytes.data(), std::streamsize(size)))
        return Error{ErrorCode::io, printable(path) +
                                        ": cannot read this picture of the report: " +
                                        (problem ? problem.message() : "read failed")};
    if (!bytes.starts_with(kPng))
        return Error{ErrorCode::badFile,
                     printable(path) + ": this picture of the report is no PNG file"};
    return bytes;
}

}  // namespace

Result<std::string> makeReport(const Json& results, const std::string& folder) {
    const std::string_view whole(reinterpret_cast<const char*>(kReportTemplate),
                                 kReportTemplateSize);
    const std::size_t resultsAt = whole.find(kResultsMark);
    const std::size_t picturesAt = whole.find(kPicturesMark);

    std::string page(whole.substr(0, resultsAt));
    page += jsonForScript(results);
    const std::size_t between = resultsAt + kResultsMark.size();
    page += whole.substr(between, picturesAt - between);
    // Text that no browser decodes until the script asks for the picture.
    for (const std::string& name : pictureNames(results)) {
        const auto bytes = readPicture((std::filesystem::path(folder) / name).string());
        if (!bytes) return bytes.error();
        page += "<script type=\"text/plain\" data-picture=\"" + escapedAttribute(name) +
                "\">" + base64(*bytes) + "</script>\n";
    }
    page += whole.substr(picturesAt + kPicturesMark.size());
    return page;
}

}  // namespace mtsm::tools
