// ShadowMap: the invariants of map.h, checked once, and the min/max-z hierarchy.
#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <set>

#include "base/finite.h"
#include "base/lazy.h"
#include "base/message.h"
#include "base/parallel.h"
#include "map/near_boxes.h"
#include "map/sheet_checks.h"
#include "mtsm/map.h"

namespace mtsm {
namespace {

using base::makeError;

constexpr std::uint32_t kRowsPerTask = 32;

template <typename... Parts>
Error invalid(const Parts&... parts) {
    return makeError(ErrorCode::badArgument, parts...);
}

Status checkProjection(const Projection& p, std::uint32_t face) {
    if (p.kind != ProjectionKind::perspective && p.kind != ProjectionKind::orthographic)
        return invalid("face ", face, ": projection kind ", unsigned(p.kind),
                       " is neither perspective (0) nor orthographic (1)");
    if (!base::isFinite(p.eye)) return invalid("face ", face, ": the eye is not finite");
    // The axes are unit vectors at right angles, to what doubles can hold.
    const glm::dvec3 axes[3] = {p.right, p.up, p.forward};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double dot = glm::dot(axes[i], axes[j]);
            if (!(std::abs(dot - (i == j ? 1.0 : 0.0)) < 1e-9))
                return invalid("face ", face,
                               ": right, up and forward are not unit vectors ",
                               "at right angles");
        }
    }
    if (!(glm::dot(glm::cross(p.forward, p.up), p.right) > 0.0))
        return invalid("face ", face, ": right is not cross(forward, up)");
    if (!(p.scale.x > 0.0 && p.scale.y < 0.0 && std::isfinite(p.scale.x) &&
          std::isfinite(p.scale.y) && std::isfinite(p.offset.x) &&
          std::isfinite(p.offset.y)))
        return invalid("face ", face, ": raster scale (", p.scale.x, ", ", p.scale.y,
                       ") and offset must be finite, with scale.x > 0 and scale.y < 0");
    if (!(p.near >= 0.0 && std::isfinite(p.near) && p.far > p.near))
        return invalid("face ", face, ": near ", p.near, " and far ", p.far,
                       " must obey 0 <= near < far");
    return {};
}

/// Layers i > 0 of which `breaks(i)` says that they cannot follow the one before, less
/// those that need not, being the first of a pixel: 0 if all is in order.
template <typename Breaks>
std::size_t countBreaks(const Tile& t, const Breaks& breaks) {
    std::size_t count = 0;
    for (std::size_t i = 1; i < t.z.size(); ++i)
        count += breaks(i);
    for (std::size_t p = 1; p + 1 < t.begin.size(); ++p) {
        const std::uint32_t first = t.begin[p];
        if (first > 0 && first < t.begin[p + 1]) count -= breaks(first);
    }
    return count;
}

/// Whether a tile's content, of which the shape is right, holds every invariant: all of
/// it in a few passes without branches. False, too, where that would not be simple.
bool looksRight(const Tile& t, std::uint32_t channels) {
    bool good = true;
    for (std::size_t p = 0; p + 1 < t.begin.size(); ++p) {
        const std::uint32_t begin = t.begin[p], end = t.begin[p + 1];
        good &= begin <= end && end - begin <= kMaxPixelLayers;
    }
    if (!good || (!t.v.empty() && channels != 1)) return false;
    constexpr std::uint32_t kInfinity = 0x7f800000, kOne = 0x3f800000, kMinus0 = 1u << 31;
    for (const float z : t.z)
        good &= std::bit_cast<std::uint32_t>(z) - 1 < kInfinity - 1;
    for (const std::uint32_t n : t.n)
        good &= n != 0;
    for (const float v : t.v) {
        const auto bits = std::bit_cast<std::uint32_t>(v);
        good &= (bits <= kOne) | (bits == kMinus0);
    }
    if (!good || countBreaks(t, [&](std::size_t i) { return t.z[i] < t.z[i - 1]; }) != 0)
        return false;
    return t.v.empty() || countBreaks(t, [&](std::size_t i) {
                              return (t.v[i] > t.v[i - 1]) & (t.v[i - 1] != 0.0f);
                          }) == 0;
}

/// What vectors grew by and do not use: up to as much again.
void dropSpare(MapFace& face) {
    base::parallelFor(std::size_t(0), face.tiles.size(), [&](std::size_t i) {
        Tile& t = face.tiles[i];
        t.begin.shrink_to_fit();
        t.z.shrink_to_fit();
        t.v.shrink_to_fit();
        t.n.shrink_to_fit();
    });
    face.nearField.chunks.shrink_to_fit();
    face.nearHair.chunks.shrink_to_fit();
    face.nearSheets.triangles.chunks.shrink_to_fit();
    face.nearSheets.chunks.shrink_to_fit();
}

}  // namespace

Result<ShadowMap> ShadowMap::create(MapInfo info, std::vector<MapFace> faces) {
    ShadowMap map;
    if (auto s = map.setShape(std::move(info), std::move(faces)); !s) return s.error();
    if (auto s = map.checkTiles(); !s) return s.error();
    for (const MapFace& face : map.faces_) {
        for (const Tile& t : face.tiles) {
            map.layerCount_ += t.z.size();
            map.isOpaque_ =
                map.isOpaque_ &&
                std::all_of(t.v.begin(), t.v.end(), [](float v) { return v == 0.0f; });
        }
    }
    for (MapFace& face : map.faces_)
        dropSpare(face);
    map.buildHierarchy();
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        map.faceRanges_[face] = map.zRange(face, map.levels_ - 1, 0, 0);
    map.finish();
    return map;
}

Result<ShadowMap> ShadowMap::createWithoutLayers(MapInfo info, std::vector<MapFace> faces,
                                                 const LayerFacts& layers) {
    ShadowMap map;
    if (auto s = map.setShape(std::move(info), std::move(faces)); !s) return s.error();
    map.layerCount_ = layers.count;
    map.isOpaque_ = layers.isOpaque;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face) {
        const ZRange& z = map.faceRanges_[face] = layers.ranges[face];
        if (!z.empty() && !(z.min > 0.0f && std::isfinite(z.max)))
            return invalid("face ", face, ": depths from ", z.min, " to ", z.max,
                           " are not finite and positive");
    }
    const bool any = std::any_of(map.faceRanges_, map.faceRanges_ + map.faceCount(),
                                 [](ZRange z) { return !z.empty(); });
    if (any != (layers.count > 0))
        return invalid(layers.count, " layers, and ", any ? "" : "no ",
                       "depths between which they lie");
    for (MapFace& face : map.faces_)
        dropSpare(face);
    map.finish();
    map.dropLayers();
    return map;
}

Status ShadowMap::setShape(MapInfo info, std::vector<MapFace> faces) {
    info_ = std::move(info);
    faces_ = std::move(faces);
    if (auto s = checkShape(); !s) return s;
    tilesX_ = (info_.width + info_.tileSize - 1) / info_.tileSize;
    tilesY_ = (info_.height + info_.tileSize - 1) / info_.tileSize;
    tileShift_ = static_cast<std::uint32_t>(std::countr_zero(info_.tileSize));
    const std::uint32_t side = std::max(info_.width, info_.height);
    levels_ = static_cast<std::uint32_t>(std::bit_width(side - 1)) + 1;
    return {};
}

/// What queries need beside layers or trees.
void ShadowMap::finish() {
    queryData_ = std::make_shared<base::Lazy>();
    for (MapFace& face : faces_) {
        map_detail::buildBoxes(face);
        map_detail::buildSheets(face.nearSheets);
    }
}

/// Everything but the tiles' content.
Status ShadowMap::checkShape() const {
    const MapInfo& i = info_;
    if (i.width < 1 || i.height < 1 || i.width > kMaxResolution ||
        i.height > kMaxResolution)
        return invalid("map of ", i.width, " x ", i.height,
                       " pixels: each side must be 1 to ", kMaxResolution);
    if (i.tileSize < 8 || i.tileSize > 256 || !std::has_single_bit(i.tileSize))
        return invalid("tile size ", i.tileSize, " is not a power of two from 8 to 256");
    if (i.channels != 1 && i.channels != 3)
        return invalid(i.channels, " visibility channels: must be 1 or 3");
    if (faces_.size() != 1 && faces_.size() != 6)
        return invalid(faces_.size(), " faces: must be 1 or 6");
    if (auto s = checkLight(i.light); !s) return s;
    for (float bias : {i.bias, i.biasPerDepth}) {
        if (!(bias >= 0.0f && std::isfinite(bias)))
            return invalid("bias ", bias, " must be finite and not negative");
    }
    for (float tolerance : {i.toleranceAsked, i.toleranceReached}) {
        if (!(tolerance >= 0.0f && tolerance <= 1.0f))
            return invalid("tolerance ", tolerance, " must be in [0, 1]");
    }
    if (i.translucent != Translucent::sheets && i.translucent != Translucent::media)
        return invalid("translucent ", unsigned(i.translucent),
                       " is neither sheets (0) nor media (1)");
    if (!(i.metresPerUnit >= 0.0 && std::isfinite(i.metresPerUnit)))
        return invalid("metres per unit ", i.metresPerUnit, " must be finite and >= 0");
    std::set<std::string> names;
    for (const Attribute& a : i.attributes) {
        if (a.name.empty() || a.name.size() > 255)
            return invalid("attribute name of ", a.name.size(),
                           " bytes: must be 1 to 255");
        if (!names.insert(a.name).second)
            return invalid("attribute \"", a.name, "\" is there twice");
    }
    for (std::uint32_t face = 0; face < faceCount(); ++face) {
        if (auto s = checkProjection(faces_[face].projection, face); !s) return s;
        const std::size_t tilesX = (i.width + i.tileSize - 1) / i.tileSize;
        const std::size_t tilesY = (i.height + i.tileSize - 1) / i.tileSize;
        if (faces_[face].tiles.size() != tilesX * tilesY)
            return invalid("face ", face, ": ", faces_[face].tiles.size(), " tiles, not ",
                           tilesX, " x ", tilesY);
        if (auto s = map_detail::checkChunks(faces_[face], face); !s) return s;
        if (auto s =
                map_detail::checkSheets(faces_[face].nearSheets, i, faces_.size(), face);
            !s)
            return s;
    }
    return {};
}

/// In parallel; the error is that of the first tile that has one.
Status ShadowMap::checkTiles() const {
    const std::size_t perFace = std::size_t(tilesX_) * tilesY_;
    const std::size_t tiles = perFace * faces_.size();
    const auto check = [&](std::size_t i) {
        const std::size_t inFace = i % perFace;
        return checkTile(std::uint32_t(i / perFace), std::uint32_t(inFace % tilesX_),
                         std::uint32_t(inFace / tilesX_));
    };
    std::atomic<std::size_t> firstBad{tiles};
    base::parallelFor(std::size_t(0), tiles, [&](std::size_t i) {
        if (check(i)) return;
        std::size_t known = firstBad;
        while (i < known && !firstBad.compare_exchange_weak(known, i)) {
        }
    });
    return firstBad < tiles ? check(firstBad) : Status();
}

Status ShadowMap::checkTile(std::uint32_t face, std::uint32_t tx,
                            std::uint32_t ty) const {
    const Tile& t = tile(face, tx, ty);
    const auto where = [&] {
        return base::concat("face ", face, ", tile (", tx, ", ", ty, ")");
    };
    const std::size_t pixels = std::size_t(tileWidth(tx)) * tileHeight(ty);
    const std::size_t layers = t.z.size();
    const std::uint32_t channels = info_.channels;

    // Shapes first: everything after may then index freely.
    if (t.begin.empty()) {
        if (layers || !t.v.empty() || !t.n.empty())
            return invalid(where(), ": layers without pixels that they belong to");
        return {};
    }
    if (t.begin.size() != pixels + 1 || t.begin.front() != 0 || t.begin.back() != layers)
        return invalid(where(), ": ", t.begin.size(), " layer offsets, ending at ",
                       t.begin.back(), ", for ", pixels, " pixels and ", layers,
                       " layers");
    if (!t.v.empty() && t.v.size() != layers * channels)
        return invalid(where(), ": ", t.v.size(), " visibilities for ", layers,
                       " layers of ", channels, " channels");
    if (!t.n.empty() && t.n.size() != layers)
        return invalid(where(), ": ", t.n.size(), " sample counts for ", layers,
                       " layers");

    if (looksRight(t, channels)) return {};
    for (std::size_t p = 0; p < pixels; ++p) {
        const std::uint32_t begin = t.begin[p], end = t.begin[p + 1];
        const auto at = [&](std::uint32_t layer) {
            return base::concat(where(), ", pixel ", p, ", layer ", layer - begin);
        };
        if (end < begin || end > layers)
            return invalid(where(), ", pixel ", p, ": layer offsets go backwards");
        if (end - begin > kMaxPixelLayers)
            return invalid(where(), ", pixel ", p, ": ", end - begin,
                           " layers, more than ", kMaxPixelLayers);
        bool restart = true;  // the accumulation starts at 1 here
        for (std::uint32_t i = begin; i < end; ++i) {
            const float z = t.z[i];
            if (!(z > 0.0f && std::isfinite(z)))
                return invalid(at(i), ": depth ", z, " is not finite and positive");
            if (i > begin && z < t.z[i - 1])
                return invalid(at(i), ": depth ", z, " is in front of the layer before, ",
                               t.z[i - 1]);
            if (!t.n.empty() && t.n[i] == 0) return invalid(at(i), ": no samples");
            if (t.v.empty()) continue;
            bool dark = true;
            for (std::uint32_t c = 0; c < channels; ++c) {
                const float v = t.v[c * layers + i];
                const float before = restart ? 1.0f : t.v[c * layers + i - 1];
                if (!(v >= 0.0f && v <= before))
                    return invalid(at(i), ": visibility ", v,
                                   " is not between 0 and the ", before,
                                   " in front of it");
                dark = dark && v == 0.0f;
            }
            restart = dark;
        }
    }
    return {};
}

std::uint32_t ShadowMap::tileWidth(std::uint32_t tx) const noexcept {
    const std::uint32_t left = info_.width - tx * info_.tileSize;
    return left < info_.tileSize ? left : info_.tileSize;
}

std::uint32_t ShadowMap::tileHeight(std::uint32_t ty) const noexcept {
    const std::uint32_t left = info_.height - ty * info_.tileSize;
    return left < info_.tileSize ? left : info_.tileSize;
}

PixelLayers ShadowMap::pixel(std::uint32_t face, std::uint32_t x,
                             std::uint32_t y) const noexcept {
    const std::uint32_t tx = x >> tileShift_, ty = y >> tileShift_;
    const Tile& t = tile(face, tx, ty);
    if (t.z.empty()) return {};
    const std::uint32_t mask = info_.tileSize - 1;
    const std::size_t p = std::size_t(y & mask) * tileWidth(tx) + (x & mask);
    const std::uint32_t begin = t.begin[p];
    PixelLayers layers;
    layers.count = t.begin[p + 1] - begin;
    layers.z = t.z.data() + begin;
    layers.v = t.v.empty() ? nullptr : t.v.data() + begin;
    layers.vStride = t.z.size();
    layers.n = t.n.empty() ? nullptr : t.n.data() + begin;
    return layers;
}

ZRange ShadowMap::zRange(std::uint32_t face, std::uint32_t level, std::uint32_t x,
                         std::uint32_t y) const noexcept {
    if (!hasLayers_) return faceRanges_[face];
    if (level == 0) {
        const PixelLayers layers = pixel(face, x, y);
        if (layers.count == 0) return {};
        return {layers.z[0], layers.z[layers.count - 1]};
    }
    const Level& l = hierarchy_[face][level - 1];
    return l.nodes[std::size_t(y) * l.width + x];
}

void ShadowMap::dropLayers() noexcept {
    hasLayers_ = false;
    for (MapFace& face : faces_) {
        for (Tile& t : face.tiles)
            t = Tile();
        // Queries look them up with their borders.
        for (NearTexture& texture : face.nearSheets.textures)
            texture.texels = {};
    }
    hierarchy_ = {};
}

/// Each level halves the one below, rounding up; a node holds what its up to four
/// children hold.
void ShadowMap::buildHierarchy() {
    hierarchy_.resize(faces_.size());
    for (std::uint32_t face = 0; face < faceCount(); ++face) {
        std::uint32_t width = info_.width, height = info_.height;
        for (std::uint32_t level = 1; level < levels_; ++level) {
            const std::uint32_t belowWidth = width, belowHeight = height;
            width = (width + 1) / 2;
            height = (height + 1) / 2;
            Level l;
            l.width = width;
            l.nodes.resize(std::size_t(width) * height);
            if (level == 1) {
                base::parallelFor(std::size_t(0), faces_[face].tiles.size(),
                                  [&](std::size_t i) { addPixels(face, i, l); });
            } else {
                const ZRange* const below = hierarchy_[face].back().nodes.data();
                base::parallelRanges(
                    0u, height, kRowsPerTask, [&](auto first, auto last) {
                        for (std::uint32_t y = first; y < last; ++y) {
                            ZRange* const row = l.nodes.data() + std::size_t(y) * width;
                            const std::uint32_t end = std::min(belowHeight, 2 * y + 2);
                            for (std::uint32_t j = 2 * y; j < end; ++j) {
                                const ZRange* const from =
                                    below + std::size_t(j) * belowWidth;
                                for (std::uint32_t x = 0; x < belowWidth; ++x)
                                    row[x / 2].include(from[x]);
                            }
                        }
                    });
            }
            hierarchy_[face].push_back(std::move(l));
        }
    }
}

/// A tile's pixels into level 1. Tiles share no node: their sides are even.
void ShadowMap::addPixels(std::uint32_t face, std::size_t tileIndex, Level& level) const {
    const Tile& t = faces_[face].tiles[tileIndex];
    if (t.z.empty()) return;
    const auto tx = std::uint32_t(tileIndex % tilesX_);
    const auto ty = std::uint32_t(tileIndex / tilesX_);
    const std::uint32_t width = tileWidth(tx), height = tileHeight(ty);
    const std::uint32_t* begin = t.begin.data();
    for (std::uint32_t y = 0; y < height; ++y, begin += width) {
        const std::size_t row = (std::size_t(ty) * info_.tileSize + y) / 2;
        ZRange* const nodes =
            level.nodes.data() + row * level.width + tx * info_.tileSize / 2;
        for (std::uint32_t x = 0; x < width; ++x) {
            if (begin[x] < begin[x + 1])
                nodes[x / 2].include({t.z[begin[x]], t.z[begin[x + 1] - 1]});
        }
    }
}

std::uint64_t ShadowMap::memoryBytes() const noexcept {
    std::uint64_t bytes = 0;
    for (const MapFace& face : faces_) {
        for (const Tile& t : face.tiles) {
            bytes += sizeof(Tile) +
                     4 * (t.begin.size() + t.z.size() + t.v.size() + t.n.size());
        }
        bytes += mtsm::memoryBytes(face.nearField) + mtsm::memoryBytes(face.nearHair);
        if (!face.nearSheets.empty()) bytes += mtsm::memoryBytes(face.nearSheets);
    }
    for (const auto& face : hierarchy_) {
        for (const Level& level : face)
            bytes += level.nodes.size() * sizeof(ZRange);
    }
    return bytes;
}

// --- identical
// -------------------------------------------------------------------------------

namespace {

bool same(double a, double b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}
bool same(float a, float b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}
bool same(glm::dvec2 a, glm::dvec2 b) {
    return same(a.x, b.x) && same(a.y, b.y);
}
bool same(glm::dvec3 a, glm::dvec3 b) {
    return same(a.x, b.x) && same(a.y, b.y) && same(a.z, b.z);
}

bool same(const AreaLight& a, const AreaLight& b) {
    return a.shape == b.shape && same(a.position, b.position) &&
           same(a.direction, b.direction) && same(a.up, b.up) &&
           same(a.radius, b.radius) && same(a.size, b.size) &&
           same(a.angularDiameter, b.angularDiameter);
}

bool same(const Attribute& a, const Attribute& b) {
    if (a.name != b.name || a.value.index() != b.value.index()) return false;
    const auto* x = std::get_if<std::vector<double>>(&a.value);
    if (!x) return a.value == b.value;
    const auto& y = std::get<std::vector<double>>(b.value);
    return x->size() == y.size() &&
           (x->empty() ||
            std::memcmp(x->data(), y.data(), x->size() * sizeof(double)) == 0);
}

bool same(const MapInfo& a, const MapInfo& b) {
    if (a.attributes.size() != b.attributes.size()) return false;
    for (std::size_t i = 0; i < a.attributes.size(); ++i) {
        if (!same(a.attributes[i], b.attributes[i])) return false;
    }
    return a.width == b.width && a.height == b.height && a.tileSize == b.tileSize &&
           a.channels == b.channels && same(a.light, b.light) && same(a.bias, b.bias) &&
           same(a.biasPerDepth, b.biasPerDepth) && a.translucent == b.translucent &&
           a.maxLayers == b.maxLayers && a.resets == b.resets &&
           same(a.toleranceAsked, b.toleranceAsked) &&
           same(a.toleranceReached, b.toleranceReached) &&
           same(a.metresPerUnit, b.metresPerUnit) &&
           a.castersClipped == b.castersClipped && a.samples == b.samples &&
           a.samplesDropped == b.samplesDropped && a.software == b.software &&
           a.settings == b.settings;
}

bool same(const Projection& a, const Projection& b) {
    return a.kind == b.kind && same(a.eye, b.eye) && same(a.right, b.right) &&
           same(a.up, b.up) && same(a.forward, b.forward) && same(a.scale, b.scale) &&
           same(a.offset, b.offset) && same(a.near, b.near) && same(a.far, b.far);
}

bool same(const PixelLayers& a, const PixelLayers& b, std::uint32_t channels) {
    if (a.count != b.count) return false;
    for (std::uint32_t i = 0; i < a.count; ++i) {
        if (!same(a.z[i], b.z[i])) return false;
        if ((a.n ? a.n[i] : 1u) != (b.n ? b.n[i] : 1u)) return false;
        for (std::uint32_t c = 0; c < channels; ++c) {
            const float va = a.v ? a.v[c * a.vStride + i] : 0.0f;
            const float vb = b.v ? b.v[c * b.vStride + i] : 0.0f;
            if (!same(va, vb)) return false;
        }
    }
    return true;
}

}  // namespace

bool identical(const ShadowMap& a, const ShadowMap& b) noexcept {
    if (!a.hasLayers() || !b.hasLayers() || !same(a.info(), b.info()) ||
        a.faceCount() != b.faceCount())
        return false;
    for (std::uint32_t face = 0; face < a.faceCount(); ++face) {
        if (!same(a.projection(face), b.projection(face)) ||
            !map_detail::sameChunks(a.nearField(face), b.nearField(face)) ||
            !map_detail::sameChunks(a.nearHair(face), b.nearHair(face)) ||
            !map_detail::sameSheets(a.nearSheets(face), b.nearSheets(face)))
            return false;
        for (std::uint32_t y = 0; y < a.info().height; ++y) {
            for (std::uint32_t x = 0; x < a.info().width; ++x) {
                if (!same(a.pixel(face, x, y), b.pixel(face, x, y), a.info().channels))
                    return false;
            }
        }
    }
    return true;
}

}  // namespace mtsm
