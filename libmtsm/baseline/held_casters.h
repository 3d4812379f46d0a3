// held_casters.h - a copy of casters in memory, for methods that go through them again
// and again.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "mtsm/scene.h"

namespace mtsm::baseline {

class HeldCasters final : public CasterSource {
  public:
    /// Errors: what visit() returns, tooLarge without enough memory.
    static Result<HeldCasters> copy(CasterSource& casters);
    Status visit(const CasterVisitor& visitor) override;

    /// Is every one an opaque mesh?
    [[nodiscard]] bool opaque() const noexcept { return opaque_; }
    [[nodiscard]] std::uint64_t bytes() const noexcept { return bytes_; }

    HeldCasters(HeldCasters&&) noexcept;
    HeldCasters& operator=(HeldCasters&&) noexcept;
    ~HeldCasters() override;

  private:
    struct Held;
    HeldCasters();
    void add(const MeshView& mesh);
    void add(const StrandsView& strands);
    void add(const VolumeView& volume);
    template <typename T>
    const T* keep(const T* values, std::size_t count, std::vector<T>& kept);

    std::vector<std::unique_ptr<Held>> held_;
    std::uint64_t bytes_ = 0;
    bool opaque_ = true;
};

}  // namespace mtsm::baseline
