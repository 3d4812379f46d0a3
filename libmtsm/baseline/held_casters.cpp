#include "baseline/held_casters.h"

#include <new>
#include <optional>

namespace mtsm::baseline {

/// A view and what it points to, as far as it has it.
struct HeldCasters::Held {
    CasterView view;
    std::vector<glm::vec3> points;
    std::vector<std::uint32_t> indices;  // or where strands begin
    std::vector<glm::vec2> uvs;
    std::optional<OpacityTexture> texture;
    std::vector<float> widths, numbers;  // numbers: opacities or densities
    std::vector<glm::ivec3> blocks;
};

HeldCasters::HeldCasters() = default;
HeldCasters::HeldCasters(HeldCasters&&) noexcept = default;
HeldCasters& HeldCasters::operator=(HeldCasters&&) noexcept = default;
HeldCasters::~HeldCasters() = default;

template <typename T>
const T* HeldCasters::keep(const T* values, std::size_t count, std::vector<T>& kept) {
    if (!values) return nullptr;
    kept.assign(values, values + count);
    bytes_ += count * sizeof(T);
    return kept.data();
}

void HeldCasters::add(const MeshView& mesh) {
    Held& held = *held_.back();
    MeshView copy = mesh;
    copy.positions = keep(mesh.positions, mesh.vertexCount, held.points);
    copy.indices = keep(mesh.indices, 3 * mesh.triangleCount, held.indices);
    copy.uvs = mesh.texture ? keep(mesh.uvs, mesh.vertexCount, held.uvs) : nullptr;
    if (mesh.texture) {
        held.texture = *mesh.texture;
        copy.texture = &*held.texture;
        bytes_ += mesh.texture->memoryBytes();
    }
    const bool casts = mesh.texture || mesh.opacity > 0.0f;
    const bool translucent =
        mesh.texture ? mesh.texture->translucent() : mesh.opacity < 1.0f;
    opaque_ = opaque_ && !(casts && translucent);
    held.view = copy;
}

void HeldCasters::add(const StrandsView& strands) {
    Held& held = *held_.back();
    StrandsView copy = strands;
    const std::size_t points =
        strands.strandCount > 0 ? strands.begin[strands.strandCount] : 0;
    copy.points = keep(strands.points, points, held.points);
    copy.begin = keep(strands.begin, strands.strandCount + 1, held.indices);
    copy.widths = keep(strands.widths, points, held.widths);
    copy.opacities = keep(strands.opacities, points, held.numbers);
    opaque_ = false;
    held.view = copy;
}

void HeldCasters::add(const VolumeView& volume) {
    Held& held = *held_.back();
    VolumeView copy = volume;
    copy.blocks = keep(volume.blocks, volume.blockCount, held.blocks);
    copy.density =
        keep(volume.density, volume.blockCount * VolumeView::kBlockVoxels, held.numbers);
    opaque_ = false;
    held.view = copy;
}

Result<HeldCasters> HeldCasters::copy(CasterSource& casters) {
    try {
        HeldCasters copies;
        const Status read = casters.visit([&](const CasterView& caster) -> Status {
            copies.held_.push_back(std::make_unique<Held>());
            std::visit([&](const auto& view) { copies.add(view); }, caster);
            return {};
        });
        if (!read) return read.error();
        return copies;
    } catch (const std::bad_alloc&) {
        return Error{ErrorCode::tooLarge,
                     "there is not enough memory for a copy of the "
                     "casters; leave some of them out"};
    }
}

Status HeldCasters::visit(const CasterVisitor& visitor) {
    for (const auto& held : held_) {
        if (Status s = visitor(held->view); !s) return s;
    }
    return {};
}

}  // namespace mtsm::baseline
