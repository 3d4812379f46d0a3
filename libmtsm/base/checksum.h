// checksum.h - the one checksum of the file format: XXH3-64 with seed 0 and the default
// secret (https://github.com/Cyan4973/xxHash, "XXH3 64-bit").
//
// It finds damage (a flipped bit, a cut, a block of another file), not malice: whoever
// can change bytes can change a checksum too.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace mtsm::base {

/// Of all bytes at once.
[[nodiscard]] std::uint64_t checksum(std::span<const std::uint8_t> bytes) noexcept;

/// The same of bytes that come in pieces, in constant memory.
class ChecksumStream {
  public:
    ChecksumStream();  ///< throws std::bad_alloc
    ~ChecksumStream();
    ChecksumStream(const ChecksumStream&) = delete;
    ChecksumStream& operator=(const ChecksumStream&) = delete;

    void add(std::span<const std::uint8_t> bytes) noexcept;
    /// Of all that was added so far.
    [[nodiscard]] std::uint64_t value() const noexcept;

  private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace mtsm::base
