// lazy.h - something made when it is first asked for, once, by whichever thread comes
// first; the others wait.
#pragma once
#include <atomic>
#include <memory>
#include <mutex>

#if !defined(__SANITIZE_THREAD__)
#include <tbb/task_arena.h>
#endif

namespace mtsm::base {

/// Holds one object of any type.
class Lazy {
  public:
    /// make() returns the object, by value, the first time; T must not change. If make()
    /// throws, nothing is held and the next one tries again. (Not std::call_once: under
    /// the thread sanitizer one that throws is never free again.)
    template <typename T, typename Make>
    const T& get(const Make& make) {
        if (!made_.load(std::memory_order_acquire)) {
            const std::lock_guard<std::mutex> lock(mutex_);
            if (!made_.load(std::memory_order_relaxed)) {
                const auto hold = [&] { held_ = std::make_shared<const T>(make()); };
#if defined(__SANITIZE_THREAD__)
                hold();
#else
                // A thread that waits for its own loops in make() must not take up other
                // work, which might come back here.
                tbb::this_task_arena::isolate(hold);
#endif
                made_.store(true, std::memory_order_release);
            }
        }
        return *static_cast<const T*>(held_.get());
    }

    /// What is held, null as long as that is nothing.
    template <typename T>
    const T* find() const {
        const bool made = made_.load(std::memory_order_acquire);
        return made ? static_cast<const T*>(held_.get()) : nullptr;
    }

    /// Of a new one: holds what the other does, if that is something.
    void share(const Lazy& other) {
        if (!other.made_.load(std::memory_order_acquire)) return;
        held_ = other.held_;
        made_.store(true, std::memory_order_release);
    }

  private:
    std::mutex mutex_;
    std::atomic<bool> made_{false};
    std::shared_ptr<const void> held_;
};

}  // namespace mtsm::base
