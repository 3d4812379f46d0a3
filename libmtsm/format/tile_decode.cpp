#include "format/tile_decode.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <type_traits>

#include "base/bytes.h"
#include "base/message.h"
#include "format/bad_file.h"
#include "format/frame.h"
#include "format/predict.h"
#include "format/unpredict.h"

namespace mtsm::format {
namespace {

using base::makeError;

/// What the plane at one position of the payload has to be.
struct PlaneSlot {
    PlaneKind kind;
    std::uint8_t channel;
};

std::vector<PlaneSlot> planesOf(const TileFacts& facts) {
    std::vector<PlaneSlot> slots = {{PlaneKind::counts, 0}, {PlaneKind::z, 0}};
    for (std::uint32_t c = 0; (facts.planes & kHasV) && c < facts.channels; ++c)
        slots.push_back({PlaneKind::v, static_cast<std::uint8_t>(c)});
    if (facts.planes & kHasN) slots.push_back({PlaneKind::n, 0});
    return slots;
}

std::string text(PlaneSlot slot) {
    switch (slot.kind) {
        case PlaneKind::counts:
            return "plane counts";
        case PlaneKind::z:
            return "plane z";
        case PlaneKind::v:
            return base::concat("plane v of channel ", int(slot.channel));
        case PlaneKind::n:
            break;
    }
    return "plane n";
}

std::uint64_t elementsOf(PlaneSlot slot, const TileFacts& facts) {
    return slot.kind == PlaneKind::counts ? facts.place.pixels() : facts.layers;
}

/// Everything about a record that can be wrong before its bytes are looked at.
Status checkRecord(const PlaneRecord& r, PlaneSlot slot, const TileFacts& facts) {
    const bool isFloat = slot.kind == PlaneKind::z || slot.kind == PlaneKind::v;
    if (r.kind != std::uint8_t(slot.kind) || r.channel != slot.channel)
        return bad("is announced as kind ", int(r.kind), ", channel ", int(r.channel));
    if (std::any_of(r.reserved.begin(), r.reserved.end(),
                    [](auto b) { return b != 0; }) ||
        r.reserved2 != 0)
        return bad("reserved bytes are not zero");
    if (r.elementSize != 4 && (isFloat || (r.elementSize != 1 && r.elementSize != 2)))
        return bad("elements of ", int(r.elementSize), " bytes");
    if (r.decodedLength != elementsOf(slot, facts) * r.elementSize)
        return bad("claims ", r.decodedLength, " decoded bytes, not ",
                   elementsOf(slot, facts), " elements of ", int(r.elementSize));
    if (r.encoding > std::uint8_t(PlaneEncoding::zstd))
        return bad("unknown encoding ", int(r.encoding));
    if (r.filter > std::uint8_t(PlaneFilter::delta))
        return bad("unknown filter ", int(r.filter));

    const auto encoding = PlaneEncoding(r.encoding);
    const auto filter = PlaneFilter(r.filter);
    if (encoding != PlaneEncoding::zstd && filter != PlaneFilter::none)
        return bad("filter ", int(r.filter), " on a plane that is not compressed");
    if (filter == PlaneFilter::shuffle && r.elementSize == 1)
        return bad("the shuffle filter on elements of one byte");
    if (isGuess(filter) && !isFloat)
        return bad("filter ", int(r.filter), " on a plane of integers");
    if (r.shift > 31 || (r.shift != 0 && !isGuess(filter)))
        return bad("shift ", int(r.shift), " with filter ", int(r.filter));
    if (encoding != PlaneEncoding::constant && r.constant != 0)
        return bad("a constant on a plane that is not constant");
    if (encoding == PlaneEncoding::constant && r.elementSize < 4 &&
        r.constant >> (8 * r.elementSize) != 0)
        return bad("constant ", r.constant, " does not fit in ", int(r.elementSize),
                   " bytes");
    const bool fits = encoding == PlaneEncoding::raw ? r.storedLength == r.decodedLength
                      : encoding == PlaneEncoding::constant
                          ? r.storedLength == 0
                          : r.storedLength < r.decodedLength;
    if (!fits)
        return bad("stores ", r.storedLength, " bytes for ", r.decodedLength,
                   " with encoding ", int(r.encoding));
    return {};
}

}  // namespace

std::uint64_t leastTileBytes(const TileFacts& facts) noexcept {
    std::uint64_t planes = 2;
    if (facts.planes & kHasV) planes += facts.channels;
    if (facts.planes & kHasN) planes += 1;
    return sizeof(TileRecord) + planes * sizeof(PlaneRecord);
}

std::uint64_t mostTileBytes(const TileFacts& facts) noexcept {
    std::uint64_t perLayer = 4;
    if (facts.planes & kHasV) perLayer += 4 * std::uint64_t(facts.channels);
    if (facts.planes & kHasN) perLayer += 4;
    return leastTileBytes(facts) + 4 * std::uint64_t(facts.place.pixels()) +
           perLayer * facts.layers;
}

std::uint64_t scratchBytes(const TileFacts& facts) noexcept {
    const std::uint64_t pixels = facts.place.pixels();
    // Counts, and of the largest plane the decompressed bytes and the elements.
    return 4 * pixels + 8 * std::max<std::uint64_t>(pixels, facts.layers);
}

struct TileDecoder::Scratch {
    FrameDecoder frames;
    std::vector<PlaneRecord> records;
    Bytes decoded;
    std::vector<std::uint32_t> counts;
    std::vector<std::uint32_t> values;  // of a plane that is neither constant nor raw

    /// Appends a plane's elements; `to` has the memory that it needs, or none.
    template <typename T>
    Status appendPlane(const PlaneRecord& r, BytesView stored,
                       std::span<const std::uint32_t> begin, std::uint32_t width,
                       std::vector<T>& to);
    Status readContent(const PlaneRecord& r, BytesView stored);
    void unpredict(PlaneFilter filter, std::span<const std::uint32_t> begin,
                   std::uint32_t width, float* to) const;
};

TileDecoder::TileDecoder() : scratch_(std::make_unique<Scratch>()) {}
TileDecoder::~TileDecoder() = default;
TileDecoder::TileDecoder(TileDecoder&&) noexcept = default;

const std::vector<PlaneRecord>& TileDecoder::records() const noexcept {
    return scratch_->records;
}

/// The content of a plane that is neither constant nor raw, into `values`: its elements,
/// or of a filter that guesses the differences, in the order in which they are stored.
Status TileDecoder::Scratch::readContent(const PlaneRecord& r, BytesView stored) {
    const std::size_t size = r.elementSize;
    const std::size_t n = r.decodedLength / size;
    BytesView bytes = stored;
    if (PlaneEncoding(r.encoding) == PlaneEncoding::zstd) {
        if (auto s = frames.decode(stored, r.decodedLength, decoded); !s) return s;
        bytes = decoded;
    }
    reuse(values, n);
    std::uint32_t* const to = values.data();
    const auto filter = PlaneFilter(r.filter);
    if (isGuess(filter)) {
        const int shift = r.shift;
        const std::uint8_t *const b0 = bytes.data(), *const b1 = b0 + n,
                                  *const b2 = b1 + n, *const b3 = b2 + n;
        for (std::size_t i = 0; i < n; ++i)
            to[i] = unzigzag(std::uint32_t(b0[i]) | std::uint32_t(b1[i]) << 8 |
                             std::uint32_t(b2[i]) << 16 | std::uint32_t(b3[i]) << 24)
                    << shift;
        return {};
    }
    // Byte j of element i lies at i * size + j, or shuffled at j * n + i.
    const bool apart = filter == PlaneFilter::shuffle || size == 1;
    for (std::size_t j = 0; j < size; ++j) {
        const std::uint8_t* const from = bytes.data() + j * (apart ? n : 1);
        const std::uint32_t keep = j > 0 ? ~std::uint32_t(0) : 0;
        const auto add = [&, shift = 8 * j](std::size_t step) {
            for (std::size_t i = 0; i < n; ++i)
                to[i] = (to[i] & keep) | std::uint32_t(from[i * step]) << shift;
        };
        apart ? add(1) : add(size);
    }
    return {};
}

/// Adds the differences in `values` to what is guessed.
void TileDecoder::Scratch::unpredict(PlaneFilter filter,
                                     std::span<const std::uint32_t> begin,
                                     std::uint32_t width, float* to) const {
    if (filter == PlaneFilter::gradient)
        return addGradient(begin, width, values.data(), to);
    forEachGuess<true>(begin, width, to, [&](std::uint32_t i, std::uint32_t guess) {
        const std::uint32_t bits = guess + values[i];
        to[i] = std::bit_cast<float>(bits);
        return bits;
    });
}

template <typename T>
Status TileDecoder::Scratch::appendPlane(const PlaneRecord& r, BytesView stored,
                                         std::span<const std::uint32_t> begin,
                                         std::uint32_t width, std::vector<T>& to) {
    static_assert(sizeof(T) == sizeof(std::uint32_t));
    const std::size_t n = r.decodedLength / r.elementSize, at = to.size();
    if (PlaneEncoding(r.encoding) == PlaneEncoding::constant) {
        to.insert(to.end(), n, std::bit_cast<T>(r.constant));
        return {};
    }
    const auto filter = PlaneFilter(r.filter);
    const bool raw =
        PlaneEncoding(r.encoding) == PlaneEncoding::raw && r.elementSize == sizeof(T);
    if (!raw) {
        if (auto s = readContent(r, stored); !s) return s;
    }
    to.resize(at + n);
    if constexpr (std::is_same_v<T, float>) {
        if (isGuess(filter)) {
            unpredict(filter, begin, width, to.data() + at);
            return {};
        }
    }
    const void* const elements =
        raw ? static_cast<const void*>(stored.data()) : values.data();
    std::memcpy(to.data() + at, elements, n * sizeof(T));
    return {};
}

namespace {

Status checkTileRecord(const TileRecord& t, const TileFacts& facts) {
    const TilePlace& p = facts.place;
    if (t.face != p.face || t.tx != p.tx || t.ty != p.ty)
        return bad("calls itself tile face ", t.face, " (", t.tx, ", ", t.ty, ")");
    if (t.width != p.width || t.height != p.height)
        return bad("has ", t.width, " x ", t.height, " pixels, not ", p.width, " x ",
                   p.height);
    if (t.layers != facts.layers)
        return bad("has ", t.layers, " layers, the index says ", facts.layers);
    if (t.planes != facts.planes)
        return bad("has planes ", t.planes, ", the index says ", facts.planes);
    if (t.reserved != 0) return bad("reserved bytes are not zero");
    return {};
}

/// Layers per pixel into offsets; they must add up to all layers.
Status sumCounts(std::span<const std::uint32_t> counts, std::uint32_t layers,
                 std::vector<std::uint32_t>& begin) {
    std::uint64_t sum = 0;
    for (const std::uint32_t count : counts)
        sum += count;
    if (sum != layers)
        return bad("layers of all pixels add up to ", sum > layers ? "more" : "fewer",
                   " than the tile's ", layers);
    begin.resize(counts.size() + 1);
    std::uint32_t next = 0;
    for (std::size_t i = 0; i < counts.size(); ++i) {
        begin[i] = next;
        next += counts[i];
    }
    begin.back() = next;
    return {};
}

}  // namespace

Result<Tile> TileDecoder::decode(BytesView payload, const TileFacts& facts) {
    Scratch& s = *scratch_;
    base::ByteReader in(payload);
    const auto head = in.get<TileRecord>();
    if (!in.ok()) return bad("ends within its first ", sizeof head, " bytes");
    if (auto status = checkTileRecord(head, facts); !status) return status.error();
    const std::vector<PlaneSlot> slots = planesOf(facts);
    if (head.planeCount != slots.size())
        return bad("has ", head.planeCount, " planes, not ", slots.size());
    s.records.clear();
    for (const PlaneSlot& slot : slots) {
        s.records.push_back(in.get<PlaneRecord>());
        if (!in.ok()) return bad("ends within the record of ", text(slot));
        if (auto status = checkRecord(s.records.back(), slot, facts); !status)
            return bad(text(slot), ": ", status.error().message);
    }

    Tile tile;
    for (std::size_t i = 0; i < slots.size(); ++i) {
        const PlaneRecord& r = s.records[i];
        const BytesView stored = in.bytes(r.storedLength);
        if (!in.ok()) return bad(text(slots[i]), ": reaches past the end");
        const auto appendTo = [&](auto& to) {
            return s.appendPlane(r, stored, tile.begin, facts.place.width, to);
        };
        Status status;
        switch (slots[i].kind) {
            case PlaneKind::counts:
                s.counts.clear();
                status = appendTo(s.counts);
                if (status) status = sumCounts(s.counts, facts.layers, tile.begin);
                break;
            case PlaneKind::z:
                status = appendTo(tile.z);
                break;
            case PlaneKind::v:
                tile.v.reserve(std::size_t(facts.layers) * facts.channels);
                status = appendTo(tile.v);
                break;
            case PlaneKind::n:
                status = appendTo(tile.n);
                break;
        }
        if (!status) return bad(text(slots[i]), ": ", status.error().message);
    }
    if (in.left() != 0) return bad(in.left(), " bytes are left over at its end");
    return tile;
}

}  // namespace mtsm::format
