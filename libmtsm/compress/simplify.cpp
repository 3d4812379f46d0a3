// The slope window of [Lokovic00, sec. 3.1], extended with the count of [Xie07,
// sec. 5.1].
//
// V' of a layer of n samples takes n equal steps of ln v at places that z and n alone
// decide: ln V'_j = ln v_before + j x. So it is known before x is which steps of V' meet
// which steps of V (walk() in error.h), and |V - V'| <= tolerance means that x lies in an
// interval, the meet of one for each pair. That window is exact: if it is empty these
// samples make no layer. Otherwise x is what comes closest to the true visibility behind
// the layer.
//
// Differs from the paper: windows there range over straight lines in v, and a layer is as
// long as one exists; here optical depth, length and the places of samples are bounded
// too.
#include "compress/simplify.h"

#include <cfloat>
#include <limits>

namespace mtsm::compress {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Half of it is what a v below 1 loses by being a float; a window has to be narrower by
/// that, and a little of the tolerance is left for how readers round.
constexpr double kFloatStep = 0x1p-24;
constexpr double kReserve = 0x1p-26;

/// Larger layers that are tried after one that did not fit: two samples at random places
/// often do not make a layer where four do.
constexpr int kSecondChances = 2;

/// The layer of a single sample: the true visibility, or a little less where the layer
/// before was that far down already.
Span single(const Visibility& samples, std::uint32_t sample, const float* vBefore) {
    Span span;
    span.end = sample + 1;
    for (std::uint32_t c = 0; c < samples.channels; ++c)
        span.v[c] = std::min(float(samples.v[c][sample]), vBefore[c]);
    return span;
}

double errorOfSingle(const Visibility& samples, const Span& span) {
    double error = 0.0;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        const double v = samples.v[c][span.end - 1];
        if (float(v) != span.v[c])
            error = std::max(error, std::abs(v - double(span.v[c])));
    }
    return error;
}

}  // namespace

Simplifier::Simplifier(double tolerance, double drift, const Bounds& bounds)
    : tolerance_(tolerance), drift_(std::log1p(drift)), bounds_(bounds) {}

double Simplifier::simplify(const Visibility& samples, std::vector<Span>& layers) {
    const bool merges = tolerance_ > kFloatStep;
    if (merges) takeLogarithms(samples);
    layers.clear();
    double reached = 0.0;
    std::uint32_t limit = 0;  // the next sample that stands alone
    for (std::uint32_t begin = 0; begin < samples.size(); begin = layers.back().end) {
        float vBefore[3] = {1.0f, 1.0f, 1.0f};
        if (!samples.startsAt(begin)) std::copy_n(layers.back().v, 3, vBefore);
        Span span = single(samples, begin, vBefore);
        error_ = errorOfSingle(samples, span);
        if (merges) {
            for (limit = std::max(limit, begin);
                 limit < samples.size() && samples.wall[limit] == Wall::none;)
                ++limit;
            extend(samples, begin, limit, vBefore, span);
        }
        reached = std::max(reached, error_);
        layers.push_back(span);
    }
    return reached;
}

void Simplifier::takeLogarithms(const Visibility& samples) {
    const double most = tolerance_ - kFloatStep;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        for (auto* plane : {&log_[c], &logLow_[c], &logHigh_[c]})
            plane->resize(samples.size() + 1);
        for (std::uint32_t i = 0; i <= samples.size(); ++i) {
            const double v = i > 0 ? samples.v[c][i - 1] : 1.0;
            log_[c][i] = std::log(v);
            logLow_[c][i] = v > most ? std::log(v - most) : -kInfinity;
            logHigh_[c][i] = std::log(v + most);
        }
    }
}

/// Doubles the size while it fits, then bisects: n samples cost O(n log n).
void Simplifier::extend(const Visibility& samples, std::uint32_t begin,
                        std::uint32_t limit, const float* vBefore, Span& span) {
    if (limit <= begin + 1) return;
    const std::uint32_t largest = limit - begin;
    std::uint32_t good = 1, bad = 0;  // bad 0: no size is known not to fit
    double error = error_;
    const auto tryOut = [&](std::uint32_t size) {
        Span longer;
        const Fit result = fit(samples, {begin, begin + size}, vBefore, longer);
        if (result == Fit::good) {
            span = longer;
            error = error_;
            good = size;
            if (bad < good) bad = 0;
        } else if (bad == 0 || size < bad) {
            bad = size;
        }
        return result;
    };
    int misses = 0;
    for (std::uint32_t size = 1; size < largest && misses <= kSecondChances;) {
        size = size > largest / 2 ? largest : 2 * size;
        const Fit result = tryOut(size);
        if (result == Fit::hopeless) break;
        misses = result == Fit::good ? 0 : misses + 1;
    }
    while (bad > good + 1)
        tryOut(good + (bad - good) / 2);
    error_ = error;
}

Simplifier::Fit Simplifier::fit(const Visibility& samples, Group g, const float* vBefore,
                                Span& span) {
    const double n = g.size();
    const double length = bounds_.length(samples.z[g.end - 1]);
    if (lengthOf(samples, g) > length) return Fit::hopeless;
    const std::uint32_t first = samples.startsAt(g.begin) ? 0 : g.begin;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        if (vBefore[c] > 0.0f &&
            log_[c][first] - log_[c][g.end] > bounds_.opticalDepth + 2.0 * drift_)
            return Fit::hopeless;
    }
    const double move = std::min(0.5 * length, coveredDepth(samples, g));
    if (largestMove(samples, g, move) > move) return Fit::bad;

    span.end = g.end;
    for (std::uint32_t c = 0; c < samples.channels; ++c) {
        span.v[c] = 0.0f;
        if (vBefore[c] == 0.0f) continue;
        // Of all x = ln(v / vBefore) / n that the bounds leave, the truest.
        const double start = std::log(double(vBefore[c]));
        const double end = log_[c][g.end] - start;
        double low = std::max(-bounds_.opticalDepth, end - drift_) / n;
        double high = std::min(0.0, end + drift_) / n;
        if (!window(samples, g, c, start, low, high)) return Fit::bad;
        const double x = std::clamp(end / n, low, high);
        const float v = float(std::exp(start + n * x));
        span.v[c] = std::clamp(v, FLT_MIN, vBefore[c]);
    }
    const double most = tolerance_ - kReserve;
    error_ = largestError(samples, g, vBefore, span.v, most);
    return error_ <= most ? Fit::good : Fit::bad;
}

/// Narrows [low, high] to the x with |V - V'| within the tolerance; false if none is
/// left.
bool Simplifier::window(const Visibility& samples, Group g, std::uint32_t channel,
                        double start, double& low, double& high) const {
    // Index 0 is for what is in front of the group: 1 where accumulation starts.
    const bool starts = samples.startsAt(g.begin);
    const double* const logLow = logLow_[channel].data() + g.begin;
    const double* const logHigh = logHigh_[channel].data() + g.begin;
    return walk(samples, g, [&](std::uint32_t j, std::uint32_t k) {
        const bool clear = k == 0 && starts;
        const double least = (clear ? logLow_[channel][0] : logLow[k]) - start;
        const double most = (clear ? logHigh_[channel][0] : logHigh[k]) - start;
        // Divides only where that narrows the window.
        if (low * j < least) low = j > 0 ? least / j : kInfinity;
        if (high * j > most) high = j > 0 ? most / j : -kInfinity;
        return low <= high;
    });
}

}  // namespace mtsm::compress
