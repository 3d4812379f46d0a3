#!/usr/bin/env python3
"""Checks who includes whom: `includes.py SOURCE_DIR` lists what strays and fails if anything does.

The table is the architecture: a module may include the modules listed for it, its own files and
the public headers in mtsm/. Tools and samples include public headers only, but for the tools that
put methods of the baseline to work.
"""
import pathlib
import re
import sys

MAY_INCLUDE = {
    "base": set(),
    "map": {"base"},
    "compress": {"base", "map"},
    "light": {"base"},
    "scene": {"base"},
    "raster": {"base", "map", "scene"},
    "format": {"base", "map", "trace"},
    "trace": {"base", "map"},
    "shadow": {"base", "map", "light", "trace"},
    "bake": {"base", "map", "light", "scene", "raster", "compress"},
    "io": {"base"},
    "baseline": {"base", "map", "light", "trace", "shadow", "scene", "raster"},
}
# Tools that compare methods: they may include headers of baseline.
COMPARES = ("tools/compare/", "tools/mtsm-compare.cpp", "tools/mtsm-radiance.cpp")
# Third-party headers that a module may use, by the start of their path.
HEAVY = {
    "assimp": {"scene"},
    "openvdb": {"baseline", "scene"},
    "OpenImageIO": {"scene"},
    "Imf": {"io"},
    "OpenEXR": {"io"},
    "Imath": {"io"},
    "png.h": {"io"},
    "embree3": {"baseline"},
    "hwy": {"bake", "format", "raster", "shadow", "trace"},
    "zstd": {"format"},
    "xxhash": {"base"},
    "CLI": set(),
    "nlohmann": set(),
    "toml++": set(),
}


def includes(path):
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        found = re.match(r'\s*#\s*include\s+["<]([^">]+)[">]', line)
        if found:
            yield number, found.group(1)


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    strays = []
    for folder in sorted((root / "libmtsm").iterdir()):
        if folder.is_dir() and folder.name != "include" and folder.name not in MAY_INCLUDE:
            strays.append(f"{folder}: the table of modules does not know it")
    for folder in ("libmtsm", "tools", "samples"):
        for path in sorted((root / folder).rglob("*")):
            if path.suffix not in (".h", ".cpp"):
                continue
            for number, name in includes(path):
                if ".." in name.split("/"):
                    strays.append(f"{path}:{number}: {name} leads out of its folder; name it from the root")
    for module, allowed in MAY_INCLUDE.items():
        for path in sorted((root / "libmtsm" / module).rglob("*")):
            if path.suffix not in (".h", ".cpp"):
                continue
            for number, name in includes(path):
                folder = name.split("/")[0] if "/" in name else ""
                if folder in MAY_INCLUDE and folder != module and folder not in allowed:
                    strays.append(f"{path}:{number}: {module} must not include {name}")
                for start, users in HEAVY.items():
                    if name.startswith(start) and module not in users:
                        strays.append(f"{path}:{number}: {module} must not use {name}")
    for folder in ("tools", "samples"):
        for path in sorted((root / folder).rglob("*")):
            if path.suffix not in (".h", ".cpp"):
                continue
            compares = path.relative_to(root).as_posix().startswith(COMPARES)
            for number, name in includes(path):
                if compares and name.startswith("baseline/"):
                    continue
                if "/" in name and name.split("/")[0] in MAY_INCLUDE:
                    strays.append(f"{path}:{number}: {folder} includes public headers only, not {name}")
    for path in sorted((root / "libmtsm/include/mtsm").glob("*.h")):
        for number, name in includes(path):
            if name.split("/")[0] not in ("mtsm", "glm") and not re.fullmatch(r"[a-z_]+", name):
                strays.append(f"{path}:{number}: a public header must not include {name}")
    print("\n".join(strays) if strays else "no include strays")
    return 1 if strays else 0


if __name__ == "__main__":
    sys.exit(main())
