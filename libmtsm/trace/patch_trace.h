// patch_trace.h - a bundle of rays through the patches of an opaque map.
#pragma once
#include "trace/bundle.h"
#include "trace/patch_tree.h"

namespace mtsm::trace {

/// Clears the open bits of all rays that a patch blocks. A ray takes the coarsest patches
/// that are fine enough for it; whether it is blocked does not depend on the other rays.
/// Nothing is allocated.
void tracePatches(const PatchTree& tree, RayBundle& bundle) noexcept;

/// May any ray of the hull meet a patch? Where that is not soon found out, it may.
/// Nothing is allocated.
[[nodiscard]] bool mayMeet(const PatchTree& tree, const RayHull& hull) noexcept;

}  // namespace mtsm::trace
