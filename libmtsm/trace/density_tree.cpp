// Level 0 from the layers of each pixel, each level above from four lists of slabs below.
#include "trace/density_tree.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <utility>

#include "base/lazy.h"
#include "base/message.h"
#include "base/parallel.h"

namespace mtsm::trace {
namespace {

constexpr std::uint32_t kTileRowsPerTask = 2;
/// Vectors index the words of texels by 31 bits.
constexpr std::uint64_t kMostTexels = std::uint64_t(1) << 28;
/// What lies at one depth is given this length, of its w: enough for floats to tell parts
/// of it, and far below a pixel's footprint.
constexpr float kThinnest = 0x1p-19f;
/// A slab's depth is off by at most about this where a ray begins in it, or by a share of
/// 1 / kMostPieces of its layer's.
constexpr float kUneven = 0.004f;
constexpr float kMostPieces = 64.0f;

template <std::uint32_t kChannels>
using Depths = std::array<float, kChannels>;

template <std::uint32_t kChannels>
struct Slab {
    float low = 0.0f, high = 0.0f;
    Depths<kChannels> depth{};

    [[nodiscard]] float length() const noexcept { return high - low; }
    [[nodiscard]] float thickest() const noexcept {
        return *std::max_element(depth.begin(), depth.end());
    }
};
template <std::uint32_t kChannels>
using Slabs = std::vector<Slab<kChannels>>;

/// The least length of a slab.
float thinnest(float low) {
    return std::max(kThinnest * std::abs(low), 1e-30f);
}

// Two floats >= 0 in a word, both without their sign: the upper 15 bits of one, which is
// not made smaller, and the upper 17 bits of the other.
std::uint32_t packed(float length, float density) {
    const std::uint32_t upper = (std::bit_cast<std::uint32_t>(length) + 0xffffu) >> 16;
    const auto bits = std::bit_cast<std::uint32_t>(density);
    return upper << 17 | (bits + 0x1fffu + (bits >> 14 & 1u)) >> 14;
}
float lengthOf(std::uint32_t word) {
    return std::bit_cast<float>((word & DensityLevel::kLengthBits) >> 1);
}
float densityOf(std::uint32_t word) {
    return std::bit_cast<float>((word & ~DensityLevel::kLengthBits)
                                << DensityLevel::kDensityShift);
}

/// Words of a slab.
constexpr std::size_t wordsOf(std::uint32_t channels) {
    return channels == 3 ? 4 : 2;
}

/// A slab as a level keeps it.
template <std::uint32_t kChannels>
std::array<std::uint32_t, wordsOf(kChannels)> encode(const Slab<kChannels>& slab) {
    const float length =
        lengthOf(packed(std::max(slab.length(), thinnest(slab.low)), 0.0f));
    const float high = slab.low + length;
    const float inverse = 1.0f / (high - slab.low);
    std::array<std::uint32_t, wordsOf(kChannels)> words;
    words[0] = std::bit_cast<std::uint32_t>(slab.low);
    words[1] = packed(length, slab.depth[0] * inverse);
    for (std::size_t c = 1; c < kChannels; ++c)
        words[c + 1] = std::bit_cast<std::uint32_t>(slab.depth[c] * inverse);
    return words;
}

template <std::uint32_t kChannels>
Slab<kChannels> decode(const std::array<std::uint32_t, wordsOf(kChannels)>& words) {
    const float low = std::bit_cast<float>(words[0]);
    const float high = low + lengthOf(words[1]), length = high - low;
    Slab<kChannels> slab{low, high, {}};
    slab.depth[0] = densityOf(words[1]) * length;
    for (std::size_t c = 1; c < kChannels; ++c)
        slab.depth[c] = std::bit_cast<float>(words[c + 1]) * length;
    return slab;
}

/// A texel before its level is whole.
struct LooseTexel {
    float low = HUGE_VALF, high = -HUGE_VALF;  // w between which the slabs lie
    std::uint32_t words = 0;
};

/// Appends a list of slabs as a level keeps it; says where they lie.
template <std::uint32_t kChannels>
LooseTexel pack(const Slabs<kChannels>& list, std::vector<std::uint32_t>& out) {
    const std::size_t begin = out.size(), n = list.size();
    LooseTexel texel;
    texel.words = std::uint32_t(n * wordsOf(kChannels));
    out.resize(begin + n * wordsOf(kChannels));
    for (std::size_t i = 0; i < n; ++i) {
        const auto words = encode(list[i]);
        for (std::size_t k = 0; k < words.size(); ++k)
            out[begin + k * n + i] = words[k];
        texel.low = std::min(texel.low, list[i].low);
        texel.high = std::max(texel.high, list[i].low + lengthOf(words[1]));
    }
    return texel;
}

/// Appends the slabs of a texel.
template <std::uint32_t kChannels>
void unpack(const DensityLevel& level, std::size_t texel, Slabs<kChannels>& out) {
    const std::uint32_t* const list = level.slabs.data() + level.texels[texel].begin;
    const std::size_t count = level.words(texel) / wordsOf(kChannels);
    for (std::size_t i = 0; i < count; ++i) {
        std::array<std::uint32_t, wordsOf(kChannels)> words;
        for (std::size_t k = 0; k < words.size(); ++k)
            words[k] = list[k * count + i];
        out.push_back(decode<kChannels>(words));
    }
}

enum class Kind { media, sheets };

/// Slabs that lie about one another are merged up to these.
struct Limits {
    float depth = 0.0f;
    float length = 0.0f;    ///< w, or share of w
    bool relative = false;  ///< to w: a perspective view's footprint is a share of z
    bool thin = false;  ///< slabs are not cut, and merged lie at the mean of the depths
    [[nodiscard]] float lengthAt(float w) const noexcept {
        return relative ? length * w : length;
    }
};

/// Of slabs that are as deep as they may be: longer ones would be uneven in depth.
constexpr double kMostOfDepth = 0.1;
/// Slabs are cut to not less than this share of the longest they may be.
constexpr float kShortestCut = 1.0f / 16;
/// And this share of the longest, a texel's footprint, may be of any depth.
constexpr float kTogether = 1.0f / 4;
/// Sheets are merged over this many texel footprints, at any depth.
constexpr double kSheetLength = 2.0;

Limits limitsOf(const Projection& p, const DensityOptions& options, Kind kind,
                std::uint32_t level) {
    const double texel = p.pixelFootprint(1.0) * double(std::uint64_t(1) << level);
    const bool perspective = p.kind == ProjectionKind::perspective;
    const bool media = kind == Kind::media;
    const double length = texel * (media ? options.length : kSheetLength);
    return {media ? float(options.depth) : 8.0f * kDarkDepth,
            float(perspective ? std::min(length, kMostOfDepth) : length), perspective,
            !media};
}

// --- a pixel's layers ------------------------------------------------------------------

/// The logarithm of a normal number, to the last bit or two; a third of the library's
/// time.
float logOf(float x) {
    const auto bits = std::bit_cast<std::uint32_t>(x);
    constexpr std::uint32_t kRootOfHalf = 0x3f3504f3u;
    const std::uint32_t above = bits - kRootOfHalf;
    const auto exponent = float(std::int32_t(above) >> 23);
    const float m = std::bit_cast<float>((above & 0x7fffffu) + kRootOfHalf);
    // log m = 2 atanh t
    const float t = (m - 1.0f) / (m + 1.0f), t2 = t * t;
    const float series =
        t2 * (1.0f / 3 + t2 * (1.0f / 5 + t2 * (1.0f / 7 + t2 * (1.0f / 9))));
    return exponent * 0.693147181f + 2.0f * (t + t * series);
}

template <std::uint32_t kChannels>
class PixelSlabs {
  public:
    using List = Slabs<kChannels>;

    PixelSlabs(const ShadowMap& map, std::uint32_t face)
        : projection_(map.projection(face)),
          perspective_(projection_.kind == ProjectionKind::perspective),
          sheets_(map.info().translucent == Translucent::sheets),
          strandsAlone_(!map.nearHair(face).empty() && map.nearField(face).empty()) {}

    /// Appends the slabs of pixel (x, y) of one kind, in order of w.
    void read(const PixelLayers& pixel, std::uint32_t x, std::uint32_t y, Kind kind,
              List& out) const {
        if (pixel.count == 0) return;
        const float way = kind == Kind::sheets ? 1.0f : 1.0f / centreWay(x, y);
        bool dark = isDark(pixel, pixel.count - 1);
        for (std::uint32_t i = pixel.count; i-- > 0;) {
            const bool restart = i == 0 || isDark(pixel, i - 1);
            const bool one = !pixel.n || pixel.n[i] == 1;
            if ((isSheet(dark && one) ? Kind::sheets : Kind::media) == kind)
                add({pixel, i, dark, restart, one || i == 0, straight(pixel.z[i])}, way,
                    out);
            dark = restart;
        }
    }
    /// Are there slabs of sheets in a map of media?
    [[nodiscard]] bool hasSheets(const PixelLayers& pixel) const {
        if (!isSheet(true)) return false;
        for (std::uint32_t i = 0; i < pixel.count; ++i) {
            if (isDark(pixel, i) && (!pixel.n || pixel.n[i] == 1)) return true;
        }
        return false;
    }

  private:
    struct Layer {
        const PixelLayers& pixel;
        std::uint32_t i;
        bool dark, restart, single;
        float w;  // of its depth
    };

    /// `blocks`: of one sample, and dark. Where strands are all that there is, it is what
    /// fills a pixel, and is one with what fills a part of the next.
    [[nodiscard]] bool isSheet(bool blocks) const {
        return sheets_ || (blocks && !strandsAlone_);
    }

    static float v(const PixelLayers& pixel, std::uint32_t i, std::uint32_t c) {
        return pixel.v ? pixel.v[c * pixel.vStride + i] : 0.0f;
    }
    static bool isDark(const PixelLayers& pixel, std::uint32_t i) {
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            if (v(pixel, i, c) > 0.0f) return false;
        }
        return true;
    }

    /// Way of the centre ray per unit of depth.
    [[nodiscard]] float centreWay(std::uint32_t x, std::uint32_t y) const {
        if (!perspective_) return 1.0f;
        const glm::dvec2 c =
            (glm::dvec2(x + 0.5, y + 0.5) - projection_.offset) / projection_.scale;
        return float(std::sqrt(1.0 + c.x * c.x + c.y * c.y));
    }

    /// Bounded, so that neither sums nor lengths overflow.
    [[nodiscard]] float straight(float z) const {
        constexpr float kMost = 1e30f;
        return perspective_ ? std::min(1.0f / z, kMost) : -std::min(z, kMost);
    }

    static Slab<kChannels> between(float low, float high,
                                   const Depths<kChannels>& depth) {
        const float least = thinnest(low);
        if (high - low >= least) return {low, high, depth};
        const float middle = 0.5f * (low + high);
        return {middle - 0.5f * least, middle + 0.5f * least, depth};
    }

    /// The samples of a layer. Where they end dark, the last one blocks and the others
    /// take nothing.
    void add(const Layer& layer, float way, List& out) const {
        Depths<kChannels> depth{}, end{};
        if (layer.dark && (sheets_ || layer.single)) {  // blocks all channels
            end.fill(kDarkDepth);
            out.push_back(between(layer.w, layer.w, end));
            return;
        }
        bool takes = false, ends = false;
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            const float after = v(layer.pixel, layer.i, c);
            const float before = layer.restart ? 1.0f : v(layer.pixel, layer.i - 1, c);
            if (!(after < before)) continue;
            if (after > 0.0f) {
                depth[c] = way * std::min(logOf(before / after), kDarkDepth);
                takes = true;
            } else {
                end[c] = kDarkDepth;
                ends = true;
            }
        }
        if (ends) out.push_back(between(layer.w, layer.w, end));
        if (!takes) return;
        if (layer.single)
            out.push_back(between(layer.w, layer.w, depth));
        else
            spread(layer, ends, depth, out);
    }

    /// Evenly in depth, so that half of each sample lies in front of where it is met; a
    /// slab is even in 1/z instead, so a long layer becomes several.
    void spread(const Layer& layer, bool ends, Depths<kChannels> depth, List& out) const {
        const float z0 = layer.pixel.z[layer.i - 1] + halfStep(layer.pixel, layer.i);
        const float z1 =
            layer.pixel.z[layer.i] + (ends ? 0.0f : reach(layer.pixel, layer.i));
        std::uint32_t pieces = 1;
        if (perspective_ && z1 > z0) {
            const float thickest = *std::max_element(depth.begin(), depth.end());
            const float off = thickest * (z1 - z0) / (4.0f * z0);  // of one piece
            if (off > kUneven)
                pieces = std::uint32_t(
                    std::ceil(std::min(std::sqrt(off / kUneven), kMostPieces)));
        }
        for (float& d : depth)
            d /= float(pieces);
        const float step = (z1 - z0) / float(pieces);
        float low = straight(z1);
        for (std::uint32_t k = pieces; k-- > 0;) {
            const float high = straight(k > 0 ? z0 + step * float(k) : z0);
            out.push_back(between(low, high, depth));
            low = high;
        }
    }

    /// Of a layer of several samples, half of the distance between them.
    static float halfStep(const PixelLayers& pixel, std::uint32_t i) {
        return 0.5f * (pixel.z[i] - pixel.z[i - 1]) / float(pixel.n[i]);
    }
    /// How far behind its depth the last of them is spread: to where the next layer
    /// begins at most.
    static float reach(const PixelLayers& pixel, std::uint32_t i) {
        const float half = halfStep(pixel, i);
        if (i + 1 == pixel.count) return half;
        return std::min(half, pixel.n[i + 1] > 1 ? halfStep(pixel, i + 1)
                                                 : pixel.z[i + 1] - pixel.z[i]);
    }

    const Projection& projection_;
    bool perspective_, sheets_, strandsAlone_;
};

// --- merging ---------------------------------------------------------------------------

/// 1 - exp(-depth), exact for thin ones too.
float takenBy(float depth) {
    if (depth > 0.0625f) return 1.0f - std::exp(-depth);
    return depth * (1.0f - depth * (0.5f - depth * (1.0f / 6 - depth * (1.0f / 24))));
}

float depthThatTakes(float taken) {
    if (!(taken < 1.0f)) return kDarkDepth;
    if (taken > 0.0625f) return -std::log(1.0f - taken);
    return taken * (1.0f + taken * (0.5f + taken * (1.0f / 3 + taken * 0.25f)));
}

// --- levels ----------------------------------------------------------------------------

/// Some rows of texels.
struct Rows {
    std::vector<LooseTexel> texels;
    std::vector<std::uint32_t> slabs;

    template <std::uint32_t kChannels>
    void append(const Slabs<kChannels>& list) {
        texels.push_back(pack(list, slabs));
    }
};

/// Says what the steps of a level are: from a step below all slabs to one above, which is
/// more than rounding hides.
void setSteps(float low, float high, DensityLevel& level) {
    constexpr float kSteps = 65535.0f, kOutside = 3.0f;
    level.step = std::max((high - low) / (kSteps - kOutside),
                          0x1p-20f * std::max(std::abs(low), std::abs(high)));
    level.step = std::max(level.step, 1e-30f);
    level.base = low - level.step;
}

std::uint32_t rangeOf(const LooseTexel& texel, const DensityLevel& level) {
    if (texel.words == 0) return DensityTexel::kEmpty;
    const auto steps = [&](float w) { return (w - level.base) / level.step; };
    const float low = std::floor(steps(texel.low) - 0.5f);
    const float high = std::ceil(steps(texel.high) + 0.5f);
    return std::uint32_t(std::clamp(low, 0.0f, 65535.0f)) |
           std::uint32_t(std::clamp(high, 0.0f, 65535.0f)) << 16;
}

/// Puts the rows of all tasks together; false if they are too much.
bool assemble(std::vector<Rows>& tasks, DensityLevel& level) {
    std::vector<std::uint64_t> first(tasks.size() + 1, 0);
    float low = HUGE_VALF, high = -HUGE_VALF;
    for (std::size_t t = 0; t < tasks.size(); ++t) {
        first[t + 1] = first[t] + tasks[t].slabs.size();
        for (const LooseTexel& texel : tasks[t].texels) {
            low = std::min(low, texel.low);
            high = std::max(high, texel.high);
        }
    }
    if (first.back() > std::numeric_limits<std::uint32_t>::max() - kLanes) return false;
    if (low < high) setSteps(low, high, level);
    level.texels.resize(level.texelCount() + 1);
    level.texels.back().begin = std::uint32_t(first.back());
    level.slabs.resize(first.back() + kLanes);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        Rows& rows = tasks[task];
        std::copy(rows.slabs.begin(), rows.slabs.end(),
                  level.slabs.begin() + std::ptrdiff_t(first[task]));
        std::uint64_t begin = first[task];
        std::size_t to = task * kTileRowsPerTask * level.tilesX() * 64;
        for (const LooseTexel& texel : rows.texels) {
            level.texels[to++] = {rangeOf(texel, level), std::uint32_t(begin)};
            begin += texel.words;
        }
        rows = {};
    });
    return true;
}

/// makeTexels() gives each thread's texel(x, y, slabs), which lists the slabs of a texel.
template <std::uint32_t kChannels, typename MakeTexels>
bool makeLevel(DensityLevel& level, const MakeTexels& makeTexels) {
    std::vector<Rows> tasks((level.tilesY() + kTileRowsPerTask - 1) / kTileRowsPerTask);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        auto texel = makeTexels();
        Slabs<kChannels> slabs;
        const std::uint32_t first = std::uint32_t(task) * kTileRowsPerTask;
        const std::uint32_t end = std::min(first + kTileRowsPerTask, level.tilesY());
        for (std::uint32_t tile = first * level.tilesX(); tile < end * level.tilesX();
             ++tile) {
            for (std::uint32_t i = 0; i < 64; ++i) {
                const std::uint32_t x = tile % level.tilesX() * 8 + i % 8;
                const std::uint32_t y = tile / level.tilesX() * 8 + i / 8;
                slabs.clear();
                if (x < level.width && y < level.height) texel(x, y, slabs);
                tasks[task].append(slabs);
            }
        }
    });
    return assemble(tasks, level);
}

template <std::uint32_t kChannels>
bool makePixels(const ShadowMap& map, std::uint32_t face, Kind kind,
                DensityLevel& level) {
    level.width = map.info().width;
    level.height = map.info().height;
    const PixelSlabs<kChannels> pixels(map, face);
    return makeLevel<kChannels>(level, [&] {
        return [&](std::uint32_t x, std::uint32_t y, Slabs<kChannels>& slabs) {
            pixels.read(map.pixel(face, x, y), x, y, kind, slabs);
        };
    });
}

/// Merges the lists of up to four texels, whose areas are equal and beside one another.
/// Where a slab of theirs is as deep or long as may be, all are cut.
template <std::uint32_t kChannels>
class Merger {
  public:
    using List = Slabs<kChannels>;

    explicit Merger(Limits limits) : limits_(limits) {}

    void clear() noexcept {
        slabs_.clear();
        hiding_.clear();
        count_ = 0;
    }
    /// A list, which `append` appends to what it is given.
    template <typename Append>
    void add(const Append& append) {
        begin_[count_++] = slabs_.size();
        append(slabs_);
        slabs_.push_back(kEnd);
        hidingFirst_[count_ - 1] = hidingEnd_[count_ - 1] = hiding_.size();
    }
    /// The sheets of the texel of the list that was added last.
    template <typename Append>
    void addSheets(const Append& append) {
        append(hiding_);
        hidingEnd_[count_ - 1] = hiding_.size();
    }

    void merge(List& out) {
        if (slabs_.size() == count_) return;
        Slab<kChannels> nothing = kEnd;
        Fronts fronts;
        for (std::size_t k = 0; k < 4; ++k)
            fronts[k] = k < count_ ? slabs_.data() + begin_[k] : &nothing;
        const float share = 1.0f / float(count_);
        Open open;
        for (;;) {
            const float at = std::min(std::min(fronts[0]->low, fronts[1]->low),
                                      std::min(fronts[2]->low, fronts[3]->low));
            if (open.any && at >= open.end) close(open, share, out);
            if (at == HUGE_VALF) return;
            if (!open.any) begin(open, at);
            // Which list has one that is not to be cut cannot be foreseen, so no branch
            // asks.
            unsigned whole = 0;
            for (std::size_t k = 0; k < 4; ++k) {
                const bool isShort =
                    limits_.thin | (fronts[k]->length() <= open.shortest);
                whole |= unsigned(isShort & (fronts[k]->low <= at)) << k;
            }
            if (whole == 0) {
                advance(fronts, at, share, open, out);
                continue;
            }
            // Takes all of it, or ends the one that is open because it does not fit.
            const auto k = std::size_t(std::countr_zero(whole));
            const Slab<kChannels>& slab = *fronts[k];
            const float thickest = open.thickest + share * slab.thickest();
            const float together = isRest(open, slab, k) ? open.end : open.together;
            if (open.high > open.low &&
                ((thickest > limits_.depth && slab.high > together) ||
                 slab.high > open.end)) {
                close(open, share, out);
            } else {
                take(open, slab, k, slab.high, 1.0f, share);
                ++fronts[k];
            }
        }
    }

  private:
    /// What is left of each list, whose first slab may be a part of one.
    using Fronts = std::array<Slab<kChannels>*, 4>;
    static constexpr Slab<kChannels> kEnd{HUGE_VALF, HUGE_VALF, {}};

    /// The slab that is open: from `low` to `high` so far, to `end` at most. What its
    /// thickest channel has, mean over the children.
    struct Open {
        bool any = false;
        float low = 0.0f, high = 0.0f, end = 0.0f, shortest = 0.0f, thickest = 0.0f;
        float together = 0.0f;  // what ends before it fits, however deep
        float moment = 0.0f;    // of that, about `low`
        std::array<std::array<float, kChannels>, 4> depth{};  // [child][channel]
    };

    /// Is a child dense here of which nothing is in the open slab yet? A strand that
    /// leads towards the light fills one child after another: apart, the slabs would let
    /// through what each leaves of the whole texel.
    bool isRest(const Open& open, const Slab<kChannels>& slab, std::size_t k) const {
        float before = 0.0f, least = kDarkDepth;
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            before = std::max(before, open.depth[k][c]);
            least = std::min(least, slab.depth[c]);
        }
        return before == 0.0f && least >= limits_.depth;
    }

    void begin(Open& open, float at) const {
        open = {};
        open.any = true;
        open.low = open.high = at;
        open.end = at + limits_.lengthAt(at);
        open.shortest = kShortestCut * limits_.lengthAt(at);
        open.together = at + kTogether * limits_.lengthAt(at);
    }

    void close(Open& open, float share, List& out) {
        Slab<kChannels> slab{open.low, open.high, {}};
        if (limits_.thin && open.high <= open.end && open.thickest > 0.0f) {
            const float w = open.low + open.moment / open.thickest;
            slab.low = w - 0.5f * thinnest(w);
            slab.high = w + 0.5f * thinnest(w);
        }
        // The depth whose transmittance is the mean of the children's.
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            float taken = 0.0f;
            for (const auto& child : open.depth)
                taken += takenBy(child[c]);
            taken *= share;
            if (!hiding_.empty()) taken = takenBesideSheets(open, c, taken);
            slab.depth[c] = depthThatTakes(taken);
        }
        out.push_back(slab);
        open.any = false;
    }

    /// What the children take of the light that their sheets close by leave: where these
    /// are dark there is none to be taken. `all`: if that is nowhere.
    [[nodiscard]] float takenBesideSheets(const Open& open, std::uint32_t c, float all) {
        const float reach = kTogether * limits_.lengthAt(open.low);
        float taken = 0.0f, left = 0.0f;
        for (std::size_t k = 0; k < count_; ++k) {
            float hidden = 0.0f;
            std::size_t& first = hidingFirst_[k];
            while (first < hidingEnd_[k] && hiding_[first].high < open.low - reach)
                ++first;
            for (std::size_t i = first;
                 i < hidingEnd_[k] && hiding_[i].low <= open.high + reach; ++i)
                hidden += hiding_[i].depth[c];
            const float share = 1.0f - takenBy(hidden);
            taken += share * takenBy(open.depth[k][c]);
            left += share;
        }
        constexpr float kNone = 1e-3f;
        return left > kNone ? taken / left : all;
    }

    /// Takes what lies from `at` to where a list's slab begins or ends, or the one that
    /// is open has to.
    void advance(Fronts& fronts, float at, float share, Open& open, List& out) {
        float to = std::max(open.end, at + open.shortest), density = 0.0f;
        for (const Slab<kChannels>* slab : fronts) {
            if (slab->low > at) {
                to = std::min(to, slab->low);
            } else {
                to = std::min(to, slab->high);
                density += share * slab->thickest() / slab->length();
            }
        }
        const float left = std::max(limits_.depth - open.thickest, 0.0f);
        if (density * (to - at) > left)
            to = std::min(to, at + std::max(left / density, open.shortest));
        for (std::size_t k = 0; k < 4; ++k) {
            Slab<kChannels>& slab = *fronts[k];
            if (slab.low > at) continue;
            // All of it, too, where floats do not tell the ends of the part.
            const bool cut = to > at && to < slab.high;
            const float part = cut ? (to - at) / slab.length() : 1.0f;
            take(open, slab, k, std::min(to, slab.high), part, share);
            if (!cut) {
                ++fronts[k];
                continue;
            }
            slab.low = to;
            for (float& d : slab.depth)
                d *= 1.0f - part;
        }
        if (open.thickest >= 0.999f * limits_.depth || to >= open.end)
            close(open, share, out);
    }

    /// A part of a slab of list k, up to `high`.
    static void take(Open& open, const Slab<kChannels>& slab, std::size_t k, float high,
                     float part, float share) {
        open.high = std::max(open.high, high);
        float thickest = 0.0f;
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            const float depth = part * slab.depth[c];
            open.depth[k][c] += depth;
            thickest = std::max(thickest, depth);
        }
        open.thickest += share * thickest;
        open.moment += share * thickest * (0.5f * (slab.low + high) - open.low);
    }

    Limits limits_;
    List slabs_;   // of all lists, each with kEnd behind
    List hiding_;  // sheets of all texels
    std::size_t begin_[4] = {}, hidingFirst_[4] = {}, hidingEnd_[4] = {}, count_ = 0;
};

/// Level 1 of a face, level 0 being read a texel's four pixels at a time.
template <std::uint32_t kChannels>
bool makeLevel1(const ShadowMap& map, std::uint32_t face, Kind kind, bool besideSheets,
                Limits limits, DensityLevel& level) {
    const std::uint32_t width = map.info().width, height = map.info().height;
    level.width = (width + 1) / 2;
    level.height = (height + 1) / 2;
    const PixelSlabs<kChannels> pixels(map, face);
    return makeLevel<kChannels>(level, [&] {
        return [&, merger = Merger<kChannels>(limits)](std::uint32_t x, std::uint32_t y,
                                                       Slabs<kChannels>& slabs) mutable {
            merger.clear();
            for (std::uint32_t v = 2 * y; v < std::min(2 * y + 2, height); ++v) {
                for (std::uint32_t u = 2 * x; u < std::min(2 * x + 2, width); ++u) {
                    merger.add([&](Slabs<kChannels>& list) {
                        const std::size_t first = list.size();
                        pixels.read(map.pixel(face, u, v), u, v, kind, list);
                        // As level 0 would keep them.
                        for (std::size_t i = first; i < list.size(); ++i)
                            list[i] = decode<kChannels>(encode(list[i]));
                    });
                    if (!besideSheets) continue;
                    merger.addSheets([&](Slabs<kChannels>& list) {
                        pixels.read(map.pixel(face, u, v), u, v, Kind::sheets, list);
                    });
                }
            }
            merger.merge(slabs);
        };
    });
}

/// `sheets`: those of the texels of `fine`, or null.
template <std::uint32_t kChannels>
bool makeCoarser(const DensityLevel& fine, const DensityLevel* sheets, Limits limits,
                 DensityLevel& level) {
    level.width = (fine.width + 1) / 2;
    level.height = (fine.height + 1) / 2;
    return makeLevel<kChannels>(level, [&] {
        return [&, merger = Merger<kChannels>(limits)](std::uint32_t x, std::uint32_t y,
                                                       Slabs<kChannels>& slabs) mutable {
            merger.clear();
            for (std::uint32_t v = 2 * y; v < std::min(2 * y + 2, fine.height); ++v) {
                for (std::uint32_t u = 2 * x; u < std::min(2 * x + 2, fine.width); ++u) {
                    merger.add([&](Slabs<kChannels>& list) {
                        unpack(fine, fine.at(u, v), list);
                    });
                    if (!sheets) continue;
                    merger.addSheets([&](Slabs<kChannels>& list) {
                        unpack(*sheets, sheets->at(u, v), list);
                    });
                }
            }
            merger.merge(slabs);
        };
    });
}

/// Are there layers that a map of media keeps as sheets?
template <std::uint32_t kChannels>
bool hasSheets(const ShadowMap& map, std::uint32_t face) {
    const PixelSlabs<kChannels> pixels(map, face);
    std::atomic<bool> found = false;
    base::parallelFor(std::uint32_t(0), map.info().height, [&](std::uint32_t y) {
        for (std::uint32_t x = 0; x < map.info().width && !found; ++x) {
            if (pixels.hasSheets(map.pixel(face, x, y))) found = true;
        }
    });
    return found;
}

/// `sheets`: those beside media.
template <std::uint32_t kChannels>
bool makePyramid(const ShadowMap& map, std::uint32_t face, Kind kind,
                 const DensityPyramid& sheets, const DensityOptions& options,
                 DensityPyramid& pyramid) {
    const Projection& p = map.projection(face);
    const bool sheetsAlone = map.info().translucent == Translucent::sheets;
    if (kind == Kind::media ? sheetsAlone
                            : !sheetsAlone && !hasSheets<kChannels>(map, face))
        return true;
    pyramid.levels.emplace_back();
    if (options.finest == 0) {
        if (!makePixels<kChannels>(map, face, kind, pyramid.levels[0])) return false;
    } else {
        pyramid.levels.emplace_back();
        if (!makeLevel1<kChannels>(map, face, kind, !sheets.empty(),
                                   limitsOf(p, options, kind, 1), pyramid.levels[1]))
            return false;
    }
    if (pyramid.levels.back().slabs.size() == kLanes) {
        pyramid = {};
        return true;
    }
    pyramid.low = pyramid.levels.back().base;
    pyramid.high = pyramid.low + 65535.0f * pyramid.levels.back().step;
    while (pyramid.levels.back().width > 1 || pyramid.levels.back().height > 1) {
        const auto i = std::uint32_t(pyramid.levels.size());
        DensityLevel level;
        const Limits limits = limitsOf(p, options, kind, i);
        const DensityLevel* const beside =
            sheets.empty() ? nullptr : &sheets.levels[i - 1];
        if (!makeCoarser<kChannels>(pyramid.levels.back(), beside, limits, level))
            return false;
        pyramid.levels.push_back(std::move(level));
    }
    return true;
}

bool isIndexable(const ShadowMap& map) {
    return std::uint64_t(map.info().width) * map.info().height <= kMostTexels;
}

std::uint64_t bytesOf(const DensityPyramid& pyramid) {
    std::uint64_t bytes = 0;
    for (const DensityLevel& level : pyramid.levels)
        bytes += level.texels.size() * sizeof(DensityTexel) +
                 level.slabs.size() * sizeof(std::uint32_t);
    return bytes;
}

}  // namespace

std::vector<DensityLevel> DensityPyramid::levelsOf(std::uint32_t width,
                                                   std::uint32_t height,
                                                   std::uint32_t finest) {
    std::vector<DensityLevel> levels;
    for (;;) {
        const bool isLast = width <= 1 && height <= 1;
        DensityLevel& level = levels.emplace_back();
        if (levels.size() > finest || isLast) {
            level.width = width;
            level.height = height;
        }
        if (isLast) return levels;
        width = (width + 1) / 2;
        height = (height + 1) / 2;
    }
}

DensityTree::DensityTree(const ShadowMap& map, std::uint32_t face,
                         const DensityOptions& options)
    : projection_(map.projection(face)),
      channels_(map.info().channels),
      width_(map.info().width),
      height_(map.info().height),
      ofSheets_(map.info().translucent == Translucent::sheets) {
    const std::uint32_t side = std::max(width_, height_);
    finest_ = std::min(options.finest, std::uint32_t(std::bit_width(side - 1)));
    coarsest_ = std::max(finest_,
                         std::uint32_t(std::bit_width((side - 1) / options.leastAcross)));
}

Result<DensityTree> DensityTree::build(const ShadowMap& map, std::uint32_t face,
                                       const DensityOptions& options) {
    DensityTree tree(map, face, options);
    DensityOptions present = options;
    present.finest = tree.finest_;
    const auto make = tree.channels_ == 3 ? makePyramid<3> : makePyramid<1>;
    if (!isIndexable(map) || !make(map, face, Kind::sheets, {}, present, tree.sheets_) ||
        !make(map, face, Kind::media, tree.sheets_, present, tree.media_))
        return base::makeError(
            ErrorCode::tooLarge, "face ", face,
            " has too many pixels or layers for a density tree: bake with a "
            "lower resolution or a larger tolerance");
    for (DensityPyramid* pyramid : {&tree.media_, &tree.sheets_}) {
        if (pyramid->empty()) continue;
        for (std::uint32_t i = 0; i < tree.finest_; ++i)
            pyramid->levels[i] = {};
    }
    return tree;
}

namespace {

Status checkLevel(const DensityLevel& level) {
    if (!std::isfinite(level.base) || !(level.step > 0.0f) || !std::isfinite(level.step))
        return base::makeError(ErrorCode::badFile, "ranges from ", level.base,
                               " on in steps of ", level.step);
    if (level.slabs.size() < kLanes)
        return base::makeError(ErrorCode::badFile, "no room behind the slabs");
    const std::uint64_t words = level.slabs.size() - kLanes;
    std::uint32_t before = 0;
    for (std::size_t i = 0; i < level.texels.size(); ++i) {
        const std::uint32_t begin = level.texels[i].begin;
        if (begin < before || begin > words)
            return base::makeError(ErrorCode::badFile, "texel ", i, ": slabs from word ",
                                   begin, " on, behind ", before, ", of ", words);
        before = begin;
    }
    if (before != words)
        return base::makeError(ErrorCode::badFile, "lists of ", before, " words, of ",
                               words);
    return {};
}

}  // namespace

Result<DensityTree> DensityTree::restore(const ShadowMap& map, std::uint32_t face,
                                         const DensityOptions& options,
                                         DensityPyramid media, DensityPyramid sheets) {
    DensityTree tree(map, face, options);
    if (!isIndexable(map))
        return base::makeError(ErrorCode::badFile, "a density tree of more than ",
                               kMostTexels, " pixels");
    for (const DensityPyramid* const pyramid : {&media, &sheets}) {
        if (pyramid->empty()) continue;
        if (!std::isfinite(pyramid->low) || !std::isfinite(pyramid->high))
            return base::makeError(ErrorCode::badFile, "a pyramid of depths from ",
                                   pyramid->low, " to ", pyramid->high);
        for (std::size_t i = tree.finest_; i < pyramid->levels.size(); ++i) {
            if (auto s = checkLevel(pyramid->levels[i]); !s)
                return base::makeError(ErrorCode::badFile, "level ", i, ": ",
                                       s.error().message);
        }
    }
    if (tree.ofSheets_ && !media.empty())
        return base::makeError(ErrorCode::badFile, "media in a map of sheets");
    tree.media_ = std::move(media);
    tree.sheets_ = std::move(sheets);
    return tree;
}

std::uint64_t DensityTree::memoryBytes() const noexcept {
    return bytesOf(media_) + bytesOf(sheets_);
}

namespace {

/// Of all faces; none if a tree is too large.
std::vector<DensityTree> buildAll(const ShadowMap& map, const DensityOptions& options) {
    std::vector<DensityTree> trees;
    try {
        for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
            Result<DensityTree> tree = DensityTree::build(map, face, options);
            if (!tree) return {};
            trees.push_back(*std::move(tree));
        }
    } catch (const std::bad_alloc&) {
        trees = {};
    }
    return trees;
}

}  // namespace

bool hasNearMedia(const ShadowMap& map) noexcept {
    return map.faceCount() == 1 && !map.isOpaque() &&
           (!map.nearHair(0).empty() || !map.nearSheets(0).empty());
}

namespace {

using Trees = std::vector<DensityTree>;
/// From the finest level on, and from the one that is enough beside a near field.
using TreeSets = std::array<base::Lazy, 2>;

TreeSets& setsOf(const ShadowMap& map) {
    return *map.queryData().get<std::shared_ptr<TreeSets>>(
        [] { return std::make_shared<TreeSets>(); });
}

}  // namespace

const std::vector<DensityTree>* densityTrees(const ShadowMap& map, DensityUse use) {
    // Without layers there is nothing to make others from.
    const bool coarse =
        hasNearMedia(map) && (use == DensityUse::receivers || !map.hasLayers());
    const Trees& trees = setsOf(map)[coarse].get<Trees>(
        [&] { return buildAll(map, coarse ? receiverOptions(map) : DensityOptions()); });
    return trees.empty() ? nullptr : &trees;
}

DensityOptions receiverOptions(const ShadowMap& map) noexcept {
    DensityOptions options;
    options.finest = hasNearMedia(map) ? kFinestBesideNear : 0;
    return options;
}

void holdDensityTrees(const ShadowMap& map, std::vector<DensityTree> trees) {
    setsOf(map)[hasNearMedia(map)].get<Trees>([&] { return std::move(trees); });
}

std::uint64_t densityTreeBytes(const ShadowMap& map) noexcept {
    const auto* const sets = map.queryData().find<std::shared_ptr<TreeSets>>();
    std::uint64_t bytes = 0;
    for (std::size_t i = 0; sets && i < 2; ++i) {
        const Trees* const trees = (**sets)[i].find<Trees>();
        for (std::size_t face = 0; trees && face < trees->size(); ++face)
            bytes += (*trees)[face].memoryBytes();
    }
    return bytes;
}

std::shared_ptr<base::Lazy> densityTreesAlone(const ShadowMap& map) {
    const bool coarse = hasNearMedia(map);
    const auto sets = std::make_shared<TreeSets>();
    (*sets)[coarse].share(setsOf(map)[coarse]);
    auto all = std::make_shared<base::Lazy>();
    all->get<std::shared_ptr<TreeSets>>([&] { return sets; });
    return all;
}

}  // namespace mtsm::trace
