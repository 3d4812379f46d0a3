// lazy.h - something made when it is first asked for, once, by whichever thread comes
// first; the others wait.
#pragma once
#include <memory>
#include <mutex>

#if !defined(__SANITIZE_THREAD__)
#include <tbb/task_arena.h>
#endif

namespace mtsm::base {

/// Holds one object of any type.
class Lazy {
  public:
    /// make() returns the object, by value, the first time; T must not change.
    template <typename T, typename Make>
    const T& get(const Make& make) {
        std::call_once(once_, [&] {
            const auto hold = [&] { held_ = std::make_shared<const T>(make()); };
#if defined(__SANITIZE_THREAD__)
            hold();
#else
            // A thread that waits for its own loops in make() must not take up other work,
            // which might come back here.
            tbb::this_task_arena::isolate(hold);
#endif
        });
        return *static_cast<const T*>(held_.get());
    }

  private:
    std::once_flag once_;
    std::shared_ptr<const void> held_;
};

}  // namespace mtsm::base
