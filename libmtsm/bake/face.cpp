#include "bake/face.h"

#include <chrono>
#include <variant>

#include "base/message.h"

namespace mtsm::bake_detail {

bool isSolid(const MeshView& mesh) noexcept {
    return mesh.texture ? !mesh.texture->translucent()
                        : mesh.opacity == 1.0f || mesh.opacity == 0.0f;
}

bool isThere(const StrandsView& strands) noexcept {
    return strands.strandCount > 0;
}

bool isThere(const VolumeView& volume) noexcept {
    return volume.blockCount > 0 && volume.extinction != 0.0f;
}

Result<CasterKinds> kindsOf(Visits& visits) {
    CasterKinds kinds;
    bool known = false;
    const Status status = visits.each([&](const CasterView& caster) -> Status {
        if (auto s = visits.progress()("reading casters", -1.0); !s) return s;
        if (const auto* mesh = std::get_if<MeshView>(&caster)) {
            kinds.translucent = kinds.translucent || !isSolid(*mesh);
            return {};
        }
        const auto* strands = std::get_if<StrandsView>(&caster);
        const auto* volume = std::get_if<VolumeView>(&caster);
        if ((strands && !isThere(*strands)) || (volume && !isThere(*volume))) return {};
        kinds.translucent = kinds.media = known = true;
        return Error{ErrorCode::cancelled, "all is known"};
    });
    if (!status && !known) return status.error();
    return kinds;
}

double WorkClock::now() const {
    using namespace std::chrono;
    return duration<double>(steady_clock::now().time_since_epoch()).count() -
           visits_.readSeconds();
}

Error tooLarge(const BakeOptions& o, std::uint64_t least) {
    const std::string needs =
        least > 0 ? base::concat("needs at least ", least, " bytes, more than the ")
                  : std::string("needs more than the ");
    return base::makeError(
        ErrorCode::tooLarge, "a map of ", o.width, " x ", o.height,
        " pixels of these casters ", needs, o.maxBytes,
        " bytes of --max-memory: raise it, or lower --resolution or --layers, or raise ",
        "--tolerance");
}

raster::Facing facing(Cull cull) {
    switch (cull) {
        case Cull::none:
            break;
        case Cull::back:
            return raster::Facing::front;
        case Cull::front:
            return raster::Facing::back;
    }
    return raster::Facing::any;
}

std::uint64_t bytesOf(const Tile& tile) {
    return sizeof(std::uint32_t) *
           (tile.begin.size() + tile.z.size() + tile.v.size() + tile.n.size());
}

}  // namespace mtsm::bake_detail
