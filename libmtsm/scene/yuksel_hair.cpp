// Cem Yuksel's .hair: a header of 128 bytes, then whole arrays one after another, each
// there or not: segments per strand (u16), points, thickness, transparency, colours.
#include <algorithm>
#include <cstring>

#include "base/bytes.h"
#include "base/message.h"
#include "scene/hair_reader.h"

namespace mtsm::scene {
namespace {

using base::makeError;

constexpr std::uint64_t kHeaderBytes = 128;
enum Flag : std::uint32_t {
    kSegments = 1,
    kPoints = 2,
    kThickness = 4,
    kTransparency = 8,
    kColours = 16
};

struct Header {
    std::uint32_t strands = 0, points = 0, flags = 0, segments = 0;
    float thickness = 0, transparency = 0;

    [[nodiscard]] bool has(Flag flag) const { return (flags & flag) != 0; }
};

template <typename... Parts>
Error bad(const ByteFile& file, const Parts&... parts) {
    return makeError(ErrorCode::badFile, file.path(), ": ", parts...);
}

class YukselReader final : public HairReader {
  public:
    YukselReader(const ByteFile& file, const Header& header, HairWanted wanted)
        : file_(file), header_(header) {
        if (!header.has(kThickness)) width = header.thickness;
        if (!header.has(kTransparency)) transparency = header.transparency;
        std::uint64_t at = kHeaderBytes;
        const auto place = [&](Flag flag, std::uint64_t bytes) {
            const std::uint64_t here = at;
            if (header.has(flag)) at += bytes;
            return here;
        };
        segmentsAt_ = place(kSegments, std::uint64_t(header.strands) * 2);
        pointsAt_ = place(kPoints, std::uint64_t(header.points) * 12);
        thicknessAt_ = place(kThickness, std::uint64_t(header.points) * 4);
        transparencyAt_ = place(kTransparency, std::uint64_t(header.points) * 4);
        place(kColours, std::uint64_t(header.points) * 12);
        end_ = at;
        readWidths_ = wanted.widths && header.has(kThickness);
        readTransparency_ = wanted.transparency && header.has(kTransparency);
    }

    Status check() const {
        if (end_ > file_.size())
            return bad(file_, "its header declares ", header_.strands, " strands and ",
                       header_.points, " points, which take ", end_,
                       " bytes, but the file has ", file_.size(),
                       "; it is cut off or damaged: export it again");
        std::uint64_t points = 0;
        if (!header_.has(kSegments)) {
            if (header_.segments == 0 || header_.segments >= kMostPoints)
                return bad(file_, "its header gives every strand ", header_.segments,
                           " segments, expected 1 to ", kMostPoints - 1,
                           "; it is damaged: export it again");
            points = std::uint64_t(header_.strands) * (header_.segments + 1);
        }
        std::vector<std::uint16_t> segments;
        for (std::uint64_t s = 0; header_.has(kSegments) && s < header_.strands;) {
            const auto n =
                std::size_t(std::min<std::uint64_t>(kChunkStrands, header_.strands - s));
            if (Status r = file_.readArray(segmentsAt_ + 2 * s, segments, n); !r)
                return r;
            for (std::size_t i = 0; i < n; ++i) {
                if (segments[i] == 0)
                    return bad(file_, "strand ", s + i,
                               " has no segment, so only one point, expected two or "
                               "more; remove such strands and export it again");
                points += segments[i] + 1u;
            }
            s += n;
        }
        if (points != header_.points)
            return bad(file_, "its ", header_.strands, " strands have ", points,
                       " points, but its header declares ", header_.points,
                       "; it is damaged: export it again");
        return {};
    }

    Result<bool> next(HairChunk& chunk) override {
        chunk.begin.assign(1, 0);
        const auto most = std::size_t(
            std::min<std::uint64_t>(kChunkStrands, header_.strands - strand_));
        if (most == 0) return false;
        if (header_.has(kSegments)) {
            if (Status r = file_.readArray(segmentsAt_ + 2 * strand_, segments_, most);
                !r)
                return r.error();
        }
        std::uint64_t points = 0;
        for (std::size_t i = 0; i < most && points < kChunkPoints; ++i) {
            points += header_.has(kSegments) ? segments_[i] + 1u : header_.segments + 1u;
            chunk.begin.push_back(std::uint32_t(points));
        }
        // check() has added them up; but that was a while ago.
        if (points > header_.points - point_)
            return makeError(ErrorCode::io, file_.path(), ": changed while it was read");
        const auto count = std::size_t(points);
        chunk.widths.clear();
        chunk.transparency.clear();
        Status r = file_.readArray(pointsAt_ + 12 * point_, chunk.points, count);
        if (r && readWidths_)
            r = file_.readArray(thicknessAt_ + 4 * point_, chunk.widths, count);
        if (r && readTransparency_)
            r = file_.readArray(transparencyAt_ + 4 * point_, chunk.transparency, count);
        if (!r) return r.error();
        strand_ += chunk.strands();
        point_ += count;
        return true;
    }

  private:
    const ByteFile& file_;
    Header header_;
    std::uint64_t segmentsAt_, pointsAt_, thicknessAt_, transparencyAt_, end_;
    bool readWidths_, readTransparency_;
    std::uint64_t strand_ = 0, point_ = 0;  // where the next chunk starts
    std::vector<std::uint16_t> segments_;
};

}  // namespace

HairReaderResult openYukselHair(const ByteFile& file, HairWanted wanted) {
    if (file.size() < kHeaderBytes)
        return bad(file, "has ", file.size(), " bytes, but a .hair header alone takes ",
                   kHeaderBytes, "; it is cut off or no .hair file");
    std::uint8_t bytes[kHeaderBytes];
    if (Status s = file.read(0, bytes, kHeaderBytes); !s) return s.error();
    if (std::memcmp(bytes, "HAIR", 4) != 0)
        return bad(file, "does not begin with \"HAIR\"; it is no .hair file");
    base::ByteReader in(std::span<const std::uint8_t>(bytes).subspan(4));
    Header header;
    header.strands = in.get<std::uint32_t>();
    header.points = in.get<std::uint32_t>();
    header.flags = in.get<std::uint32_t>();
    header.segments = in.get<std::uint32_t>();
    header.thickness = in.get<float>();
    header.transparency = in.get<float>();
    if (!header.has(kPoints) || header.points == 0 || header.strands == 0)
        return bad(file, "declares ", header.strands, " strands and ",
                   header.has(kPoints) ? header.points : 0u,
                   " points, expected some of both; export it again with its points");
    auto reader = std::make_unique<YukselReader>(file, header, wanted);
    if (Status s = reader->check(); !s) return s.error();
    return std::unique_ptr<HairReader>(std::move(reader));
}

}  // namespace mtsm::scene
