// shadow_at_point - the smallest program that uses a map: how dark is it at one point?
//
//     shadow_at_point key.mtsm 0 0 0
#include <cstdio>
#include <cstdlib>

#include "mtsm/reader.h"
#include "mtsm/shadow.h"

int main(int argc, char** argv) {
    if (argc != 5) {
        std::fprintf(
            stderr,
            "usage: shadow_at_point MAP X Y Z\n"
            "Prints the shadow factor at a point of world space: 0 lit, 1 dark.\n"
            "Example: shadow_at_point key.mtsm 0 0 0\n"
            "Exit codes: 0 good, 2 usage, 3 input failed, 4 bad file, 5 "
            "unsupported.\n");
        return 2;
    }
    const auto map = mtsm::readMap(argv[1]);
    if (!map) {
        std::fprintf(stderr, "shadow_at_point: %s\n", map.error().message.c_str());
        return mtsm::exitCode(map.error().code);
    }
    const glm::dvec3 point(std::atof(argv[2]), std::atof(argv[3]), std::atof(argv[4]));
    std::printf("%g\n", mtsm::shadowFactor(*map, map->info().light, point));
    return 0;
}
