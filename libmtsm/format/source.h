// source.h - where a reader's bytes come from: a file or memory.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "mtsm/result.h"

namespace mtsm::format {

/// Bytes at known offsets. read() may be called from several threads at once.
class Source {
  public:
    virtual ~Source() = default;
    [[nodiscard]] virtual std::uint64_t size() const noexcept = 0;
    /// Fills `out` with the bytes from `offset` on. Anything less is an error (io): the
    /// caller has already proved that they lie within size().
    virtual Status read(std::uint64_t offset, std::span<std::uint8_t> out) const = 0;
    /// What messages call it.
    [[nodiscard]] const std::string& name() const noexcept { return name_; }

  protected:
    explicit Source(std::string name) : name_(std::move(name)) {}

  private:
    std::string name_;
};

/// A regular file; everything else (a folder, a pipe, a device) is refused, because tiles
/// are read where the index says they are. Errors: io.
Result<std::unique_ptr<Source>> openFile(const std::string& path);

/// Bytes that outlive the source.
std::unique_ptr<Source> openMemory(std::span<const std::uint8_t> bytes, std::string name);

}  // namespace mtsm::format
