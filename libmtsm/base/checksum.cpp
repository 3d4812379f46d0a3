#include "base/checksum.h"

#include <xxhash.h>

#include <new>

namespace mtsm::base {

std::uint64_t checksum(std::span<const std::uint8_t> bytes) noexcept {
    return XXH3_64bits(bytes.data(), bytes.size());
}

struct ChecksumStream::State {
    XXH3_state_t* xxh = XXH3_createState();
    ~State() { XXH3_freeState(xxh); }
};

ChecksumStream::ChecksumStream() : state_(std::make_unique<State>()) {
    if (!state_->xxh || XXH3_64bits_reset(state_->xxh) != XXH_OK) throw std::bad_alloc();
}

ChecksumStream::~ChecksumStream() = default;

void ChecksumStream::add(std::span<const std::uint8_t> bytes) noexcept {
    XXH3_64bits_update(state_->xxh, bytes.data(), bytes.size());
}

std::uint64_t ChecksumStream::value() const noexcept {
    return XXH3_64bits_digest(state_->xxh);
}

}  // namespace mtsm::base
