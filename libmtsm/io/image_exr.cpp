// FloatImage -> OpenEXR.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>

#include <algorithm>
#include <set>
#include <vector>

#include "base/file_output.h"
#include "base/message.h"
#include "mtsm/image.h"

namespace mtsm {
namespace {

using base::makeError;

/// OpenEXR goes back to fill in its table of offsets, so the file is made in memory.
class MemoryStream final : public Imf::OStream {
  public:
    explicit MemoryStream(const std::string& path) : OStream(path.c_str()) {}
    void write(const char* bytes, int size) override {
        const std::size_t end = at_ + std::size_t(size);
        if (end > bytes_.size()) bytes_.resize(end);
        std::copy_n(bytes, size, bytes_.begin() + std::ptrdiff_t(at_));
        at_ = end;
    }
    std::uint64_t tellp() override { return at_; }
    void seekp(std::uint64_t position) override { at_ = position; }
    [[nodiscard]] const std::vector<std::uint8_t>& bytes() const { return bytes_; }

  private:
    std::vector<std::uint8_t> bytes_;
    std::size_t at_ = 0;
};

bool fitsWindow(PixelWindow w) {
    constexpr std::int64_t kLargest = 0x3fffffff;  // OpenEXR's own bound on coordinates
    return w.width >= 1 && w.height >= 1 && w.x >= -kLargest && w.y >= -kLargest &&
           std::int64_t(w.x) + w.width <= kLargest &&
           std::int64_t(w.y) + w.height <= kLargest;
}

Status checkImage(const std::string& path, const FloatImage& image) {
    const auto invalid = [&](const auto&... parts) -> Status {
        return makeError(ErrorCode::badArgument, path, ": ", parts...);
    };
    if (!fitsWindow(image.data) || !fitsWindow(image.display))
        return invalid("an image of ", image.data.width, " x ", image.data.height,
                       " pixels cannot be written: its windows must hold a pixel and lie "
                       "within 2^30 of the origin");
    if (image.channels.empty()) return invalid("the image has no channels");
    std::set<std::string> names;
    const std::size_t pixels = std::size_t(image.data.width) * image.data.height;
    for (const FloatImage::Channel& c : image.channels) {
        if (c.name.empty() || c.name.size() > 255 || !names.insert(c.name).second)
            return invalid("channel name \"", c.name,
                           "\" is empty, too long or twice there");
        if (c.values.size() != pixels)
            return invalid("channel ", c.name, " has ", c.values.size(), " values for ",
                           pixels, " pixels");
    }
    for (const auto& [name, text] : image.attributes) {
        if (name.empty() || name.size() > 255)
            return invalid("attribute name \"", name, "\" must have 1 to 255 bytes");
    }
    return {};
}

Imath::Box2i box(PixelWindow w) {
    return {{w.x, w.y}, {w.x + int(w.width) - 1, w.y + int(w.height) - 1}};
}

}  // namespace

Status writeImageExr(const std::string& path, const FloatImage& image) {
    if (auto s = checkImage(path, image); !s) return s;
    try {
        Imf::Header header(box(image.display), box(image.data));
        header.compression() = Imf::ZIP_COMPRESSION;
        for (const auto& [name, text] : image.attributes)
            header.insert(name, Imf::StringAttribute(text));
        Imf::FrameBuffer frame;
        for (const FloatImage::Channel& c : image.channels) {
            header.channels().insert(c.name, Imf::Channel(Imf::FLOAT));
            frame.insert(c.name, Imf::Slice::Make(Imf::FLOAT, c.values.data(),
                                                  header.dataWindow()));
        }
        MemoryStream stream(path);
        {
            Imf::OutputFile file(stream, header, 0);
            file.setFrameBuffer(frame);
            file.writePixels(int(image.data.height));
        }  // writes the table of offsets
        return base::writeFile(path, stream.bytes());
    } catch (const std::exception& e) {
        return makeError(ErrorCode::badArgument, path, ": cannot be written: ", e.what());
    }
}

}  // namespace mtsm
