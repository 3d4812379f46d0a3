#include "compare/plan.h"

#include <algorithm>

#include "common/quality_options.h"
#include "common/tool.h"
#include "mtsm/describe.h"

namespace mtsm::tools {
namespace {

using baseline::MethodInfo;
using baseline::Settings;
using baseline::SettingUse;

constexpr std::size_t kMostRuns = 2000;

/// What is compared if the job names no method: of Embree all of its modes, for it is the
/// rival.
std::vector<JobMethod> defaultMethods() {
    using Values = std::vector<JobMethod::Value>;
    const auto numbers = [](std::initializer_list<double> values) {
        return Values(values.begin(), values.end());
    };
    const auto word = [](const char* text) { return Values{std::string(text)}; };
    std::vector<JobMethod> methods;
    const auto add = [&](const std::string& name,
                         decltype(JobMethod::settings) settings) {
        methods.emplace_back();
        methods.back().name = name;
        methods.back().settings = std::move(settings);
    };
    for (const MethodInfo& info : baseline::methods()) {
        if (info.name == "embree") {
            add(info.name, {{"samples", numbers({1, 4, 8, 16, 32, 64, 256})}});
            add(info.name, {{"mode", word("adaptive")},
                            {"samples", numbers({16})},
                            {"most", numbers({64, 256})}});
            add(info.name, {{"mode", word("pixel")}, {"samples", numbers({1, 4, 16})}});
        } else if (info.name == "mtsm") {
            add(info.name, {{"resolution", numbers({512, 1024, 2048})},
                            {"samples", numbers({16, 64, 256})}});
            add(info.name, {{"lookup", word("pcf")}, {"samples", numbers({64})}});
        } else if (info.fixedCost) {
            add(info.name, {{"samples", numbers({64})}});
        } else {
            add(info.name, {});
        }
    }
    return methods;
}

/// Whether the setting that this one depends on has the value that it needs.
bool counting(const Settings& settings, const baseline::SettingInfo& setting) {
    const auto equals = setting.with.find('=');
    for (const auto& [name, value] : settings.all())
        if (name == setting.with.substr(0, equals))
            return baseline::settingText(value) == setting.with.substr(equals + 1);
    return true;
}

/// `given`: settings that the job names, said in the label even at their defaults.
PlannedRun makeRun(const MethodInfo& info, Settings settings,
                   const Settings::Given& given) {
    PlannedRun run{&info, std::move(settings), info.name, info.name, info.name};
    for (std::size_t i = 0; i < info.settings.size(); ++i) {
        const auto& setting = info.settings[i];
        const auto& [name, value] = run.settings.all()[i];
        const std::string text = " " + name + "=" + baseline::settingText(value);
        if (setting.use == SettingUse::build) run.buildKey += text;
        const bool samples = name == "samples";
        const bool named = std::any_of(given.begin(), given.end(), [&](const auto& g) {
            return g.first == setting.name;
        });
        const bool said = named && counting(run.settings, setting);
        // What is not said is chosen, perhaps as something else than the fallback.
        const bool chooses = targetError(run) > 0.0;
        if (chooses && setting.use == SettingUse::build && said) run.buildKey += "!";
        if (value != setting.fallback || (samples && !chooses) || said) run.label += text;
        if (!samples && (value != setting.fallback || (chooses && said)))
            run.series += text;
    }
    return run;
}

/// What is meant by one setting of a row: quality of a map is a target-error, by name.
std::pair<std::string, baseline::SettingValue> meantBy(const std::string& method,
                                                       const std::string& name,
                                                       const JobMethod::Value& value,
                                                       const std::string& place) {
    if (method != "mtsm" || name != "quality") return {name, value};
    const auto* word = std::get_if<std::string>(&value);
    if (const auto error = word ? errorOfQuality(*word) : std::nullopt)
        return {"target-error", std::stod(shortText(*error))};  // 0.005, not 0.00499999
    throw Failure{{ErrorCode::badFile, place + "method mtsm, quality: found " +
                                           printable(baseline::settingText(value)) +
                                           ", expected draft, preview or final"}};
}

/// Refuses a row whose settings exclude each other.
void checkRow(const JobMethod& method, const Settings& settings,
              const std::string& place) {
    if (method.name != "mtsm" || !(settings.number("target-error") > 0.0)) return;
    if (settings.word("lookup") != "trace")
        throw Failure{{ErrorCode::badFile,
                       place + "method mtsm, lookup: found " + settings.word("lookup") +
                           " beside target-error, which is for lookup = \"trace\"; leave "
                           "one of them out"}};
}

void checkNames(const JobMethod& method, const std::string& place) {
    const auto has = [&](const char* name) {
        return std::any_of(method.settings.begin(), method.settings.end(),
                           [&](const auto& s) { return s.first == name; });
    };
    if (method.name == "mtsm" && has("quality") && has("target-error"))
        throw Failure{{ErrorCode::badFile,
                       place + "method mtsm: quality is a target-error by name: leave "
                               "one of them out"}};
}

/// All combinations, the last setting changing fastest.
void addCombinations(const JobMethod& method, const MethodInfo& info,
                     const Settings::Given& defaults, std::vector<PlannedRun>& runs) {
    std::vector<std::size_t> at(method.settings.size(), 0);
    const std::string place = method.place.empty() ? "" : method.place + ": ";
    checkNames(method, place);
    while (true) {
        Settings::Given given = defaults;
        for (std::size_t i = 0; i < at.size(); ++i)
            given.push_back(meantBy(method.name, method.settings[i].first,
                                    method.settings[i].second[at[i]], place));
        auto settings = Settings::complete(info.settings, given, info.name);
        if (!settings)
            throw Failure{{ErrorCode::badFile, place + settings.error().message}};
        if (runs.size() == kMostRuns)
            throw Failure{{ErrorCode::badFile, place + "more than " +
                                                   std::to_string(kMostRuns) +
                                                   " combinations of settings; leave "
                                                   "some values out"}};
        checkRow(method, *settings, place);
        runs.push_back(makeRun(info, *std::move(settings), given));
        std::size_t i = at.size();
        while (i > 0 && ++at[i - 1] == method.settings[i - 1].second.size())
            at[--i] = 0;
        if (i == 0) return;
    }
}

}  // namespace

std::vector<PlannedRun> planRuns(const std::vector<JobMethod>& methods,
                                 const std::vector<std::string>& only,
                                 const Settings::Given& mapDefaults) {
    for (const std::string& name : only) {
        const auto known = baseline::findMethod(name);
        if (!known) throw UsageError("--method: " + known.error().message);
    }
    std::vector<PlannedRun> runs;
    for (const JobMethod& method : methods.empty() ? defaultMethods() : methods) {
        const auto info = baseline::findMethod(method.name);
        if (!info)
            throw Failure{
                {ErrorCode::badFile, method.place + ": " + info.error().message}};
        if (!only.empty() &&
            std::find(only.begin(), only.end(), method.name) == only.end())
            continue;
        addCombinations(method, **info,
                        method.name == "mtsm" ? mapDefaults : Settings::Given(), runs);
    }
    // The same run twice is one.
    std::vector<PlannedRun> unique;
    for (PlannedRun& run : runs) {
        const bool known =
            std::any_of(unique.begin(), unique.end(),
                        [&](const PlannedRun& u) { return u.label == run.label; });
        if (!known) unique.push_back(std::move(run));
    }
    if (unique.empty())
        throw UsageError("--method: the scene file compares none of these methods");
    return unique;
}

double targetError(const PlannedRun& run) {
    for (const auto& [name, value] : run.settings.all())
        if (name == "target-error") return std::get<double>(value);
    return 0.0;
}

std::string methodsText() {
    std::string text;
    for (const MethodInfo& info : baseline::methods()) {
        text += (text.empty() ? "" : "\n") + info.name + ": " + info.title + " " +
                info.source + "\n";
        for (const auto& s : info.settings) {
            std::string range;
            if (!s.words.empty()) {
                for (const std::string& word : s.words)
                    range += (range.empty() ? "" : ", ") + word;
                if (s.bytes) range += ", or bytes such as 32M";
            } else if (std::holds_alternative<bool>(s.fallback)) {
                range = "true, false";
            } else {
                range = baseline::settingText(s.least) + " to " +
                        baseline::settingText(s.most);
            }
            text += "  " + s.name + " = " + baseline::settingText(s.fallback) + "  (" +
                    range + ")  " + s.help + "\n";
        }
    }
    return text;
}

}  // namespace mtsm::tools
