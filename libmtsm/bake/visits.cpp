#include "bake/visits.h"

#include <algorithm>
#include <chrono>
#include <exception>

#include "base/message.h"

namespace mtsm::bake_detail {
namespace {

using base::makeError;
using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

Status checkMesh(const MeshView& mesh, std::uint64_t number) {
    if (!(mesh.opacity >= 0.0f && mesh.opacity <= 1.0f))
        return makeError(ErrorCode::badArgument, "mesh ", number, " has opacity ",
                         mesh.opacity, ", which is not in [0, 1]");
    if (mesh.triangleCount == 0) return {};
    const std::uint32_t highest =
        *std::max_element(mesh.indices, mesh.indices + 3 * mesh.triangleCount);
    if (highest >= mesh.vertexCount)
        return makeError(ErrorCode::badArgument, "mesh ", number,
                         " has a triangle with vertex ", highest, ", but only ",
                         mesh.vertexCount, " vertices");
    return {};
}

}  // namespace

Status Progress::operator()(const char* stage, double fraction) const {
    if (!callback_ || callback_(stage, fraction)) return {};
    return makeError(ErrorCode::cancelled, "the bake was cancelled while ", stage);
}

Status Visits::each(const CasterVisitor& visitor) {
    const Clock::time_point start = Clock::now();
    visitorSeconds_ = 0.0;
    std::uint64_t number = 0;
    std::exception_ptr thrown;
    Status failed;  // of the first mesh that did, should the source not pass it on
    const Status status = casters_.visit([&](const CasterView& caster) -> Status {
        const Clock::time_point begin = Clock::now();
        Status s;
        try {
            if (const auto* mesh = std::get_if<MeshView>(&caster))
                s = checkMesh(*mesh, number++);
            if (s) s = visitor(caster);
        } catch (...) {
            thrown = std::current_exception();
            s = makeError(ErrorCode::cancelled, "the visitor failed");
        }
        visitorSeconds_ += secondsSince(begin);
        if (!s && failed) failed = s;
        return s;
    });
    readSeconds_ += secondsSince(start) - visitorSeconds_;
    if (thrown) std::rethrow_exception(thrown);
    return failed ? status : failed;
}

}  // namespace mtsm::bake_detail
