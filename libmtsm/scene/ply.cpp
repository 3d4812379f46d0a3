#include "scene/ply.h"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>
#include <fstream>
#include <optional>
#include <sstream>
#include <string_view>

#include "base/message.h"

namespace mtsm::scene {
namespace {

enum class Type { int8, uint8, int16, uint16, int32, uint32, float32, float64 };

std::optional<Type> typeOf(const std::string& name) {
    static constexpr std::pair<std::string_view, Type> kTypes[] = {
        {"char", Type::int8},      {"int8", Type::int8},       {"uchar", Type::uint8},
        {"uint8", Type::uint8},    {"short", Type::int16},     {"int16", Type::int16},
        {"ushort", Type::uint16},  {"uint16", Type::uint16},   {"int", Type::int32},
        {"int32", Type::int32},    {"uint", Type::uint32},     {"uint32", Type::uint32},
        {"float", Type::float32},  {"float32", Type::float32}, {"double", Type::float64},
        {"float64", Type::float64}};
    for (const auto& [spelling, type] : kTypes)
        if (spelling == name) return type;
    return std::nullopt;
}

struct Property {
    std::string name;
    Type type = Type::float32;
    std::optional<Type> countType;  // of a list
};

struct Element {
    std::string name;
    std::uint64_t count = 0;
    std::vector<Property> properties;
};

enum class Encoding { ascii, littleEndian, bigEndian };

struct Header {
    Encoding encoding = Encoding::ascii;
    std::vector<Element> elements;
    std::size_t bytes = 0;
};

bool addProperty(std::istringstream& words, std::vector<Element>& elements) {
    std::string type, countType, name;
    if (elements.empty() || !(words >> type)) return false;
    Property property;
    if (type == "list") {
        if (!(words >> countType >> type)) return false;
        property.countType = typeOf(countType);
        if (!property.countType) return false;
    }
    const auto known = typeOf(type);
    if (!known || !(words >> property.name)) return false;
    property.type = *known;
    elements.back().properties.push_back(std::move(property));
    return true;
}

bool setEncoding(const std::string& word, Encoding& encoding) {
    if (word == "ascii")
        encoding = Encoding::ascii;
    else if (word == "binary_little_endian")
        encoding = Encoding::littleEndian;
    else if (word == "binary_big_endian")
        encoding = Encoding::bigEndian;
    else
        return false;
    return true;
}

std::optional<Header> parseHeader(std::string_view file) {
    Header header;
    for (bool first = true;; first = false) {
        const std::size_t end = file.find('\n', header.bytes);
        if (end == file.npos) return std::nullopt;
        std::istringstream words(
            std::string(file.substr(header.bytes, end - header.bytes)));
        header.bytes = end + 1;
        std::string keyword, word;
        words >> keyword;
        if (first ? keyword != "ply" : keyword == "ply") return std::nullopt;
        if (keyword == "end_header") return header;
        if (keyword == "format") {
            if (!(words >> word) || !setEncoding(word, header.encoding))
                return std::nullopt;
        } else if (keyword == "element") {
            Element element;
            if (!(words >> element.name >> element.count)) return std::nullopt;
            header.elements.push_back(std::move(element));
        } else if (keyword == "property") {
            if (!addProperty(words, header.elements)) return std::nullopt;
        }
    }
}

/// Numbers one after another, until there is none.
class Numbers {
  public:
    Numbers(std::string_view data, Encoding encoding)
        : data_(data), encoding_(encoding) {}

    std::optional<double> next(Type type) {
        if (encoding_ == Encoding::ascii) return nextWord();
        switch (type) {
            case Type::int8:
                return nextBinary<std::int8_t>();
            case Type::uint8:
                return nextBinary<std::uint8_t>();
            case Type::int16:
                return nextBinary<std::int16_t>();
            case Type::uint16:
                return nextBinary<std::uint16_t>();
            case Type::int32:
                return nextBinary<std::int32_t>();
            case Type::uint32:
                return nextBinary<std::uint32_t>();
            case Type::float32:
                return nextBinary<float>();
            case Type::float64:
                return nextBinary<double>();
        }
        return std::nullopt;
    }

  private:
    std::optional<double> nextWord() {
        const auto isSpace = [](char c) { return c == ' ' || (c >= '\t' && c <= '\r'); };
        while (at_ < data_.size() && isSpace(data_[at_]))
            ++at_;
        if (at_ < data_.size() && data_[at_] == '+') ++at_;
        double value = 0;
        const char* first = data_.data() + at_;
        const auto [stop, error] =
            std::from_chars(first, data_.data() + data_.size(), value);
        if (error == std::errc::invalid_argument) return std::nullopt;
        at_ += std::size_t(stop - first);
        return value;
    }
    template <typename T>
    std::optional<double> nextBinary() {
        if (data_.size() - at_ < sizeof(T)) return std::nullopt;
        char bytes[sizeof(T)];
        std::memcpy(bytes, data_.data() + at_, sizeof(T));
        at_ += sizeof(T);
        const bool little = std::endian::native == std::endian::little;
        if (little != (encoding_ == Encoding::littleEndian))
            std::reverse(bytes, bytes + sizeof(T));
        T value;
        std::memcpy(&value, bytes, sizeof(T));
        return double(value);
    }

    std::string_view data_;
    Encoding encoding_;
    std::size_t at_ = 0;
};

/// A strip's corner k makes a triangle with the two before it, every other one turned
/// around; -1 starts a new strip.
class StripCutter {
  public:
    explicit StripCutter(std::vector<std::uint32_t>& triangles) : triangles_(triangles) {}
    void add(std::int64_t corner) {
        if (corner == -1) {
            length_ = 0;
            return;
        }
        if (++length_ > 2) {
            const bool turned = length_ % 2 == 0;
            for (std::int64_t i : {turned ? before_[1] : before_[0],
                                   turned ? before_[0] : before_[1], corner})
                triangles_.push_back(std::uint32_t(i));
        }
        before_[0] = before_[1];
        before_[1] = corner;
    }

  private:
    std::vector<std::uint32_t>& triangles_;
    std::int64_t before_[2] = {0, 0};
    std::uint64_t length_ = 0;
};

class Scanner {
  public:
    Scanner(const Header& header, std::string_view data)
        : header_(header), numbers_(data, header.encoding) {
        for (const Element& e : header.elements) {
            if (e.name == "vertex") vertices_ = e.count;
            if (e.name == "tristrips") scan_.hasStrips = true;
        }
    }

    PlyScan run() {
        for (const Element& element : header_.elements) {
            if (scan_.hasStrips && element.name == "face" && element.count > 0)
                return fail("it has both faces and triangle strips; export one of them");
            if (element.properties.empty()) continue;
            for (std::uint64_t i = 0; i < element.count; ++i)
                if (!item(element, i)) return std::move(scan_);
        }
        if (scan_.hasStrips && scan_.coordinates.size() != 3 * vertices_)
            return fail("its vertices have no x, y and z");
        return std::move(scan_);
    }

  private:
    bool item(const Element& element, std::uint64_t index) {
        StripCutter cutter(scan_.stripTriangles);
        for (const Property& p : element.properties) {
            const auto first = numbers_.next(p.countType.value_or(p.type));
            if (!first) return endsEarly(element, index);
            if (!p.countType) {
                keepCoordinate(element, p, index, *first);
                continue;
            }
            const bool corners =
                (element.name == "face" || element.name == "tristrips") &&
                (p.name == "vertex_indices" || p.name == "vertex_index");
            for (double k = 0; k < *first; ++k) {
                const auto value = numbers_.next(p.type);
                if (!value) return endsEarly(element, index);
                if (!corners) continue;
                const bool restart = scan_.hasStrips && *value == -1.0;
                if (!restart && !(*value >= 0.0 && *value < double(vertices_)))
                    return outOfRange(element, index, *value);
                if (scan_.hasStrips) cutter.add(std::int64_t(*value));
            }
        }
        return true;
    }
    void keepCoordinate(const Element& element, const Property& p, std::uint64_t index,
                        double value) {
        if (!scan_.hasStrips || element.name != "vertex") return;
        if (p.name.size() != 1 || p.name[0] < 'x' || p.name[0] > 'z') return;
        scan_.coordinates.resize(3 * (index + 1));
        scan_.coordinates[3 * index + std::size_t(p.name[0] - 'x')] = float(value);
    }

    bool endsEarly(const Element& element, std::uint64_t index) {
        fail(base::concat("it ends, or holds no number, at ", element.name, " ", index,
                          " of ", element.count, "; the file is cut off or damaged"));
        return false;
    }
    bool outOfRange(const Element& element, std::uint64_t index, double value) {
        fail(base::concat(element.name, " ", index, " refers to vertex ",
                          std::int64_t(value), " of ", vertices_,
                          "; re-export or repair the file"));
        return false;
    }
    PlyScan fail(std::string problem) {
        scan_.problem = std::move(problem);
        return scan_;
    }

    const Header& header_;
    Numbers numbers_;
    PlyScan scan_;
    std::uint64_t vertices_ = 0;
};

/// All bytes of a file; what there is if it cannot be read to its end.
std::string contentsOf(const std::string& path) {
    std::ifstream in(path, std::ios::binary | std::ios::ate);
    if (!in) return {};
    std::string bytes(std::size_t(std::max<std::streamoff>(in.tellg(), 0)), '\0');
    in.seekg(0);
    in.read(bytes.data(), std::streamsize(bytes.size()));
    bytes.resize(std::size_t(in.gcount()));
    return bytes;
}

}  // namespace

PlyScan scanPly(const std::string& path) {
    const std::string file = contentsOf(path);
    const auto header = parseHeader(file);
    if (!header) return {};
    return Scanner(*header, std::string_view(file).substr(header->bytes)).run();
}

}  // namespace mtsm::scene
