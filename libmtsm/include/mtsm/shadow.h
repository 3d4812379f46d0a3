// shadow.h - how much of an area light a point cannot see, read from a baked map.
//
//     auto map = mtsm::readMap("key.mtsm");                     // mtsm/reader.h
//     if (!map) return complain(map.error());
//     float dark = mtsm::shadowFactor(*map, map->info().light, point, normal);
//
// Points, normals and rays are in world space, lengths in world units. Visibility runs
// from 0 (dark) to 1 (clear); shadow factor = 1 - visibility. Queries do not change a
// map: any number of threads may query it at once. A query cannot fail; answers are
// finite whatever the input. It takes memory for the trees below, once for each map, and
// for the order of a batch's points; where there is none it goes ray by ray, slowly (and,
// if it was for the trees, so do the map's later queries).
//
// The same map, point, light and seed give the same light samples on any machine, and on
// one machine the same answer alone or in a batch (unless points share pixels), for any
// number of threads. From kind of processor to kind of processor (and C library) what
// rays meet is rounded differently in the last bits: a ray that passes an edge that
// closely may be met on one and not on the other.
//
// What the bias does: a layer is met within the bias of its depth, so that no ray slips
// between two pixels of a tilted surface; and without a normal, rays start five biases
// away from the receiver, so that its own surface does not darken it. With a normal they
// start at the receiver, and what lies on its tangent plane does not count. Of opaque
// maps `trace` thickens nothing: its surfaces are pieces of tilted planes, and a larger
// bias only moves the starts of rays without normals.
//
// How it is traced (ShadowMethod::trace). Points are put into groups of neighbours whose
// rays share their way through trees over the map's layers, which the first query makes
// (prepareQueries makes them ahead); none of that changes an answer. A ray takes from as
// coarse a level as its neighbours to the same light are apart. Of an opaque map layers
// are pieces of tilted planes, up to three pixel footprints of depth from pixel to pixel;
// steeper ones let some of the light through. Where the map has a near field
// (mtsm/near_field.h), what lies within 32 pixel footprints of depth above the receiver
// is met exactly, of slender leaves up to 256 while the light, seen through the receiver,
// is less than 8 pixels wide, and at least until it is one pixel wide, so to a light of
// no size all the way; beside strands (maps of one face) and sheets
// (mtsm/near_sheets.h) up to where it is 3 to 8 pixels wide, the less the fewer samples
// there are (sheets: their root, strands: half of it): layers filter their noise; four
// times as wide where MapInfo::maxLayers is 1 to 8, for such few layers say little. The
// strand on which a receiver lies, in whichever of its segments, does not darken it
// within a width from there; so give the very point where a renderer's rays start.
// Visibility of media and sheets is kept to .0004. Of six faces each is followed by
// itself, sheets at the border between two by both. Attenuation::subtract, maps of more
// than 2^28 layers, and points further than 8 windows outside the view or closer to the
// light than any layer are followed ray by ray: ShadowMethod::scalar, the definition,
// which knows no near field.
//
// Rays of your own (visibility, visibilities) go the same way, those of a batch that
// follow each other from one origin together. Each counts for itself, down to the finest
// level, unless RayOptions::spread says how dense they are. Through opaque maps rays
// without a spread are followed by the definition, which is as fast for them. They meet
// layers only, no near field, but for rays with a spread through opaque maps.
//
// In a map of media (MapInfo::translucent) that holds for opaque surfaces. Hair and
// volumes are met at exact crossings, and without a normal from one pixel footprint away
// from the receiver on (in a map of volumes alone, from the receiver on: its attribute
// "mediaStart"); with one, the tangent plane is theirs as well. Traced rays lose light in
// them by the length of their way; pcf takes what the map holds, and so does
// Attenuation::subtract.
//
// Colour: functions whose name ends in Color give each visibility channel of the map
// (red, green, blue; a map of one channel gives it three times), all others their mean.
//
// Points that are not finite are lit. A point on or behind the plane of a one-sided light
// (disk, rect) receives nothing from it: that is not shadow, so it counts as lit and
// QueryStats says how many there were.
#pragma once
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>

#include "mtsm/light.h"
#include "mtsm/map.h"
#include "mtsm/result.h"

namespace mtsm {

enum class ShadowMethod {
    trace,  ///< rays through the map, many at once [Xie07, sec. 4.3, 5.2]
    /// The same ray by ray and layer by layer, as the paper does, without the near field:
    /// what `trace` is judged by.
    scalar,
    /// Percentage-closer filtering, size from eq. 1 [Xie07, sec. 3]: for small lights. Of
    /// a transparent map it filters the visibility at the receiver's depth, the product
    /// over all samples in front of it on the centre ray, as a deep shadow map does. With
    /// six faces a filter reaches over their edges.
    pcf
};
enum class Weight {
    uniform,  ///< the plain mean over the light's area
    cosine    ///< the ratio of irradiances: cosine at both ends over distance squared
};
enum class Attenuation {
    multiply,  ///< a sample multiplies what is left by (v_i / v_{i-1})^(1 / n_i)
    subtract   ///< a sample takes (v_{i-1} - v_i) / n_i [Xie07, eq. 3]
};

struct ShadowOptions {
    int samples = 64;  ///< points on the light, 1..kMaxSamples; a point light takes 1
    std::uint32_t seed = 0;  ///< same seed, same answer
    float bias = -1.0f;      ///< z threshold, world units; negative: the map's own
    float threshold =
        1.0f / 1024;  ///< a ray with less visibility left counts as dark, [0, 1)
    ShadowMethod method = ShadowMethod::trace;
    Weight weight = Weight::uniform;  ///< cosine needs normals
    Attenuation attenuation = Attenuation::multiply;
    /// Points of which the first samples see the same take no more: most are lit or dark.
    /// Only of ShadowMethod::trace; what blocks less of the light than a sample stands
    /// for may be missed.
    bool adaptive = false;
    /// Above 0: a point takes samples, four times as many each time, until their expected
    /// error is no larger than this, or until it has taken `samples`. Only of
    /// ShadowMethod::trace; planQueries() (mtsm/quality.h) finds a value for a mean over
    /// many points.
    float targetError = 0.0f;
    int firstSamples = 16;  ///< of those two: that every point takes, in groups of 16
    /// A pixel has up to so many points, 1..kMaxPointsPerPixel, which share its samples:
    /// each takes a part of `samples` times as many, so that their mean errs less than
    /// that of points which know nothing of each other; what lets light through, and
    /// surfaces of closed bodies, are looked at as finely as the pixel's rays need it.
    /// Batches only, and large ones: each makes the samples of some pixels first.
    int pointsPerPixel = 1;
    /// [point], if pointsPerPixel > 1: the pixel's number times pointsPerPixel plus the
    /// point's number in it. Null: points of a pixel follow each other in the batch.
    const std::uint32_t* pixelPoints = nullptr;
};

inline constexpr int kMaxSamples = 4096;
inline constexpr int kMaxPointsPerPixel = 256;

/// Refuses options out of range, and a light that the map was not baked for (lightFits).
/// Call it once before a series of queries; queries clamp what it would refuse.
Status checkQuery(const ShadowMap& map, const AreaLight& light,
                  const ShadowOptions& options);

/// Makes what queries by `trace` go through besides the map's own layers, in the caller's
/// oneTBB arena; otherwise the first query does, and takes longer for it. It lasts as
/// long as the map and serves its copies as well.
void prepareQueries(const ShadowMap& map) noexcept;

/// What the map takes while it is queried by `trace`: its own memoryBytes(), what
/// prepareQueries makes, which is made if need be, and what rays of a caller's have made
/// besides (trees of their own, in maps with a near field of hair or sheets).
[[nodiscard]] std::uint64_t queryMemoryBytes(const ShadowMap& map) noexcept;

/// For renderers that only shade: makes what prepareQueries makes and then lets go of all
/// else: the map's layers, which `trace` asks for hardly anything more, texels of near
/// sheets, and trees of which without layers there is no use.
///
///     auto map = mtsm::readMap("key.mtsm");
///     if (auto s = mtsm::releaseLayers(*map); !s) warn(s.error());  // it goes on, whole
///
/// Shadow factors by `trace` stay the same to the last bit. Points that went ray by ray
/// (above) go through the trees as well, without the near field, from where rays of
/// receivers without a normal start. So do all rays of a caller's (in maps with a near
/// field of hair or sheets through texels of two pixels and more), and one that runs
/// level to within 1/4096 of its depth is tilted to that. Everything else needs layers:
/// checkQuery() refuses `scalar`, `pcf` and, but of opaque maps, Attenuation::subtract
/// (unchecked they are answered as `trace` and multiply); writeMap() is an error, pixels
/// are empty, identical() says no. Nothing brings layers back but reading the file again.
///
/// Nothing else may use this map meanwhile. Copies made before keep layers of their own,
/// copies made after have none. While it runs layers and trees are both there, and what
/// making trees takes: up to a third of both, of opaque maps up to 2.5 times both. What
/// is freed goes back to the allocator, which need not give it on to the system (of
/// glibc, malloc_trim(0) makes it).
///
/// Errors, all of which leave the map as it was: tooLarge (no memory for the trees;
/// queries then go ray by ray), unsupported (a map that `trace` follows ray by ray). A
/// map without a layer has nothing to let go of.
Status releaseLayers(ShadowMap& map) noexcept;

/// What batches met: each adds to what is there.
struct QueryStats {
    std::uint64_t points = 0, rays = 0;
    std::uint64_t notFinite = 0;    ///< points with a NaN or infinity: lit
    std::uint64_t behindLight = 0;  ///< on or behind the plane of a one-sided light: lit
    /// Outside the frustum of the light while casters reach out of the map's window: what
    /// casts on them may be missing.
    std::uint64_t mayBeTruncated = 0;
};

/// Fraction of `light` that is blocked from `point`: one minus the mean visibility of
/// rays to points on the light [Xie07, sec. 5.2]. With a normal (any length but 0) the
/// layers of the receiver's own surface are told apart by its tangent plane instead of by
/// the bias, and points of the light below the horizon count as blocked; without, pass
/// normal = {0, 0, 0}.
[[nodiscard]] float shadowFactor(const ShadowMap& map, const AreaLight& light,
                                 glm::dvec3 point, glm::dvec3 normal = glm::dvec3(0.0),
                                 const ShadowOptions& options = {}) noexcept;

/// The same for each channel.
[[nodiscard]] glm::vec3 shadowFactorColor(const ShadowMap& map, const AreaLight& light,
                                          glm::dvec3 point,
                                          glm::dvec3 normal = glm::dvec3(0.0),
                                          const ShadowOptions& options = {}) noexcept;

/// The same for `count` points: out[i] for points[i] and normals[i] (normals may be
/// null). Runs in the caller's oneTBB arena, on up to half a megabyte of each thread's
/// stack; `stats` may be null. `errors`, if not null, gets how far each factor (the mean
/// of the channels) is expected to be from what infinitely many samples of the map would
/// give: the mean of |found - true| at points like this one, told from how neighbouring
/// samples differ. It is 0 where all samples see the same and for point lights, NaN with
/// fewer than 4 samples, and says nothing of the map's own error. Of ShadowMethod::pcf it
/// is the noise of the filter's samples.
void shadowFactors(const ShadowMap& map, const AreaLight& light, const glm::dvec3* points,
                   const glm::dvec3* normals, std::size_t count, float* out,
                   const ShadowOptions& options = {}, QueryStats* stats = nullptr,
                   float* errors = nullptr) noexcept;

void shadowFactorsColor(const ShadowMap& map, const AreaLight& light,
                        const glm::dvec3* points, const glm::dvec3* normals,
                        std::size_t count, glm::vec3* out,
                        const ShadowOptions& options = {}, QueryStats* stats = nullptr,
                        float* errors = nullptr) noexcept;

/// A shadow ray: from `origin`, `length` along the unit vector `direction`, or without
/// end if length is infinite.
struct ShadowRay {
    glm::dvec3 origin{0.0};
    glm::dvec3 direction{0.0, 1.0, 0.0};
    double length = 0.0;
};

struct RayOptions {
    float bias = -1.0f;             ///< z threshold, world units; negative: the map's own
    float threshold = 1.0f / 1024;  ///< with less visibility left the ray is dark
    ShadowMethod method = ShadowMethod::trace;  ///< or scalar; pcf knows no rays: scalar
    /// Angle between neighbouring rays of one origin, radians: `trace` may answer what
    /// looks smaller from there coarsely. Of N rays to a light of solid angle S it is
    /// sqrt(S / N). Rays that follow each other from one origin, up to 256, then are
    /// answered as one set. 0: every ray is taken for itself.
    float spread = 0.0f;
    Attenuation attenuation = Attenuation::multiply;
};

/// The visibility left to a ray by the layers it crosses, mean over the channels [Xie07,
/// sec. 5.2]. The whole ray counts: a caller that starts on a surface moves the origin
/// off it. A ray of no length, or one that is not finite, is clear.
[[nodiscard]] float visibility(const ShadowMap& map, const ShadowRay& ray,
                               const RayOptions& options = {}) noexcept;
/// The same for each channel.
[[nodiscard]] glm::vec3 visibilityColor(const ShadowMap& map, const ShadowRay& ray,
                                        const RayOptions& options = {}) noexcept;

/// The same for `count` rays, in the caller's oneTBB arena. Fastest if rays of one origin
/// follow each other.
void visibilities(const ShadowMap& map, const ShadowRay* rays, std::size_t count,
                  float* out, const RayOptions& options = {}) noexcept;
void visibilitiesColor(const ShadowMap& map, const ShadowRay* rays, std::size_t count,
                       glm::vec3* out, const RayOptions& options = {}) noexcept;

}  // namespace mtsm
