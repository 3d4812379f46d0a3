// Without memory for trees and batches queries are answered all the same.
#include <atomic>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <new>
#include <vector>

#include "mtsm/shadow.h"
#include "shadow/released.h"

using namespace mtsm;

namespace {

/// How many more times memory is given; below 0: always. Of the test's own thread: what
/// oneTBB's threads do beside it is not counted.
thread_local long left = -1;

void* give(std::size_t size, std::size_t alignment) {
    if (left == 0) throw std::bad_alloc();
    if (left > 0) --left;
    const std::size_t whole = (size + alignment - 1) / alignment * alignment;
    void* p = alignment > alignof(std::max_align_t) ? std::aligned_alloc(alignment, whole)
                                                    : std::malloc(size ? size : 1);
    if (!p) throw std::bad_alloc();
    return p;
}

void* giveOrNot(std::size_t size, std::size_t alignment) noexcept {
    try {
        return give(size, alignment);
    } catch (const std::bad_alloc&) {
        return nullptr;
    }
}

}  // namespace

// All of them: a sanitizer's own must not be mixed with these. Not inlined, where
// compilers would see free() beside the new of others.
using std::align_val_t, std::nothrow_t, std::size_t;
void* operator new(size_t n) {
    return give(n, 1);
}
void* operator new[](size_t n) {
    return give(n, 1);
}
void* operator new(size_t n, align_val_t a) {
    return give(n, size_t(a));
}
void* operator new[](size_t n, align_val_t a) {
    return give(n, size_t(a));
}
void* operator new(size_t n, const nothrow_t&) noexcept {
    return giveOrNot(n, 1);
}
void* operator new[](size_t n, const nothrow_t&) noexcept {
    return giveOrNot(n, 1);
}
void* operator new(size_t n, align_val_t a, const nothrow_t&) noexcept {
    return giveOrNot(n, size_t(a));
}
void* operator new[](size_t n, align_val_t a, const nothrow_t&) noexcept {
    return giveOrNot(n, size_t(a));
}
[[gnu::noinline]] void operator delete(void* p) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete[](void* p) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete(void* p, size_t) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete[](void* p, size_t) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete(void* p, align_val_t) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete[](void* p, align_val_t) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete(void* p, size_t, align_val_t) noexcept {
    std::free(p);
}
[[gnu::noinline]] void operator delete[](void* p, size_t, align_val_t) noexcept {
    std::free(p);
}

namespace {

ShadowMap halfPlane(bool opaque) {
    return test::halfDark(opaque ? 0.0f : 0.5f, Translucent::sheets);
}

/// From each point to the light's side.
std::vector<ShadowRay> raysFrom(const std::vector<glm::dvec3>& points) {
    std::vector<ShadowRay> rays;
    for (const glm::dvec3& p : points)
        rays.push_back({p, {0, 0, 1}, 4.0});
    return rays;
}

}  // namespace

TEST_CASE("queries that run out of memory anywhere are answered ray by ray",
          "[shadow][threads]") {
    for (const bool opaque : {true, false}) {
        const auto make = [&] { return halfPlane(opaque); };
        const std::size_t count = 300;
        const std::vector<glm::dvec3> points = test::acrossTheEdge(int(count));
        const std::vector<ShadowRay> rays = raysFrom(points);
        ShadowOptions scalar;
        scalar.method = ShadowMethod::scalar;
        std::vector<float> expected(count), found(count), visible(count);
        const ShadowMap first = make();
        const MapInfo& info = first.info();
        shadowFactors(first, info.light, points.data(), nullptr, count, expected.data(),
                      scalar);
        // One allocation more each time, until there is enough.
        int answered = 0;
        for (long given = 0; given < 4000; given += 1 + given / 16) {
            const ShadowMap map = make();
            RayOptions dense;
            dense.spread = 0.01f;
            left = given;
            shadowFactors(map, info.light, points.data(), nullptr, count, found.data());
            visibilities(map, rays.data(), count, visible.data(), dense);
            prepareQueries(map);
            const std::uint64_t bytes = queryMemoryBytes(map);
            const bool enough = left > 0;
            left = -1;
            INFO("opaque " << opaque << " allocations " << given);
            CHECK(bytes >= map.memoryBytes());
            double away = 0.0;
            for (std::size_t i = 0; i < count; ++i) {
                away += std::abs(found[i] - expected[i]) / double(count);
                const bool behind = points[i].x < 0.0;
                if (std::abs(points[i].x) > 0.3)
                    CHECK(visible[i] ==
                          Approx(behind ? (opaque ? 0.0 : 0.5) : 1.0).margin(4e-4));
            }
            CHECK(away < 0.01);
            ++answered;
            if (enough) break;
        }
        CHECK(answered > 5);
    }
}

TEST_CASE("layers go only if there was memory for what takes their place", "[shadow]") {
    for (const bool opaque : {true, false}) {
        bool refused = false, done = false;
        for (long given = 0; given < 4000 && !done; given += 1 + given / 16) {
            ShadowMap map = halfPlane(opaque);
            const std::uint64_t whole = map.memoryBytes();
            left = given;
            const Status status = releaseLayers(map);
            left = -1;
            const bool released = bool(status);
            if (!released) CHECK(status.error().code == ErrorCode::tooLarge);
            INFO("opaque " << opaque << " allocations " << given);
            CHECK(map.hasLayers() == !released);
            CHECK((map.memoryBytes() == whole) == !released);
            refused = refused || !released;
            done = released;
            const float dark = shadowFactor(map, map.info().light, {-1, 0.1, -4});
            CHECK(dark == Approx(opaque ? 1.0 : 0.5).margin(4e-4));
        }
        CHECK(refused);
        CHECK(done);
    }
}

TEST_CASE("without layers queries that run out of memory are answered all the same",
          "[shadow]") {
    for (const bool opaque : {true, false}) {
        ShadowMap map = halfPlane(opaque);
        const AreaLight light = map.info().light;
        const std::size_t count = 300;
        const std::vector<glm::dvec3> points = test::acrossTheEdge(int(count));
        const std::vector<ShadowRay> rays = raysFrom(points);
        REQUIRE(releaseLayers(map));
        std::vector<float> expected(count), clear(count), found(count), visible(count);
        shadowFactors(map, light, points.data(), nullptr, count, expected.data());
        visibilities(map, rays.data(), count, clear.data());
        int answered = 0;
        for (long given = 0; given < 4000; given += 1 + given / 16) {
            left = given;
            shadowFactors(map, light, points.data(), nullptr, count, found.data());
            visibilities(map, rays.data(), count, visible.data());
            const bool enough = left > 0;
            left = -1;
            INFO("opaque " << opaque << " allocations " << given);
            double away = 0.0;
            for (std::size_t i = 0; i < count; ++i)
                away += std::abs(found[i] - expected[i]) / double(count);
            CHECK(away < 0.01);
            CHECK(visible == clear);
            ++answered;
            if (enough) break;
        }
        CHECK(answered > 5);
    }
}
