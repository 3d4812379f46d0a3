// Each plane becomes, in this order of preference: a constant, the smallest zstd frame
// among the filters that suit it, raw bytes. Which filters are tried was measured: see
// "Rationale: filters" in format-spec/mtsm-format.md.
#include "format/tile_encode.h"

#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <new>
#include <span>

#include "base/bytes.h"
#include "format/gradient.h"

namespace mtsm::format {
namespace {

struct FreeContext {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
};

/// What a plane may be filtered with; the first of equally small results wins.
std::span<const PlaneFilter> filtersFor(PlaneKind kind, std::size_t elementSize) {
    static constexpr PlaneFilter kPlain[] = {PlaneFilter::none};
    static constexpr PlaneFilter kShuffled[] = {PlaneFilter::shuffle};
    static constexpr PlaneFilter kSmooth[] = {PlaneFilter::gradient};
    static constexpr PlaneFilter kAny[] = {PlaneFilter::none, PlaneFilter::shuffle,
                                           PlaneFilter::gradient};
    if (kind == PlaneKind::z) return kSmooth;
    if (kind == PlaneKind::v) return kAny;
    if (elementSize == 1) return kPlain;
    return kShuffled;
}

/// Byte j of all elements, for each j in turn.
void shuffle(BytesView in, std::size_t elementSize, Bytes& out) {
    const std::size_t n = in.size() / elementSize;
    out.resize(in.size());
    for (std::size_t j = 0; j < elementSize; ++j) {
        for (std::size_t i = 0; i < n; ++i)
            out[j * n + i] = in[i * elementSize + j];
    }
}

std::uint8_t narrowestSize(std::uint32_t most) {
    return most < 0x100 ? 1 : most < 0x10000 ? 2 : 4;
}

BytesView asBytes(std::span<const std::uint32_t> values) {
    return {reinterpret_cast<const std::uint8_t*>(values.data()), values.size_bytes()};
}

}  // namespace

std::uint32_t planesNeeded(const Tile& tile) {
    // By bits: -0 must come back as -0, so it is not "all v are 0".
    const bool v = std::any_of(tile.v.begin(), tile.v.end(),
                               [](float x) { return std::bit_cast<std::uint32_t>(x); });
    const bool n =
        std::any_of(tile.n.begin(), tile.n.end(), [](auto x) { return x != 1; });
    return (v ? kHasV : 0) | (n ? kHasN : 0);
}

struct TileEncoder::Scratch {
    Scratch(Codec c, int l) : codec(c), level(l) {
        if (!context) throw std::bad_alloc();
    }
    Codec codec;
    int level;
    std::unique_ptr<ZSTD_CCtx, FreeContext> context{ZSTD_createCCtx()};
    std::vector<std::uint32_t> bits, residuals;
    Bytes elements, filtered, trial, best;

    std::vector<PlaneRecord> records;
    Bytes stored;  // the planes' bytes, one after another

    void addPlane(PlaneRecord record, std::span<const std::uint32_t> begin,
                  std::uint32_t width);
    BytesView filter(PlaneFilter filter, std::size_t elementSize,
                     std::span<const std::uint32_t> begin, std::uint32_t width);
    BytesView compress(BytesView bytes);
};

TileEncoder::TileEncoder(Codec codec, int level)
    : scratch_(std::make_unique<Scratch>(codec, level)) {}
TileEncoder::~TileEncoder() = default;
TileEncoder::TileEncoder(TileEncoder&&) noexcept = default;

BytesView TileEncoder::Scratch::compress(BytesView bytes) {
    trial.resize(ZSTD_compressBound(bytes.size()));
    const std::size_t n = ZSTD_compressCCtx(context.get(), trial.data(), trial.size(),
                                            bytes.data(), bytes.size(), level);
    if (ZSTD_isError(n)) throw std::bad_alloc();  // the only way left for it to fail
    return BytesView(trial).first(n);
}

/// The plane's elements as they go to the codec.
BytesView TileEncoder::Scratch::filter(PlaneFilter filter, std::size_t elementSize,
                                       std::span<const std::uint32_t> begin,
                                       std::uint32_t width) {
    if (filter == PlaneFilter::none) return elements;
    if (filter == PlaneFilter::shuffle) {
        shuffle(elements, elementSize, filtered);
        return filtered;
    }
    const GradientPredictor predict(begin, width, bits.data());
    residuals.resize(bits.size());
    for (std::uint32_t p = 0, x = 0, y = 0; p + 1 < begin.size(); ++p) {
        for (std::uint32_t i = begin[p]; i < begin[p + 1]; ++i)
            residuals[i] = zigzag(bits[i] - predict(x, y, i - begin[p]));
        if (++x == width) x = 0, ++y;
    }
    shuffle(asBytes(residuals), sizeof(std::uint32_t), filtered);
    return filtered;
}

/// Appends the plane whose elements are `bits`: `record` has kind, channel and element
/// size; the rest is decided here.
void TileEncoder::Scratch::addPlane(PlaneRecord record,
                                    std::span<const std::uint32_t> begin,
                                    std::uint32_t width) {
    const std::size_t size = record.elementSize;
    record.decodedLength = bits.size() * size;
    if (std::all_of(bits.begin(), bits.end(), [&](auto b) { return b == bits[0]; })) {
        record.encoding = std::uint8_t(PlaneEncoding::constant);
        record.constant = bits[0];
        records.push_back(record);
        return;
    }
    elements.resize(bits.size() * size);
    for (std::size_t i = 0; i < bits.size(); ++i)
        std::memcpy(elements.data() + i * size, &bits[i], size);

    record.encoding = std::uint8_t(PlaneEncoding::raw);
    best = elements;
    if (codec == Codec::zstd) {
        for (PlaneFilter f : filtersFor(PlaneKind(record.kind), size)) {
            const BytesView frame = compress(filter(f, size, begin, width));
            if (frame.size() >= best.size()) continue;
            best.assign(frame.begin(), frame.end());
            record.encoding = std::uint8_t(PlaneEncoding::zstd);
            record.filter = std::uint8_t(f);
        }
    }
    record.storedLength = best.size();
    records.push_back(record);
    stored.insert(stored.end(), best.begin(), best.end());
}

Bytes TileEncoder::encode(const Tile& tile, const TilePlace& place,
                          std::uint32_t channels) {
    Scratch& s = *scratch_;
    s.records.clear();
    s.stored.clear();
    const std::size_t layers = tile.z.size();
    const std::uint32_t planes = planesNeeded(tile);
    const auto add = [&](PlaneKind kind, std::uint32_t channel, std::uint8_t size) {
        PlaneRecord record = {};
        record.kind = std::uint8_t(kind);
        record.channel = static_cast<std::uint8_t>(channel);
        record.elementSize = size;
        s.addPlane(record, tile.begin, place.width);
    };
    const auto addFloats = [&](PlaneKind kind, std::uint32_t channel, const float* f) {
        s.bits.resize(layers);
        std::memcpy(s.bits.data(), f, layers * sizeof(float));
        add(kind, channel, sizeof(float));
    };

    s.bits.resize(place.pixels());
    for (std::size_t p = 0; p < s.bits.size(); ++p)
        s.bits[p] = tile.begin[p + 1] - tile.begin[p];
    add(PlaneKind::counts, 0,
        narrowestSize(*std::max_element(s.bits.begin(), s.bits.end())));
    addFloats(PlaneKind::z, 0, tile.z.data());
    if (planes & kHasV) {
        for (std::uint32_t c = 0; c < channels; ++c)
            addFloats(PlaneKind::v, c, tile.v.data() + c * layers);
    }
    if (planes & kHasN) {
        s.bits.assign(tile.n.begin(), tile.n.end());
        add(PlaneKind::n, 0,
            narrowestSize(*std::max_element(s.bits.begin(), s.bits.end())));
    }

    TileRecord head = {};
    head.face = place.face;
    head.tx = place.tx;
    head.ty = place.ty;
    head.width = static_cast<std::uint16_t>(place.width);
    head.height = static_cast<std::uint16_t>(place.height);
    head.layers = static_cast<std::uint32_t>(layers);
    head.planes = planes;
    head.planeCount = static_cast<std::uint32_t>(s.records.size());
    Bytes payload;
    payload.reserve(sizeof head + s.records.size() * sizeof(PlaneRecord) +
                    s.stored.size());
    base::ByteWriter out(payload);
    out.put(head);
    for (const PlaneRecord& record : s.records)
        out.put(record);
    out.bytes(s.stored);
    return payload;
}

}  // namespace mtsm::format
