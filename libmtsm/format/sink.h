// sink.h - where a writer's bytes go: memory, or a file that appears whole or not at all.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/file_output.h"
#include "mtsm/result.h"

namespace mtsm::format {

/// Takes bytes in order; there is no going back, so a pipe will do.
class Sink {
  public:
    virtual ~Sink() = default;
    virtual Status write(std::span<const std::uint8_t> bytes) = 0;
};

class MemorySink final : public Sink {
  public:
    Status write(std::span<const std::uint8_t> bytes) override {
        bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
        return {};
    }
    [[nodiscard]] std::vector<std::uint8_t> take() && { return std::move(bytes_); }

  private:
    std::vector<std::uint8_t> bytes_;
};

/// A file that appears whole or not at all: see base::FileOutput.
class FileSink final : public Sink {
  public:
    explicit FileSink(base::FileOutput& file) : file_(file) {}
    Status write(std::span<const std::uint8_t> bytes) override {
        return file_.write(bytes);
    }

  private:
    base::FileOutput& file_;
};

}  // namespace mtsm::format
