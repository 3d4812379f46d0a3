// OpenEXR files that may be hostile. Layout of the header: "OpenEXR File Layout" in the
// OpenEXR documentation.
#include "io/exr_file.h"

#include <IexBaseExc.h>
#include <ImfChannelList.h>
#include <ImfCompression.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputPart.h>
#include <ImfTileDescription.h>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "base/message.h"
#include "base/printable.h"
#include "base/system_error.h"

namespace mtsm::io {
namespace {

using base::makeError;
using base::printable;

constexpr std::uint32_t kMultiPartFlag = 0x1000;
constexpr std::size_t kLongestName = 255;
constexpr std::int64_t kLargestChunk = std::int64_t(1) << 30;  // decoded bytes
constexpr int kBandRows = 64;                                  // rows per call, at most
constexpr std::int64_t kBandBytes = std::int64_t(64) << 20;    // of them, as floats

std::uint32_t readUint32(ExrStream& stream) {
    unsigned char b[4];
    stream.read(reinterpret_cast<char*>(b), 4);
    return b[0] | std::uint32_t(b[1]) << 8 | std::uint32_t(b[2]) << 16 |
           std::uint32_t(b[3]) << 24;
}

std::string readName(ExrStream& stream) {
    std::string name;
    for (char c = 0; stream.read(&c, 1), c != 0;) {
        name.push_back(c);
        if (name.size() > kLongestName)
            throw Iex::InputExc("a name in the header does not end within 255 bytes");
    }
    return name;
}

/// One header up to its end mark; false if there is none left (multi-part).
Status walkHeader(ExrStream& stream, const std::string& path, bool& empty) {
    empty = true;
    for (std::string name; !(name = readName(stream)).empty(); empty = false) {
        readName(stream);  // type
        const std::uint32_t size = readUint32(stream);
        const std::uint64_t left = stream.length() - stream.tellg();
        if (size > left)
            return makeError(ErrorCode::badFile, path, ": damaged EXR: the attribute at ",
                             "offset ", stream.tellg(), " claims ", size,
                             " bytes, but only ", left, " are left in the file");
        stream.seekg(stream.tellg() + size);
    }
    return {};
}

int linesPerChunk(const Imf::Header& header) {
    switch (header.compression()) {
        case Imf::ZIP_COMPRESSION:
        case Imf::PXR24_COMPRESSION:
            return 16;
        case Imf::PIZ_COMPRESSION:
        case Imf::B44_COMPRESSION:
        case Imf::B44A_COMPRESSION:
        case Imf::DWAA_COMPRESSION:
            return 32;
        case Imf::DWAB_COMPRESSION:
            return 256;
        default:
            return 1;
    }
}

/// Rows of a chunk (or of a row of tiles); an error if it would take more than memory
/// should be asked for.
Result<int> chunkRows(const Imf::Header& header, std::int64_t width,
                      const std::string& path) {
    std::int64_t bytesPerPixel = 0;
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c)
        bytesPerPixel += c.channel().type == Imf::HALF ? 2 : 4;
    std::int64_t rows = linesPerChunk(header), columns = width;
    if (header.hasTileDescription()) {
        rows = header.tileDescription().ySize;
        columns = std::max<std::int64_t>(width, header.tileDescription().xSize);
    }
    if (rows < 1 || columns > kLargestChunk / rows ||
        columns * rows > kLargestChunk / std::max<std::int64_t>(bytesPerPixel, 1))
        return makeError(ErrorCode::tooLarge, path, ": chunks of ", columns, " x ", rows,
                         " pixels with ", bytesPerPixel,
                         " bytes each are larger than 1 GiB");
    return static_cast<int>(rows);
}

/// Rows per call: whole chunks, at least one, within both bounds of a band.
int bandRows(int rowsOfChunk, std::int64_t bytesOfRow) {
    const std::int64_t rows = std::min<std::int64_t>(kBandRows, kBandBytes / bytesOfRow);
    return static_cast<int>(std::max<std::int64_t>(rows / rowsOfChunk, 1) * rowsOfChunk);
}

}  // namespace

Result<std::unique_ptr<ExrStream>> ExrStream::open(const std::string& path) {
    // Opening a pipe that nobody writes to would wait for ever: O_NONBLOCK does not.
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0)
        return makeError(ErrorCode::io, path,
                         ": cannot open: ", base::systemReason(errno));
    std::unique_ptr<ExrStream> stream(new ExrStream);
    stream->file_ = ::fdopen(fd, "rb");
    struct stat info = {};
    if (!stream->file_ || ::fstat(fd, &info) != 0) {
        const int reason = errno;
        if (!stream->file_) ::close(fd);
        return makeError(ErrorCode::io, path,
                         ": cannot open: ", base::systemReason(reason));
    }
    if (S_ISDIR(info.st_mode))
        return makeError(ErrorCode::io, path, ": is a folder, not an EXR file");
    if (!S_ISREG(info.st_mode))
        return makeError(ErrorCode::io, path,
                         ": is no regular file; an EXR is not read from front to back");
    stream->length_ = static_cast<std::uint64_t>(info.st_size);
    return stream;
}

ExrStream::~ExrStream() {
    if (file_) std::fclose(file_);
}

bool ExrStream::read(char* bytes, int size) {
    if (size < 0 || std::uint64_t(size) > length_ - std::min(position_, length_))
        throw Iex::InputExc("the file ends too early");
    if (std::fread(bytes, 1, std::size_t(size), file_) != std::size_t(size))
        throw Iex::InputExc("the system could not read the file");
    position_ += std::uint64_t(size);
    return position_ < length_;
}

void ExrStream::seekg(std::uint64_t position) {
    if (position > length_) throw Iex::InputExc("an offset points behind the file's end");
    if (::fseeko(file_, static_cast<off_t>(position), SEEK_SET) != 0)
        throw Iex::InputExc("the system could not seek in the file");
    position_ = position;
}

void ExrStream::clear() {
    std::clearerr(file_);
}

Error exrError(const std::string& path, const char* what) {
    // OpenEXR says `Cannot read image file "NAME". Reason.`: our streams have no name.
    // What it quotes may hold any bytes of the file.
    static constexpr const char* kNoName = "file \"\". ";
    std::string text(what);
    for (std::size_t at; (at = text.find(kNoName)) != std::string::npos;)
        text.erase(0, at + std::strlen(kNoName));
    return makeError(ErrorCode::badFile, path, ": damaged EXR: ", printable(text, 300));
}

Error exrMemoryError(const std::string& path) {
    return makeError(ErrorCode::tooLarge, path,
                     ": not enough memory for what this EXR says it holds");
}

Status checkExrHeader(ExrStream& stream, const std::string& path) {
    return guardExr(path, [&]() -> Status {
        constexpr std::uint32_t kMagic = 20000630;
        if (stream.length() < 8 || readUint32(stream) != kMagic)
            return makeError(ErrorCode::badFile, path, ": is not an OpenEXR file");
        const bool multiPart = readUint32(stream) & kMultiPartFlag;
        bool empty = false;
        do {
            if (auto s = walkHeader(stream, path, empty); !s) return s;
        } while (multiPart && !empty);
        stream.seekg(0);
        return {};
    });
}

PixelWindow exrDataWindow(const Imf::MultiPartInputFile& file, int part) {
    const Imath::Box2i box = file.header(part).dataWindow();
    return {box.min.x, box.min.y,
            static_cast<std::uint32_t>(std::int64_t(box.max.x) - box.min.x + 1),
            static_cast<std::uint32_t>(std::int64_t(box.max.y) - box.min.y + 1)};
}

Status readExrChannels(
    Imf::MultiPartInputFile& file, int part, const std::vector<std::string>& channels,
    const std::string& path,
    const std::function<void(const float* values, std::size_t pixels)>& sink) {
    const Imf::Header& header = file.header(part);
    const PixelWindow window = exrDataWindow(file, part);
    for (const std::string& name : channels) {
        const Imf::Channel& c = header.channels()[name];
        if (c.xSampling != 1 || c.ySampling != 1)
            return makeError(ErrorCode::unsupported, path, ": channel ",
                             printable(name, 80), " is subsampled ", c.xSampling, " x ",
                             c.ySampling, "; a pass needs a value for every pixel");
    }
    auto rows = chunkRows(header, window.width, path);
    if (!rows) return rows.error();

    Imf::InputPart input(file, part);
    const std::size_t stride = channels.size() * sizeof(float);
    const int step = bandRows(*rows, std::int64_t(stride) * window.width);
    std::vector<float> band;
    for (std::int64_t y = 0; y < window.height; y += step) {
        const auto count =
            static_cast<int>(std::min<std::int64_t>(step, window.height - y));
        band.resize(std::size_t(count) * window.width * channels.size());
        const int top = static_cast<int>(window.y + y);
        Imf::FrameBuffer frame;
        for (std::size_t c = 0; c < channels.size(); ++c)
            frame.insert(
                channels[c],
                Imf::Slice::Make(Imf::FLOAT, band.data() + c, Imath::V2i(window.x, top),
                                 window.width, count, stride, stride * window.width));
        input.setFrameBuffer(frame);
        input.readPixels(top, top + count - 1);
        sink(band.data(), std::size_t(count) * window.width);
    }
    return {};
}

}  // namespace mtsm::io
