// temp_folder.h - a folder of its own for a test, gone afterwards.
#pragma once
#include <unistd.h>

#include <filesystem>
#include <string>

namespace mtsm::test {

class TempFolder {
  public:
    TempFolder() {
        namespace fs = std::filesystem;
        const auto base = fs::temp_directory_path();
        for (int i = 0;; ++i) {
            path_ = base / ("mtsm-format-" + std::to_string(::getpid()) + "-" +
                            std::to_string(i));
            if (fs::create_directory(path_)) return;
        }
    }
    ~TempFolder() {
        std::error_code ignored;
        std::filesystem::permissions(path_, std::filesystem::perms::owner_all, ignored);
        std::filesystem::remove_all(path_, ignored);
    }
    TempFolder(const TempFolder&) = delete;
    TempFolder& operator=(const TempFolder&) = delete;

    [[nodiscard]] std::string path() const { return path_.string(); }
    [[nodiscard]] std::string operator/(const std::string& name) const {
        return (path_ / name).string();
    }
    /// Names of all that is in it.
    [[nodiscard]] std::size_t files() const {
        std::size_t n = 0;
        for ([[maybe_unused]] const auto& e : std::filesystem::directory_iterator(path_))
            ++n;
        return n;
    }

  private:
    std::filesystem::path path_;
};

}  // namespace mtsm::test
