// Level 0 from the layers of each pixel, each level above from four lists of slabs below.
#include "trace/density_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/message.h"
#include "base/parallel.h"

namespace mtsm::trace {
namespace {

constexpr std::uint32_t kRowsPerTask = 16;
/// What lies at one depth is given this length, of its w: enough for floats to tell parts
/// of it, and far below a pixel's footprint.
constexpr float kThinnest = 0x1p-17f;
/// Surfaces are merged over this many texel footprints, at any depth.
constexpr double kSurfaceLength = 2.0;

struct Slab {
    float low = 0.0f, high = 0.0f;
    std::array<float, 3> depth{};
};

/// Slabs that join one another are merged up to these.
struct Limits {
    float depth = 0.0f;
    float length = 0.0f;    ///< w, or share of w
    bool relative = false;  ///< to w: a perspective view's footprint is a share of z
    [[nodiscard]] float lengthAt(float w) const noexcept {
        return relative ? length * w : length;
    }
};

Limits limitsOf(const Projection& p, double depth, double length, std::uint32_t level) {
    const double texel = p.pixelFootprint(1.0) * double(std::uint64_t(1) << level);
    return {float(depth), float(length * texel), p.kind == ProjectionKind::perspective};
}

// --- a pixel's layers ------------------------------------------------------------------

class PixelSlabs {
  public:
    PixelSlabs(const ShadowMap& map, std::uint32_t face)
        : projection_(map.projection(face)),
          channels_(map.info().channels),
          perspective_(projection_.kind == ProjectionKind::perspective) {}

    /// The slabs of pixel (x, y), in order of w: those of the medium, or the surfaces.
    void read(const PixelLayers& pixel, std::uint32_t x, std::uint32_t y, bool surfaces,
              std::vector<Slab>& out) const {
        out.clear();
        const float way = surfaces ? 1.0f : 1.0f / centreWay(x, y);
        for (std::uint32_t i = pixel.count; i-- > 0;) {
            const bool surface = isSurface(pixel, i);
            if (surface != surfaces) continue;
            if (surface)
                out.push_back(at(pixel.z[i], {kDarkDepth, kDarkDepth, kDarkDepth}));
            else
                medium(pixel, i, way, out);
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
    [[nodiscard]] bool isSurface(const PixelLayers& pixel, std::uint32_t i) const {
        return (!pixel.n || pixel.n[i] == 1) && isDark(pixel, i);
    }

    /// Way of the centre ray per unit of depth.
    [[nodiscard]] float centreWay(std::uint32_t x, std::uint32_t y) const {
        if (!perspective_) return 1.0f;
        const glm::dvec2 c =
            (glm::dvec2(x + 0.5, y + 0.5) - projection_.offset) / projection_.scale;
        return float(std::sqrt(1.0 + c.x * c.x + c.y * c.y));
    }

    [[nodiscard]] float straight(float z) const { return perspective_ ? 1.0f / z : -z; }

    [[nodiscard]] Slab at(float z, std::array<float, 3> depth) const {
        return between(straight(z), straight(z), depth);
    }
    static Slab between(float low, float high, std::array<float, 3> depth) {
        const float thinnest = std::max(kThinnest * std::abs(low), 1e-30f);
        return {low, std::max(high, low + thinnest), depth};
    }

    /// The samples of layer i: spread from the layer before to its own depth. Where they
    /// end dark, the last one blocks and the others take nothing.
    void medium(const PixelLayers& pixel, std::uint32_t i, float way,
                std::vector<Slab>& out) const {
        const bool restart = i == 0 || isDark(pixel, i - 1);
        std::array<float, 3> depth{}, end{};
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
        const bool single = i == 0 || !pixel.n || pixel.n[i] == 1;
        out.push_back(between(straight(pixel.z[i]),
                              straight(single ? pixel.z[i] : pixel.z[i - 1]), depth));
    }

    const Projection& projection_;
    std::uint32_t channels_;
    bool perspective_;
};

// --- merging ---------------------------------------------------------------------------

/// Merges slabs that come in order of their middle. Each belongs to one of `children`
/// areas of equal size that lie beside one another.
class Merger {
  public:
    Merger(std::uint32_t channels, Limits limits)
        : channels_(channels), limits_(limits) {}

    void begin(std::uint32_t children, std::vector<Slab>& out) {
        children_ = children;
        out_ = &out;
        out.clear();
        count_ = 0;
    }
    void add(const Slab& slab, std::uint32_t child) {
        if (count_ > 0 && !fits(slab)) end();
        if (count_++ == 0) {
            low_ = slab.low;
            high_ = slab.high;
            depth_ = {};
            thickest_ = 0.0f;
        }
        low_ = std::min(low_, slab.low);
        high_ = std::max(high_, slab.high);
        for (std::uint32_t c = 0; c < channels_; ++c)
            depth_[child][c] += slab.depth[c];
        thickest_ += *std::max_element(slab.depth.begin(), slab.depth.end());
    }
    void end() {
        if (count_ > 0) out_->push_back({low_, high_, merged()});
        count_ = 0;
    }

  private:
    [[nodiscard]] bool fits(const Slab& slab) const {
        const float low = std::min(low_, slab.low), high = std::max(high_, slab.high);
        const float depth =
            thickest_ + *std::max_element(slab.depth.begin(), slab.depth.end());
        return high - low <= limits_.lengthAt(high) &&
               depth <= limits_.depth * float(children_);
    }

    /// The depth whose transmittance is the mean of the children's.
    [[nodiscard]] std::array<float, 3> merged() const {
        std::array<float, 3> result{};
        for (std::uint32_t c = 0; c < channels_; ++c) {
            if (children_ == 1) {
                result[c] = std::min(depth_[0][c], kDarkDepth);
                continue;
            }
            // 1 - exp(-d), kept apart from 1 for thin slabs.
            float taken = 0.0f;
            for (std::uint32_t k = 0; k < children_; ++k)
                taken -= std::expm1(-depth_[k][c]);
            taken /= float(children_);
            result[c] = taken < 1.0f ? -std::log1p(-taken) : kDarkDepth;
        }
        return result;
    }

    std::uint32_t channels_;
    Limits limits_;
    std::uint32_t children_ = 1;
    std::vector<Slab>* out_ = nullptr;
    std::uint32_t count_ = 0;  // slabs in what is open
    float low_ = 0.0f, high_ = 0.0f, thickest_ = 0.0f;
    std::array<std::array<float, 3>, 4> depth_{};  // [child][channel]
};

// --- levels ----------------------------------------------------------------------------

/// The slabs of some rows of texels, one list after another.
struct Rows {
    std::vector<std::uint32_t> counts;
    std::vector<Slab> slabs;
};

/// Puts the rows of all tasks together; false if there are too many slabs.
bool assemble(std::vector<Rows>& tasks, std::uint32_t channels, DensityLevel& level) {
    const std::size_t texels = std::size_t(level.width) * level.height;
    std::vector<std::uint64_t> first(tasks.size() + 1, 0);
    for (std::size_t t = 0; t < tasks.size(); ++t)
        first[t + 1] = first[t] + tasks[t].slabs.size();
    if (first.back() > std::numeric_limits<std::uint32_t>::max() - kLanes) return false;
    const std::size_t room = first.back() + kLanes;
    level.low.resize(texels);
    level.high.resize(texels);
    level.begin.resize(texels + 1);
    level.begin[texels] = std::uint32_t(first.back());
    level.slabLow.resize(room);
    level.slabHigh.resize(room);
    for (std::uint32_t c = 0; c < channels; ++c)
        level.density[c].resize(room);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        std::size_t texel = task * kRowsPerTask * level.width, to = first[task];
        const Slab* from = tasks[task].slabs.data();
        for (const std::uint32_t count : tasks[task].counts) {
            float low = HUGE_VALF, high = -HUGE_VALF;
            level.begin[texel] = std::uint32_t(to);
            for (std::uint32_t i = 0; i < count; ++i, ++from, ++to) {
                low = std::min(low, from->low);
                high = std::max(high, from->high);
                level.slabLow[to] = from->low;
                level.slabHigh[to] = from->high;
                for (std::uint32_t c = 0; c < channels; ++c)
                    level.density[c][to] = from->depth[c] / (from->high - from->low);
            }
            level.low[texel] = low;
            level.high[texel++] = high;
        }
        tasks[task] = {};
    });
    return true;
}

/// texel(x, y, scratch) calls for every texel, row by row; its slabs are scratch.slabs.
template <typename MakeTexels>
bool makeLevel(std::uint32_t channels, DensityLevel& level, const MakeTexels& make) {
    std::vector<Rows> tasks((level.height + kRowsPerTask - 1) / kRowsPerTask);
    base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
        const auto y0 = std::uint32_t(task) * kRowsPerTask;
        make(y0, std::min(level.height, y0 + kRowsPerTask), tasks[task]);
    });
    return assemble(tasks, channels, level);
}

void append(const std::vector<Slab>& slabs, Rows& rows) {
    rows.counts.push_back(std::uint32_t(slabs.size()));
    rows.slabs.insert(rows.slabs.end(), slabs.begin(), slabs.end());
}

bool makePixels(const ShadowMap& map, std::uint32_t face, bool surfaces, Limits limits,
                DensityLevel& level) {
    level.width = map.info().width;
    level.height = map.info().height;
    const PixelSlabs pixels(map, face);
    const auto make = [&](std::uint32_t y0, std::uint32_t y1, Rows& rows) {
        Merger merger(map.info().channels, limits);
        std::vector<Slab> slabs, merged;
        for (std::uint32_t y = y0; y < y1; ++y) {
            for (std::uint32_t x = 0; x < level.width; ++x) {
                pixels.read(map.pixel(face, x, y), x, y, surfaces, slabs);
                merger.begin(1, merged);
                for (const Slab& slab : slabs)
                    merger.add(slab, 0);
                merger.end();
                append(merged, rows);
            }
        }
    };
    return makeLevel(map.info().channels, level, make);
}

/// Reads a texel's list from its front.
struct ListReader {
    const DensityLevel& level;
    std::uint32_t next, end;
    ListReader(const DensityLevel& from, std::uint32_t x, std::uint32_t y)
        : level(from),
          next(from.begin[std::size_t(y) * from.width + x]),
          end(from.begin[std::size_t(y) * from.width + x + 1]) {}
    /// Twice the middle of the next slab.
    [[nodiscard]] float middle() const {
        return next < end ? level.slabLow[next] + level.slabHigh[next] : HUGE_VALF;
    }
    Slab take(std::uint32_t channels) {
        Slab slab{level.slabLow[next], level.slabHigh[next], {}};
        for (std::uint32_t c = 0; c < channels; ++c)
            slab.depth[c] = level.density[c][next] * (slab.high - slab.low);
        ++next;
        return slab;
    }
};

bool makeCoarser(const DensityLevel& fine, std::uint32_t channels, Limits limits,
                 DensityLevel& level) {
    level.width = (fine.width + 1) / 2;
    level.height = (fine.height + 1) / 2;
    const auto make = [&](std::uint32_t y0, std::uint32_t y1, Rows& rows) {
        Merger merger(channels, limits);
        std::vector<Slab> merged;
        std::vector<ListReader> lists;
        for (std::uint32_t y = y0; y < y1; ++y) {
            for (std::uint32_t x = 0; x < level.width; ++x) {
                lists.clear();
                for (std::uint32_t v = 2 * y; v < std::min(2 * y + 2, fine.height); ++v) {
                    for (std::uint32_t u = 2 * x; u < std::min(2 * x + 2, fine.width);
                         ++u)
                        lists.emplace_back(fine, u, v);
                }
                merger.begin(std::uint32_t(lists.size()), merged);
                for (;;) {
                    std::uint32_t first = 0;
                    for (std::uint32_t k = 1; k < lists.size(); ++k) {
                        if (lists[k].middle() < lists[first].middle()) first = k;
                    }
                    if (lists[first].next == lists[first].end) break;
                    merger.add(lists[first].take(channels), first);
                }
                merger.end();
                append(merged, rows);
            }
        }
    };
    return makeLevel(channels, level, make);
}

struct Merging {
    double depth, length, finestLength;
};

bool makePyramid(const ShadowMap& map, std::uint32_t face, bool surfaces, Merging merging,
                 DensityPyramid& pyramid) {
    const Projection& p = map.projection(face);
    pyramid.levels.emplace_back();
    if (!makePixels(map, face, surfaces,
                    limitsOf(p, merging.depth, merging.finestLength, 0),
                    pyramid.levels[0]))
        return false;
    if (pyramid.levels[0].begin.back() == 0) {
        pyramid = {};
        return true;
    }
    for (std::uint32_t i = 1;
         pyramid.levels.back().width > 1 || pyramid.levels.back().height > 1; ++i) {
        DensityLevel level;
        if (!makeCoarser(pyramid.levels.back(), map.info().channels,
                         limitsOf(p, merging.depth, merging.length, i), level))
            return false;
        pyramid.levels.push_back(std::move(level));
    }
    pyramid.low = pyramid.levels.back().low[0];
    pyramid.high = pyramid.levels.back().high[0];
    return true;
}

std::uint64_t bytesOf(const DensityPyramid& pyramid) {
    std::uint64_t bytes = 0;
    for (const DensityLevel& l : pyramid.levels) {
        for (const auto* plane : {&l.low, &l.high, &l.slabLow, &l.slabHigh, &l.density[0],
                                  &l.density[1], &l.density[2]})
            bytes += plane->size() * sizeof(float);
        bytes += l.begin.size() * sizeof(std::uint32_t);
    }
    return bytes;
}

}  // namespace

Result<DensityTree> DensityTree::build(const ShadowMap& map, std::uint32_t face,
                                       const DensityOptions& options) {
    if (map.info().translucent != Translucent::media)
        return base::makeError(ErrorCode::badArgument,
                               "a density tree is made of a map of media, not of sheets");
    DensityTree tree;
    tree.projection_ = map.projection(face);
    tree.channels_ = map.info().channels;
    const double dark = 8.0 * kDarkDepth;
    const double length = options.length > 0.0 ? options.length : DensityOptions{}.length;
    if (!makePyramid(map, face, false, {options.depth, length, options.length},
                     tree.media_) ||
        !makePyramid(map, face, true, {dark, kSurfaceLength, 0.0}, tree.surfaces_))
        return base::makeError(ErrorCode::tooLarge, "face ", face,
                               " has too many layers for a density tree: bake with a "
                               "larger tolerance or fewer layers");
    return tree;
}

std::uint64_t DensityTree::memoryBytes() const noexcept {
    return bytesOf(media_) + bytesOf(surfaces_);
}

}  // namespace mtsm::trace
