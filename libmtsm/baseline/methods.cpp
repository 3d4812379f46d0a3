#include "baseline/methods.h"

#include "base/message.h"
#include "base/printable.h"

namespace mtsm::baseline {

const std::vector<MethodInfo>& methods() {
    static const std::vector<MethodInfo> all = {
        embreeMethod(),        //
        mtsmMethod(),          //
        slsmMethod(),          //
        mlsmMethod(),          //
        mvsmMethod(),          //
        pcfMethod(),           //
        deepPcfMethod(),       //
        accumulatedMethod(),   //
        radianceMethod(),      //
        singleSampleMethod(),  //
        sdfMethod(),           //
    };
    return all;
}

Result<const MethodInfo*> findMethod(const std::string& name) {
    std::vector<std::string> names;
    std::string list;
    for (const MethodInfo& info : methods()) {
        if (info.name == name) return &info;
        names.push_back(info.name);
        list += (list.empty() ? "" : ", ") + info.name;
    }
    const std::string meant = nearestName(name, names);
    return base::makeError(
        ErrorCode::badArgument, "there is no method \"", base::printable(name), "\"",
        meant.empty() ? "; there are " : "; did you mean \"" + meant + "\"? There are ",
        list);
}

}  // namespace mtsm::baseline
