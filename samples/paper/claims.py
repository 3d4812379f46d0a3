#!/usr/bin/env python3
"""Every claim of the papers beside the number found: `claims.py out/paper` reads the results.json
of the scenes there and prints tables as Markdown."""
import json
import pathlib
import sys

SCENES = ["character", "palm", "fur", "giant-13m", "giant-109m"]
PAPER_ERRORS = {"character": (.063, .042, .0044, .005), "palm": (.017, .014, .003, .003),
                "fur": (.016, .05, .005, .002)}  # [Xie07, table 1]: PCF mean, std, MTSM mean, std
PAPER_TIMES = {"character": (57, 207, 273, 18), "palm": (61, 446, 311, 20),
               "fur": (98, 2662, None, 33)}  # [Xie07, table 2]: MSM, geometry, MVSM, PCF
PAPER_BUILD = {"character": 2, "palm": 5, "fur": 15, "giant-13m": 20, "giant-109m": 30}


def number(value, digits=4):
    if value is None:
        return "-"
    text = f"{value:.{digits}f}"
    return text.removeprefix("0") if text.startswith("0.") else text


def ratio(a, b):
    return None if a is None or not b else a / b


def times(value):
    return "-" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"


class Scene:
    def __init__(self, path):
        self.name = path.parent.name
        self.all = json.loads(path.read_text())

    def find(self, method, light, **settings):
        """The run of a method with these settings; default ones elsewhere, if it can choose."""
        found = [r for r in self.all["runs"] if r["method"] == method and r["light"] == light
                 and all(r["settings"].get(k.replace("_", "-")) == v for k, v in settings.items())]
        return min(found, key=lambda r: len(r["label"])) if found else None

    def map(self, light, **settings):
        layers = 5
        asked = {"resolution": 1024, "samples": 256, "layers": layers, "lookup": "trace", **settings}
        if self.name.startswith("giant"):
            asked["resolution"] = settings.get("resolution", 2048)
        return self.find("mtsm", light, **asked)

    def pcf(self, light):
        return self.find("pcf", light, layers=1, filter="zmin") or \
            self.find("deep-pcf", light, filter="zmin")

    @property
    def lights(self):
        return range(len(self.all["lights"]))


def mean(run, kind="image"):
    return run and run["errors"][kind] and run["errors"][kind]["mean"]


def std(run, kind="image"):
    return run and run["errors"][kind] and run["errors"][kind]["deviation"]


def seconds(run, threads="one"):
    return run and run["query"][threads] and run["query"][threads]["median"]


def built(run, threads="all"):
    return run and run["build"][threads] and run["build"][threads]["median"]


def row(*cells):
    print("| " + " | ".join(str(c) for c in cells) + " |")


def head(*cells):
    row(*cells)
    print("|" + "---|" * len(cells))


def errors(scenes):
    print("### Errors (003, table 1)\nMean difference from ray tracing and its standard deviation over "
          "the image; maps of 5 layers, 256 samples; the paper does not give its lights' sizes.\n")
    head("scene", "map, truth's samples", "light", "PCF here", "PCF paper", "RT MTSM here", "RT MTSM paper", "PCF / MTSM")
    for s in scenes:
        paper = PAPER_ERRORS.get(s.name)
        for light in s.lights:
            pcf, own = s.pcf(light), s.map(light)
            truth = s.all["lights"][light]["truth"]["samples"]
            row(s.name, f"{own['settings']['resolution']:.0f}, {truth}" if own else "-",
                s.all["lights"][light]["name"], f"{number(mean(pcf))} ({number(std(pcf))})",
                f"{number(paper[0])} ({number(paper[1])})" if paper else "-",
                f"{number(mean(own))} ({number(std(own))})",
                f"{number(paper[2])} ({number(paper[3])})" if paper else "-",
                times(ratio(mean(pcf), mean(own))))
    print()


def relative_times(scenes):
    print("### Time relative to RT MTSM (003, table 2)\nQuery alone, one thread, 256 samples; in brackets "
          "the paper's ratio. RT geometry is Embree. Accumulated: 256 maps, all threads against all.\n")
    head("scene", "light", "RT MTSM, s", "RT geometry", "RT MVSM", "PCF or deep", "accumulated")
    for s in scenes:
        paper = PAPER_TIMES.get(s.name, (None,) * 4)
        said = [f" ({times(ratio(p, paper[0]))})" if p else "" for p in paper]
        for light in s.lights:
            own = s.map(light)
            others = [s.find("embree", light, mode="fixed", samples=256), s.find("mvsm", light),
                      s.pcf(light)]
            accumulated = s.find("accumulated", light, samples=256)
            row(s.name, s.all["lights"][light]["name"], number(seconds(own), 2),
                *(times(ratio(seconds(o), seconds(own))) + p for o, p in zip(others, said[1:])),
                times(ratio(seconds(accumulated, "all"), seconds(own, "all"))))
    print()


def construction(scenes):
    print("### Construction (003, table 3 and sec. 4.2)\nSeconds with all threads; the paper's in "
          "brackets. 5 layers / 1 and 5 views / 1 layer, opaque maps, one thread: the paper says 1.05 and 5.\n")
    head("scene", "shaded points", "triangles", "map", "5 layers / 1 layer", "5 views / 1 layer",
         "Embree's tree", "memory: map, Embree (MB)")
    for s in scenes:
        own, one, five = s.map(0), s.find("slsm", 0), s.find("mlsm", 0)
        embree = s.find("embree", 0, mode="fixed", samples=256)
        triangles = s.all["scene"]["triangles"] + 2 * s.all["scene"]["segments"]
        memory = [f"{1e-6 * r['build']['memoryBytes']:.0f}" if r else "-" for r in (own, embree)]
        row(s.name, s.all["scene"]["points"], triangles,
            f"{number(built(own), 2)} ({PAPER_BUILD[s.name]})",
            times(ratio(built(five, "one"), built(one, "one"))),
            times(ratio(built(s.find("mvsm", 0), "one"), built(one, "one"))),
            number(built(embree), 2), ", ".join(memory))
    print()


def radius(scenes):
    print("### Error against light radius (003, figure 4)\nMean over the image.\n")
    head("scene", "method", "small", "medium", "large")
    for s in scenes:
        for name, pick in [
                ("PCF, z_min", s.pcf),
                ("PCF, z_min, 5 layers", lambda l, s=s: s.find("pcf", l, layers=5, filter="zmin")),
                ("PCF, blocker search",
                 lambda l, s=s: s.find("pcf", l, layers=1, filter="blocker") or
                 s.find("deep-pcf", l, filter="blocker")),
                ("single layer, traced", lambda l, s=s: s.find("slsm", l)),
                ("multi-view", lambda l, s=s: s.find("mvsm", l)),
                ("RT MTSM", s.map),
                ("MTSM, filtered", lambda l, s=s: s.find("mtsm", l, lookup="pcf")),
                ("single sample", lambda l, s=s: s.find("single-sample", l, hard=False)),
                ("distance field", lambda l, s=s: s.find("sdf", l))]:
            runs = [pick(light) for light in s.lights]
            if any(runs):
                row(s.name, name, *(number(mean(r)) for r in runs))
    print()


def resolution(scenes):
    print("### Cost against resolution (003, sec. 8: logarithmic)\nQuery time of the traced map relative to "
          "1024 x 1024, 256 samples.\n")
    head("scene", "light", "512", "1024", "2048", "4096")
    for s in scenes:
        samples = 256 if s.map(0, resolution=512) else 64
        for light in s.lights:
            layers = 5 if s.map(light, resolution=512) else 0
            runs = [s.map(light, resolution=r, samples=samples, layers=layers)
                    for r in (512, 1024, 2048, 4096)]
            if any(runs):
                row(s.name, s.all["lights"][light]["name"],
                    *(times(ratio(seconds(r), seconds(runs[1]))) for r in runs))
    print()


def others(scenes):
    print("### The older papers (000, 001, 004)\n")
    head("scene", "light", "single sample: soft / hard time (000: 1.2)", "its error",
         "radiance textures, floor: 2 x 2, 4 x 4, 16 x 16 (001)", "distance field: bias (004: too dark)")
    for s in scenes:
        for light in s.lights:
            soft = s.find("single-sample", light, hard=False)
            if not soft:
                continue
            hard = s.find("single-sample", light, hard=True)
            grids = [s.find("radiance", light, samples=n) for n in (2, 4, 16)]
            field = s.find("sdf", light)
            bias = field and field["errors"]["image"] and field["errors"]["image"]["bias"]
            row(s.name, s.all["lights"][light]["name"], times(ratio(seconds(soft), seconds(hard))),
                number(mean(soft)), ", ".join(number(mean(g)) for g in grids),
                "-" if bias is None else f"{bias:+.4f}")
    print()


def equal_error(scenes):
    print("### Equal error\nTime of Embree's cheapest mode over that of the cheapest map at the same mean "
          "error over the image, one thread: above 1 the map is ahead. First frame: build included. "
          "\"no\": one side does not reach it.\n")
    head("scene", "light", *(f"{e}: further, first frame" for e in (.02, .01, .005, .002)))
    for s in scenes:
        for light in s.lights:
            cells = []
            for target in s.all["targets"]:
                if target["light"] != light:
                    continue
                best = {c["method"]: c for c in target["cheapest"]}
                if "mtsm" not in best or "embree" not in best:
                    missing = [m for m in ("mtsm", "embree") if m not in best]
                    cells.append("no: " + " and ".join("map" if m == "mtsm" else "Embree" for m in missing))
                    continue
                own, rival = best["mtsm"], best["embree"]
                cells.append(f"{times(ratio(rival['seconds'], own['seconds']))}, "
                             f"{times(ratio(rival['firstFrameSeconds'], own['firstFrameSeconds']))}")
            row(s.name, s.all["lights"][light]["name"], *cells)
    print()


def load(folder, suffix):
    found = []
    for name in SCENES:
        path = folder / (name + suffix) / "results.json"
        if path.exists():
            found.append(Scene(path))
            found[-1].name = name
    return found


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "out/paper")
    suffix = sys.argv[2] if len(sys.argv) > 2 else ""
    scenes = load(folder, suffix)
    if not scenes:
        sys.exit(f"claims.py: no results.json in {folder}/SCENE{suffix}; run samples/paper/run.sh first")
    machine = scenes[0].all["machine"]
    print(f"{machine['processor']}, {machine['threads']} threads, {machine['software']}"
          f"{'; scenes' + suffix if suffix else ''}\n")
    if suffix != "-16":
        for table in (errors, relative_times, construction, radius, resolution, others):
            table(scenes)
    equal_error(scenes)


if __name__ == "__main__":
    main()
