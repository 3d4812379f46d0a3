// map.h - a multilayer transparent shadow map in memory [Xie07, sec. 4 and 5].
//
//     mtsm::MapInfo info;                        // resolution, light, projection, ...
//     std::vector<mtsm::MapFace> faces = ...;    // pixels' layers, tile by tile
//     auto map = mtsm::ShadowMap::create(info, std::move(faces));
//
// Spaces. *World* is the user's, right-handed, any unit, in doubles. *Light space* has
// its origin at the map's eye, x right, y up and z along the view: depth z is the linear
// distance along that axis, in world units, positive in front of the eye. *Raster space*
// has x right and y down; pixel (i, j) covers [i, i+1) x [j, j+1) and its centre ray runs
// through (i + 0.5, j + 0.5).
//
// A pixel is a list of layers (z, v, n) in order of depth: v is the visibility that is
// left just behind z, accumulated since the last reset; n >= 1 is the number of original
// samples in (z of the layer before, z]. After a layer whose v is zero in every channel
// the accumulation starts again at 1: that is the reset. An opaque surface is (z, 0, 1).
//
// A ShadowMap never changes once made: any number of threads may use it at once. The one
// exception is releaseLayers() (mtsm/shadow.h), which like an assignment must have the
// map to itself; copies are maps of their own.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "mtsm/light.h"
#include "mtsm/near_field.h"
#include "mtsm/near_sheets.h"
#include "mtsm/result.h"

namespace mtsm {

namespace base {
class Lazy;
}

enum class ProjectionKind : std::uint32_t { perspective = 0, orthographic = 1 };

/// What layers that let light through stand for; opaque ones are surfaces in either.
enum class Translucent : std::uint32_t {
    /// Samples of smooth sheets (glass, cards): met within the bias, and those that a ray
    /// has paid for where it changes pixels are not paid for again.
    sheets = 0,
    /// Hair and volumes, whose samples in neighbouring pixels have nothing to do with
    /// each other: met where the ray crosses their depth, and nowhere else, and for as
    /// much as its way there is longer than the pixel's centre ray's. Opaque are then
    /// layers of one sample (n = 1) that are dark (v = 0 in every channel).
    media = 1
};

/// World <-> light <-> raster for one face.
struct Projection {
    ProjectionKind kind = ProjectionKind::perspective;
    glm::dvec3 eye{0.0};              ///< world; origin of light space
    glm::dvec3 right{1.0, 0.0, 0.0};  ///< unit, world; cross(forward, up)
    glm::dvec3 up{0.0, 1.0, 0.0};     ///< unit, world
    glm::dvec3 forward{0.0, 0.0,
                       -1.0};  ///< unit, world; the axis that depth is measured along
    /// raster = scale * (x, y) / z + offset (perspective) or scale * (x, y) + offset
    /// (orthographic); scale.x > 0, scale.y < 0.
    glm::dvec2 scale{1.0, -1.0};
    glm::dvec2 offset{0.0};
    double near = 0.0;  ///< light-space depth in front of which nothing was kept; >= 0
    double far =
        std::numeric_limits<double>::infinity();  ///< behind which nothing was kept

    [[nodiscard]] glm::dvec3 lightFromWorld(glm::dvec3 p) const noexcept;
    [[nodiscard]] glm::dvec3 worldFromLight(glm::dvec3 p) const noexcept;
    /// Turns a direction; lengths stay.
    [[nodiscard]] glm::dvec3 lightFromWorldDirection(glm::dvec3 d) const noexcept;
    /// p in light space; for a perspective projection p.z must not be 0.
    [[nodiscard]] glm::dvec2 rasterFromLight(glm::dvec3 p) const noexcept;
    /// The point at depth z on the ray through raster position r.
    [[nodiscard]] glm::dvec3 lightFromRaster(glm::dvec2 r, double z) const noexcept;
    /// Side of a pixel's footprint at depth z, world units: the larger of width and
    /// height.
    [[nodiscard]] double pixelFootprint(double z) const noexcept;
};

/// Depths between which all layers of a region lie; empty() when there is none.
struct ZRange {
    float min = std::numeric_limits<float>::infinity();
    float max = -std::numeric_limits<float>::infinity();

    [[nodiscard]] bool empty() const noexcept { return !(min <= max); }
    void include(ZRange other) noexcept {
        if (other.min < min) min = other.min;
        if (other.max > max) max = other.max;
    }
    friend bool operator==(ZRange a, ZRange b) noexcept {
        return a.min == b.min && a.max == b.max;
    }
};

/// The layers of one tile's pixels. Pixels are row-major within the tile; tiles at the
/// right and lower border are cropped to the map.
struct Tile {
    /// [pixels + 1]: pixel p has layers [begin[p], begin[p + 1]). Empty: no pixel has a
    /// layer.
    std::vector<std::uint32_t> begin;
    /// [layers]: depth, finite, > 0, in ascending order within a pixel.
    std::vector<float> z;
    /// [channels][layers]: visibility in [0, 1]. Empty: every layer is opaque (v = 0).
    std::vector<float> v;
    /// [layers]: number of samples, >= 1. Empty: all are 1.
    std::vector<std::uint32_t> n;

    [[nodiscard]] bool empty() const noexcept { return z.empty(); }
};

/// A free attribute: a name and a value of one of the types the format knows.
struct Attribute {
    std::string name;  ///< 1..255 bytes of UTF-8, unique within the map
    std::variant<std::string, std::int64_t, std::vector<double>> value;
};

/// What a map is and how it came to be: all of it is stored in the file.
struct MapInfo {
    std::uint32_t width = 0;  ///< pixels per face, 1..kMaxResolution
    std::uint32_t height = 0;
    std::uint32_t tileSize = 64;  ///< pixels per side: 8, 16, 32, 64, 128 or 256
    std::uint32_t channels = 1;  ///< visibility channels: 1, or 3 for coloured visibility
    AreaLight light;             ///< what the map was baked for
    /// z threshold, world units: a layer at depth z is met within bias + biasPerDepth * z
    /// of z. The first is a constant; the second grows as a pixel's footprint does. See
    /// `translucent` for what it holds for.
    float bias = 0.0f;
    float biasPerDepth = 0.0f;
    Translucent translucent = Translucent::sheets;
    std::uint32_t maxLayers = 0;  ///< cap per pixel that was asked for; 0: none
    std::uint32_t resets = 0;     ///< times that accumulation may restart; see kAllResets
    float toleranceAsked = 0.0f;  ///< bound on |V - V'| that was asked for; 0: lossless
    float toleranceReached = 0.0f;  ///< largest |V - V'| that compression left
    double metresPerUnit = 0.0;     ///< 0: unknown
    bool castersClipped =
        false;                  ///< some caster reached out of the window: see QueryStats
    std::uint64_t samples = 0;  ///< samples that the casters gave
    std::uint64_t samplesDropped = 0;  ///< of those, lost to maxLayers or resets
    std::string software;              ///< name and version of what wrote the map
    std::string settings;  ///< the settings that made it, as the writer spells them
    std::vector<Attribute> attributes;
};

inline constexpr std::uint32_t kMaxResolution = 32768;      ///< pixels per side
inline constexpr std::uint32_t kMaxPixelLayers = 1u << 20;  ///< layers in one pixel
inline constexpr std::uint32_t kAllResets = 0xffffffffu;    ///< MapInfo::resets: no bound

/// One view: its projection and its tiles, row-major, ceil(width / tileSize) in a row. Of
/// six, a point belongs to the one in which its depth is greatest (to the first of
/// several that are level): six windows of 90 degrees along the axes of a cube share out
/// all of space so. What lies outside its face's window is not in the map.
struct MapFace {
    Projection projection;
    std::vector<Tile> tiles;
    /// Every triangle and every segment of a strand of the casters that reaches into the
    /// window, if all of them are opaque triangles and strands; or both empty.
    NearField nearField = {};
    NearHair nearHair = {};
    /// The same if some of them let light through and none is hair or a volume.
    NearSheets nearSheets = {};
};

/// A pixel's layers, pointing into a map.
struct PixelLayers {
    std::uint32_t count = 0;
    const float* z = nullptr;  ///< [count]
    const float* v = nullptr;  ///< [channels] planes, vStride apart; null: all are 0
    std::size_t vStride = 0;   ///< layers between one channel's v and the next one's
    const std::uint32_t* n = nullptr;  ///< [count]; null: all are 1
};

class ShadowMap {
  public:
    /// Checks every invariant that this header states and builds the min/max-z hierarchy
    /// and the boxes of the near field.
    /// Errors (badArgument) name the face, the tile, the pixel and what is wrong. There
    /// must be 1 face or 6. Time and memory are linear in the number of layers, pixels
    /// and triangles.
    [[nodiscard]] static Result<ShadowMap> create(MapInfo info,
                                                  std::vector<MapFace> faces);

    /// What is known of layers that are not there.
    struct LayerFacts {
        std::uint64_t count = 0;  ///< over all faces
        bool isOpaque = true;
        ZRange ranges[6];  ///< of each face
    };
    /// A map as releaseLayers() leaves it, for the library's own use: whoever makes it
    /// gives it trees. Its faces' tiles are empty. Errors as above.
    [[nodiscard]] static Result<ShadowMap> createWithoutLayers(MapInfo info,
                                                               std::vector<MapFace> faces,
                                                               const LayerFacts& layers);

    [[nodiscard]] const MapInfo& info() const noexcept { return info_; }
    [[nodiscard]] std::uint32_t faceCount() const noexcept {
        return static_cast<std::uint32_t>(faces_.size());
    }
    [[nodiscard]] const Projection& projection(std::uint32_t face) const noexcept {
        return faces_[face].projection;
    }
    [[nodiscard]] std::uint32_t tilesX() const noexcept { return tilesX_; }
    [[nodiscard]] std::uint32_t tilesY() const noexcept { return tilesY_; }
    [[nodiscard]] const Tile& tile(std::uint32_t face, std::uint32_t tx,
                                   std::uint32_t ty) const noexcept {
        return faces_[face].tiles[std::size_t(ty) * tilesX_ + tx];
    }
    /// Pixels of tile column tx that lie inside the map.
    [[nodiscard]] std::uint32_t tileWidth(std::uint32_t tx) const noexcept;
    [[nodiscard]] std::uint32_t tileHeight(std::uint32_t ty) const noexcept;

    /// Empty if the map has none, whatever its layers are.
    [[nodiscard]] const NearField& nearField(std::uint32_t face) const noexcept {
        return faces_[face].nearField;
    }
    /// The same for maps of sheets; only those of one face and one channel have it.
    [[nodiscard]] const NearSheets& nearSheets(std::uint32_t face) const noexcept {
        return faces_[face].nearSheets;
    }
    [[nodiscard]] const NearHair& nearHair(std::uint32_t face) const noexcept {
        return faces_[face].nearHair;
    }

    [[nodiscard]] PixelLayers pixel(std::uint32_t face, std::uint32_t x,
                                    std::uint32_t y) const noexcept;

    /// Level 0 is a pixel, level L a square of 2^L pixels; the last level has one node.
    [[nodiscard]] std::uint32_t levels() const noexcept { return levels_; }
    [[nodiscard]] ZRange zRange(std::uint32_t face, std::uint32_t level, std::uint32_t x,
                                std::uint32_t y) const noexcept;
    /// The whole face.
    [[nodiscard]] ZRange zRange(std::uint32_t face) const noexcept {
        return faceRanges_[face];
    }

    /// False after releaseLayers() (mtsm/shadow.h), and of a map that was read without
    /// layers (ReadLimits::layers). Then tiles, pixels and the texels of
    /// near sheets are empty, and every zRange() is that of its whole face. All else is
    /// as before.
    [[nodiscard]] bool hasLayers() const noexcept { return hasLayers_; }
    /// That the map was made with.
    [[nodiscard]] std::uint64_t layerCount() const noexcept { return layerCount_; }
    /// No layer lets anything through.
    [[nodiscard]] bool isOpaque() const noexcept { return isOpaque_; }
    /// Bytes that layers, hierarchy and near field take in memory.
    [[nodiscard]] std::uint64_t memoryBytes() const noexcept;

    /// What queries make of the map, once; for the library's own use. Copies of a map
    /// share it.
    [[nodiscard]] base::Lazy& queryData() const noexcept { return *queryData_; }

  private:
    struct Level {
        std::uint32_t width = 0;
        std::vector<ZRange> nodes;  // row-major
    };
    ShadowMap() = default;
    friend Status releaseLayers(ShadowMap& map) noexcept;
    void dropLayers() noexcept;
    Status setShape(MapInfo info, std::vector<MapFace> faces);
    void finish();
    Status checkShape() const;
    Status checkTiles() const;
    Status checkTile(std::uint32_t face, std::uint32_t tx, std::uint32_t ty) const;
    void buildHierarchy();
    void addPixels(std::uint32_t face, std::size_t tileIndex, Level& level) const;

    MapInfo info_;
    std::vector<MapFace> faces_;
    std::vector<std::vector<Level>>
        hierarchy_;  // [face][level - 1]: level 0 is in the layers
    ZRange faceRanges_[6];
    std::uint32_t tilesX_ = 0, tilesY_ = 0, tileShift_ = 0, levels_ = 0;
    std::uint64_t layerCount_ = 0;
    bool isOpaque_ = true, hasLayers_ = true;
    std::shared_ptr<base::Lazy> queryData_;
};

/// True if the two maps are the same to the last bit: info, projections, layers and near
/// field.
/// (Planes that say what their absence means, all v = 0 or all n = 1, equal absent ones.)
/// Of maps without layers there is no telling: false.
[[nodiscard]] bool identical(const ShadowMap& a, const ShadowMap& b) noexcept;

}  // namespace mtsm
