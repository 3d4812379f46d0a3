// exr_file.h - OpenEXR files that may be hostile: opened, proved and read in bands.
//
// OpenEXR throws; what calls into it goes through guardExr, the one edge where exceptions
// become errors.
#pragma once
#include <ImfIO.h>
#include <ImfMultiPartInputFile.h>

#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "mtsm/image.h"
#include "mtsm/result.h"

namespace mtsm::io {

/// A file as OpenEXR wants to see it. Reading past the end throws, as the interface asks.
class ExrStream final : public Imf::IStream {
  public:
    /// A regular file; everything else is refused without waiting. Errors: io.
    static Result<std::unique_ptr<ExrStream>> open(const std::string& path);
    ~ExrStream() override;

    bool read(char* bytes, int size) override;
    std::uint64_t tellg() override { return position_; }
    void seekg(std::uint64_t position) override;
    void clear() override;
    [[nodiscard]] std::uint64_t length() const noexcept { return length_; }

  private:
    ExrStream() : IStream("") {}

    std::FILE* file_ = nullptr;
    std::uint64_t length_ = 0, position_ = 0;
};

/// Runs `body` (Status() or Result<T>()) and turns what it throws into an Error about
/// `path`.
template <typename Body>
auto guardExr(const std::string& path, Body&& body) -> decltype(body());

/// Walks the header's attributes without reading them: every size must fit in the file,
/// because OpenEXR allocates what they claim. Leaves the stream at its beginning.
Status checkExrHeader(ExrStream& stream, const std::string& path);

/// Some channels of one part, widened to float, interleaved, from the top row down.
/// `sink` gets every pixel once, in bands of whole rows of at most 64 MiB (or one row of
/// chunks), so that memory grows only with what the file proves to hold. Refuses
/// subsampled channels and chunks beyond reason.
Status readExrChannels(
    Imf::MultiPartInputFile& file, int part, const std::vector<std::string>& channels,
    const std::string& path,
    const std::function<void(const float* values, std::size_t pixels)>& sink);

/// A part's data window. Sizes fit in 32 bits because OpenEXR checks them on opening.
[[nodiscard]] PixelWindow exrDataWindow(const Imf::MultiPartInputFile& file, int part);

// --- implementation ------------------------------------------------------------------

[[nodiscard]] Error exrError(const std::string& path, const char* what);
[[nodiscard]] Error exrMemoryError(const std::string& path);

template <typename Body>
auto guardExr(const std::string& path, Body&& body) -> decltype(body()) {
    try {
        return body();
    } catch (const std::bad_alloc&) {
        return exrMemoryError(path);
    } catch (const std::exception& e) {
        return exrError(path, e.what());
    }
}

}  // namespace mtsm::io
