// file_surgery.h - takes an MTSM file apart and puts it together again with every
// checksum right, so that a test can ask what the checks behind the checksums find.
#pragma once
#include <bit>
#include <cstring>
#include <functional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "base/bytes.h"
#include "base/checksum.h"
#include "format/index.h"
#include "format/layout.h"

namespace mtsm::test {

using format::Bytes;
using format::BytesView;

template <typename Record>
Record peek(BytesView bytes, std::size_t offset) {
    return base::ByteReader(bytes.subspan(offset)).get<Record>();
}

template <typename Record>
void poke(Bytes& bytes, std::size_t offset, const Record& record) {
    if (offset + sizeof record > bytes.size()) throw std::out_of_range("poke");
    std::memcpy(bytes.data() + offset, &record, sizeof record);
}

/// Changes a record in place.
template <typename Record>
void edit(Bytes& bytes, std::size_t offset, const std::function<void(Record&)>& change) {
    auto record = peek<Record>(bytes, offset);
    change(record);
    poke(bytes, offset, record);
}

struct Surgery {
    struct Part {
        format::BlockType type;
        std::uint32_t flags;
        Bytes payload;
    };
    format::Prefix prefix = {};
    std::vector<Part> parts;  ///< every block but INDX, in the order of the file
    /// Change the index, the trailer or the whole file after everything else was sealed.
    std::function<void(format::Index&)> onIndex;
    std::function<void(format::IndexFixed&)> onIndexFixed;
    std::function<void(format::Trailer&)> onTrailer;

    explicit Surgery(const Bytes& file) {
        prefix = peek<format::Prefix>(file, 0);
        for (std::size_t at = sizeof(format::Prefix);;) {
            const auto h = peek<format::BlockHeader>(file, at);
            if (h.type == format::kIndx) break;
            const auto* first = file.data() + at + sizeof h;
            parts.push_back({h.type, h.flags, Bytes(first, first + h.length)});
            at += format::blockSpan(h.length);
        }
    }

    /// The n-th block of a type.
    Part& part(format::BlockType type, int n = 0) {
        for (Part& p : parts) {
            if (p.type == type && n-- == 0) return p;
        }
        throw std::logic_error("no such block");
    }
    Bytes& payload(format::BlockType type, int n = 0) { return part(type, n).payload; }

    /// Where the n-th plane's record of a TILE payload lies.
    static std::size_t planeAt(int n) {
        return sizeof(format::TileRecord) + std::size_t(n) * sizeof(format::PlaneRecord);
    }

    [[nodiscard]] Bytes close() const {
        Bytes file;
        base::ByteWriter out(file);
        format::Prefix p = prefix;
        p.checksum = seal(p);
        out.put(p);
        const format::TileGrid grid(p);
        format::Index index;
        index.tiles.resize(grid.count());
        for (const Part& part : parts) {
            const std::uint64_t sum = base::checksum(part.payload);
            if (part.type == format::kTile) {
                const auto t = peek<format::TileRecord>(part.payload, 0);
                const std::size_t i =
                    (std::size_t(t.face) * grid.tilesY + t.ty) * grid.tilesX + t.tx;
                if (i < index.tiles.size())
                    index.tiles[i] = {file.size(), part.payload.size(), t.layers,
                                      t.planes, sum};
            } else {
                index.blocks.push_back(
                    {part.type, part.flags, file.size(), part.payload.size(), sum});
            }
            putBlock(file, part);
        }
        if (onIndex) onIndex(index);
        Part last = {format::kIndx, format::kCritical, format::encodeIndex(index, p)};
        if (onIndexFixed) edit<format::IndexFixed>(last.payload, 0, onIndexFixed);
        format::Trailer t = {};
        t.indexOffset = file.size();
        putBlock(file, last);
        t.fileLength = file.size() + sizeof t;
        t.finished = format::kFinished;
        if (onTrailer) onTrailer(t);
        t.checksum = seal(t);
        out.put(t);
        return file;
    }

    /// Checksum of a record whose last 8 bytes are its checksum.
    template <typename Record>
    [[nodiscard]] static std::uint64_t seal(const Record& r) {
        const auto bytes = std::bit_cast<std::array<std::uint8_t, sizeof r>>(r);
        return base::checksum(BytesView(bytes).first(sizeof r - 8));
    }

  private:
    static void putBlock(Bytes& file, const Part& part) {
        format::BlockHeader h = {};
        h.type = part.type;
        h.flags = part.flags;
        h.length = part.payload.size();
        h.payloadChecksum = base::checksum(part.payload);
        h.headerChecksum = seal(h);
        base::ByteWriter out(file);
        out.put(h);
        out.bytes(part.payload);
        out.zeros(format::blockSpan(h.length) - sizeof h - h.length);
    }
};

}  // namespace mtsm::test
