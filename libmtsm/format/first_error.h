// first_error.h - of errors that threads find in any order, the one that comes first in
// the file.
#pragma once
#include <atomic>
#include <cstdint>
#include <mutex>
#include <utility>

#include "mtsm/result.h"

namespace mtsm::format {

/// The error of the first bad item, whatever order threads find them in.
class FirstError {
  public:
    /// Items behind a bad one need not be looked at.
    [[nodiscard]] bool isBehind(std::uint64_t item) const noexcept {
        return item > first_.load(std::memory_order_relaxed);
    }
    void add(std::uint64_t item, Error error) {
        const std::lock_guard lock(mutex_);
        if (item >= first_.load(std::memory_order_relaxed)) return;
        first_.store(item, std::memory_order_relaxed);
        status_ = std::move(error);
    }
    [[nodiscard]] Status status() const { return status_; }

  private:
    std::mutex mutex_;
    std::atomic<std::uint64_t> first_{~std::uint64_t(0)};
    Status status_;
};

}  // namespace mtsm::format
