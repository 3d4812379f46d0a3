// map_file.h - the map that a tool was given.
#pragma once
#include <string>

#include "common/tool.h"
#include "mtsm/reader.h"

namespace mtsm::tools {

/// Does the file begin as a map does?
[[nodiscard]] bool isMap(const std::string& path);

/// What is wrong with the map at `path`, as `error` has it, and what a tool's user can
/// do: a caster's or a job's file wants to be baked, a picture or a table belongs to
/// other options, a map whose trees or near field alone are damaged (which reading it
/// once more tells) has its layers.
[[nodiscard]] Failure mapFailure(Error error, const std::string& path,
                                 const ReadLimits& limits);

/// What was read of the map at `path`, or its mapFailure() thrown.
template <typename T>
T unwrapMap(Result<T> result, const std::string& path, const ReadLimits& limits) {
    if (!result) throw mapFailure(result.error(), path, limits);
    return *std::move(result);
}

}  // namespace mtsm::tools
