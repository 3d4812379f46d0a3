#!/usr/bin/env python3
"""Is the map ahead of Embree? `bench.py out/paper [-quick]` reads the results.json that
samples/paper/bench.sh has left there and prints tables as Markdown."""
import pathlib
import sys

from claims import PAPER_ERRORS, Scene, head, mean, number, ratio, row, seconds, std, times

SCENES = ["character", "bumpy", "mesh", "palm", "fur", "cards", "smoke", "giant-13m", "giant-109m"]
SIZES = ("small", "medium", "large")
# What the map is to reach, for a small, a medium and a large light: how many times Embree's rate ...
GOALS_SAMPLES = {"character": (15, 12, 10), "palm": (12, 10, 10), "fur": (80, 40, 40)}
# ... and the same at a mean error of .005.
GOALS_ERROR = {"character": (1.5, 2, 3), "bumpy": (1.5, 2, 3), "mesh": (1.5, 2, 3), "palm": (1.5, 2, 3),
               "fur": (8, 8, 8), "cards": (3, 3, 3), "smoke": (1.5, 1.5, 1.5)}
RESOLUTIONS = (512, 1024, 2048, 4096, 8192)


class BenchScene(Scene):
    def __init__(self, path, name):
        super().__init__(path)
        self.name = name
        self.near = "512M" if name.startswith("giant") else "auto"

    def map(self, light, **settings):
        """Of the sweep for equal error; no cap on layers."""
        if self.name.startswith("giant"):
            settings.setdefault("resolution", 2048)
        return self.find("mtsm", light, **{"resolution": 1024, "near-field": "none", "layers": 0,
                                        "adaptive": "false", **settings})

    def light(self, light):
        return f"{SIZES[light] if light < len(SIZES) else light + 1}, {self.all['lights'][light]['name']}"


def goal(goals, scene, light):
    return f"{goals[scene][light]:g}" if scene in goals and light < len(SIZES) else "-"


def equal_samples(scenes):
    print("## Equal samples\n256 samples a point, 1024 x 1024 (giants 2048 x 2048), one thread: time of "
          "Embree's faster mode of that number, every point alone or stratified over a pixel, over the "
          "map's. Above 1 the map is ahead. It says nothing of errors.\n")
    head("scene", "light", "Embree, s", "map without near field", "map with it", "goal",
         "Embree adaptive, 16 to 256 samples, over the map without")
    for s in scenes:
        for light in s.lights:
            modes = [s.find("embree", light, mode=m, samples=256) for m in ("fixed", "pixel")]
            embree = min((seconds(r) for r in modes if seconds(r)), default=None)
            own = [seconds(s.map(light, samples=256, **{"near-field": n})) for n in ("none", s.near)]
            adaptive = seconds(s.find("embree", light, mode="adaptive", samples=16, most=256))
            row(s.name, s.light(light), number(embree, 2), *(times(ratio(embree, o)) for o in own),
                goal(GOALS_SAMPLES, s.name, light), times(ratio(adaptive, own[0])))
    print()


def compared(target, key):
    """Embree's time over the map's, or who does not reach the error."""
    best = {c["method"]: c for c in target["cheapest"]}
    own, rival = best.get("mtsm"), best.get("embree")
    if own and rival:
        return times(ratio(rival[key], own[key])) if own[key] and rival[key] else "-"
    return "map only" if own else "Embree only" if rival else "neither"


def winner(target, method, key):
    best = {c["method"]: c for c in target["cheapest"]}
    label = best[method][key] if method in best else None
    if not label:
        return "-"
    for word in (method + " ", "resolution=", " near-field=none", "mode="):
        label = label.replace(word, "")
    return label.replace("adaptive=true", "adaptive").replace("near-field=auto", "near").replace("near-field=512M", "near").replace("samples=", "x").replace("most=", "to ")


def targets(scene, light):
    return [t for t in scene.all["targets"] if t["light"] == light]


def summary(scenes):
    errors = [t["error"] for t in targets(scenes[0], 0)]
    head("scene", "light", *(number(e) for e in errors), "goal at .005")
    for s in scenes:
        for light in s.lights:
            row(s.name, s.light(light), *(f"{compared(t, 'seconds')}, {compared(t, 'firstFrameSeconds')}"
                                          if compared(t, "seconds")[0].isdigit() else compared(t, "seconds")
                                          for t in targets(s, light)), goal(GOALS_ERROR, s.name, light))
    print()


def winners(scenes):
    print("What was the cheapest: resolution and samples of the map (\"near\": with near field), mode and "
          "samples of Embree; first frame where it is another.\n")
    head("scene", "light", "error", "map", "Embree", "map, first frame", "Embree, first frame")

    def first(target, method):
        further, other = (winner(target, method, k) for k in ("label", "firstFrameLabel"))
        return "same" if other == further != "-" else other

    for s in scenes:
        for light in s.lights:
            for t in targets(s, light):
                if t["cheapest"]:
                    row(s.name, s.light(light), number(t["error"]), winner(t, "mtsm", "label"),
                        winner(t, "embree", "label"), first(t, "mtsm"), first(t, "embree"))
    print()


def equal_error(scenes, points):
    if not scenes:
        return
    print(f"## Equal error, {points}\nTime of Embree's cheapest mode over that of the cheapest map with at "
          "most this mean error over the image, one thread: above 1 the map is ahead. First number: a "
          "further picture; second: the first one, building included.\n")
    summary(scenes)
    winners(scenes)


def errors(scenes):
    print("## Errors at the paper's settings\nMean difference from ray tracing over the image and its "
          "standard deviation; 1024 x 1024 (giants 2048 x 2048), 5 layers, 256 samples. Paper: table 1 of "
          "003, which does not give its lights' sizes.\n")
    head("scene", "light", "without near field", "with it", "paper", "without a cap on layers")
    for s in scenes:
        for light in s.lights:
            runs = [s.map(light, layers=5, samples=256, **{"near-field": n}) for n in ("none", s.near)]
            runs.append(s.map(light, samples=256))
            said = [f"{number(mean(r))} ({number(std(r))})" if r else "-" for r in runs]
            paper = PAPER_ERRORS.get(s.name)
            row(s.name, s.light(light), said[0], said[1],
                f"{number(paper[2])} ({number(paper[3])})" if paper else "-", said[2])
    print()


def cost(scenes):
    print("## Cost against resolution and light\nTime of a picture, 64 samples a point, no near field, one "
          "thread, relative to 512 x 512. Last columns: mean growth with each doubling (of all, and from "
          "1024 on), and time at 1024 x 1024 relative to the smallest light's.\n")
    head("scene", "light", *RESOLUTIONS, "growth", "from 1024 on", "light")
    for s in scenes:
        for light in s.lights:
            runs = {r: seconds(s.map(light, resolution=r, samples=64)) for r in RESOLUTIONS}
            there = [r for r in RESOLUTIONS if runs[r]]
            if len(there) < 2:
                continue

            def growth(known):
                return (runs[known[-1]] / runs[known[0]]) ** (1 / (len(known) - 1)) if len(known) > 1 else None

            row(s.name, s.light(light), *(times(ratio(runs[r], runs[there[0]])) for r in RESOLUTIONS),
                times(growth(there)), times(growth(there[1:])),
                times(ratio(runs[1024], seconds(s.map(0, samples=64)))))
    print()


def memory(scenes):
    print("## Memory while querying\nMB at 1024 x 1024 (giants 2048 x 2048), medium light: layers, near field "
          "and what queries build from them; Embree's own structures and the geometry that they refer to. "
          "In brackets how many times less than Embree; the goal is 10 without near field, 5 with it.\n")
    head("scene", "Embree", "map without near field", "with it", "5 layers, without", "5 layers, with it")
    for s in scenes:
        light = min(1, len(s.lights) - 1)

        def bytes_of(run):
            return run and run["build"]["memoryBytes"]

        embree = bytes_of(s.find("embree", light, mode="fixed", samples=256))
        own = [bytes_of(s.map(light, layers=layers, samples=256, **{"near-field": n}))
               for layers in (0, 5) for n in ("none", s.near)]
        row(s.name, f"{1e-6 * embree:.1f}" if embree else "-",
            *(f"{1e-6 * o:.1f} ({times(ratio(embree, o))})" if o else "-" for o in own))
    print()


def load(folder, suffix):
    paths = [(name, folder / f"bench-{name}{suffix}" / "results.json") for name in SCENES]
    return [BenchScene(path, name) for name, path in paths if path.exists()]


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "out/paper")
    quick = sys.argv[2] if len(sys.argv) > 2 else ""
    scenes, pixels = load(folder, quick), load(folder, "-16" + quick)
    if not scenes:
        sys.exit(f"bench.py: no results.json in {folder}/bench-SCENE{quick}; run samples/paper/bench.sh first")
    machine = scenes[0].all["machine"]
    print(f"# Ahead of Embree?\n{machine['processor']}, {machine['software']}; one thread"
          f"{'; few settings, each timed three times' if quick else ''}.\n")
    equal_samples(scenes)
    equal_error(scenes, "one point a pixel")
    equal_error(pixels, "16 points a pixel")
    for table in (errors, cost, memory):
        table(scenes)


if __name__ == "__main__":
    main()
