// Out of memory is an error of what is built, never an exception.
#include <catch2/catch.hpp>
#include <new>

#include "baseline/distance_field.h"
#include "baseline/hard_shadow.h"
#include "baseline/held_casters.h"
#include "baseline/single_sample.h"

using namespace mtsm;
using namespace mtsm::baseline;

namespace {

/// Casters that take more memory than there is.
class Endless final : public CasterSource {
  public:
    Status visit(const CasterVisitor&) override { throw std::bad_alloc(); }
};

template <typename T>
bool isTooLarge(const Result<T>& result) {
    return !result && result.error().code == ErrorCode::tooLarge &&
           !result.error().message.empty();
}

}  // namespace

TEST_CASE("copies and fields of casters say that there is not enough memory",
          "[baseline][bad-input]") {
    Endless casters;
    CHECK(isTooLarge(HeldCasters::copy(casters)));
    CHECK(isTooLarge(ShadowCasters::build(casters)));
    CHECK(isTooLarge(SingleSampleScene::build(casters)));
    CHECK(isTooLarge(meshField(casters, 64)));
}

TEST_CASE("a field of more vertices than it can number is refused unread",
          "[sdf][bad-input]") {
    MeshView mesh;
    mesh.vertexCount = std::size_t(1) << 32;
    CasterViews casters({mesh});
    CHECK(isTooLarge(meshField(casters, 64)));
}
