// Level 0 from the layers of each pixel, each level above from four lists of slabs below.
#include "trace/density_tree.h"

#include <algorithm>
#include <array>
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

using Depths = std::array<float, 3>;  // [channel]

struct Slab {
    float low = 0.0f, high = 0.0f;
    Depths depth{};
};

/// The least length of a slab.
float thinnest(float low) {
    return std::max(kThinnest * std::abs(low), 1e-30f);
}

/// What lies at one depth.
Slab thinAt(float w) {
    const float length = thinnest(w);
    return {w - 0.5f * length, w + 0.5f * length, {}};
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
std::size_t wordsOf(std::uint32_t channels) {
    return channels == 3 ? 4 : 2;
}

/// Appends a list of slabs as a level keeps it; says where they lie.
DensityTexel pack(const std::vector<Slab>& list, std::uint32_t channels,
                  std::vector<std::uint32_t>& out) {
    const std::size_t begin = out.size(), n = list.size();
    DensityTexel texel{HUGE_VALF, -HUGE_VALF, 0, std::uint32_t(n)};
    out.resize(begin + n * wordsOf(channels));
    for (std::size_t i = 0; i < n; ++i) {
        const Slab& slab = list[i];
        std::uint32_t* to = out.data() + begin + i;
        const float length =
            lengthOf(packed(std::max(slab.high - slab.low, thinnest(slab.low)), 0.0f));
        const float high = slab.low + length;
        const float inverse = 1.0f / (high - slab.low);
        to[0] = std::bit_cast<std::uint32_t>(slab.low);
        to[n] = packed(length, slab.depth[0] * inverse);
        for (std::size_t c = 1; c < channels; ++c)
            to[(c + 1) * n] = std::bit_cast<std::uint32_t>(slab.depth[c] * inverse);
        texel.low = std::min(texel.low, slab.low);
        texel.high = std::max(texel.high, high);
    }
    return texel;
}

/// The slab at `from` of a list of `count`.
Slab unpack(const std::uint32_t* from, std::size_t count, std::uint32_t channels) {
    const std::uint32_t bits = from[count];
    const float low = std::bit_cast<float>(from[0]);
    const float high = low + lengthOf(bits), length = high - low;
    Slab slab{low, high, {densityOf(bits) * length, 0.0f, 0.0f}};
    for (std::size_t c = 1; c < channels; ++c)
        slab.depth[c] = std::bit_cast<float>(from[(c + 1) * count]) * length;
    return slab;
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

class PixelSlabs {
  public:
    PixelSlabs(const ShadowMap& map, std::uint32_t face)
        : projection_(map.projection(face)),
          channels_(map.info().channels),
          perspective_(projection_.kind == ProjectionKind::perspective),
          sheets_(map.info().translucent == Translucent::sheets) {}

    /// The slabs of pixel (x, y) of one kind, in order of w.
    void read(const PixelLayers& pixel, std::uint32_t x, std::uint32_t y, Kind kind,
              std::vector<Slab>& out) const {
        out.clear();
        const float way = kind == Kind::sheets ? 1.0f : 1.0f / centreWay(x, y);
        for (std::uint32_t i = pixel.count; i-- > 0;) {
            if (kindOf(pixel, i) == kind) add(pixel, i, way, out);
        }
    }

  private:
    static float v(const PixelLayers& pixel, std::uint32_t i, std::uint32_t c) {
        return pixel.v ? pixel.v[c * pixel.vStride + i] : 0.0f;
    }
    [[nodiscard]] bool isDark(const PixelLayers& pixel, std::uint32_t i) const {
        for (std::uint32_t c = 0; c < channels_; ++c) {
            if (v(pixel, i, c) > 0.0f) return false;
        }
        return true;
    }
    [[nodiscard]] Kind kindOf(const PixelLayers& pixel, std::uint32_t i) const {
        const bool single = !pixel.n || pixel.n[i] == 1;
        return sheets_ || (single && isDark(pixel, i)) ? Kind::sheets : Kind::media;
    }

    /// Way of the centre ray per unit of depth.
    [[nodiscard]] float centreWay(std::uint32_t x, std::uint32_t y) const {
        if (!perspective_) return 1.0f;
        const glm::dvec2 c =
            (glm::dvec2(x + 0.5, y + 0.5) - projection_.offset) / projection_.scale;
        return float(std::sqrt(1.0 + c.x * c.x + c.y * c.y));
    }

    [[nodiscard]] float straight(float z) const { return perspective_ ? 1.0f / z : -z; }

    [[nodiscard]] Slab at(float z, Depths depth) const {
        return between(straight(z), straight(z), depth);
    }
    static Slab between(float low, float high, Depths depth) {
        const float least = thinnest(low);
        if (high - low >= least) return {low, high, depth};
        const float middle = 0.5f * (low + high);
        return {middle - 0.5f * least, middle + 0.5f * least, depth};
    }

    /// The samples of layer i: spread from the layer before to its own depth. Where they
    /// end dark, the last one blocks and the others take nothing.
    void add(const PixelLayers& pixel, std::uint32_t i, float way,
             std::vector<Slab>& out) const {
        const bool single = i == 0 || !pixel.n || pixel.n[i] == 1;
        if (isDark(pixel, i) && (sheets_ || single)) {  // blocks all channels
            out.push_back(at(pixel.z[i], {kDarkDepth, kDarkDepth, kDarkDepth}));
            return;
        }
        const bool restart = i == 0 || isDark(pixel, i - 1);
        Depths depth{}, end{};
        bool takes = false, ends = false;
        for (std::uint32_t c = 0; c < channels_; ++c) {
            const float after = v(pixel, i, c);
            const float before = restart ? 1.0f : v(pixel, i - 1, c);
            if (!(after < before)) continue;
            if (after > 0.0f) {
                depth[c] = way * std::min(std::log(before / after), kDarkDepth);
                takes = true;
            } else {
                end[c] = kDarkDepth;
                ends = true;
            }
        }
        if (ends) out.push_back(at(pixel.z[i], end));
        if (!takes) return;
        spread(single ? pixel.z[i] : pixel.z[i - 1], pixel.z[i], depth, out);
    }

    /// Evenly from depth z0 to z1; a slab is even in 1/z instead, so a long layer becomes
    /// several.
    void spread(float z0, float z1, Depths depth, std::vector<Slab>& out) const {
        std::uint32_t pieces = 1;
        if (perspective_ && z1 > z0) {
            const float thickest = std::max({depth[0], depth[1], depth[2]});
            const float off = thickest * (z1 - z0) / (4.0f * z0);  // of one piece
            pieces =
                std::uint32_t(std::ceil(std::min(std::sqrt(off / kUneven), kMostPieces)));
            pieces = std::max(pieces, 1u);
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

    const Projection& projection_;
    std::uint32_t channels_;
    bool perspective_, sheets_;
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
    std::vector<DensityTexel> texels;  // `begin` is not known yet
    std::vector<std::uint32_t> slabs;

    void append(const std::vector<Slab>& list, std::uint32_t channels) {
        texels.push_back(pack(list, channels, slabs));
    }
};

/// Puts the rows of all tasks together; false if they are too much.
bool assemble(std::vector<Rows>& tasks, std::uint32_t channels, DensityLevel& level) {
    std::vector<std::uint64_t> first(tasks.size() + 1, 0);
    for (std::size_t t = 0; t < tasks.size(); ++t)
        first[t + 1] = first[t] + tasks[t].slabs.size();
    if (first.back() > std::numeric_limits<std::uint32_t>::max() - kLanes) return false;
    level.texels.resize(std::size_t(level.tilesX()) * level.tilesY() * 64);
    level.slabs.resize(first.back() + kLanes);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        Rows& rows = tasks[task];
        std::copy(rows.slabs.begin(), rows.slabs.end(),
                  level.slabs.begin() + std::ptrdiff_t(first[task]));
        std::uint64_t begin = first[task];
        std::size_t to = task * kTileRowsPerTask * level.tilesX() * 64;
        for (DensityTexel texel : rows.texels) {
            texel.begin = std::uint32_t(begin);
            begin += texel.count * wordsOf(channels);
            level.texels[to++] = texel;
        }
        rows = {};
    });
    return true;
}

/// makeTexels() gives each thread's texel(x, y, slabs), which lists the slabs of a texel.
template <typename MakeTexels>
bool makeLevel(std::uint32_t channels, DensityLevel& level,
               const MakeTexels& makeTexels) {
    std::vector<Rows> tasks((level.tilesY() + kTileRowsPerTask - 1) / kTileRowsPerTask);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        auto texel = makeTexels();
        std::vector<Slab> slabs;
        const std::uint32_t first = std::uint32_t(task) * kTileRowsPerTask;
        const std::uint32_t end = std::min(first + kTileRowsPerTask, level.tilesY());
        for (std::uint32_t tile = first * level.tilesX(); tile < end * level.tilesX();
             ++tile) {
            for (std::uint32_t i = 0; i < 64; ++i) {
                const std::uint32_t x = tile % level.tilesX() * 8 + i % 8;
                const std::uint32_t y = tile / level.tilesX() * 8 + i / 8;
                slabs.clear();
                if (x < level.width && y < level.height) texel(x, y, slabs);
                tasks[task].append(slabs, channels);
            }
        }
    });
    return assemble(tasks, channels, level);
}

bool makePixels(const ShadowMap& map, std::uint32_t face, Kind kind,
                DensityLevel& level) {
    level.width = map.info().width;
    level.height = map.info().height;
    const PixelSlabs pixels(map, face);
    return makeLevel(map.info().channels, level, [&] {
        return [&](std::uint32_t x, std::uint32_t y, std::vector<Slab>& slabs) {
            pixels.read(map.pixel(face, x, y), x, y, kind, slabs);
        };
    });
}

/// The lists of up to four texels, each read from its front.
template <std::uint32_t kChannels>
struct ListReaders {
    // What is left of the first slab of each list that was not taken; low is infinite
    // at the end.
    float low[4], high[4];
    float depth[4][kChannels];

    void clear() noexcept {
        count_ = 0;
        std::fill_n(low, 4, HUGE_VALF);
        std::fill_n(high, 4, HUGE_VALF);
    }
    void add(const std::vector<std::uint32_t>& slabs,
             const DensityTexel& texel) noexcept {
        const std::size_t k = count_++;
        at_[k] = slabs.data() + texel.begin;
        left_[k] = stride_[k] = texel.count;
        take(k);
    }
    void take(std::size_t k) noexcept {
        if (left_[k] == 0) {
            low[k] = HUGE_VALF;
            return;
        }
        --left_[k];
        const Slab slab = unpack(at_[k]++, stride_[k], kChannels);
        low[k] = slab.low;
        high[k] = slab.high;
        std::copy_n(slab.depth.begin(), kChannels, depth[k]);
    }
    [[nodiscard]] std::size_t count() const noexcept { return count_; }
    [[nodiscard]] float first() const noexcept {
        return std::min(std::min(low[0], low[1]), std::min(low[2], low[3]));
    }
    [[nodiscard]] float length(std::size_t k) const noexcept { return high[k] - low[k]; }
    [[nodiscard]] float thickest(std::size_t k) const noexcept {
        return *std::max_element(depth[k], depth[k] + kChannels);
    }

  private:
    std::size_t count_ = 0;
    const std::uint32_t* at_[4] = {};
    std::uint32_t left_[4] = {}, stride_[4] = {};
};

/// Merges the lists of up to four texels, whose areas are equal and beside one another.
/// Where a slab of theirs is as deep or long as may be, all are cut.
template <std::uint32_t kChannels>
class Merger {
  public:
    using Lists = ListReaders<kChannels>;

    explicit Merger(Limits limits) : limits_(limits) {}

    void merge(Lists& lists, std::vector<Slab>& out) {
        out.clear();
        share_ = 1.0f / float(lists.count());
        for (;;) {
            const float at = lists.first();
            if (open_ && at >= end_) close(out);
            if (at == HUGE_VALF) return;
            if (!open_) begin(at);
            if (!takeWhole(lists, at, out)) advance(lists, at, out);
        }
    }

  private:
    void begin(float at) {
        open_ = true;
        low_ = high_ = at;
        end_ = at + limits_.lengthAt(at);
        shortest_ = kShortestCut * limits_.lengthAt(at);
        depth_ = {};
        thickest_ = moment_ = 0.0f;
    }

    void close(std::vector<Slab>& out) {
        Slab slab{low_, high_, {}};
        if (limits_.thin && high_ <= end_ && thickest_ > 0.0f)
            slab = thinAt(low_ + moment_ / thickest_);
        // The depth whose transmittance is the mean of the children's.
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            float taken = 0.0f;
            for (const auto& child : depth_)
                taken += takenBy(child[c]);
            slab.depth[c] = depthThatTakes(taken * share_);
        }
        out.push_back(slab);
        open_ = false;
    }

    /// If a slab that begins at `at` is not to be cut: takes all of it, or ends the one
    /// that is open because it does not fit.
    bool takeWhole(Lists& lists, float at, std::vector<Slab>& out) {
        // Which list has it cannot be foreseen, so no branch asks.
        unsigned whole = 0;
        for (std::size_t k = 0; k < 4; ++k) {
            const bool isShort = limits_.thin | (lists.length(k) <= shortest_);
            whole |= unsigned(isShort & (lists.low[k] <= at)) << k;
        }
        if (whole == 0) return false;
        const auto k = std::size_t(std::countr_zero(whole));
        const float thickest = thickest_ + share_ * lists.thickest(k);
        if (high_ > low_ && (thickest > limits_.depth || lists.high[k] > end_)) {
            close(out);
        } else {
            add(lists, k, lists.high[k], 1.0f);
            lists.take(k);
        }
        return true;
    }

    /// Takes what lies from `at` to where a list's slab begins or ends, or the one that
    /// is open has to.
    void advance(Lists& lists, float at, std::vector<Slab>& out) {
        float to = std::max(end_, at + shortest_), density = 0.0f;
        for (std::size_t k = 0; k < lists.count(); ++k) {
            if (lists.low[k] > at) {
                to = std::min(to, lists.low[k]);
            } else {
                to = std::min(to, lists.high[k]);
                density += share_ * lists.thickest(k) / lists.length(k);
            }
        }
        const float left = std::max(limits_.depth - thickest_, 0.0f);
        if (density * (to - at) > left)
            to = std::min(to, at + std::max(left / density, shortest_));
        for (std::size_t k = 0; k < lists.count(); ++k) {
            if (lists.low[k] > at) continue;
            // All of it, too, where floats do not tell the ends of the part.
            const bool cut = to > at && to < lists.high[k];
            const float part = cut ? (to - at) / lists.length(k) : 1.0f;
            add(lists, k, std::min(to, lists.high[k]), part);
            if (!cut) {
                lists.take(k);
                continue;
            }
            lists.low[k] = to;
            for (float& d : lists.depth[k])
                d *= 1.0f - part;
        }
        if (thickest_ >= 0.999f * limits_.depth || to >= end_) close(out);
    }

    /// A part of the first slab of list k, up to `high`.
    void add(const Lists& lists, std::size_t k, float high, float part) {
        high_ = std::max(high_, high);
        float thickest = 0.0f;
        for (std::uint32_t c = 0; c < kChannels; ++c) {
            const float depth = part * lists.depth[k][c];
            depth_[k][c] += depth;
            thickest = std::max(thickest, depth);
        }
        thickest_ += share_ * thickest;
        moment_ += share_ * thickest * (0.5f * (lists.low[k] + high) - low_);
    }

    Limits limits_;
    float share_ = 1.0f;  // of a child in the area
    // The slab that is open: from low_ to high_ so far, to end_ at most. What its
    // thickest channel has, mean over the children.
    bool open_ = false;
    float low_ = 0.0f, high_ = 0.0f, end_ = 0.0f, shortest_ = 0.0f, thickest_ = 0.0f;
    float moment_ = 0.0f;                                  // of that, about low_
    std::array<std::array<float, kChannels>, 4> depth_{};  // [child][channel]
};

/// Level 1 of a face, level 0 being read a texel's four pixels at a time.
template <std::uint32_t kChannels>
class PixelMerger {
  public:
    PixelMerger(const ShadowMap& map, std::uint32_t face, Kind kind, Limits limits)
        : map_(map), face_(face), kind_(kind), pixels_(map, face), merger_(limits) {}

    void operator()(std::uint32_t x, std::uint32_t y, std::vector<Slab>& slabs) {
        const std::uint32_t width = map_.info().width, height = map_.info().height;
        DensityTexel texels[4];
        std::size_t count = 0;
        words_.clear();
        for (std::uint32_t v = 2 * y; v < std::min(2 * y + 2, height); ++v) {
            for (std::uint32_t u = 2 * x; u < std::min(2 * x + 2, width); ++u) {
                pixels_.read(map_.pixel(face_, u, v), u, v, kind_, slabs);
                DensityTexel& texel = texels[count++];
                const std::size_t begin = words_.size();
                texel = pack(slabs, kChannels, words_);
                texel.begin = std::uint32_t(begin);
            }
        }
        slabs.clear();
        if (words_.empty()) return;
        lists_.clear();
        for (std::size_t k = 0; k < count; ++k)
            lists_.add(words_, texels[k]);
        merger_.merge(lists_, slabs);
    }

  private:
    const ShadowMap& map_;
    std::uint32_t face_;
    Kind kind_;
    PixelSlabs pixels_;
    Merger<kChannels> merger_;
    ListReaders<kChannels> lists_;
    std::vector<std::uint32_t> words_;
};

template <std::uint32_t kChannels>
bool makeLevel1(const ShadowMap& map, std::uint32_t face, Kind kind, Limits limits,
                DensityLevel& level) {
    level.width = (map.info().width + 1) / 2;
    level.height = (map.info().height + 1) / 2;
    return makeLevel(kChannels, level,
                     [&] { return PixelMerger<kChannels>(map, face, kind, limits); });
}

template <std::uint32_t kChannels>
bool makeCoarser(const DensityLevel& fine, Limits limits, DensityLevel& level) {
    level.width = (fine.width + 1) / 2;
    level.height = (fine.height + 1) / 2;
    return makeLevel(kChannels, level, [&] {
        return [&, merger = Merger<kChannels>(limits), lists = ListReaders<kChannels>()](
                   std::uint32_t x, std::uint32_t y, std::vector<Slab>& slabs) mutable {
            lists.clear();
            for (std::uint32_t v = 2 * y; v < std::min(2 * y + 2, fine.height); ++v) {
                for (std::uint32_t u = 2 * x; u < std::min(2 * x + 2, fine.width); ++u)
                    lists.add(fine.slabs, fine.texel(u, v));
            }
            merger.merge(lists, slabs);
        };
    });
}

bool makePyramid(const ShadowMap& map, std::uint32_t face, Kind kind,
                 const DensityOptions& options, DensityPyramid& pyramid) {
    const Projection& p = map.projection(face);
    const bool colour = map.info().channels == 3;
    pyramid.levels.emplace_back();
    if (options.finest == 0) {
        if (!makePixels(map, face, kind, pyramid.levels[0])) return false;
    } else {
        const auto level1 = colour ? makeLevel1<3> : makeLevel1<1>;
        pyramid.levels.emplace_back();
        if (!level1(map, face, kind, limitsOf(p, options, kind, 1), pyramid.levels[1]))
            return false;
    }
    if (pyramid.levels.back().slabs.size() == kLanes) {
        pyramid = {};
        return true;
    }
    pyramid.low = HUGE_VALF;
    pyramid.high = -HUGE_VALF;
    for (const DensityTexel& texel : pyramid.levels.back().texels) {
        pyramid.low = std::min(pyramid.low, texel.low);
        pyramid.high = std::max(pyramid.high, texel.high);
    }
    const auto coarser = colour ? makeCoarser<3> : makeCoarser<1>;
    while (pyramid.levels.back().width > 1 || pyramid.levels.back().height > 1) {
        const auto i = std::uint32_t(pyramid.levels.size());
        DensityLevel level;
        const Limits limits = limitsOf(p, options, kind, i);
        if (!coarser(pyramid.levels.back(), limits, level)) return false;
        if (i <= options.finest) pyramid.levels.back() = {};
        pyramid.levels.push_back(std::move(level));
    }
    return true;
}

std::uint64_t bytesOf(const DensityPyramid& pyramid) {
    std::uint64_t bytes = 0;
    for (const DensityLevel& level : pyramid.levels)
        bytes += level.texels.size() * sizeof(DensityTexel) +
                 level.slabs.size() * sizeof(std::uint32_t);
    return bytes;
}

}  // namespace

Result<DensityTree> DensityTree::build(const ShadowMap& map, std::uint32_t face,
                                       const DensityOptions& options) {
    DensityTree tree;
    tree.projection_ = map.projection(face);
    tree.channels_ = map.info().channels;
    tree.ofSheets_ = map.info().translucent == Translucent::sheets;
    tree.width_ = map.info().width;
    tree.height_ = map.info().height;
    const auto coarsest =
        std::uint32_t(std::bit_width(std::max(tree.width_, tree.height_) - 1));
    DensityOptions present = options;
    present.finest = tree.finest_ = std::min(options.finest, coarsest);
    const bool indexable = std::uint64_t(tree.width_) * tree.height_ <= kMostTexels;
    if (!indexable ||
        (!tree.ofSheets_ && !makePyramid(map, face, Kind::media, present, tree.media_)) ||
        !makePyramid(map, face, Kind::sheets, present, tree.sheets_))
        return base::makeError(
            ErrorCode::tooLarge, "face ", face,
            " has too many pixels or layers for a density tree: bake with a "
            "lower resolution or a larger tolerance");
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
    const Trees& trees = setsOf(map)[coarse].get<Trees>([&] {
        DensityOptions options;
        options.finest = coarse ? kFinestBesideNear : 0;
        return buildAll(map, options);
    });
    return trees.empty() ? nullptr : &trees;
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
