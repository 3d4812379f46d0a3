// parallel.h - loops in the caller's oneTBB arena, each carried out to its end: they do
// not belong to the caller's task group, so that cancelling that leaves no half of a
// result behind.
//
// Under the thread sanitizer the same loops run on plain threads: it cannot see into a
// libtbb that was built without it, and would report every task. So what it checks is
// what is ours, the bodies.
#pragma once
#if defined(__SANITIZE_THREAD__)
#include <algorithm>
#include <array>
#include <atomic>
#include <thread>
#else
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_group.h>
#endif

namespace mtsm::base {

/// body(begin, end) for ranges that make up [first, last), each of at least about
/// `grain`.
template <typename Index, typename Body>
void parallelRanges(Index first, Index last, Index grain, const Body& body) {
#if defined(__SANITIZE_THREAD__)
    std::atomic<Index> next{first};
    std::array<std::thread, 4> threads;
    const auto join = [&] {
        for (std::thread& thread : threads)
            if (thread.joinable()) thread.join();
    };
    try {
        for (std::thread& thread : threads) {
            thread = std::thread([&] {
                for (Index begin; (begin = next.fetch_add(grain)) < last;)
                    body(begin, std::min(last, begin + grain));
            });
        }
    } catch (...) {  // no memory for a thread
        join();
        throw;
    }
    join();
#else
    tbb::task_group_context ours(tbb::task_group_context::isolated);
    tbb::parallel_for(
        tbb::blocked_range<Index>(first, last, grain),
        [&](const tbb::blocked_range<Index>& range) { body(range.begin(), range.end()); },
        ours);
#endif
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
