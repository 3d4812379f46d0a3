// TressFX .tfx: a header that says where arrays lie; every strand has as many vertices.
//
// Version 4 has its counts and offsets in the first 32 of 160 bytes and vertices of four
// floats, the last of which says whether they move. Version 3 has counts in the first 20
// of 296 bytes, offsets from byte 144 on, and vertices of three floats; its thickness
// array holds factors of a width that is not in the file.
#include <algorithm>
#include <cmath>

#include "base/bytes.h"
#include "base/message.h"
#include "scene/hair_reader.h"

namespace mtsm::scene {
namespace {

using base::makeError;

template <typename... Parts>
Error bad(const ByteFile& file, const Parts&... parts) {
    return makeError(ErrorCode::badFile, file.path(), ": ", parts...);
}

struct Header {
    std::uint32_t strands = 0, vertices = 0;         // vertices per strand
    std::uint64_t headerBytes = 0, floats = 0;       // floats per vertex
    std::uint64_t positionsAt = 0, thicknessAt = 0;  // thickness: 0 if there is none
};

class TfxReader final : public HairReader {
  public:
    TfxReader(const ByteFile& file, const Header& header, HairWanted wanted)
        : file_(file), header_(header) {
        readThickness_ = wanted.widths && header.thicknessAt != 0;
    }

    Status check() const {
        if (header_.strands == 0)
            return bad(file_, "declares no strands, expected one or more");
        if (header_.vertices < 2 || header_.vertices > kMostPoints)
            return bad(file_, "declares ", header_.vertices,
                       " vertices per strand, expected 2 to ", kMostPoints,
                       "; it is damaged: export it again");
        const std::uint64_t vertices = std::uint64_t(header_.strands) * header_.vertices;
        if (Status s = fits("vertex positions", header_.positionsAt,
                            vertices * header_.floats * sizeof(float));
            !s)
            return s;
        if (header_.thicknessAt == 0) return {};
        return fits("strand thickness", header_.thicknessAt,
                    std::uint64_t(header_.strands) * sizeof(float));
    }

    Result<bool> next(HairChunk& chunk) override {
        const std::size_t perStrand = header_.vertices;
        const auto strands = std::size_t(
            std::min<std::uint64_t>({kChunkStrands, (kChunkPoints - 1) / perStrand + 1,
                                     header_.strands - strand_}));
        chunk.begin.resize(strands + 1);
        for (std::size_t i = 0; i <= strands; ++i)
            chunk.begin[i] = std::uint32_t(i * perStrand);
        if (strands == 0) return false;
        const std::size_t points = strands * perStrand, floats = header_.floats;
        const std::uint64_t first = strand_ * perStrand;
        if (Status s = file_.readArray(header_.positionsAt + 4 * floats * first, buffer_,
                                       points * floats);
            !s)
            return s.error();
        chunk.points.resize(points);
        for (std::size_t i = 0; i < points; ++i) {
            const float* p = buffer_.data() + i * floats;
            chunk.points[i] = {p[0], p[1], p[2]};
        }
        chunk.widths.clear();
        if (readThickness_) {
            if (Status s =
                    file_.readArray(header_.thicknessAt + 4 * strand_, buffer_, strands);
                !s)
                return s.error();
            for (const float thickness : buffer_)
                chunk.widths.insert(chunk.widths.end(), perStrand, thickness);
        }
        strand_ += strands;
        return true;
    }

  private:
    Status fits(const char* what, std::uint64_t at, std::uint64_t bytes) const {
        if (at >= header_.headerBytes && at <= file_.size() && bytes <= file_.size() - at)
            return {};
        return bad(file_, what, " of ", header_.strands, " strands with ",
                   header_.vertices, " vertices each take ", bytes, " bytes from offset ",
                   at, " on, but the file has ", file_.size(), " and a header of ",
                   header_.headerBytes, "; it is cut off or damaged: export it again");
    }

    const ByteFile& file_;
    Header header_;
    bool readThickness_;
    std::uint64_t strand_ = 0;  // where the next chunk starts
    std::vector<float> buffer_;
};

}  // namespace

HairReaderResult openTfx(const ByteFile& file, HairWanted wanted) {
    constexpr std::size_t kHeader4 = 160, kHeader3 = 296, kOffsets3 = 144;
    std::vector<std::uint8_t> bytes;
    const auto size = std::size_t(std::min<std::uint64_t>(kHeader3, file.size()));
    if (Status s = file.readArray(0, bytes, size); !s) return s.error();
    base::ByteReader in(bytes);
    const auto version = in.get<float>();
    Header header;
    header.strands = in.get<std::uint32_t>();
    header.vertices = in.get<std::uint32_t>();
    const bool four = version >= 4.0f && version < 5.0f;
    if (in.ok() && !four && !(version >= 3.0f && version < 4.0f))
        return makeError(ErrorCode::unsupported, file.path(),
                         ": is a .tfx file of version ", version,
                         ", readable are 3 and 4; or it is no .tfx file");
    header.headerBytes = four ? kHeader4 : kHeader3;
    if (file.size() < header.headerBytes)
        return bad(file, "has ", file.size(), " bytes, but a .tfx header alone takes ",
                   header.headerBytes, "; it is cut off or no .tfx file");
    header.floats = four ? 4 : 3;
    if (four) {
        header.positionsAt = in.get<std::uint32_t>();
        in.get<std::uint32_t>();  // texture coordinates of strands
        in.get<std::uint32_t>();  // and of vertices
        header.thicknessAt = in.get<std::uint32_t>();
    } else {
        in.bytes(kOffsets3 - in.position());
        header.positionsAt = in.get<std::uint32_t>();
    }
    auto reader = std::make_unique<TfxReader>(file, header, wanted);
    if (Status s = reader->check(); !s) return s.error();
    return std::unique_ptr<HairReader>(std::move(reader));
}

}  // namespace mtsm::scene
