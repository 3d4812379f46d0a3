// memory_budget.h - how many bytes may still be allocated; shared by all threads.
#pragma once
#include <atomic>
#include <cstdint>

namespace mtsm::raster {

class MemoryBudget {
  public:
    explicit MemoryBudget(std::uint64_t limit) noexcept : limit_(limit) {}

    /// Takes `bytes` from what is left, or fails for good: what was taken before one
    /// failure is a fact, what could still have fitted afterwards depends on the order.
    [[nodiscard]] bool reserve(std::uint64_t bytes) noexcept {
        const std::uint64_t before = used_.fetch_add(bytes, std::memory_order_relaxed);
        if (bytes <= limit_ && before <= limit_ - bytes) return true;
        exceeded_.store(true, std::memory_order_relaxed);
        return false;
    }
    [[nodiscard]] bool exceeded() const noexcept {
        return exceeded_.load(std::memory_order_relaxed);
    }
    [[nodiscard]] std::uint64_t limit() const noexcept { return limit_; }

  private:
    std::uint64_t limit_;
    std::atomic<std::uint64_t> used_{0};
    std::atomic<bool> exceeded_{false};
};

}  // namespace mtsm::raster
