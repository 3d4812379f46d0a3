#include "shadow/ray_query.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "shadow/light_rays.h"
#include "shadow/map_faces.h"
#include "shadow/query.h"
#include "trace/near_trace.h"
#include "trace/patch_trace.h"

namespace mtsm::shadow {
namespace {

/// Rays that rise less than this beside their depth, in w, are left to the definition:
/// what bounds them would be coarser than they are. Without layers they are made to rise
/// so much, which is about half a pixel's footprint.
constexpr double kLeastRise = 0x1p-12;
/// Origins that lie further outside the window than this many times its size are no
/// common starts.
constexpr double kFarthestOutside = 8.0;
constexpr float kLeastBegin = 0x1p-40f;

/// a + b t
struct Linear {
    double a, b;
};
/// Keeps the part of [begin, end] in which f >= 0.
void clip(Linear f, RayPart& part) {
    if (f.b > 0.0)
        part.begin = std::max(part.begin, -f.a / f.b);
    else if (f.b < 0.0)
        part.end = std::min(part.end, -f.a / f.b);
    else if (f.a < 0.0)
        part.end = part.begin;
}

/// A place in straight space.
struct Place {
    double u, v, w;
};
Place project(const Projection& p, glm::dvec3 at) {
    if (p.kind == ProjectionKind::orthographic)
        return {p.scale.x * at.x + p.offset.x, p.scale.y * at.y + p.offset.y, -at.z};
    const double w = 1.0 / at.z;
    return {p.scale.x * at.x * w + p.offset.x, p.scale.y * at.y * w + p.offset.y, w};
}

/// The first level whose tiles are as wide.
std::uint8_t levelOf(float width) {
    int level = 0;
    for (float side = 16.0f; side < width && level < 20; side *= 2.0f)
        ++level;
    return std::uint8_t(level);
}

/// As LightRays: a place on the border of a face is moved inside.
double offBorder(double x, double size, double border) {
    if (std::abs(x) < border) return border;
    return std::abs(x - size) < border ? size - border : x;
}

/// Neighbours next to each other.
void order(RayQuery::Piece* pieces, std::size_t count) {
    float low[2] = {HUGE_VALF, HUGE_VALF}, high[2] = {-HUGE_VALF, -HUGE_VALF};
    const auto slope = [](const RayQuery::Piece& p, int axis) {
        return p.way[axis] / p.way[2];
    };
    for (std::size_t i = 0; i < count; ++i) {
        for (int axis = 0; axis < 2; ++axis) {
            low[axis] = std::min(low[axis], slope(pieces[i], axis));
            high[axis] = std::max(high[axis], slope(pieces[i], axis));
        }
    }
    const float per = 15.99f / std::max({high[0] - low[0], high[1] - low[1], 0x1p-80f});
    constexpr std::uint8_t kSpread[16] = {0,  1,  4,  5,  16, 17, 20, 21,
                                          64, 65, 68, 69, 80, 81, 84, 85};
    for (std::size_t i = 0; i < count; ++i) {
        const auto cell = [&](int axis) {
            return std::size_t((slope(pieces[i], axis) - low[axis]) * per) & 15;
        };
        pieces[i].place = kSpread[cell(0)] | std::uint32_t(kSpread[cell(1)]) << 1;
    }
    std::sort(pieces, pieces + count,
              [](const RayQuery::Piece& a, const RayQuery::Piece& b) {
                  return a.place != b.place ? a.place < b.place : a.ray < b.ray;
              });
}

}  // namespace

bool RayQuery::serves(const ShadowMap& map, const RayOptions& options) {
    if (options.method != ShadowMethod::trace) return false;
    if (map.isOpaque() && !(options.spread > 0.0f) && map.hasLayers()) return false;
    return hasTrees(map, options.attenuation, trace::DensityUse::rays);
}

RayQuery::RayQuery(const ShadowMap& map, const RayOptions& options,
                   bool treesAlone) noexcept
    : map_(map),
      options_(options),
      bias_(biasOf(map, options.bias)),
      threshold_(float(thresholdOf(options.threshold))),
      treesAlone_(treesAlone || !map.hasLayers()),
      faceCount_(map.faceCount()) {
    const auto size = float(std::max(map.info().width, map.info().height));
    if (faceCount_ > 1) border_ = size * 0x1p-21f;
    for (std::uint32_t f = 0; f < faceCount_; ++f) {
        Face& face = faces_[f];
        const Projection& p = map.projection(f);
        const ZRange depths = depthsOf(map, f, options.bias);
        const bool perspective = p.kind == ProjectionKind::perspective;
        face.projection = &p;
        face.turn = glm::transpose(glm::dmat3(p.right, p.up, p.forward));
        face.nearest = LightRays::nearestOf(p, depths);
        face.farthest = depths.max + 4.0 * p.pixelFootprint(std::abs(depths.max));
        face.furthest = 0x1p20 * p.pixelFootprint(std::abs(face.nearest));
        // Beside strands triangles are not all that is close.
        static const NearField none;
        const bool near = map.isOpaque() && map.nearHair(f).empty();
        face.nearField = near ? &map.nearField(f) : &none;
        const auto depth = float(kNearDepth * p.pixelFootprint(1.0));
        face.nearPerW = perspective && !face.nearField->empty() ? depth : 0.0f;
        face.nearConstant = !perspective && !face.nearField->empty() ? depth : 0.0f;
        const float spread = options.spread > 0.0f && std::isfinite(options.spread)
                                 ? float(options.spread / p.pixelFootprint(1.0))
                                 : 0.0f;
        face.spreadPerZ = perspective ? spread : 0.0f;
        face.spreadConstant = perspective ? 0.0f : spread;
        face.highest = float(perspective ? 1.0 / face.nearest : -face.nearest);
        face.patches = map.isOpaque() ? &(*trace::patchTrees(map))[f] : nullptr;
        face.density = map.isOpaque()
                           ? nullptr
                           : &(*trace::densityTrees(map, trace::DensityUse::rays))[f];
        face.empty = map.zRange(f).empty();
    }
}

/// May rays start there, in floats?
bool RayQuery::isSeen(const Face& face, glm::dvec3 p) const noexcept {
    if (!(std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) <= face.furthest))
        return false;
    const bool perspective = face.projection->kind == ProjectionKind::perspective;
    if (perspective && !(p.z > 0.5 * face.nearest)) return false;
    const Place at = project(*face.projection, p);
    const double width = map_.info().width, height = map_.info().height;
    return std::abs(at.u / width - 0.5) <= kFarthestOutside &&
           std::abs(at.v / height - 0.5) <= kFarthestOutside;
}

/// Of a ray, the part that belongs to a face and lies between its depths and, but for a
/// pixel, in its window. In light space the ray is o + t d.
RayPart RayQuery::partOf(std::uint32_t number, const ShadowRay& ray, glm::dvec3 o,
                         glm::dvec3 d) const noexcept {
    const Face& face = faces_[number];
    const Projection& p = *face.projection;
    RayPart part;
    if (faceCount_ > 1) {
        double z[6], dz[6];
        for (std::uint32_t f = 0; f < 6; ++f) {
            const Projection& view = *faces_[f].projection;
            z[f] = glm::dot(view.forward, ray.origin - view.eye);
            dz[f] = glm::dot(view.forward, ray.direction);
        }
        part = partIn(number, z, dz);
    }
    part.end = std::min(part.end, ray.length);
    clip({o.z - face.nearest, d.z}, part);
    clip({face.farthest - o.z, -d.z}, part);
    const bool perspective = p.kind == ProjectionKind::perspective;
    const double ha = perspective ? o.z : 1.0, hb = perspective ? d.z : 0.0;
    for (int axis = 0; axis < 2; ++axis) {
        const double size = axis == 0 ? map_.info().width : map_.info().height;
        const double a = p.scale[axis] * o[axis] + p.offset[axis] * ha;
        const double b = p.scale[axis] * d[axis] + p.offset[axis] * hb;
        clip({a + ha, b + hb}, part);
        clip({(size + 1.0) * ha - a, (size + 1.0) * hb - b}, part);
    }
    return part;
}

/// What a ray has in a face; nothing if it meets nothing there or goes alone.
std::optional<RayQuery::Piece> RayQuery::pieceOf(std::uint32_t number,
                                                 const ShadowRay& ray,
                                                 Fate& fate) const noexcept {
    const Face& face = faces_[number];
    const Projection& p = *face.projection;
    const glm::dvec3 o = face.turn * (ray.origin - p.eye), d = face.turn * ray.direction;
    const RayPart part = partOf(number, ray, o, d);
    if (!(part.begin < part.end) || !std::isfinite(part.end)) return std::nullopt;

    // From the deeper end to the other; from the origin itself, if that will do.
    const bool rises = d.z < 0.0;
    const double tEnd = rises ? part.end : part.begin;
    double tStart = rises ? part.begin : part.end;
    Piece piece;
    piece.begin = kLeastBegin;
    piece.shares = rises && isSeen(face, o);
    if (piece.shares) {
        const bool perspective = p.kind == ProjectionKind::perspective;
        const double slant =
            perspective ? (o.z + tEnd * d.z) / (o.z + tStart * d.z) : 1.0;
        piece.begin = std::max(piece.begin, float(tStart / tEnd * slant));
        tStart = 0.0;
    }
    const Place a = project(p, o + tStart * d), b = project(p, o + tEnd * d);
    const double width = map_.info().width, height = map_.info().height;
    piece.start[0] = float(offBorder(a.u, width, border_));
    piece.start[1] = float(offBorder(a.v, height, border_));
    piece.start[2] = float(a.w);
    piece.way[0] = float(offBorder(b.u, width, border_) - double(piece.start[0]));
    piece.way[1] = float(offBorder(b.v, height, border_) - double(piece.start[1]));
    piece.way[2] = float(b.w - double(piece.start[2]));
    const auto least = float(kLeastRise * std::max(std::abs(a.w), std::abs(b.w)));
    if (piece.way[2] >= least) return piece;
    if (!treesAlone_) {
        fate.alone = true;
        return std::nullopt;
    }
    piece.way[2] = least;
    return piece;
}

/// Pieces on their way.
class RayQuery::Bundle {
  public:
    Bundle(const RayQuery& query, const Face& face, Fate* fates)
        : query_(query), face_(face), fates_(fates) {
        bundle_.receivers = 0;
        bundle_.hasPlanes = false;
    }

    /// Up to 16 x 16 pieces of one start.
    void add(const Piece* pieces, int count) {
        const int groups = (count + trace::kLanes - 1) / trace::kLanes;
        if (bundle_.receivers > 0 && (groups != bundle_.groups || full())) finish();
        bundle_.groups = groups;
        const int receiver = bundle_.receivers++;
        const Piece& first = pieces[0];
        bundle_.u[receiver] = first.start[0], bundle_.v[receiver] = first.start[1];
        bundle_.w[receiver] = first.start[2];
        bundle_.rise[receiver] =
            face_.nearPerW * std::abs(first.start[2]) + face_.nearConstant;
        for (int group = 0; group < groups; ++group) {
            const int from = group * trace::kLanes;
            setRow(receiver, group, pieces + from, std::min(count - from, trace::kLanes));
        }
        setSlopes(receiver);
        if (full()) finish();
    }

    void finish() {
        if (bundle_.receivers == 0) return;
        for (int i = bundle_.receivers; i < trace::kMostReceivers; ++i)
            copyFirst(i);
        if (face_.patches)
            followOpaque();
        else
            followDensity();
        bundle_.receivers = 0;
    }

  private:
    [[nodiscard]] bool full() const {
        return bundle_.receivers == trace::kMostReceivers ||
               (bundle_.receivers + 1) * bundle_.groups > trace::kMostMediaRows;
    }

    void setRow(int receiver, int group, const Piece* pieces, int count) {
        const int row = bundle_.row(receiver, group);
        const float depth = bundle_.rise[receiver];
        float lowU = HUGE_VALF, highU = -HUGE_VALF, lowV = HUGE_VALF, highV = -HUGE_VALF;
        for (int i = 0; i < trace::kLanes; ++i) {
            const Piece& p = pieces[std::min(i, count - 1)];
            bundle_.du[row][i] = p.way[0], bundle_.dv[row][i] = p.way[1];
            bundle_.dw[row][i] = p.way[2];
            bundle_.begin[row][i] = bundle_.beginSurfaces[row][i] = p.begin;
            rays_[row][i] = p.ray;
            const float end = std::min(1.0f, depth / p.way[2]);
            nearEnd_[row][i] = end;
            layersBegin_[row][i] = std::max(p.begin, end);
            const float u = p.way[0] / p.way[2], v = p.way[1] / p.way[2];
            lowU = std::min(lowU, u), highU = std::max(highU, u);
            lowV = std::min(lowV, v), highV = std::max(highV, v);
        }
        bundle_.open[row] = std::uint16_t((1u << count) - 1);
        // As LightRays: any few rays in a row have thresholds far apart.
        constexpr std::uint8_t kFar[trace::kLanes] = {0, 8, 4, 12, 2, 10, 6, 14,
                                                      1, 9, 5, 13, 3, 11, 7, 15};
        const std::uint32_t bits = std::bit_cast<std::uint32_t>(bundle_.u[receiver]) ^
                                   std::bit_cast<std::uint32_t>(bundle_.v[receiver]);
        const std::uint32_t turn = bits * 0x9e3779b1u >> 28;
        for (int i = 0; i < trace::kLanes; ++i)
            bundle_.threshold[row][i] = std::uint8_t(kFar[i] ^ turn);
        // Quotients are rounded; and none is zero.
        const auto grow = [](float& low, float& high) {
            low -= std::abs(low) * 0x1p-18f + 0x1p-80f;
            high += std::abs(high) * 0x1p-18f + 0x1p-80f;
        };
        grow(lowU, highU), grow(lowV, highV);
        slopes_[group] = {lowU, highU, lowV, highV};
    }

    void setSlopes(int receiver) {
        trace::RayBundle::Slopes all;
        for (int group = 0; group < bundle_.groups; ++group) {
            const trace::RayBundle::Slopes& s = slopes_[group];
            all.lowU = std::min(all.lowU, s.lowU);
            all.highU = std::max(all.highU, s.highU);
            all.lowV = std::min(all.lowV, s.lowV);
            all.highV = std::max(all.highV, s.highV);
            if (receiver == 0) bundle_.clearGroup(group);
            bundle_.boundRow(receiver, group, s);
        }
        bundle_.slopeLowU[receiver] = all.lowU, bundle_.slopeHighU[receiver] = all.highU;
        bundle_.slopeLowV[receiver] = all.lowV, bundle_.slopeHighV[receiver] = all.highV;
        bundle_.slant[receiver] = std::max({std::abs(all.lowU), std::abs(all.highU),
                                            std::abs(all.lowV), std::abs(all.highV)});
        const float w = bundle_.w[receiver];
        const float spread = face_.spreadPerZ / w + face_.spreadConstant;
        bundle_.spread[receiver] = spread;
        const float widest =
            std::max({all.highU - all.lowU, all.highV - all.lowV, spread});
        bundle_.topLevel[receiver] = levelOf(widest * std::max(0.0f, face_.highest - w));
    }

    void copyFirst(int i) {
        for (float* lanes : {bundle_.u, bundle_.v, bundle_.w, bundle_.rise,
                             bundle_.slopeLowU, bundle_.slopeHighU, bundle_.slopeLowV,
                             bundle_.slopeHighV, bundle_.spread, bundle_.slant})
            lanes[i] = lanes[0];
        bundle_.topLevel[i] = bundle_.topLevel[0];
    }

    void followOpaque() {
        const int rows = bundle_.receivers * bundle_.groups;
        std::uint16_t open[trace::kMostMediaRows];
        std::copy_n(bundle_.open, rows, open);
        if (!face_.nearField->empty()) {
            trace::traceNear(*face_.nearField, bundle_, nearEnd_, 0.0f);
            for (int row = 0; row < rows; ++row)
                std::copy_n(layersBegin_[row], trace::kLanes, bundle_.begin[row]);
        }
        trace::tracePatches(*face_.patches, bundle_);
        for (int row = 0; row < rows; ++row) {
            std::uint32_t blocked = open[row] & ~std::uint32_t(bundle_.open[row]);
            for (; blocked; blocked &= blocked - 1)
                fates_[rays_[row][std::countr_zero(blocked)]].blocked = true;
        }
    }

    void followDensity() {
        const int rows = bundle_.receivers * bundle_.groups;
        std::uint16_t open[trace::kMostMediaRows];
        std::copy_n(bundle_.open, rows, open);
        const std::uint32_t channels = query_.map_.info().channels;
        for (std::uint32_t c = 0; c < channels; ++c)
            std::fill_n(depths_.depth[c][0], std::size_t(rows) * trace::kLanes, 0.0f);
        trace::DensityTraceOptions options;
        options.bias = query_.bias_;
        options.darkDepth =
            query_.threshold_ > 0.0f ? -std::log(query_.threshold_) : trace::kDarkDepth;
        trace::traceDensity(*face_.density, options, bundle_, depths_);
        for (int row = 0; row < rows; ++row) {
            for (std::uint32_t rest = open[row]; rest; rest &= rest - 1) {
                const int i = std::countr_zero(rest);
                for (std::uint32_t c = 0; c < channels; ++c)
                    fates_[rays_[row][i]].depth[c] += depths_.depth[c][row][i];
            }
        }
    }

    const RayQuery& query_;
    const Face& face_;
    Fate* fates_;
    trace::RayBundle bundle_;
    trace::RayDepths depths_;
    trace::RayBundle::Slopes slopes_[trace::kMostMediaRows];
    std::uint32_t rays_[trace::kMostMediaRows][trace::kLanes];
    alignas(64) float nearEnd_[trace::kMostMediaRows][trace::kLanes];
    alignas(64) float layersBegin_[trace::kMostMediaRows][trace::kLanes];
};

void RayQuery::followAll(const Face& face, const ShadowRay* rays, Piece* pieces,
                         std::size_t count, Fate* fates) const noexcept {
    Bundle bundle(*this, face, fates);
    for (std::size_t first = 0; first < count;) {
        std::size_t end = first + 1;
        const Piece& p = pieces[first];
        while (p.shares && end < count && pieces[end].shares &&
               rays[pieces[end].ray].origin == rays[p.ray].origin)
            ++end;
        if (end - first > std::size_t(trace::kLanes)) order(pieces + first, end - first);
        bundle.add(pieces + first, int(end - first));
        first = end;
    }
    bundle.finish();
}

std::vector<std::size_t> RayQuery::beginnings(const ShadowRay* rays, std::size_t count) {
    std::vector<std::size_t> all = {0};
    for (std::size_t run = 0; run < count;) {
        std::size_t end = run + 1;
        while (end < count && end - run < kAtOnce && rays[end].origin == rays[run].origin)
            ++end;
        if (end - all.back() > kAtOnce) all.push_back(run);
        run = end;
    }
    all.push_back(count);
    return all;
}

void RayQuery::look(const ShadowRay* rays, std::size_t count,
                    glm::vec3* out) const noexcept {
    Fate fates[kAtOnce];
    Piece pieces[kAtOnce];
    for (std::uint32_t f = 0; f < faceCount_; ++f) {
        std::size_t found = 0;
        for (std::size_t i = 0; i < count && !faces_[f].empty; ++i) {
            if (!isRay(rays[i])) continue;
            const std::optional<Piece> piece = pieceOf(f, rays[i], fates[i]);
            if (!piece) continue;
            pieces[found] = *piece;
            pieces[found++].ray = std::uint32_t(i);
        }
        if (found > 0) followAll(faces_[f], rays, pieces, found, fates);
    }
    const std::uint32_t channels = map_.info().channels;
    for (std::size_t i = 0; i < count; ++i) {
        if (fates[i].alone) {
            out[i] = visibilityByDefinition(map_, rays[i], options_);
            continue;
        }
        for (std::uint32_t c = 0; c < 3; ++c) {
            const float v = std::exp(-fates[i].depth[c < channels ? c : 0]);
            out[i][int(c)] = fates[i].blocked || !(v > threshold_) ? 0.0f : v;
        }
    }
}

}  // namespace mtsm::shadow
