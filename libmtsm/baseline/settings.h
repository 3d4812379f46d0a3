// settings.h - the settings of a shadow method by name, as a scene file spells them.
//
//     const SettingInfo kSamples = wholeSetting("samples", 256, 1, 4096, "rays a point");
//     auto settings = Settings::complete(infos, {{"samples", 64.0}}, "mvsm");
//     settings->whole("samples");                             // 64
#pragma once
#include <cstdint>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "mtsm/result.h"

namespace mtsm::baseline {

/// A yes or no, a number or a word.
using SettingValue = std::variant<bool, double, std::string>;

/// The shortest text that a scene file would have: true, 0.5, adaptive.
[[nodiscard]] std::string settingText(const SettingValue& value);

/// When a setting takes effect.
enum class SettingUse {
    build,  ///< when the method is built
    query   ///< only when it answers: one build serves all its values
};

struct SettingInfo {
    std::string name;       ///< "samples": lower case, words joined by -
    SettingValue fallback;  ///< what holds if none is given; its type is the setting's
    SettingUse use = SettingUse::query;
    std::string help;  ///< one line, with unit
    double least = 0.0, most = 0.0;
    bool whole = false;
    std::vector<std::string> words{};  ///< that a word may be
    /// "mode=adaptive": it counts only where another setting has this value; elsewhere it
    /// stays at its fallback. Empty: always.
    std::string with{};
    bool bytes = false;  ///< besides its words what parseBytes() takes: 32M
};

[[nodiscard]] SettingInfo wholeSetting(std::string name, double fallback, double least,
                                       double most, std::string help,
                                       SettingUse use = SettingUse::query);
[[nodiscard]] SettingInfo numberSetting(std::string name, double fallback, double least,
                                        double most, std::string help,
                                        SettingUse use = SettingUse::query);
[[nodiscard]] SettingInfo flagSetting(std::string name, bool fallback, std::string help,
                                      SettingUse use = SettingUse::query);
/// The first of `words` is the fallback.
[[nodiscard]] SettingInfo wordSetting(std::string name, std::vector<std::string> words,
                                      std::string help,
                                      SettingUse use = SettingUse::query);

/// A value for every setting of a method.
class Settings {
  public:
    using Given = std::vector<std::pair<std::string, SettingValue>>;

    /// `given` and, for what is not given, the fallbacks, in the order of `infos`.
    /// badArgument (the message names `method`, the setting, what was found and what was
    /// expected; for an unknown name the nearest that there is) where a name, a type or a
    /// value is none of the method's.
    static Result<Settings> complete(const std::vector<SettingInfo>& infos,
                                     const Given& given, const std::string& method);

    // The setting must be there and be of that type.
    [[nodiscard]] bool flag(const std::string& name) const;
    [[nodiscard]] double number(const std::string& name) const;
    [[nodiscard]] int whole(const std::string& name) const;
    [[nodiscard]] const std::string& word(const std::string& name) const;

    [[nodiscard]] const Given& all() const noexcept { return values_; }
    /// Was it said, and not left to its fallback?
    [[nodiscard]] bool given(const std::string& name) const;

  private:
    [[nodiscard]] std::size_t find(const std::string& name) const;
    Given values_;
    std::vector<bool> given_;  // [values_.size()]
};

/// The name among `names` that `wrong` was most likely meant to be: the one of the fewest
/// differing letters, or else the first that begins with it ("near": "near-field"). Empty
/// if none is near.
[[nodiscard]] std::string nearestName(const std::string& wrong,
                                      const std::vector<std::string>& names);

}  // namespace mtsm::baseline
