#include "compare/recommend.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include "common/arguments.h"
#include "common/tool.h"

namespace mtsm::tools {
namespace {

using Json = nlohmann::ordered_json;

struct Candidate {
    const Json* run;
    double error, query, build, firstFrame;  // all threads
};

std::vector<Candidate> candidates(const Json& results, std::size_t light,
                                  ErrorKind error) {
    std::vector<Candidate> all;
    for (const Json& run : results["runs"]) {
        const Json& e = run["errors"][kErrorKinds[std::size_t(error)]];
        if (run["light"].get<std::size_t>() != light || e.is_null() ||
            run["unanswered"].get<std::size_t>() > 0)
            continue;
        const double query = run["query"]["all"]["median"],
                     build = run["build"]["all"]["median"];
        all.push_back({&run, e["mean"], query, build, build + query});
    }
    return all;
}

/// What is slower than the least by no more than noise may be.
constexpr double kTie = 1.2;

/// Those whose cost is the least, or nearly.
template <typename Cost>
std::vector<Candidate> nearlyLeast(std::vector<Candidate> all, const Cost& cost) {
    double least = INFINITY;
    for (const Candidate& c : all)
        least = std::min(least, cost(c));
    std::erase_if(all, [&](const Candidate& c) { return cost(c) > kTie * least; });
    return all;
}

double memoryOf(const Candidate& c) {
    return (*c.run)["build"]["memoryBytes"].get<double>();
}

/// The quickest of those that `fits` lets in; of what is nearly as quick the one that is
/// built the quickest, and of those again the smallest.
template <typename Fits, typename Seconds>
std::optional<Candidate> quickest(std::vector<Candidate> all, const Fits& fits,
                                  const Seconds& seconds) {
    std::erase_if(all, [&](const Candidate& c) { return !fits(c); });
    const auto left = nearlyLeast(nearlyLeast(std::move(all), seconds),
                                  [](const Candidate& c) { return c.build; });
    const auto least = std::min_element(
        left.begin(), left.end(),
        [](const Candidate& a, const Candidate& b) { return memoryOf(a) < memoryOf(b); });
    return least == left.end() ? std::nullopt : std::optional(*least);
}

/// The candidate whose cost is the least of those that `fits` lets in.
template <typename Fits, typename Cost>
std::optional<Candidate> best(const std::vector<Candidate>& all, const Fits& fits,
                              const Cost& cost) {
    std::optional<Candidate> found;
    for (const Candidate& c : all)
        if (fits(c) && (!found || cost(c) < cost(*found))) found = c;
    return found;
}

std::string line(const Candidate& c) {
    return (*c.run)["label"].get<std::string>() + ": mean error " +
           shortText(float(c.error)) + ", " + secondsText(c.query) + " a picture, " +
           secondsText(c.firstFrame) + " for the first one, its build included, " +
           bytesText((*c.run)["build"]["memoryBytes"].get<std::uint64_t>());
}

/// The options of mtsm-bake that make the light as large as it was compared.
std::string lightSize(const Json& light) {
    const std::string shape = light["shape"];
    const Json& l = light["light"];
    if (shape == "disk" || shape == "sphere")
        return " --light-radius " + numberText(l["radius"]);
    if (shape == "rect")
        return " --light-size " + numberText(l["size"][0]) + "," +
               numberText(l["size"][1]);
    if (shape == "sun")
        return " --light-angle " + numberText(l["angularDiameterDegrees"]);
    return "";
}

std::string mapLines(const Json& run, const Json& light, const std::string& input,
                     const std::string& positionPass, const std::string& normalPass) {
    const Json& s = run["settings"];
    const bool chosen = s["target-error"] > 0.0;
    const std::string target = " --target-error " + numberText(s["target-error"]);
    // What is not given beside a target is chosen again.
    const auto option = [&](const char* name) -> std::string {
        const Json& given = run["given"];
        if (chosen && std::find(given.begin(), given.end(), name) == given.end())
            return "";
        const Json& value = s[name];
        return std::string(" --") + name + " " +
               (value.is_string() ? value.get<std::string>() : numberText(value));
    };
    std::string bake = "  mtsm-bake " + input + lightSize(light);
    if (chosen) bake += target;
    bake += option("resolution");
    if (s["layers"] > 0.0) bake += " --layers " + numberText(s["layers"]);
    bake += option("near-field") + option("tolerance");
    if (s["subsamples"] > 1.0) bake += " --subsamples " + numberText(s["subsamples"]);
    if (s["bias"] >= 0.0) bake += " --bias " + numberText(s["bias"]);
    std::string query =
        "  mtsm-query key.mtsm --position " +
        quotedForShell(positionPass.empty() ? "shot.P.exr" : positionPass);
    if (positionPass.empty() || !normalPass.empty())
        query += " --normal-pass " +
                 quotedForShell(normalPass.empty() ? "shot.N.exr" : normalPass);
    if (chosen) query += target;
    query += option("samples");
    if (s["adaptive"] == "true") query += " --adaptive";
    if (s["query-bias"] >= 0.0) query += " --bias " + numberText(s["query-bias"]);
    if (s["lookup"] != "trace") query += " --method " + s["lookup"].get<std::string>();
    if (s["attenuation"] == "subtract") query += " --attenuation subtract";
    return bake + " -o key.mtsm\n" + query + " -o shadow.exr\n";
}

}  // namespace

Wish parseWish(const std::string& text) {
    const auto wrong = [&] {
        return UsageError("--recommend: found \"" + text +
                          "\", expected a mean error such as error=0.005, or a time such "
                          "as time=2s (ms, s, min)");
    };
    const auto equals = text.find('=');
    if (equals == std::string::npos) throw wrong();
    const std::string what = text.substr(0, equals), rest = text.substr(equals + 1);
    Wish wish;
    const auto [end, problem] =
        std::from_chars(rest.data(), rest.data() + rest.size(), wish.value);
    const std::string unit(end, rest.data() + rest.size());
    if (problem != std::errc() || !(wish.value > 0.0) || !std::isfinite(wish.value))
        throw wrong();
    if (what == "error" && unit.empty()) return wish;
    wish.isTime = true;
    if (what != "time") throw wrong();
    if (unit == "ms")
        wish.value *= 1e-3;
    else if (unit == "min")
        wish.value *= 60.0;
    else if (unit != "s")
        throw wrong();
    return wish;
}

std::string recommendation(const Json& results, const Wish& wish, ErrorKind error,
                           const std::string& input, const std::string& positionPass,
                           const std::string& normalPass) {
    std::string text;
    for (std::size_t l = 0; l < results["lights"].size(); ++l) {
        const Json& light = results["lights"][l];
        text += "light " + std::to_string(l + 1) + ", " +
                light["name"].get<std::string>() + "\n";
        const auto all = candidates(results, l, error);
        const auto fits = [&](const Candidate& c) {
            return wish.isTime ? c.firstFrame <= wish.value : c.error <= wish.value;
        };
        const auto byError = [](const Candidate& c) { return c.error; };
        const auto byFirst = [](const Candidate& c) { return c.firstFrame; };
        const auto byQuery = [](const Candidate& c) { return c.query; };
        const auto first =
            wish.isTime ? best(all, fits, byError) : quickest(all, fits, byFirst);
        if (!first) {
            const auto near =
                wish.isTime ? best(
                                  all, [](const Candidate&) { return true; }, byFirst)
                            : best(
                                  all, [](const Candidate&) { return true; }, byError);
            text += "  none of what was compared meets it";
            text += near ? "; nearest: " + line(*near) + "\n" : "\n";
            continue;
        }
        text += "  " + line(*first) + "\n";
        // Who shades many pictures pays for the first one once.
        const auto further = wish.isTime ? first : quickest(all, fits, byQuery);
        if (further->run != first->run)
            text += "  for many pictures: " + line(*further) + "\n";
        const auto isMap = [](const Candidate& c) {
            return (*c.run)["method"] == "mtsm";
        };
        const auto fitsAndIsMap = [&](const Candidate& c) { return fits(c) && isMap(c); };
        auto map = wish.isTime ? best(all, fitsAndIsMap, byError)
                               : quickest(all, fitsAndIsMap, byFirst);
        if (!map) {
            const auto near =
                wish.isTime ? best(all, isMap, byFirst) : best(all, isMap, byError);
            if (near)
                text +=
                    "  no map that was compared meets it; nearest: " + line(*near) + "\n";
            continue;
        }
        if (isMap(*further)) map = further;
        if (isMap(*first)) map = first;
        if (!isMap(*first) && !isMap(*further))
            text += "  from a map: " + line(*map) + "\n";
        text += mapLines(*map->run, light, input, positionPass, normalPass);
    }
    return text;
}

}  // namespace mtsm::tools
