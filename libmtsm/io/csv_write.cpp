// Results as CSV.
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>

#include "base/file_output.h"
#include "base/message.h"
#include "mtsm/points.h"

namespace mtsm {
namespace {

using base::makeError;

constexpr std::size_t kBlock = std::size_t(1) << 18;  // characters gathered per write
constexpr std::size_t kLongestNumber = 32;            // shortest decimals need fewer

/// Hands over the text in blocks; `write` returns false to stop.
template <typename Write>
void formatCsv(const std::vector<CsvColumn>& columns, std::size_t rows, Write&& write) {
    std::string text;
    for (const CsvColumn& c : columns)
        text += (text.empty() ? "" : ",") + c.name;
    text += '\n';
    for (std::size_t row = 0; row < rows; ++row) {
        for (const CsvColumn& c : columns) {
            char digits[kLongestNumber];
            const auto end = std::visit(
                [&](const auto* values) {
                    return std::to_chars(digits, digits + kLongestNumber,
                                         values[row * c.stride]);
                },
                c.values);
            text.append(digits, end.ptr);
            text += &c == &columns.back() ? '\n' : ',';
        }
        if (text.size() < kBlock) continue;
        if (!write(text)) return;
        text.clear();
    }
    write(text);
}

Status writeToStandardOutput(const std::vector<CsvColumn>& columns, std::size_t rows) {
    bool good = true;
    errno = 0;
    formatCsv(columns, rows, [&](const std::string& text) {
        return good = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
    });
    if (!good || std::fflush(stdout) != 0)
        return makeError(ErrorCode::io, "standard output: cannot write: ",
                         std::strerror(errno ? errno : EIO));
    return {};
}

}  // namespace

Status writeCsv(const std::string& path, const std::vector<CsvColumn>& columns,
                std::size_t rows) {
    if (columns.empty())
        return makeError(ErrorCode::badArgument, path, ": a CSV file needs a column");
    if (path == "-") return writeToStandardOutput(columns, rows);
    base::FileOutput file(path);
    if (auto s = file.open(); !s) return s;
    Status written;
    formatCsv(columns, rows, [&](const std::string& text) {
        written = file.write(base::bytesOf(text));
        return written.ok();
    });
    return written ? file.commit() : written;
}

}  // namespace mtsm
