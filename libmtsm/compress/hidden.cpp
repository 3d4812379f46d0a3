// How far a ray can stray. In light space a ray from the point (c z, z) of the ray
// through raster position scale c + offset to the light's point (l, d) is at depth s, d <
// s < z,
//
//     scale (l - c d) (z - s) / (s (z - d))
//
// pixels away from where it started: further the nearer s, and the further z. For an
// orthographic face it is scale (z - s) times the ray's slope.
#include "compress/hidden.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <limits>
#include <optional>
#include <vector>

#include "base/parallel.h"

namespace mtsm::compress {
namespace {

constexpr float kNone = std::numeric_limits<float>::infinity();
constexpr std::uint32_t kRowsPerTask = 32;
constexpr double kMostPixels = 256.0;  // across a window

struct Interval {
    double low = 0.0, high = 0.0;
};

Interval operator*(Interval a, Interval b) {
    const auto [low, high] =
        std::minmax({a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high});
    return {low, high};
}
Interval operator-(Interval a, Interval b) {
    return {a.low - b.high, a.high - b.low};
}

/// Pixels [x0, x1] x [y0, y1].
struct Window {
    double x0 = 0.0, x1 = 0.0, y0 = 0.0, y1 = 0.0;
};

/// The rays to one light.
class Rays {
  public:
    Rays(const Projection& projection, const AreaLight& light) : projection_(projection) {
        perspective_ = projection.kind == ProjectionKind::perspective;
        usable_ = perspective_ != (light.shape == LightShape::sun);
        const glm::dvec3 axis =
            glm::normalize(projection.lightFromWorldDirection(light.direction));
        if (!perspective_) {
            const double angle =
                std::acos(std::clamp(axis.z, -1.0, 1.0)) + 0.5 * light.angularDiameter;
            usable_ = usable_ && angle < 0.499 * glm::pi<double>();
            const double slope = std::tan(angle);
            x_ = y_ = {-slope, slope};
            return;
        }
        const glm::dvec3 centre = projection.lightFromWorld(light.position);
        const double radius = lightRadius(light);
        // Disk and rect reach in depth as far as they are turned off the axis.
        double reach = 0.0;
        if (light.shape == LightShape::sphere)
            reach = radius;
        else if (light.shape != LightShape::point)
            reach = radius * glm::length(glm::dvec2(axis));
        x_ = {centre.x - radius, centre.x + radius};
        y_ = {centre.y - radius, centre.y + radius};
        z_ = {centre.z - reach, centre.z + reach};
    }

    /// False: nothing is known of these rays.
    [[nodiscard]] bool usable() const noexcept { return usable_; }

    /// Where rays from pixel (x, y), at depths up to `from`, may be while no nearer than
    /// `to`, and a pixel more on each side.
    [[nodiscard]] std::optional<Window> reach(std::uint32_t x, std::uint32_t y,
                                              double from, double to) const {
        Interval dx, dy;
        if (perspective_) {
            // Light at both sides of such depths is in nobody's way.
            if (!(to > z_.high && from > to)) return {};
            const double factor = (from - to) / (to * (from - z_.high));
            dx = strays(x, projection_.scale.x, projection_.offset.x, x_, factor);
            dy = strays(y, projection_.scale.y, projection_.offset.y, y_, factor);
        } else {
            if (!(from > to)) return {};
            dx = Interval{projection_.scale.x, projection_.scale.x} * x_;
            dy = Interval{projection_.scale.y, projection_.scale.y} * y_;
            for (Interval* d : {&dx, &dy})
                *d = {d->low * (from - to), d->high * (from - to)};
        }
        // It starts anywhere in the pixel, and strays by nothing at first.
        const Window w{std::floor(x - 1.0 + std::min(0.0, dx.low)),
                       std::ceil(x + 1.0 + std::max(0.0, dx.high)),
                       std::floor(y - 1.0 + std::min(0.0, dy.low)),
                       std::ceil(y + 1.0 + std::max(0.0, dy.high))};
        if (!(w.x1 - w.x0 < kMostPixels && w.y1 - w.y0 < kMostPixels)) return {};
        return w;
    }

  private:
    [[nodiscard]] Interval strays(double pixel, double scale, double offset,
                                  Interval light, double factor) const {
        const double a = (pixel - offset) / scale, b = (pixel + 1.0 - offset) / scale;
        const Interval across = light - Interval{std::min(a, b), std::max(a, b)} * z_;
        const double f = scale * factor;
        return Interval{f, f} * across;
    }

    const Projection& projection_;
    bool perspective_ = true, usable_ = true;
    Interval x_, y_;  ///< of the light's points; orthographic: of the rays' slopes
    Interval z_;      ///< of the light's points
};

/// The first opaque layers of all pixels, and a pyramid of their depths.
class Walls {
  public:
    Walls(const MapInfo& info, const MapFace& face)
        : width_(info.width),
          height_(info.height),
          bias_(info.bias),
          biasPerDepth_(info.biasPerDepth) {
        find(info, face);
        build();
    }

    /// kNone if the pixel has none.
    [[nodiscard]] float at(std::uint32_t x, std::uint32_t y) const noexcept {
        return first_[std::size_t(y) * width_ + x];
    }

    /// The depths over a window, or a little more of the face; max is kNone if there is a
    /// hole or a step.
    [[nodiscard]] ZRange range(const Window& w) const noexcept {
        const auto x0 = std::uint32_t(w.x0), x1 = std::uint32_t(w.x1);
        const auto y0 = std::uint32_t(w.y0), y1 = std::uint32_t(w.y1);
        // The window is two to four nodes wide: it touches up to five.
        const auto digits = std::uint32_t(std::bit_width(std::max(x1 - x0, y1 - y0) + 1));
        const std::uint32_t level =
            std::min(std::max(digits, 2u) - 2, std::uint32_t(levels_.size()));
        ZRange range;
        for (std::uint32_t y = y0 >> level; y <= y1 >> level; ++y) {
            for (std::uint32_t x = x0 >> level; x <= x1 >> level; ++x)
                range.include(node(level, x, y));
        }
        return range;
    }

  private:
    struct Level {
        std::uint32_t width = 0, height = 0;
        std::vector<ZRange> nodes;
    };

    void find(const MapInfo& info, const MapFace& face);
    void build();

    /// Does no ray slip through between neighbours at these depths? It would have to be
    /// further than the threshold from both where it changes pixels.
    [[nodiscard]] bool joined(float a, float b) const noexcept {
        constexpr double kAlmost = 1.0 - 1e-6;  // rays are rounded, too
        return std::abs(double(a) - b) <=
               2.0 * kAlmost * (bias_ + biasPerDepth_ * std::min(a, b));
    }
    /// Of a pixel and its neighbours on the right and below; rays cross corners, too.
    [[nodiscard]] ZRange pixel(std::uint32_t x, std::uint32_t y) const noexcept {
        const float z = at(x, y);
        const bool right = x + 1 < width_, below = y + 1 < height_;
        bool closed = z < kNone;
        if (right) closed = closed && joined(z, at(x + 1, y));
        if (below) closed = closed && joined(z, at(x, y + 1));
        if (right && below)
            closed = closed && joined(z, at(x + 1, y + 1)) &&
                     joined(at(x + 1, y), at(x, y + 1));
        return {z, closed ? z : kNone};
    }
    [[nodiscard]] ZRange node(std::uint32_t level, std::uint32_t x,
                              std::uint32_t y) const noexcept {
        if (level == 0) return pixel(x, y);
        const Level& l = levels_[level - 1];
        return l.nodes[std::size_t(y) * l.width + x];
    }

    std::uint32_t width_, height_;
    double bias_, biasPerDepth_;
    std::vector<float> first_;
    std::vector<Level> levels_;  ///< of 2 x 2 pixels and up
};

bool isOpaque(const Tile& tile, std::uint32_t layer, std::uint32_t channels) {
    for (std::uint32_t c = 0; c < channels && !tile.v.empty(); ++c) {
        if (tile.v[c * tile.z.size() + layer] > 0.0f) return false;
    }
    return true;
}

/// Where a tile's pixels lie in the face.
struct Place {
    std::uint32_t x = 0, y = 0, width = 0;
};

Place placeOf(const MapInfo& info, std::size_t tile) {
    const std::uint32_t tilesX = (info.width + info.tileSize - 1) / info.tileSize;
    Place p;
    p.x = std::uint32_t(tile % tilesX) * info.tileSize;
    p.y = std::uint32_t(tile / tilesX) * info.tileSize;
    p.width = std::min(info.tileSize, info.width - p.x);
    return p;
}

void Walls::find(const MapInfo& info, const MapFace& face) {
    first_.assign(std::size_t(width_) * height_, kNone);
    base::parallelFor(std::size_t(0), face.tiles.size(), [&](std::size_t i) {
        const Tile& tile = face.tiles[i];
        const Place place = placeOf(info, i);
        for (std::uint32_t p = 0; p + 1 < tile.begin.size(); ++p) {
            std::uint32_t layer = tile.begin[p];
            while (layer < tile.begin[p + 1] && !isOpaque(tile, layer, info.channels))
                ++layer;
            if (layer == tile.begin[p + 1]) continue;
            const std::size_t x = place.x + p % place.width,
                              y = place.y + p / place.width;
            first_[y * width_ + x] = tile.z[layer];
        }
    });
}

void Walls::build() {
    std::uint32_t width = width_, height = height_;
    for (std::uint32_t side = 2; side < std::uint32_t(kMostPixels); side *= 2) {
        const auto below = std::uint32_t(levels_.size());
        const std::uint32_t belowWidth = width, belowHeight = height;
        Level l;
        l.width = width = (width + 1) / 2;
        l.height = height = (height + 1) / 2;
        l.nodes.resize(std::size_t(width) * height);
        base::parallelRanges(0u, height, kRowsPerTask, [&](auto first, auto last) {
            for (std::uint32_t y = 2 * first; y < std::min(belowHeight, 2 * last); ++y) {
                ZRange* const row = l.nodes.data() + std::size_t(y / 2) * l.width;
                for (std::uint32_t x = 0; x < belowWidth; ++x)
                    row[x / 2].include(node(below, x, y));
            }
        });
        levels_.push_back(std::move(l));
    }
}

/// What decides for one face.
class Seen {
  public:
    Seen(const MapInfo& info, const MapFace& face, double zMax)
        : info_(info), rays_(face.projection, info.light), walls_(info, face) {
        const double base = info.bias, perDepth = info.biasPerDepth;
        // A ray's threshold is that of its depth, which is at most so far behind zMax.
        const double end = zMax * (1.0 + 0x1p-20) + base + perDepth * zMax;
        bias_ = base + perDepth * end;
        // In front of the first opaque layer of a pixel a ray may begin where surfaces do
        // not count yet but media do (five thresholds and one footprint from a receiver
        // without a normal): what is that close behind a wall stays.
        margin_ = (info.translucent == Translucent::media ? 8.0 : 2.0) * bias_;
    }

    [[nodiscard]] bool usable() const noexcept { return rays_.usable(); }

    /// How many layers of a tile's pixel some point of the light may see.
    [[nodiscard]] std::uint32_t layers(const Tile& tile, std::uint32_t p,
                                       Place place) const {
        const std::uint32_t begin = tile.begin[p], end = tile.begin[p + 1];
        const std::uint32_t x = place.x + p % place.width, y = place.y + p / place.width;
        std::uint32_t kept = end - begin;
        for (; kept > 1; --kept) {
            // The first of the samples that the layer stands for.
            const std::uint32_t i = begin + kept - 1;
            const double z = tile.z[i], before = tile.z[i - 1];
            const std::uint32_t n = tile.n.empty() ? 1 : tile.n[i];
            if (!isHidden(x, y, n > 1 ? before + (z - before) / n : z, z)) break;
        }
        return kept;
    }

  private:
    [[nodiscard]] bool isHidden(std::uint32_t x, std::uint32_t y, double nearest,
                                double furthest) const {
        // The window holds rays as far as its nearest wall, which may lie in the part
        // that is added.
        double to = walls_.at(x, y);
        for (int grown = 0; grown < 8 && nearest > to + margin_; ++grown) {
            const auto window = rays_.reach(x, y, furthest + bias_, to);
            if (!window || window->x0 < 0.0 || window->y0 < 0.0 ||
                window->x1 >= info_.width || window->y1 >= info_.height)
                return false;
            const ZRange range = walls_.range(*window);
            if (!(nearest > double(range.max) + margin_)) return false;
            if (range.min >= to) return true;
            to = range.min;
        }
        return false;
    }

    const MapInfo& info_;
    Rays rays_;
    Walls walls_;
    double bias_ = 0.0, margin_ = 0.0;
};

/// Leaves the first kept[p] layers of each pixel.
Tile cut(const Tile& tile, const std::vector<std::uint32_t>& kept,
         std::uint32_t channels) {
    Tile out;
    out.begin.push_back(0);
    for (const std::uint32_t count : kept)
        out.begin.push_back(out.begin.back() + count);
    const auto take = [&](const auto& from, auto& to, std::size_t plane) {
        if (from.empty()) return;
        for (std::size_t p = 0; p < kept.size(); ++p) {
            const auto first = from.begin() + std::ptrdiff_t(plane + tile.begin[p]);
            to.insert(to.end(), first, first + kept[p]);
        }
    };
    take(tile.z, out.z, 0);
    for (std::uint32_t c = 0; c < channels; ++c)
        take(tile.v, out.v, c * tile.z.size());
    take(tile.n, out.n, 0);
    // Planes may say nothing any more.
    if (std::all_of(out.v.begin(), out.v.end(), [](float v) { return v == 0.0f; }))
        out.v = {};
    if (std::all_of(out.n.begin(), out.n.end(), [](std::uint32_t n) { return n == 1; }))
        out.n = {};
    return out;
}

}  // namespace

Hidden dropHidden(const MapInfo& info, MapFace& face) {
    float zMax = 0.0f;
    for (const Tile& tile : face.tiles) {
        for (const float z : tile.z)
            zMax = std::max(zMax, z);
    }
    const Seen seen(info, face, zMax);
    if (!seen.usable()) return {};
    std::vector<Hidden> dropped(face.tiles.size());
    base::parallelFor(std::size_t(0), face.tiles.size(), [&](std::size_t i) {
        Tile& tile = face.tiles[i];
        if (tile.empty()) return;
        const Place place = placeOf(info, i);
        std::vector<std::uint32_t> kept(tile.begin.size() - 1);
        for (std::uint32_t p = 0; p < kept.size(); ++p) {
            kept[p] = seen.layers(tile, p, place);
            for (std::uint32_t l = tile.begin[p] + kept[p]; l < tile.begin[p + 1]; ++l) {
                ++dropped[i].layers;
                dropped[i].samples += tile.n.empty() ? 1 : tile.n[l];
            }
        }
        if (dropped[i].layers > 0) tile = cut(tile, kept, info.channels);
    });
    Hidden all;
    for (const Hidden& h : dropped) {
        all.layers += h.layers;
        all.samples += h.samples;
    }
    return all;
}

}  // namespace mtsm::compress
