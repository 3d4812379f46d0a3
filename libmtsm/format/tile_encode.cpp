// Each plane becomes, in this order of preference: a constant, the smallest zstd frame
// among the filters that suit it, raw bytes. Which filters are tried was measured: see
// "Rationale: filters" in format-spec/mtsm-format.md.
#include "format/tile_encode.h"

#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <new>
#include <span>

#include "base/bytes.h"
#include "format/predict.h"

namespace mtsm::format {
namespace {

constexpr int kLongMatch = 7;  // the most that zstd takes

struct FreeContext {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
};

/// What a plane may be filtered with; the first of equally small results wins. Gradient
/// stands for itself and delta.
std::span<const PlaneFilter> filtersFor(PlaneKind kind, std::size_t elementSize) {
    static constexpr PlaneFilter kPlain[] = {PlaneFilter::none};
    static constexpr PlaneFilter kShuffled[] = {PlaneFilter::shuffle};
    static constexpr PlaneFilter kDepths[] = {PlaneFilter::gradient};
    static constexpr PlaneFilter kAny[] = {PlaneFilter::none, PlaneFilter::shuffle,
                                           PlaneFilter::gradient};
    if (kind == PlaneKind::z) return kDepths;
    if (kind == PlaneKind::v) return kAny;
    if (elementSize == 1) return kPlain;
    return kShuffled;
}

std::uint8_t narrowestSize(std::uint32_t most) {
    return most < 0x100 ? 1 : most < 0x10000 ? 2 : 4;
}

/// How unevenly bytes of one place in the elements are distributed: the more, the fewer
/// bits an entropy code needs. In integers, so that the file does not depend on how
/// exactly a machine computes logarithms.
std::uint64_t order(std::span<const std::uint32_t> elements) {
    std::array<std::array<std::uint64_t, 256>, 4> counts{};
    for (const std::uint32_t element : elements) {
        for (std::size_t j = 0; j < counts.size(); ++j)
            ++counts[j][element >> (8 * j) & 0xff];
    }
    // The logarithm in 1/256, linear between powers of two.
    const auto log2 = [](std::uint64_t n) {
        const int whole = std::bit_width(n) - 1;
        return std::uint64_t(whole) * 256 + ((n << 8 >> whole) - 256);
    };
    std::uint64_t sum = 0;
    for (const auto& ofPlace : counts) {
        for (const std::uint64_t n : ofPlace)
            sum += n > 0 ? n * log2(n) : 0;
    }
    return sum;
}

/// Low bits that are 0 in all elements.
int freeBits(std::span<const std::uint32_t> elements) {
    std::uint32_t any = 0;
    for (const std::uint32_t bits : elements)
        any |= bits;
    return std::min(std::countr_zero(any), 31);
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
    Scratch(Codec c, int level) : codec(c) {
        if (!context || ZSTD_isError(ZSTD_CCtx_setParameter(
                            context.get(), ZSTD_c_compressionLevel, level)))
            throw std::bad_alloc();
    }
    Codec codec;
    std::unique_ptr<ZSTD_CCtx, FreeContext> context{ZSTD_createCCtx()};
    std::vector<std::uint32_t> bits;  // of the plane at work
    std::vector<std::uint32_t> shifted, residuals;
    Bytes content, trial, best;

    std::vector<PlaneRecord> records;
    Bytes stored;  // the planes' bytes, one after another

    void addPlane(PlaneRecord record, std::span<const std::uint32_t> begin,
                  std::uint32_t width);
    void lineUp(std::size_t elementSize);
    void shuffle(std::span<const std::uint32_t> elements, std::size_t elementSize);
    PlaneFilter guess(int shift, std::span<const std::uint32_t> begin,
                      std::uint32_t width);
    template <bool along>
    void predict(std::span<const std::uint32_t> begin, std::uint32_t width);
    BytesView compress(std::size_t part);
};

TileEncoder::TileEncoder(Codec codec, int level)
    : scratch_(std::make_unique<Scratch>(codec, level)) {}
TileEncoder::~TileEncoder() = default;
TileEncoder::TileEncoder(TileEncoder&&) noexcept = default;

/// `content` in one frame. Its parts, of so many bytes each, have different statistics:
/// each becomes a block with an entropy table of its own.
BytesView TileEncoder::Scratch::compress(std::size_t part) {
    const auto check = [](std::size_t result) {
        if (ZSTD_isError(result)) throw std::bad_alloc();  // the only way left to fail
    };
    ZSTD_CCtx* const c = context.get();
    check(ZSTD_CCtx_reset(c, ZSTD_reset_session_only));
    // Short matches in what is mostly noise cost more than they save.
    const bool parts = part < content.size();
    check(ZSTD_CCtx_setParameter(c, ZSTD_c_minMatch, parts ? kLongMatch : 0));
    check(ZSTD_CCtx_setPledgedSrcSize(c, content.size()));
    trial.resize(ZSTD_compressBound(content.size()) + ZSTD_CStreamOutSize());
    ZSTD_outBuffer out = {trial.data(), trial.size(), 0};
    for (std::size_t at = 0; at < content.size(); at += part) {
        ZSTD_inBuffer in = {content.data() + at, part, 0};
        const bool last = at + part == content.size();
        check(ZSTD_compressStream2(c, &out, &in, last ? ZSTD_e_end : ZSTD_e_flush));
    }
    return BytesView(trial).first(out.pos);
}

/// Differences of `shifted` from what is guessed of them, into `residuals`.
template <bool along>
void TileEncoder::Scratch::predict(std::span<const std::uint32_t> begin,
                                   std::uint32_t width) {
    forEachGuess<along>(begin, width, shifted.data(),
                        [&](std::uint32_t i, std::uint32_t guess) {
                            residuals[i] = zigzag(shifted[i] - guess);
                            return shifted[i];
                        });
}

/// The filter whose differences should need fewer bits, and those into `residuals`.
PlaneFilter TileEncoder::Scratch::guess(int shift, std::span<const std::uint32_t> begin,
                                        std::uint32_t width) {
    shifted.resize(bits.size());
    residuals.resize(bits.size());
    for (std::size_t i = 0; i < bits.size(); ++i)
        shifted[i] = bits[i] >> shift;
    predict<true>(begin, width);
    const std::uint64_t delta = order(residuals);
    predict<false>(begin, width);
    if (order(residuals) >= delta) return PlaneFilter::gradient;
    predict<true>(begin, width);
    return PlaneFilter::delta;
}

/// The elements one behind the other, into `content`.
void TileEncoder::Scratch::lineUp(std::size_t elementSize) {
    content.resize(bits.size() * elementSize);
    for (std::size_t i = 0; i < bits.size(); ++i)
        std::memcpy(content.data() + i * elementSize, &bits[i], elementSize);
}

/// The first bytes of all elements, then the second ones, and so on, into `content`.
void TileEncoder::Scratch::shuffle(std::span<const std::uint32_t> elements,
                                   std::size_t elementSize) {
    content.resize(elements.size() * elementSize);
    std::uint8_t* to = content.data();
    for (std::size_t j = 0; j < elementSize; ++j) {
        for (const std::uint32_t element : elements)
            *to++ = std::uint8_t(element >> (8 * j));
    }
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
    record.encoding = std::uint8_t(PlaneEncoding::raw);
    lineUp(size);
    best = content;
    for (PlaneFilter f : filtersFor(PlaneKind(record.kind), size)) {
        if (codec != Codec::zstd) break;
        const int shift = f == PlaneFilter::gradient ? freeBits(bits) : 0;
        if (f == PlaneFilter::gradient) {
            f = guess(shift, begin, width);
            shuffle(residuals, size);
        } else if (f == PlaneFilter::shuffle) {
            shuffle(bits, size);
        } else {
            lineUp(size);
        }
        const BytesView frame =
            compress(f == PlaneFilter::none ? content.size() : bits.size());
        if (frame.size() >= best.size()) continue;
        best.assign(frame.begin(), frame.end());
        record.encoding = std::uint8_t(PlaneEncoding::zstd);
        record.filter = std::uint8_t(f);
        record.shift = std::uint8_t(shift);
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
