// bytes.h - little-endian numbers in and out of byte arrays, with bounds checked.
#pragma once
#include <bit>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

namespace mtsm::base {

static_assert(
    std::endian::native == std::endian::little,
    "planes are copied as they lie in memory: a big-endian port must swap them");

/// Reads from the front of a span. A read past the end gives zero and fails for good:
/// check ok() once after a group of reads, before using what they gave.
class ByteReader {
  public:
    explicit ByteReader(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}

    template <typename T>
    T get() {
        static_assert(std::is_trivially_copyable_v<T>);
        T value{};
        if (!take(sizeof(T))) return value;
        std::memcpy(&value, bytes_.data() + at_ - sizeof(T), sizeof(T));
        return value;
    }
    /// The next n bytes, or an empty span if there are fewer.
    std::span<const std::uint8_t> bytes(std::uint64_t n) {
        if (!take(n)) return {};
        return bytes_.subspan(at_ - n, n);
    }
    [[nodiscard]] bool ok() const { return ok_; }
    [[nodiscard]] std::uint64_t position() const { return at_; }
    [[nodiscard]] std::uint64_t left() const { return ok_ ? bytes_.size() - at_ : 0; }

  private:
    bool take(std::uint64_t n) {
        if (!ok_ || n > bytes_.size() - at_) return ok_ = false;
        at_ += n;
        return true;
    }
    std::span<const std::uint8_t> bytes_;
    std::uint64_t at_ = 0;
    bool ok_ = true;
};

/// Appends to a vector.
class ByteWriter {
  public:
    explicit ByteWriter(std::vector<std::uint8_t>& out) : out_(out) {}

    template <typename T>
    void put(T value) {
        static_assert(std::is_trivially_copyable_v<T>);
        const std::size_t at = out_.size();
        out_.resize(at + sizeof(T));
        std::memcpy(out_.data() + at, &value, sizeof(T));
    }
    void bytes(std::span<const std::uint8_t> b) {
        out_.insert(out_.end(), b.begin(), b.end());
    }
    void text(std::string_view s) { out_.insert(out_.end(), s.begin(), s.end()); }
    void zeros(std::size_t n) { out_.insert(out_.end(), n, std::uint8_t(0)); }

  private:
    std::vector<std::uint8_t>& out_;
};

}  // namespace mtsm::base
