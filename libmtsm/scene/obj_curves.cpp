// The polylines of OBJ files: `v` and `l` lines; everything else is passed over.
#include <algorithm>
#include <charconv>
#include <cstring>
#include <deque>
#include <limits>
#include <new>
#include <string_view>

#include "base/message.h"
#include "base/printable.h"
#include "scene/hair_reader.h"

namespace mtsm::scene {
namespace {

using base::makeError;

constexpr std::size_t kBlock = std::size_t(1) << 20;
constexpr std::size_t kLongestLine = std::size_t(1) << 28;
constexpr std::size_t kWordShown = 40;

/// A file's lines, one after another; those that end in a backslash go on.
class Lines {
  public:
    explicit Lines(const ByteFile& file) : file_(file) {}

    /// False at the end of the file.
    Result<bool> next(std::string& line) {
        line.clear();
        number_ += lines_;
        lines_ = 0;
        for (bool some = false;;) {
            if (at_ == block_.size()) {
                const std::uint64_t left = file_.size() - read_;
                const auto bytes = std::size_t(std::min<std::uint64_t>(left, kBlock));
                at_ = 0;
                if (Status s = file_.readArray(read_, block_, bytes); !s)
                    return s.error();
                read_ += bytes;
                if (bytes == 0) return some;
            }
            some = true;
            const char* const from = block_.data() + at_;
            const std::size_t left = block_.size() - at_;
            const void* const end = std::memchr(from, '\n', left);
            const std::size_t length =
                end ? std::size_t(static_cast<const char*>(end) - from) : left;
            line.append(from, length);
            at_ += length + (end ? 1 : 0);
            if (line.size() > kLongestLine)
                return makeError(ErrorCode::badFile, file_.path(), ": line ", number(),
                                 " is longer than ", kLongestLine,
                                 " bytes; it is no OBJ file, or damaged");
            if (!end) continue;
            ++lines_;
            if (!line.empty() && line.back() == '\r') line.pop_back();
            if (line.empty() || line.back() != '\\') return true;
            line.back() = ' ';
        }
    }
    /// Of the line that came last, counted from 1.
    [[nodiscard]] std::uint64_t number() const { return number_; }

  private:
    const ByteFile& file_;
    std::vector<char> block_;
    std::size_t at_ = 0;
    std::uint64_t read_ = 0, number_ = 1, lines_ = 0;
};

/// Takes the first word off `line`; empty at its end.
std::string_view takeWord(std::string_view& line) {
    const auto isSpace = [](char c) { return c == ' ' || c == '\t'; };
    std::size_t first = 0;
    while (first < line.size() && isSpace(line[first]))
        ++first;
    std::size_t end = first;
    while (end < line.size() && !isSpace(line[end]))
        ++end;
    const std::string_view word = line.substr(first, end - first);
    line.remove_prefix(end);
    return word;
}

class Parser {
  public:
    explicit Parser(const ByteFile& file) : file_(file), lines_(file) {}

    Result<ObjCurves> run() {
        std::string line;
        curves_.begin.push_back(0);
        for (;;) {
            const auto more = lines_.next(line);
            if (!more) return more.error();
            if (!*more) break;
            std::string_view rest = line;
            const std::string_view keyword = takeWord(rest);
            Status s;
            if (keyword == "v") s = vertex(rest);
            if (keyword == "l") s = polyline(rest);
            if (!s) return s.error();
        }
        if (curves_.corners.empty())
            return makeError(ErrorCode::badFile, file_.path(),
                             ": holds no polyline (a line that begins with \"l\")");
        for (std::size_t i = 0; i < curves_.corners.size(); ++i) {
            if (curves_.corners[i] >= curves_.vertices.size())
                return makeError(ErrorCode::badFile, file_.path(),
                                 ": a polyline refers to vertex ",
                                 std::uint64_t(curves_.corners[i]) + 1, " of ",
                                 curves_.vertices.size(), "; repair or re-export it");
        }
        return std::move(curves_);
    }

  private:
    template <typename... Parts>
    Error bad(const Parts&... parts) const {
        return makeError(ErrorCode::badFile, file_.path(), ": line ", lines_.number(),
                         ": ", parts...);
    }

    Status vertex(std::string_view rest) {
        glm::vec3 p;
        for (int axis = 0; axis < 3; ++axis) {
            std::string_view word = takeWord(rest);
            if (!word.empty() && word[0] == '+') word.remove_prefix(1);
            const auto [end, error] =
                std::from_chars(word.data(), word.data() + word.size(), p[axis]);
            if (error == std::errc::result_out_of_range) {
                p[axis] = word.find("e-") == word.npos && word.find("E-") == word.npos
                              ? std::numeric_limits<float>::infinity()
                              : 0.0f;
            } else if (error != std::errc() || end != word.data() + word.size()) {
                return bad("found \"", base::printable(word, kWordShown),
                           "\" where a vertex has coordinate ", axis + 1,
                           " of 3; repair or re-export it");
            }
        }
        if (curves_.vertices.size() == std::numeric_limits<std::uint32_t>::max())
            return bad("more than 4294967295 vertices; split the file");
        curves_.vertices.push_back(p);
        return {};
    }

    Status polyline(std::string_view rest) {
        const std::size_t first = curves_.corners.size();
        for (;;) {
            const std::string_view word = takeWord(rest);
            if (word.empty()) break;
            const std::string_view index = word.substr(0, word.find('/'));
            std::int64_t i = 0;
            const auto [end, error] =
                std::from_chars(index.data(), index.data() + index.size(), i);
            const auto vertices = std::int64_t(curves_.vertices.size());
            const std::int64_t from0 = i < 0 ? vertices + i : i - 1;
            if (error != std::errc() || end != index.data() + index.size() || from0 < 0 ||
                from0 >= std::numeric_limits<std::uint32_t>::max())
                return bad("found \"", base::printable(word, kWordShown),
                           "\" where a polyline has the number of a vertex, of which ",
                           vertices, " came before; repair or re-export it");
            if (curves_.corners.size() - first == kMostPoints)
                return bad("a polyline has more than ", kMostPoints, " points; split it");
            curves_.corners.push_back(std::uint32_t(from0));
        }
        const std::size_t corners = curves_.corners.size() - first;
        if (corners < 2)
            return bad("a polyline has ", corners, corners == 1 ? " point" : " points",
                       ", expected two or more; repair or re-export it");
        curves_.begin.push_back(curves_.corners.size());
        return {};
    }

    const ByteFile& file_;
    Lines lines_;
    ObjCurves curves_;
};

/// Puts lines of two points together: many exporters write strands that way.
class Joiner {
  public:
    explicit Joiner(ObjCurves& curves) : in_(curves), uses_(curves.vertices.size()) {
        for (std::size_t s = 0; s + 1 < in_.begin.size(); ++s) {
            for (std::uint64_t i = in_.begin[s]; i < in_.begin[s + 1]; ++i) {
                const bool end = i == in_.begin[s] || i + 1 == in_.begin[s + 1];
                std::uint8_t& uses = uses_[in_.corners[i]];
                uses = std::uint8_t(std::min(255, uses + (end ? 1 : 2)));
            }
        }
    }

    void run() {
        begin_.push_back(0);
        for (std::size_t s = 0; s + 1 < in_.begin.size(); ++s) {
            const std::uint32_t* const corners = in_.corners.data() + in_.begin[s];
            const std::uint64_t count = in_.begin[s + 1] - in_.begin[s];
            if (count == 2 && join(corners[0], corners[1])) continue;
            flush();
            if (count == 2)
                strand_ = {corners[0], corners[1]};
            else
                put(corners, corners + count);
        }
        flush();
        in_.corners = std::move(corners_);
        in_.begin = std::move(begin_);
    }

  private:
    bool join(std::uint32_t a, std::uint32_t b) {
        if (strand_.empty() || strand_.size() >= kMostPoints) return false;
        const auto meets = [&](std::uint32_t end, std::uint32_t of) {
            return end == of && uses_[of] == 2;
        };
        if (meets(a, strand_.back()))
            strand_.push_back(b);
        else if (meets(b, strand_.back()))
            strand_.push_back(a);
        else if (meets(b, strand_.front()))
            strand_.push_front(a);
        else if (meets(a, strand_.front()))
            strand_.push_front(b);
        else
            return false;
        return true;
    }
    void flush() {
        if (!strand_.empty()) put(strand_.begin(), strand_.end());
        strand_.clear();
    }
    template <typename Iterator>
    void put(Iterator first, Iterator last) {
        corners_.insert(corners_.end(), first, last);
        begin_.push_back(corners_.size());
    }

    ObjCurves& in_;
    std::vector<std::uint8_t> uses_;  // [vertices]: ends of segments there, up to 255
    std::deque<std::uint32_t> strand_;
    std::vector<std::uint32_t> corners_;
    std::vector<std::uint64_t> begin_;
};

class CurvesReader final : public HairReader {
  public:
    explicit CurvesReader(const ObjCurves& curves) : curves_(curves) {}

    Result<bool> next(HairChunk& chunk) override {
        chunk.begin.assign(1, 0);
        chunk.points.clear();
        while (strand_ + 1 < curves_.begin.size() && chunk.strands() < kChunkStrands &&
               chunk.points.size() < kChunkPoints) {
            for (std::uint64_t i = curves_.begin[strand_]; i < curves_.begin[strand_ + 1];
                 ++i)
                chunk.points.push_back(curves_.vertices[curves_.corners[i]]);
            chunk.begin.push_back(std::uint32_t(chunk.points.size()));
            ++strand_;
        }
        return chunk.strands() > 0;
    }

  private:
    const ObjCurves& curves_;
    std::size_t strand_ = 0;
};

}  // namespace

Result<ObjCurves> readObjCurves(const ByteFile& file) {
    auto curves = Parser(file).run();
    if (curves) Joiner(*curves).run();
    return curves;
}

std::unique_ptr<HairReader> openObjCurves(const ObjCurves& curves) {
    return std::make_unique<CurvesReader>(curves);
}

}  // namespace mtsm::scene

namespace mtsm {

Result<ObjContent> objContent(const std::string& path) try {
    const auto file = scene::ByteFile::open(path);
    if (!file) return file.error();
    ObjContent content;
    scene::Lines lines(**file);
    std::string line;
    while (!content.polylines || !content.faces) {
        const auto more = lines.next(line);
        if (!more) return more.error();
        if (!*more) break;
        std::string_view rest = line;
        const std::string_view keyword = scene::takeWord(rest);
        content.polylines = content.polylines || keyword == "l";
        content.faces = content.faces || keyword == "f";
    }
    return content;
} catch (const std::bad_alloc&) {
    return base::makeError(ErrorCode::tooLarge, path,
                           ": there is not enough memory to read one of its lines");
}

}  // namespace mtsm
