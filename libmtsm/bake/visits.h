// visits.h - going through the casters, once per pass: checked, timed, cancellable.
#pragma once
#include "mtsm/bake.h"
#include "mtsm/scene.h"

namespace mtsm::bake_detail {

/// Tells the caller's callback what is done; its wish to stop becomes an Error.
class Progress {
  public:
    explicit Progress(const BakeOptions& options) : callback_(options.progress) {}

    Status operator()(const char* stage, double fraction) const;

  private:
    const std::function<bool(const char*, double)>& callback_;
};

/// All casters, so many times.
class Visits {
  public:
    Visits(CasterSource& casters, const Progress& progress)
        : casters_(casters), progress_(progress) {}

    /// Hands every caster to `visitor`, after checking what scene.h promises of it
    /// (badArgument if not): indices, opacities, widths, densities. Exceptions that
    /// `visitor` throws come back as thrown, but do not pass through the source.
    Status each(const CasterVisitor& visitor);

    [[nodiscard]] const Progress& progress() const { return progress_; }
    /// Spent in the source so far, outside the visitors.
    [[nodiscard]] double readSeconds() const { return readSeconds_; }

  private:
    CasterSource& casters_;
    const Progress& progress_;
    double readSeconds_ = 0.0;
};

}  // namespace mtsm::bake_detail
