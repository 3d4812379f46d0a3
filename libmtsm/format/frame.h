// frame.h - one zstd frame, as every compressed part of a file is one.
#pragma once
#include <zstd.h>

#include <cstdint>
#include <memory>
#include <new>

#include "format/bad_file.h"
#include "format/header.h"

namespace mtsm::format {

/// Resizes memory that is used again and again: its content is lost, and no more than
/// `size` elements are ever held for its sake.
template <typename T>
void reuse(std::vector<T>& scratch, std::size_t size) {
    if (scratch.capacity() < size) scratch = std::vector<T>();
    scratch.resize(size);
}

/// Decodes frames one after another; one per thread.
class FrameDecoder {
  public:
    FrameDecoder() {
        if (!context_) throw std::bad_alloc();
    }

    /// Exactly one frame, that states exactly this content size, into `decoded`. Errors:
    /// badFile.
    Status decode(BytesView frame, std::uint64_t decodedLength, Bytes& decoded) {
        const auto content = ZSTD_getFrameContentSize(frame.data(), frame.size());
        if (content == ZSTD_CONTENTSIZE_ERROR || content == ZSTD_CONTENTSIZE_UNKNOWN)
            return bad("no zstd frame that states its content size");
        if (content != decodedLength)
            return bad("a zstd frame of ", content, " bytes, not ", decodedLength);
        if (ZSTD_findFrameCompressedSize(frame.data(), frame.size()) != frame.size())
            return bad("more or less than one zstd frame");
        reuse(decoded, decodedLength);
        const std::size_t got = ZSTD_decompressDCtx(
            context_.get(), decoded.data(), decoded.size(), frame.data(), frame.size());
        if (ZSTD_isError(got)) return bad("zstd: ", ZSTD_getErrorName(got));
        if (got != decodedLength)
            return bad("zstd gave ", got, " bytes, not ", decodedLength);
        return {};
    }

  private:
    struct Free {
        void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
    };
    std::unique_ptr<ZSTD_DCtx, Free> context_{ZSTD_createDCtx()};
};

}  // namespace mtsm::format
