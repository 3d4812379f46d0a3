// make_report RESULTS_JSON FOLDER: the page of results, on stdout. For report_test.py.
#include <cstdio>
#include <fstream>

#include "compare/report.h"

int main(int argc, char** argv) {
    if (argc != 3) return 2;
    std::ifstream in(argv[1]);
    const auto results = nlohmann::ordered_json::parse(in, nullptr, false);
    if (results.is_discarded()) return 2;
    const auto page = mtsm::tools::makeReport(results, argv[2]);
    if (!page) {
        std::fprintf(stderr, "%s\n", page.error().message.c_str());
        return mtsm::exitCode(page.error().code);
    }
    return std::fwrite(page->data(), 1, page->size(), stdout) == page->size() ? 0 : 3;
}
