// parallel.h - loops in the caller's oneTBB arena.
//
// What comes before a loop happens before each of its bodies, and each body before what
// comes after the loop: oneTBB guarantees it, and Happens tells the thread sanitizer,
// which cannot see into a libtbb that was built without it.
#pragma once
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#if defined(__SANITIZE_THREAD__)
#include <sanitizer/tsan_interface.h>
#endif

namespace mtsm::base {

/// Orders what one thread did before `before()` in front of what another does after
/// `after()`, for the thread sanitizer alone: the program itself must be ordered by other
/// means.
class Happens {
  public:
#if defined(__SANITIZE_THREAD__)
    void before() {
        __tsan_release(this);
    }
    void after() {
        __tsan_acquire(this);
    }
#else
    void before() {}
    void after() {}
#endif
};

/// body(begin, end) for ranges that make up [first, last), of `grain` or so.
template <typename Index, typename Body>
void parallelRanges(Index first, Index last, Index grain, const Body& body) {
    Happens start, finish;
    start.before();
    tbb::parallel_for(tbb::blocked_range<Index>(first, last, grain),
                      [&](const tbb::blocked_range<Index>& range) {
                          start.after();
                          body(range.begin(), range.end());
                          finish.before();
                      });
    finish.after();
}

/// body(i) for every i in [first, last).
template <typename Index, typename Body>
void parallelFor(Index first, Index last, const Body& body) {
    parallelRanges(first, last, Index(1), [&](Index begin, Index end) {
        for (Index i = begin; i < end; ++i)
            body(i);
    });
}

}  // namespace mtsm::base
