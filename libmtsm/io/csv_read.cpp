// Points and rays from CSV files.
#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <glm/geometric.hpp>
#include <limits>
#include <new>
#include <optional>
#include <string_view>

#include "base/message.h"
#include "base/printable.h"
#include "mtsm/points.h"

namespace mtsm {
namespace {

using base::concat;
using base::makeError;
using base::printable;

constexpr std::size_t kBlock = std::size_t(1) << 20;  // bytes read at once
constexpr std::size_t kLongestLine = std::size_t(1) << 20;
constexpr std::size_t kMostColumns = 4096;
constexpr std::size_t kMostShown = 40;  // bytes of a field in a message

/// The lines of a file or of standard input, without their ends.
class LineReader {
  public:
    static Result<LineReader> open(const std::string& path) {
        LineReader reader;
        reader.name_ = path == "-" ? "standard input" : path;
        reader.file_ =
            path == "-" ? stdin : std::fopen(path.c_str(), "rbe");  // e: close on exec
        if (!reader.file_)
            return makeError(ErrorCode::io, path,
                             ": cannot open: ", std::strerror(errno));
        return reader;
    }
    LineReader(LineReader&& other) noexcept
        : name_(std::move(other.name_)), file_(std::exchange(other.file_, nullptr)) {}
    LineReader& operator=(LineReader&&) = delete;
    ~LineReader() {
        if (file_ && file_ != stdin) std::fclose(file_);
    }

    /// The next line, valid until the next call; nothing at the end.
    Result<std::optional<std::string_view>> next() {
        std::size_t scanned = 0;
        for (;;) {
            const char* start = buffer_.data() + begin_;
            const void* newline =
                std::memchr(start + scanned, '\n', end_ - begin_ - scanned);
            if (newline) return line(static_cast<const char*>(newline) - start, 1);
            scanned = end_ - begin_;
            if (scanned > kLongestLine)
                return makeError(ErrorCode::badFile, name_, ":", number_ + 1,
                                 ": the line is longer than 1 MiB; is this a CSV file?");
            if (atEnd_) {
                if (scanned == 0) return std::optional<std::string_view>();
                return line(scanned, 0);
            }
            if (auto s = fill(); !s) return s.error();
        }
    }

    [[nodiscard]] std::uint64_t number() const noexcept { return number_; }
    [[nodiscard]] const std::string& name() const noexcept { return name_; }

  private:
    LineReader() = default;

    std::optional<std::string_view> line(std::size_t length, std::size_t endLength) {
        std::string_view text(buffer_.data() + begin_, length);
        begin_ += length + endLength;
        if (!text.empty() && text.back() == '\r') text.remove_suffix(1);
        if (++number_ == 1 && text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
        return text;
    }

    Status fill() {
        std::memmove(buffer_.data(), buffer_.data() + begin_, end_ - begin_);
        end_ -= begin_;
        begin_ = 0;
        buffer_.resize(end_ + kBlock);
        errno = 0;
        const std::size_t got = std::fread(buffer_.data() + end_, 1, kBlock, file_);
        end_ += got;
        atEnd_ = got < kBlock;
        if (atEnd_ && std::ferror(file_))
            return makeError(ErrorCode::io, name_,
                             ": cannot read: ", std::strerror(errno));
        return {};
    }

    std::string name_;
    std::FILE* file_ = nullptr;
    std::vector<char> buffer_ = std::vector<char>(1);
    std::size_t begin_ = 0, end_ = 0;
    std::uint64_t number_ = 0;  // of the line that was returned last
    bool atEnd_ = false;
};

/// A column that a reader asks for.
struct WantedColumn {
    const char* name;
    bool required = true;
    std::optional<double> whenEmpty;
};

std::string_view withoutBlanks(std::string_view text) {
    const auto blank = [](char c) { return c == ' ' || c == '\t'; };
    while (!text.empty() && blank(text.front()))
        text.remove_prefix(1);
    while (!text.empty() && blank(text.back()))
        text.remove_suffix(1);
    return text;
}

/// A field without the blanks around it and without its quotes.
std::string_view trimmed(std::string_view text) {
    text = withoutBlanks(text);
    if (text.size() >= 2 && text.front() == '"' && text.back() == '"')
        text = text.substr(1, text.size() - 2);
    return text;
}

/// Where the field that begins at `from` ends: at a comma outside quotes, or with the
/// line.
std::size_t fieldEnd(std::string_view line, std::size_t from) {
    bool quoted = false;
    for (std::size_t i = from; i < line.size(); ++i) {
        if (line[i] == '"') quoted = !quoted;
        if (line[i] == ',' && !quoted) return i;
    }
    return line.size();
}

/// A number as a user may write it; nothing if `text` is none.
std::optional<double> parseNumber(std::string_view text) {
    if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
    double value = 0.0;
    const auto [end, problem] =
        std::from_chars(text.data(), text.data() + text.size(), value);
    if (end != text.data() + text.size() || text.empty()) return std::nullopt;
    // Beyond a double's range: strtod knows which way (infinity or zero).
    if (problem == std::errc::result_out_of_range)
        return std::strtod(std::string(text).c_str(), nullptr);
    if (problem != std::errc()) return std::nullopt;
    return value;
}

/// The table that readers share: finds the wanted columns and hands out their numbers.
class Table {
  public:
    using OnHeader = std::function<Status(const std::vector<bool>& present)>;
    /// [wanted]: the row's numbers; absent columns hold their whenEmpty or 0.
    using OnRow = std::function<void(const double* values)>;

    Table(LineReader& lines, std::vector<WantedColumn> wanted)
        : lines_(lines), wanted_(std::move(wanted)) {}

    Status read(const OnHeader& onHeader, const OnRow& onRow) {
        bool headed = false;
        for (;;) {
            auto next = lines_.next();
            if (!next) return next.error();
            if (!*next) break;
            const std::string_view text = **next;
            const std::string_view content = withoutBlanks(text);
            if (content.empty() || content.front() == '#') continue;
            Status s = headed ? readRow(text, onRow) : readHeader(text, onHeader);
            if (!s) return s;
            headed = true;
        }
        if (!headed)
            return makeError(ErrorCode::badFile, lines_.name(),
                             ": is empty; expected a line that names the columns ",
                             wantedNames());
        return {};
    }

    /// An error at a column (counted from 1 in bytes) of the current line.
    template <typename... Parts>
    Error errorAt(std::size_t column, const Parts&... parts) const {
        return makeError(ErrorCode::badFile, lines_.name(), ":", lines_.number(), ":",
                         column, ": ", parts...);
    }

  private:
    static constexpr int kIgnored = -1;

    std::string wantedNames() const {
        std::string names;
        for (const WantedColumn& w : wanted_) {
            if (w.required) names += concat(names.empty() ? "" : ",", w.name);
        }
        return names;
    }

    Status readHeader(std::string_view line, const OnHeader& onHeader) {
        std::vector<bool> present(wanted_.size());
        for (std::size_t at = 0, end = 0; at <= line.size(); at = end + 1) {
            end = fieldEnd(line, at);
            std::string name(trimmed(line.substr(at, end - at)));
            for (char& c : name)
                c = char(std::tolower(static_cast<unsigned char>(c)));
            int slot = kIgnored;
            for (std::size_t w = 0; w < wanted_.size(); ++w) {
                if (name != wanted_[w].name) continue;
                if (present[w])
                    return errorAt(at + 1, "column ", wanted_[w].name, " is there twice");
                present[w] = true;
                slot = static_cast<int>(w);
            }
            slots_.push_back(slot);
            if (slots_.size() > kMostColumns)
                return errorAt(at + 1, "more than ", kMostColumns, " columns");
        }
        for (std::size_t w = 0; w < wanted_.size(); ++w) {
            if (wanted_[w].required && !present[w])
                return errorAt(1, "found \"", printable(line, kMostShown),
                               "\", but the first line must ", "name the columns ",
                               wantedNames(), "; there is no ", wanted_[w].name);
        }
        values_.resize(wanted_.size());
        for (std::size_t w = 0; w < wanted_.size(); ++w)
            values_[w] = wanted_[w].whenEmpty.value_or(0.0);
        return onHeader(present);
    }

    Status readRow(std::string_view line, const OnRow& onRow) {
        std::size_t at = 0, count = 0;
        for (std::size_t end = 0; at <= line.size(); at = end + 1, ++count) {
            end = fieldEnd(line, at);
            if (count == slots_.size()) break;
            if (slots_[count] == kIgnored) continue;
            const auto w = static_cast<std::size_t>(slots_[count]);
            const std::string_view field = trimmed(line.substr(at, end - at));
            auto value = field.empty() ? wanted_[w].whenEmpty : parseNumber(field);
            if (!value)
                return errorAt(at + 1, "found \"", printable(field, kMostShown),
                               "\", expected a number for ", wanted_[w].name);
            values_[w] = *value;
        }
        if (count < slots_.size())
            return errorAt(line.size() + 1, "found ", count, " fields, expected ",
                           slots_.size(), " as in the line of names");
        if (at <= line.size())
            return errorAt(at + 1, "found more than the ", slots_.size(),
                           " fields that the line of names has");
        onRow(values_.data());
        return {};
    }

    LineReader& lines_;
    std::vector<WantedColumn> wanted_;
    std::vector<int> slots_;  // per column of the file: which wanted one it is
    std::vector<double> values_;
};

Error outOfMemory(const std::string& path, std::size_t rows) {
    return makeError(ErrorCode::tooLarge, path, ": not enough memory after ", rows,
                     " rows; split the file");
}

}  // namespace

Result<PointList> readPoints(const std::string& path) {
    PointList list;
    try {
        auto lines = LineReader::open(path);
        if (!lines) return lines.error();
        Table table(*lines, {{"x", true, {}},
                             {"y", true, {}},
                             {"z", true, {}},
                             {"nx", false, {}},
                             {"ny", false, {}},
                             {"nz", false, {}}});
        bool normals = false;
        auto done = table.read(
            [&](const std::vector<bool>& present) -> Status {
                normals = present[3];
                if (present[3] != present[4] || present[4] != present[5])
                    return table.errorAt(
                        1, "found some of the columns nx, ny, nz; a normal ",
                        "needs all three");
                return {};
            },
            [&](const double* v) {
                list.points.emplace_back(v[0], v[1], v[2]);
                if (normals) list.normals.emplace_back(v[3], v[4], v[5]);
            });
        if (!done) return done.error();
    } catch (const std::bad_alloc&) {
        return outOfMemory(path, list.points.size());
    }
    return list;
}

Result<std::vector<ShadowRay>> readRays(const std::string& path,
                                        std::vector<glm::dvec3>* directions) {
    constexpr double kEndless = std::numeric_limits<double>::infinity();
    std::vector<ShadowRay> rays;
    try {
        auto lines = LineReader::open(path);
        if (!lines) return lines.error();
        Table table(*lines, {{"ox", true, {}},
                             {"oy", true, {}},
                             {"oz", true, {}},
                             {"dx", true, {}},
                             {"dy", true, {}},
                             {"dz", true, {}},
                             {"tmax", false, kEndless}});
        auto done = table.read([](const std::vector<bool>&) { return Status(); },
                               [&](const double* v) {
                                   ShadowRay ray;
                                   ray.origin = {v[0], v[1], v[2]};
                                   ray.direction = {v[3], v[4], v[5]};
                                   if (directions) directions->push_back(ray.direction);
                                   const double length = std::hypot(v[3], v[4], v[5]);
                                   if (length > 0.0) ray.direction /= length;
                                   ray.length = v[6];
                                   rays.push_back(ray);
                               });
        if (!done) return done.error();
    } catch (const std::bad_alloc&) {
        return outOfMemory(path, rays.size());
    }
    return rays;
}

}  // namespace mtsm
