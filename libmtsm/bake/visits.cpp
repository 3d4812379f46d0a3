#include "bake/visits.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>

#include "base/message.h"

namespace mtsm::bake_detail {
namespace {

using base::makeError;
using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

bool isShare(float x) {
    return x >= 0.0f && x <= 1.0f;  // false for NaN
}

Status check(const MeshView& mesh, std::uint64_t number) {
    if (!isShare(mesh.opacity))
        return makeError(ErrorCode::badArgument, "caster ", number, " has opacity ",
                         mesh.opacity, ", which is not in [0, 1]");
    for (int c = 0; c < 3; ++c) {
        if (!isShare(mesh.tint[c]))
            return makeError(ErrorCode::badArgument, "caster ", number, " has a tint of ",
                             mesh.tint[c], ", which is not in [0, 1]");
    }
    if (mesh.texture && !mesh.uvs)
        return makeError(ErrorCode::badArgument, "caster ", number,
                         " has a texture but no texture coordinates");
    if (mesh.triangleCount == 0) return {};
    const std::uint32_t highest =
        *std::max_element(mesh.indices, mesh.indices + 3 * mesh.triangleCount);
    if (highest >= mesh.vertexCount)
        return makeError(ErrorCode::badArgument, "caster ", number,
                         " has a triangle with vertex ", highest, ", but only ",
                         mesh.vertexCount, " vertices");
    return {};
}

Status check(const StrandsView& strands, std::uint64_t number) {
    for (std::size_t s = 0; s < strands.strandCount; ++s) {
        if (strands.begin[s + 1] < strands.begin[s])
            return makeError(ErrorCode::badArgument, "caster ", number, ": strand ", s,
                             " ends before it begins");
    }
    const std::size_t points =
        strands.strandCount ? strands.begin[strands.strandCount] : 0;
    const auto isWidth = [](float w) { return w >= 0.0f && std::isfinite(w); };
    for (std::size_t i = 0; i < (strands.widths ? points : 1); ++i) {
        const float width = strands.widths ? strands.widths[i] : strands.width;
        if (!isWidth(width))
            return makeError(ErrorCode::badArgument, "caster ", number,
                             " has a strand of width ", width,
                             ", which is not finite and at least 0");
    }
    for (std::size_t i = 0; i < (strands.opacities ? points : 1); ++i) {
        const float opacity = strands.opacities ? strands.opacities[i] : strands.opacity;
        if (!isShare(opacity))
            return makeError(ErrorCode::badArgument, "caster ", number,
                             " has a strand of opacity ", opacity,
                             ", which is not in [0, 1]");
    }
    return {};
}

Status check(const VolumeView& volume, std::uint64_t number) {
    if (!(volume.extinction >= 0.0f && std::isfinite(volume.extinction)))
        return makeError(ErrorCode::badArgument, "caster ", number,
                         " has an extinction of ", volume.extinction,
                         ", which is not finite and at least 0");
    for (std::size_t i = 0; i < volume.blockCount; ++i) {
        if ((volume.blocks[i].x | volume.blocks[i].y | volume.blocks[i].z) & 7)
            return makeError(ErrorCode::badArgument, "caster ", number, ": block ", i,
                             " does not begin at multiples of 8");
    }
    for (std::size_t i = 0; i < volume.blockCount * VolumeView::kBlockVoxels; ++i) {
        if (!(volume.density[i] >= 0.0f && std::isfinite(volume.density[i])))
            return makeError(ErrorCode::badArgument, "caster ", number,
                             " has a density of ", volume.density[i],
                             ", which is not finite and at least 0");
    }
    return {};
}

}  // namespace

Status Progress::operator()(const char* stage, double fraction) const {
    if (!callback_ || callback_(stage, fraction)) return {};
    return makeError(ErrorCode::cancelled, "the bake was cancelled while ", stage);
}

Status Visits::each(const CasterVisitor& visitor) {
    const Clock::time_point start = Clock::now();
    double visitorSeconds = 0.0;
    std::uint64_t number = 0;
    std::exception_ptr thrown;
    Status failed;  // of the first mesh that did, should the source not pass it on
    const Status status = casters_.visit([&](const CasterView& caster) -> Status {
        const Clock::time_point begin = Clock::now();
        Status s;
        try {
            s = std::visit([&](const auto& view) { return check(view, number); }, caster);
            ++number;
            if (s) s = visitor(caster);
        } catch (...) {
            thrown = std::current_exception();
            s = makeError(ErrorCode::cancelled, "the visitor failed");
        }
        visitorSeconds += secondsSince(begin);
        if (!s && failed) failed = s;
        return s;
    });
    readSeconds_ += secondsSince(start) - visitorSeconds;
    if (thrown) std::rethrow_exception(thrown);
    return failed ? status : failed;
}

}  // namespace mtsm::bake_detail
