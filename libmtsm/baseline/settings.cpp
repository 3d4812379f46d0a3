#include "baseline/settings.h"

#include <algorithm>
#include <cassert>
#include <charconv>
#include <cmath>

#include "base/message.h"
#include "base/printable.h"
#include "mtsm/describe.h"

namespace mtsm::baseline {
namespace {

std::string joined(const std::vector<std::string>& names) {
    std::string text;
    for (const std::string& name : names)
        text += (text.empty() ? "" : ", ") + name;
    return text;
}

std::string expected(const SettingInfo& info) {
    if (std::holds_alternative<bool>(info.fallback)) return "true or false";
    if (std::holds_alternative<std::string>(info.fallback))
        return "one of " + joined(info.words) +
               (info.bytes ? ", or bytes such as 32M" : "");
    return std::string(info.whole ? "a whole number" : "a number") + " from " +
           settingText(info.least) + " to " + settingText(info.most);
}

bool fits(const SettingInfo& info, const SettingValue& value) {
    if (value.index() != info.fallback.index()) return false;
    if (const auto* number = std::get_if<double>(&value))
        return *number >= info.least && *number <= info.most &&
               !(info.whole && *number != std::floor(*number));
    if (const auto* word = std::get_if<std::string>(&value))
        return std::find(info.words.begin(), info.words.end(), *word) !=
                   info.words.end() ||
               (info.bytes && parseBytes(*word));
    return true;
}

/// A scene file may spell the words "5" and "true", or bytes, without quotes.
SettingValue asMeant(const SettingInfo& info, const SettingValue& value) {
    if (!std::holds_alternative<std::string>(info.fallback)) return value;
    const auto* number = std::get_if<double>(&value);
    if (!number) return settingText(value);
    const bool whole =
        *number >= 0.0 && *number < 0x1p53 && *number == std::floor(*number);
    return whole ? std::to_string(std::uint64_t(*number)) : settingText(value);
}

/// Insertions, deletions, replacements that make one of the other.
std::size_t editDistance(const std::string& a, const std::string& b) {
    std::vector<std::size_t> row(b.size() + 1);
    for (std::size_t j = 0; j <= b.size(); ++j)
        row[j] = j;
    for (std::size_t i = 1; i <= a.size(); ++i) {
        std::size_t diagonal = row[0];
        row[0] = i;
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
            diagonal = row[j];
            row[j] = std::min({row[j] + 1, row[j - 1] + 1, replaced});
        }
    }
    return row[b.size()];
}

}  // namespace

std::string settingText(const SettingValue& value) {
    if (const auto* flag = std::get_if<bool>(&value)) return *flag ? "true" : "false";
    if (const auto* word = std::get_if<std::string>(&value)) return *word;
    char text[32];
    const auto end = std::to_chars(text, text + sizeof text, std::get<double>(value));
    return std::string(text, end.ptr);
}

SettingInfo wholeSetting(std::string name, double fallback, double least, double most,
                         std::string help, SettingUse use) {
    return {std::move(name), fallback, use, std::move(help), least, most, true};
}
SettingInfo numberSetting(std::string name, double fallback, double least, double most,
                          std::string help, SettingUse use) {
    return {std::move(name), fallback, use, std::move(help), least, most};
}
SettingInfo flagSetting(std::string name, bool fallback, std::string help,
                        SettingUse use) {
    return {std::move(name), fallback, use, std::move(help)};
}
SettingInfo wordSetting(std::string name, std::vector<std::string> words,
                        std::string help, SettingUse use) {
    std::string fallback = words.front();
    return {std::move(name), std::move(fallback), use, std::move(help), 0.0, 0.0,
            false,           std::move(words)};
}

std::string nearestName(const std::string& wrong, const std::vector<std::string>& names) {
    std::string nearest;
    std::size_t least = std::max<std::size_t>(2, wrong.size() / 3) + 1;
    for (const std::string& name : names) {
        const std::size_t distance = editDistance(wrong, name);
        if (distance < least) {
            least = distance;
            nearest = name;
        }
    }
    if (!nearest.empty() || wrong.size() < 3) return nearest;
    for (const std::string& name : names)
        if (name.rfind(wrong, 0) == 0) return name;
    return nearest;
}

Result<Settings> Settings::complete(const std::vector<SettingInfo>& infos,
                                    const Given& given, const std::string& method) {
    Settings settings;
    for (const SettingInfo& info : infos)
        settings.values_.emplace_back(info.name, info.fallback);
    settings.given_.assign(infos.size(), false);
    for (const auto& [name, value] : given) {
        std::size_t at = 0;
        while (at < infos.size() && infos[at].name != name)
            ++at;
        if (at == infos.size()) {
            std::vector<std::string> names;
            for (const SettingInfo& info : infos)
                names.push_back(info.name);
            const std::string near = nearestName(name, names);
            return base::makeError(
                ErrorCode::badArgument, "method ", method, " has no setting \"",
                base::printable(name), "\"",
                near.empty() ? "; it has " : "; did you mean \"" + near + "\"? It has ",
                names.empty() ? "none" : joined(names));
        }
        const SettingValue meant = asMeant(infos[at], value);
        if (!fits(infos[at], meant))
            return base::makeError(ErrorCode::badArgument, "method ", method, ", ", name,
                                   ": found ", base::printable(settingText(value)),
                                   ", expected ", expected(infos[at]));
        settings.values_[at].second = meant;
        settings.given_[at] = true;
    }
    for (std::size_t i = 0; i < infos.size(); ++i) {
        const auto equals = infos[i].with.find('=');
        if (equals == std::string::npos) continue;
        const std::size_t other = settings.find(infos[i].with.substr(0, equals));
        if (settingText(settings.values_[other].second) ==
            infos[i].with.substr(equals + 1))
            continue;
        settings.values_[i].second = infos[i].fallback;
        settings.given_[i] = false;
    }
    return settings;
}

std::size_t Settings::find(const std::string& name) const {
    const auto found =
        std::find_if(values_.begin(), values_.end(),
                     [&](const auto& setting) { return setting.first == name; });
    assert(found != values_.end());
    return std::size_t(found - values_.begin());
}

bool Settings::given(const std::string& name) const {
    return given_[find(name)];
}
bool Settings::flag(const std::string& name) const {
    return std::get<bool>(values_[find(name)].second);
}
double Settings::number(const std::string& name) const {
    return std::get<double>(values_[find(name)].second);
}
int Settings::whole(const std::string& name) const {
    return int(number(name));
}
const std::string& Settings::word(const std::string& name) const {
    return std::get<std::string>(values_[find(name)].second);
}

}  // namespace mtsm::baseline
