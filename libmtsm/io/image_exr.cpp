// FloatImage -> OpenEXR.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>

#include <set>

#include "base/message.h"
#include "io/atomic_output.h"
#include "mtsm/image.h"

namespace mtsm {
namespace {

using base::makeError;

/// Failures stay in the AtomicOutput as well: OutputFile's destructor writes the table of
/// offsets and swallows what is thrown meanwhile.
class OutputStream final : public Imf::OStream {
  public:
    OutputStream(io::AtomicOutput& out, const std::string& path)
        : OStream(path.c_str()), out_(out) {}
    void write(const char* bytes, int size) override {
        if (!out_.write(bytes, std::size_t(size)))
            throw Iex::IoExc("the system could not write the file");
    }
    std::uint64_t tellp() override { return out_.tell(); }
    void seekp(std::uint64_t position) override {
        if (!out_.seek(position)) throw Iex::IoExc("the system could not seek");
    }

  private:
    io::AtomicOutput& out_;
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
    auto out = io::AtomicOutput::create(path);
    if (!out) return out.error();
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
        OutputStream stream(*out, path);
        Imf::OutputFile file(stream, header, 0);
        file.setFrameBuffer(frame);
        file.writePixels(int(image.data.height));
    } catch (const std::exception& e) {
        if (!out->failed())
            return makeError(ErrorCode::badArgument, path,
                             ": cannot be written: ", e.what());
    }
    return out->commit();
}

}  // namespace mtsm
