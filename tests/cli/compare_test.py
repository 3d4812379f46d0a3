#!/usr/bin/env python3
"""mtsm-compare as a user meets it: `compare_test.py MTSM_COMPARE MTSM_BAKE MTSM_QUERY [unittest arguments]`.

The scene is a square of side 2, one unit above the ground, on a leg that stands on it. Pictures are tiny:
what the methods answer is tested in the library.
"""
import csv
import json
import math
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time
import unittest

import cli_test
from cli_test import TOOLS, as_nobody, read_exr, read_png, run, write_exr

TABLE = """v -1 1 -1
v 1 1 -1
v 1 1 1
v -1 1 1
v -0.1 0 0
v 0.1 0 0
v 0 1 0
f 1 2 3 4
f 5 6 7
"""
LIGHT = ["--light-radius", "0.4", "--light-position", "1,4,0"]
SMALL = ["--image", "40x20", "--truth", 64, "--measured-pixels", 64, "--repeats", 1]
OPTIONS = """--folder --cache --no-cache --no-pictures --light-shape --light-position --light-target
             --light-direction --light-up --light-radius --light-size --light-angle --light-name --projection
             --fov --near --far --cull --light-scales --camera-position --camera-target --camera-up
             --camera-fov --image --points --pixels --position-pass --normal-pass --method --list-methods
             --truth --measured-pixels --repeats --targets --error --recommend --threads --quiet --json
             --version --help"""
JOB = """[light]
radius = 0.4
position = [1, 4, 0]

[compare]
light-scales = [0.5, 1]
targets = [0.1]
{compare}
[camera]
position = [2, 3, 6]
target = [0, 0.5, 0]
fov = 40
{camera}
[[caster]]
file = "table.obj"
{more}
"""
METHOD = """[[method]]
name = "mtsm"
resolution = [64, 128]
samples = [4, 64]
"""
FLOOR = """[[receiver]]
floor = true
"""


def job(more=FLOOR + METHOD, camera="", compare=""):
    text = JOB.format(more=more, camera=camera, compare=compare)
    pathlib.Path("shot.toml").write_text(text)
    return text


class Compare(cli_test.ToolTest):
    def setUp(self):
        super().setUp()
        os.remove("scene.obj")
        pathlib.Path("table.obj").write_text(TABLE)

    def compare(self, *arguments, inputs=("table.obj",), light=LIGHT, folder="out", without=(), **more):
        """`arguments` take the place of those of SMALL."""
        known = {*arguments, *without}
        small = [(o, v) for o, v in zip(SMALL[::2], SMALL[1::2]) if o not in known]
        return run("compare", *inputs, *light, *[x for pair in small for x in pair], "--quiet", "-o", folder,
                   *arguments, **more)

    def of_job(self, *arguments, **more):
        keys = re.findall(r"(?m)^([\w-]+) =", pathlib.Path("shot.toml").read_text())
        own = ["--" + key for key in keys]
        return self.compare(*arguments, inputs=["shot.toml"], light=[], without=own, **more)

    def results(self, folder="out"):
        return json.loads(pathlib.Path(folder, "results.json").read_text())

    def has(self, method):
        return method in TOOLS["methods"]

    def needs(self, method):
        if not self.has(method):
            self.skipTest(f"there is no method {method}")

    def nothing_came_out(self, folder="out"):
        """No result, and no temporary either."""
        left = [n for _, _, names in os.walk(folder) for n in names if not n.endswith((".values", ".json"))]
        self.assertEqual(left, [])
        self.assertFalse(pathlib.Path(folder, "results.json").exists())


class Help(Compare):
    def test_help_mentions_every_option_and_the_exit_codes(self):
        text = self.good(run("compare", "--help")).stdout
        for option in OPTIONS.split():
            self.assertRegex(text, rf"(?<![\w-]){option}(?![\w-])")
        self.assertIn("Examples:", text)
        self.assertIn("Exit codes: 0 good", text)
        self.assertLessEqual(max(map(len, text.splitlines())), 100)
        self.assertRegex(self.good(run("compare", "--version")).stdout, r"^mtsm-compare \d+\.\d+\.\d+\n$")

    def test_methods_are_listed_with_their_settings(self):
        text = self.good(run("compare", "--list-methods")).stdout
        self.assertRegex(text, r"(?m)^mtsm: .*\[Xie07\]$")
        self.assertRegex(text, r"(?m)^  resolution = 1024  \(1 to 32768\)  pixels")
        self.assertRegex(text, r"(?m)^  lookup = trace  \(trace, scalar, pcf\)")
        # By the name that mtsm-bake has for it.
        self.assertRegex(text, r"(?m)^  near-field = auto  \(auto, none, or bytes such as 32M\)")


class CommandLine(Compare):
    def test_what_makes_maps_of_other_casters_than_the_truth_has_is_told(self):
        for option in (["--near", "0.5"], ["--far", "20"], ["--cull", "back"]):
            done = self.good(self.compare(*option, "--method", "embree"))
            self.assertIn("warning: near, far and cull leave casters out of maps alone", done.stderr)
        self.assertNotIn("near, far and cull", self.good(self.compare("--method", "embree")).stderr)

    def test_casters_stand_on_a_floor_and_everything_is_written(self):
        done = self.good(self.compare("--method", "mtsm", "--truth", 1024))
        j = self.results()
        self.assertEqual((j["format"], j["version"]), ("mtsm-compare", 1))
        self.assertEqual(j["scene"]["triangles"], 3)
        self.assertEqual(j["scene"]["image"], [40, 20])
        self.assertTrue(50 < j["scene"]["objectPixels"] < 400, j["scene"])
        self.assertEqual(j["scene"]["measuredPixels"], 64)
        self.assertEqual([light["radius"] for light in j["lights"]], [0.4])
        self.assertEqual(j["lights"][0]["truth"]["samples"], 1024)
        self.assertEqual(j["failed"], [])
        self.assertEqual({m["name"] for m in j["methods"]}, {"mtsm"})
        for r in j["runs"]:
            self.assertEqual(r["unanswered"], 0)
            for threads in ("one", "all"):
                for what in ("build", "query"):
                    t = r[what][threads]
                    self.assertTrue(0 < t["least"] <= t["median"] <= t["most"], t)
            for e in r["errors"].values():
                self.assertTrue(0 <= e["p95"] <= e["p99"] <= e["largest"] <= 1, e)
                self.assertLessEqual(abs(e["bias"]), e["mean"] + 1e-12)
            # A lit cosine is at most 1.
            for kind in ("image", "object"):
                self.assertLessEqual(r["errors"][kind + "Cosine"]["mean"], r["errors"][kind]["mean"])
        best = min(r["errors"]["image"]["mean"] for r in j["runs"])
        self.assertLess(best, 0.003)
        self.assertIn("mtsm", done.stdout)
        for r in j["runs"]:
            self.assertIn(r["label"], done.stdout)
        # One row a run, and the same numbers.
        with open("out/results.csv", newline="") as table:
            rows = list(csv.DictReader(table))
        self.assertEqual([row["label"] for row in rows], [r["label"] for r in j["runs"]])
        for row, r in zip(rows, j["runs"]):
            self.assertEqual(float(row["query_one"]), r["query"]["one"]["median"])
            self.assertEqual(float(row["image_mean"]), r["errors"]["image"]["mean"])
            self.assertEqual(float(row["objectCosine_p99"]), r["errors"]["objectCosine"]["p99"])
            self.assertEqual(int(row["memory"]), r["build"]["memoryBytes"])
        # Pictures: what the numbers were taken from.
        truth = read_exr("out/truth-1.exr")[2]["shadow"]
        shown = [i for i, t in enumerate(truth) if not math.isnan(t)]
        self.assertEqual(j["scene"]["pixels"], len(shown))
        self.assertEqual(read_png("out/" + j["lights"][0]["truth"]["image"])[:2], (40, 20))
        self.assertTrue(0.02 < sum(truth[i] for i in shown) / len(shown) < 0.6)
        for r in j["runs"]:
            self.assertEqual(read_png("out/" + r["image"])[:2], (40, 20))
            self.assertEqual(read_png("out/" + r["difference"])[:2], (40, 20))
            _, _, c = read_exr(f"out/{r['id']}.exr")
            differences = [c["difference"][i] for i in shown]
            for i, d in zip(shown, differences):
                self.assertAlmostEqual(c["shadow"][i] - truth[i], d, places=6)
            mean = sum(map(abs, differences)) / len(shown)
            self.assertAlmostEqual(mean, r["errors"]["image"]["mean"], places=6)
            self.assertAlmostEqual(sum(differences) / len(shown), r["errors"]["image"]["bias"], places=6)
        page = pathlib.Path("out/report.html").read_text()
        self.assertIn("data:image/png;base64", page)
        self.assertEqual(sorted(n for n in os.listdir("out") if "." not in n), ["cache"])

    def test_json_is_what_is_written_and_no_pictures_are_made_unasked(self):
        job()
        done = self.good(self.of_job("--json", "--no-pictures", "--no-cache"))
        self.assertEqual(json.loads(done.stdout), self.results())
        self.assertEqual(sorted(os.listdir("out")), ["results.csv", "results.json"])

    def test_ray_tracing_s_error_falls_with_its_samples(self):
        self.needs("embree")
        self.good(self.compare("--method", "embree", "--truth", 1024, "--no-pictures"))
        fixed = [r for r in self.results()["runs"] if r["settings"]["mode"] == "fixed"]
        errors = [r["errors"]["image"]["mean"]
                  for r in sorted(fixed, key=lambda r: r["settings"]["samples"])]
        self.assertEqual(len(errors), 7)
        for more, less in zip(errors[1:], errors):
            self.assertLess(more, less)
        self.assertLess(errors[-1], errors[0] / 8)

    def test_a_light_that_is_scaled_is_compared_at_each_size(self):
        job()
        self.good(self.of_job("--light-scales", "0,0.5,2", "--no-pictures"))
        j = self.results()
        self.assertEqual([l["radius"] for l in j["lights"]], [0, 0.2, 0.8])
        self.assertEqual({r["light"] for r in j["runs"]}, {0, 1, 2})

    def test_some_pixels_of_a_picture_and_several_points_of_each(self):
        job()
        self.good(self.of_job("--points", 4, "--pixels", 128))
        scene = self.results()["scene"]
        self.assertEqual((scene["comparedPixels"], scene["pointsPerPixel"]), (128, 4))
        self.assertTrue(128 < scene["pixels"] <= 800, scene)
        self.assertTrue(3 * scene["pixels"] < scene["points"] <= 4 * scene["pixels"], scene)
        truth = read_exr("out/truth-1.exr")[2]["shadow"]
        self.assertEqual(sum(not math.isnan(t) for t in truth), 128)

    def test_few_pixels_are_told_to_be_a_matter_of_luck(self):
        job()
        said = r"\nmeans are of (\d+) of \d+ pixels: by chance they are off by about (.*) of themselves " \
               r"\(standard error\)(?:; for 10 % (?:take all: --pixels 0|take --pixels (\d+)))?\n$"
        for pixels, compared in ((70, 64), (320, 320)):
            done = self.good(self.of_job("--pixels", pixels, "--no-pictures"))
            found = re.search(said, done.stdout)
            self.assertTrue(found, done.stdout)
            self.assertEqual(int(found[1]), compared)
            errors = [r["standardError"] for r in self.results()["runs"]]
            if compared == 64:  # one run of neighbours
                self.assertEqual(found[2], "an unknown part")
                self.assertEqual(set(errors), {None})
            else:
                self.assertRegex(found[2], r"^\d+ %$")
                self.assertGreater(min(errors), 0)
        done = self.good(self.of_job("--no-pictures"))
        self.assertNotIn("by chance", done.stdout)
        self.assertEqual({r["standardError"] for r in self.results()["runs"]}, {0})

    def test_only_what_a_caster_shows_may_count(self):
        job()
        self.good(self.of_job("--error", "object", "--no-pictures"))
        j = self.results()
        self.assertEqual(j["errorKind"], "object")
        # Where no pixel shows one, nothing is best by having no error.
        done = self.good(self.of_job(
            "--error", "object", "--no-pictures", "--camera-position", "0.6,0.5,-1.4",
            "--camera-target", "0.6,0,-1.5", "--camera-fov", 20, "--recommend", "error=0.5", folder="floor"))
        j = self.results("floor")
        self.assertEqual(j["scene"]["objectPixels"], 0)
        self.assertEqual([t["cheapest"] for t in j["targets"]], [[], []])
        self.assertEqual(j["equalError"], [])
        self.assertIn("none of what was compared meets it", done.stderr)


class Recommended(Compare):
    def follow(self, done):
        """Runs the lines that were recommended; the shadow factors that come out."""
        lines = re.findall(r"(?m)^  (mtsm-(?:bake|query) .*)$", done.stderr)
        self.assertEqual([line.split()[0] for line in lines], ["mtsm-bake", "mtsm-query"], done.stderr)
        os.mkdir("bin")
        for tool in ("bake", "query"):
            os.symlink(TOOLS[tool], f"bin/mtsm-{tool}")
        for line in lines:
            made = subprocess.run(line, shell=True, capture_output=True, text=True,
                                  env={**os.environ, "PATH": os.path.abspath("bin") + ":" + os.environ["PATH"]})
            self.assertEqual(made.returncode, 0, line + "\n" + made.stderr)
        return read_exr("shadow.exr")[2]["shadow"]

    def pass_of_floor(self):
        """Points on the floor below, 40 x 20, with normals."""
        xs = [-3 + 6 * (x + 0.5) / 40 for _ in range(20) for x in range(40)]
        zs = [-1.5 + 3 * (y + 0.5) / 20 for y in range(20) for _ in range(40)]
        zero, one = [0.0] * 800, [1.0] * 800
        write_exr("floor P.exr", 40, 20, {"P.X": xs, "P.Y": zero, "P.Z": zs})
        write_exr("N.exr", 40, 20, {"N.X": zero, "N.Y": one, "N.Z": zero})
        return ["--position-pass", "floor P.exr", "--normal-pass", "N.exr"]

    def check_followed(self, done, light=1):
        shadow = self.follow(done)
        truth = read_exr(f"out/truth-{light}.exr")[2]["shadow"]
        self.assertGreater(max(truth), 0.9)
        self.assertLess(sum(abs(s - t) for s, t in zip(shadow, truth)) / 800, 0.011)

    def small_pass(self, *arguments, **more):
        return run("compare", *arguments, *SMALL[2:], "--quiet", "-o", "out", **more)

    def test_lines_for_an_error_work_from_casters(self):
        os.rename("table.obj", "my table's.obj")
        self.check_followed(self.good(self.small_pass(
            "my table's.obj", *LIGHT, *self.pass_of_floor(), "--method", "mtsm", "--recommend", "error=0.01")))

    def test_lines_for_a_time_work_from_a_scene_file(self):
        job()
        done = self.good(self.small_pass("shot.toml", *self.pass_of_floor(), "--light-scales", "0.7",
                                         "--recommend", "time=10min"))
        self.check_followed(done)

    def test_a_time_gets_the_most_accurate_map_within_it(self):
        job()
        done = self.good(self.of_job("--recommend", "time=10min", "--no-pictures"))
        least = {}
        for r in self.results()["runs"]:
            mean = r["errors"]["image"]["mean"]
            least[r["light"]] = min(least.get(r["light"], 1.0), mean)
        said = [float(m) for m in re.findall(r"^  .*: mean error ([0-9.e-]+)", done.stderr, re.M)]
        self.assertEqual(len(said), len(least))
        for found, light in zip(said, sorted(least)):
            self.assertAlmostEqual(found, least[light], delta=1e-5 + 1e-4 * least[light])

    def test_what_nothing_meets_is_told_with_the_nearest(self):
        job()
        done = self.good(self.of_job("--recommend", "time=0.000001ms", "--no-pictures"))
        self.assertIn("none of what was compared meets it; nearest: mtsm", done.stderr)
        self.assertNotIn("mtsm-bake", done.stderr)

    def test_wishes_that_are_none(self):
        for wish in ("0.005", "error=", "error=0", "error=-1", "error=nan", "error=1s", "time=2", "time=2h",
                     "time=1e999s", "speed=1", ""):
            self.fails(self.compare("--recommend", wish), 2, "--recommend")
        self.assertFalse(os.path.exists("out"))


class Chosen(Compare):
    def test_rows_that_choose_say_what_and_whether_it_was_enough(self):
        job(more=FLOOR + '[[method]]\nname = "mtsm"\ntarget-error = [0.1, 0.0002]\n')
        done = self.good(self.of_job("--light-scales", "1", "--no-pictures", "--truth", 256))
        runs = self.results()["runs"]
        # Samples are chosen: the row does not claim those of the default.
        self.assertEqual([r["label"] for r in runs], ["mtsm target-error=0.1", "mtsm target-error=2e-04"])
        easy, hard = (r["choice"] for r in runs)
        self.assertRegex(easy["text"], r"^resolution 512, (\d+ to )?\d+ samples$")
        self.assertEqual((easy["target"], easy["met"], hard["met"]), (0.1, True, False))
        self.assertLess(easy["expected"], 0.1)
        self.assertGreater(hard["expected"], 0.0002)
        self.assertIn(easy["text"] + ", expects an error of", done.stdout)
        self.assertIn(": target met", done.stdout)
        self.assertIn(": TARGET MISSED", done.stdout)
        warnings = [line for line in done.stderr.splitlines() if "more than was asked for" in line]
        self.assertEqual(len(warnings), 1, done.stderr)
        self.assertIn("mtsm target-error=2e-04: expects to be off by about", warnings[0])
        again = self.good(self.of_job("--light-scales", "1", "--no-pictures", "--truth", 256))
        self.assertEqual(again.stdout, done.stdout)
        self.assertEqual(again.stderr, done.stderr)
        job()
        self.good(self.of_job("--no-pictures", folder="given"))
        self.assertEqual({r["choice"] for r in self.results("given")["runs"]}, {None})


    def labels_and_choices(self, rows, map="", *arguments):
        job(more=FLOOR + map + rows)
        shutil.rmtree("out", ignore_errors=True)
        done = self.good(self.of_job("--light-scales", "1", "--no-pictures", *arguments))
        self.runs = self.results()["runs"]
        return done, [(r["label"], (r["choice"] or {}).get("text")) for r in self.runs]

    def test_what_is_given_beside_a_target_stays(self):
        rows = """[[method]]
            name = "mtsm"
            target-error = 0.1
            resolution = [64, 1024]
            near-field = "none"
            samples = 4
            adaptive = "true"
            [[method]]
            name = "mtsm"
            quality = "draft"
            """
        _, found = self.labels_and_choices(rows)
        # adaptive has no meaning beside a target, as in mtsm-query, and the label does not claim it.
        self.assertEqual(found[:2], [
            (f"mtsm resolution={n} near-field=none target-error=0.1 samples=4", f"resolution {n}, 4 samples")
            for n in (64, 1024)])
        self.assertEqual(found[2][0], "mtsm target-error=0.02")
        self.assertRegex(found[2][1], "^resolution 512, ")
        self.assertEqual([r["settings"]["near-field"] for r in self.runs], ["none", "none", "auto"])
        self.assertEqual(self.runs[0]["given"], ["resolution", "near-field", "target-error", "samples"])
        # Without a near field the map expects more of an error.
        self.assertGreater(self.runs[0]["choice"]["expected"], self.runs[2]["choice"]["expected"])
        # As mtsm-bake and mtsm-query do.
        done = self.good(run("bake", "shot.toml", "--target-error", 0.1, "--resolution", 64, "--near-field", "none",
                             "-o", "key.mtsm", "--json"))
        self.assertEqual(json.loads(done.stdout)["width"], 64)
        # A row that says 1024 is not the one that chooses, in the cache neither.
        _, given = self.labels_and_choices('[[method]]\nname = "mtsm"\ntarget-error = 0.1\nresolution = 1024\n', "",
                                           "--cache", "kept")
        _, chosen = self.labels_and_choices('[[method]]\nname = "mtsm"\ntarget-error = 0.1\n', "", "--cache", "kept")
        self.assertIn("resolution 1024", given[0][1])
        self.assertIn("resolution 512", chosen[0][1])

    def test_what_excludes_a_target_is_refused(self):
        for text, *words in (
                ('target-error = 0.1\nlookup = "pcf"', "lookup: found pcf beside target-error", "leave one of them out"),
                ('target-error = 0.1\nquality = "draft"', "quality is a target-error by name"),
                ('quality = "best"', "quality: found best, expected draft, preview or final"),
                ('quality = 0.1', "quality: found 0.1, expected draft, preview or final")):
            with self.subTest(text=text):
                job(more=FLOOR + f'[[method]]\nname = "mtsm"\n{text}\n')
                self.fails(self.of_job(), 4, "shot.toml:", *words)
                self.nothing_came_out()

    def test_map_says_what_the_rows_do_not(self):
        row = '[[method]]\nname = "mtsm"\nsamples = 4\n'
        settings = '[map]\nresolution = 64\nlayers = 3\nnear-field = {}\n'
        for near, text in (('"none"', "none"), ('"32M"', "32M"), ("32000000", "32000000")):
            done, found = self.labels_and_choices(row, settings.format(near))
            self.assertEqual(found, [(f"mtsm resolution=64 layers=3 near-field={text} samples=4", None)])
            self.assertEqual(self.runs[0]["settings"]["near-field"], text)
        self.assertNotIn("warning", done.stderr)
        _, found = self.labels_and_choices(row + 'near-field = "auto"\n', settings.format('"none"'))
        self.assertEqual(found[0][0], "mtsm resolution=64 layers=3 near-field=auto samples=4")
        # What is chosen stays as [map] has it, as in mtsm-bake.
        _, found = self.labels_and_choices(row + "target-error = 0.1\n", settings.format('"none"'))
        self.assertEqual(found[0][1], "resolution 64, 4 samples")
        done, _ = self.labels_and_choices(row, "[map]\nresolution = 64\nrounding = 0.0\ntarget-error = 0.1\ncolor = true\n")
        for warning in ("shot.toml:20:1: rounding is not compared", "shot.toml:21:1: target-error in [map] is for mtsm-bake",
                        "shot.toml:22:1: color is not compared"):
            self.assertIn(warning, done.stderr)
        for wrong, *words in (("near-field = 'lots'", "near-field: found lots", "auto, none, or bytes such as 32M"),
                              ("near-fild = 'auto'", '"near-fild"', 'did you mean "near-field"?'),
                              ("resol = 64", '"resol"', 'did you mean "resolution"?'),
                              ("resolution = 99999", "map.resolution"), ("tolerance = 5", "tolerance: found 5"),
                              ("layers = 9999999", "layers: found 9999999")):
            with self.subTest(wrong=wrong):
                job(more=FLOOR + "[map]\n" + wrong + "\n" + row)
                self.fails(self.of_job(folder="none"), 4, "shot.toml:19:1: ", *words)
                self.assertFalse(os.path.exists("none"))


class SceneFile(Compare):
    def test_sweeps_cameras_and_receivers(self):
        job(camera="image = [40, 20]", compare="truth = 32\nmeasured-pixels = 64\nrepeats = 1\n")
        self.good(run("compare", "shot.toml", "--quiet", "-o", "out"))
        j = self.results()
        self.assertEqual([light["scale"] for light in j["lights"]], [0.5, 1])
        labels = ["mtsm resolution=64 samples=4", "mtsm resolution=64 samples=64",
                  "mtsm resolution=128 samples=4", "mtsm resolution=128 samples=64"]
        self.assertEqual([(r["light"], r["label"]) for r in j["runs"]],
                         [(light, label) for light in (0, 1) for label in labels])
        self.assertEqual(len({r["id"] for r in j["runs"]}), 8)
        self.assertEqual([(t["light"], t["error"]) for t in j["targets"]], [(0, 0.1), (1, 0.1)])
        for few, many in zip(j["runs"][::2], j["runs"][1::2]):
            self.assertGreater(few["errors"]["image"]["mean"], many["errors"]["image"]["mean"])
            self.assertEqual(few["series"], many["series"])
        self.assertEqual(j["runs"][0]["settings"]["resolution"], 64)

    def test_mtsm_bake_accepts_the_same_file(self):
        job(more=FLOOR + '[[receiver]]\nplane = [0, 0, 0, 1, 0, 0, 0, 0, -1]\n' + METHOD,
            camera="image = [40, 20]\npoints = 4\npixels = 64\n", compare="truth = 32\n")
        self.good(run("bake", "shot.toml", "--resolution", 32, "--quiet", "-o", "key.mtsm"))
        self.assertTrue(os.path.exists("key.mtsm"))

    def test_the_command_line_comes_first(self):
        job(camera="image = [60, 60]")
        self.good(run("compare", "shot.toml", *SMALL, "--quiet", "--light-scales", "1", "--light-radius", "0.1",
                      "--no-pictures", "-o", "out"))
        j = self.results()
        self.assertEqual(j["scene"]["image"], [40, 20])
        self.assertEqual([light["radius"] for light in j["lights"]], [0.1])

    def test_receivers_are_seen_and_cast_nothing(self):
        pathlib.Path("lid.obj").write_text("v -1 2 -1\nv 1 2 -1\nv 1 2 1\nv -1 2 1\nf 1 2 3 4\n")
        job(more=FLOOR + '[[receiver]]\nfile = "lid.obj"\n' + METHOD)
        self.good(self.of_job("--light-scales", "1"))
        lid = read_exr("out/truth-1.exr")[2]["shadow"]
        job()
        self.good(self.of_job("--light-scales", "1", folder="bare"))
        bare = read_exr("bare/truth-1.exr")[2]["shadow"]
        self.assertNotEqual(lid, bare)
        # What the lid hides is in the light as it is; all else stays as it was.
        for a, b in zip(lid, bare):
            self.assertTrue(a == b or a < 0.01 or math.isnan(a), (a, b))

    def test_wrong_methods_and_settings_are_told_at_their_place(self):
        line = job().count("\n") - METHOD.count("\n")
        for wrong, right, *words in (
                ('"mtsm"', '"mtms"', 'no method "mtms"; did you mean "mtsm"?'),
                ("samples", "sampels", 'no setting "sampels"; did you mean "samples"?'),
                ("samples", "near", 'no setting "near"; did you mean "near-field"?'),
                ("[4, 64]", "[4, 0.5]", "samples: found 0.5, expected a whole number from 1 to 4096"),
                ("[4, 64]", '"many"', "samples: found many, expected a whole number"),
                ("[4, 64]", "[]", "samples: found an empty list"),
                ("[4, 64]", "[[4]]", "samples: found a list of 1 value"),
                ("[4, 64]", "{ a = 1 }", "samples: found a table"),
                ("[4, 64]", "inf", "samples: found the number inf"),
                ('name = "mtsm"', "", 'no name = "..."'),
                ('name = "mtsm"', 'name = ["mtsm", "embree"]', "the name of a method, in quotes"),
                ("[4, 64]", str(list(range(1, 2002))), "more than 2000 combinations")):
            with self.subTest(right=right[:20]):
                job(more=FLOOR + METHOD.replace(wrong, right))
                done = self.fails(self.of_job(), 4, *words)
                place = re.search(r"shot\.toml:(\d+):\d+: ", done.stderr)
                self.assertTrue(place, done.stderr)
                self.assertTrue(line <= int(place[1]) <= line + 5, done.stderr)
                self.assertFalse(os.path.exists("out"))

    def test_wrong_cameras_receivers_and_numbers_are_told_at_their_place(self):
        job()
        for kind, text, *words in (
                ("camera", "points = 3", "camera.points", "found 3", "square"),
                ("camera", "image = 0", "camera.image"),
                ("camera", "image = [40, -2]", "camera.image"),
                ("camera", "up = [2, 2.5, 6]", "camera.position", "along its up"),
                ("camera", 'normal-pass = "table.obj"', "camera.normal-pass", "position pass"),
                ("camera", "postion = 3", '"postion"', '"position"'),
                ("compare", "truth = 0", "compare.truth"),
                ("compare", "repeats = 1.5", "repeats", "a whole number"),
                ("compare", 'truth = "all"', "truth", "a whole number"),
                ("more", "[[receiver]]\n", "one of file"),
                ("more", "[[receiver]]\nfloor = true\nplane = [0,0,0,1,0,0,0,0,1]\n", "one of file"),
                ("more", "[[receiver]]\nplane = [1, 2, 3]\n", "9 finite numbers"),
                ("more", "[[receiver]]\nplane = [0,0,0, 1,0,0, 2,0,0]\n", "no area"),
                ("more", "[[receiver]]\nfloor = 1\n", "true or false"),
                ("more", "[[receiver]]\nfile = \"table.obj\"\nheight = 1\n", "floor = true alone"),
                ("more", "[[reciever]]\nfloor = true\n", '"reciever"', '"receiver"'),
                ("more", "[receiver]\nfloor = true\n", "[[receiver]]"),
                ("more", "[method]\nname = \"mtsm\"\n", "[[method]]")):
            with self.subTest(text=text):
                job(**{kind: text})
                self.fails(self.of_job(), 4, "shot.toml:", *words)
                self.nothing_came_out()
        text = job().replace("[0.5, 1]", "[1, -1]")
        pathlib.Path("shot.toml").write_text(text)
        self.fails(self.of_job(), 4, "shot.toml:6:1: compare.light-scales: found -1")
        for wrong in ('"big"', "[]", '["big"]', "1", "[1, nan]"):
            pathlib.Path("shot.toml").write_text(text.replace("[1, -1]", wrong))
            self.fails(self.of_job(), 4, "shot.toml:6:", "light-scales", "a list of finite numbers")
        job(more='[[receiver]]\nfile = "none.obj"\n')
        self.fails(self.of_job(), 3, "shot.toml:", "none.obj")

    def test_a_camera_that_sees_nothing(self):
        away = job().replace("target = [0, 0.5, 0]", "target = [4, 6, 12]")
        pathlib.Path("shot.toml").write_text(away)
        line = away[:away.index("position = [2")].count("\n") + 1
        self.fails(self.of_job(), 4, f"shot.toml:{line}:1: camera.position: the camera at 2, 3, 6",
                   "sees nothing", "-1, 0, -1", "1, 1, 1")
        self.nothing_came_out()

    def test_two_scene_files_or_one_beside_casters(self):
        job()
        self.fails(self.compare(inputs=["shot.toml", "table.obj"], light=[]), 2, "give it alone")


class Cache(Compare):
    def setUp(self):
        super().setUp()
        job()

    def truths(self, folder="out/cache"):
        return sorted(pathlib.Path(folder).glob("truth-*.values"))

    def test_a_second_run_takes_all_from_it(self):
        first = self.good(self.of_job())
        kept = {p: p.read_bytes() for p in pathlib.Path("out/cache").iterdir()}
        self.assertEqual(len(self.truths()), 2)
        before = self.results()
        second = self.good(self.of_job())
        self.assertEqual(first.stdout, second.stdout)
        after = self.results()
        self.assertEqual([l["truth"].pop("cached") for l in before["lights"]], [False, False])
        self.assertEqual([l["truth"].pop("cached") for l in after["lights"]], [True, True])
        self.assertEqual([l.pop("runsCached") for l in before["lights"]], [False, False])
        self.assertEqual([l.pop("runsCached") for l in after["lights"]], [True, True])
        for j in (before, after):
            for light in j["lights"]:
                light["truth"].pop("seconds")
        self.assertEqual(before, after)
        self.assertEqual(kept, {p: p.read_bytes() for p in pathlib.Path("out/cache").iterdir()})

    def test_it_may_be_elsewhere_or_left_out(self):
        self.good(self.of_job("--cache", "a/b"))
        self.assertEqual(len(self.truths("a/b")), 2)
        self.assertNotIn("cache", os.listdir("out"))
        self.good(self.of_job("--cache", "a/b", folder="other"))
        self.assertTrue(all(light["truth"]["cached"] for light in self.results("other")["lights"]))
        self.good(self.of_job("--cache", "a/b", "--no-cache", folder="third"))
        self.assertFalse(any(light["truth"]["cached"] for light in self.results("third")["lights"]))

    def test_whatever_changes_the_answer_is_computed_anew(self):
        def cached(*arguments):
            self.good(self.of_job("--no-pictures", *arguments))
            return self.results()["lights"][0]["truth"]["cached"]

        self.assertFalse(cached())
        self.assertTrue(cached())
        self.assertTrue(cached("--repeats", 2))  # another timing, the same truth
        self.assertFalse(cached("--truth", 65))
        self.assertFalse(cached("--image", "40x21"))
        self.assertFalse(cached("--points", 4))
        self.assertFalse(cached("--light-scales", "2"))
        pathlib.Path("table.obj").write_text(TABLE.replace("v 1 1 1", "v 1 1 1.5"))
        self.assertFalse(cached())

    def test_damaged_files_are_told_with_the_way_out(self):
        arguments = ["--light-scales", "1", "--no-pictures"]
        self.good(self.of_job(*arguments))
        os.remove("out/results.json")
        for path in pathlib.Path("out/cache").iterdir():
            whole = path.read_bytes()
            damages = {"cut": whole[:len(whole) // 2], "empty": b""}
            if path.suffix == ".values":
                damages["flipped"] = whole[:-1] + bytes([whole[-1] ^ 1])
                damages["longer"] = whole + b"x"
            else:
                damages["timeless"] = re.sub(rb"\[[\d., e\n-]*\]", b"null", whole)
                damages["another"] = b'{"a": 1}'
                damages["text"] = whole.replace(b'"memory": ', b'"memory": "", "m": ')
            for what, damaged in damages.items():
                with self.subTest(file=path.suffix, what=what):
                    self.assertNotEqual(whole, damaged)
                    path.write_bytes(damaged)
                    self.fails(self.of_job(*arguments), 4, path.name, "delete it")
                    self.assertFalse(os.path.exists("out/results.json"))
            path.write_bytes(whole)
        self.good(self.of_job(*arguments))

    def test_the_truth_of_another_scene_is_refused(self):
        arguments = ["--light-scales", "1", "--no-pictures"]
        self.good(self.of_job(*arguments))
        self.good(self.of_job("--light-scales", "3", "--no-pictures", folder="other"))
        shutil.copy(self.truths()[0], self.truths("other/cache")[0])
        self.fails(self.of_job("--light-scales", "3", "--no-pictures", folder="other"), 4,
                   self.truths("other/cache")[0].name, "another scene", "delete it")

    def test_stopped_in_the_middle_it_goes_on_where_it_was(self):
        arguments = [TOOLS["compare"], "shot.toml", "--image", "40x20", "--truth", "2048", "--light-scales",
                     "1,0.5,0.25", "--measured-pixels", "64", "--repeats", "1", "--no-pictures", "-o", "out"]
        running = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until = time.monotonic() + 120
        while not self.truths() and running.poll() is None and time.monotonic() < until:
            time.sleep(0.005)
        running.send_signal(signal.SIGINT)
        self.assertEqual(running.wait(60), -signal.SIGINT)
        had = len(self.truths())
        self.assertGreater(had, 0)
        self.assertFalse(os.path.exists("out/results.json"))
        subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        cached = [light["truth"]["cached"] for light in self.results()["lights"]]
        self.assertEqual(cached, [True] * had + [False] * (3 - had))


class BadInput(Compare):
    def test_usage(self):
        for arguments, *words in (
                (["--method", "mtms"], "--method", 'no method "mtms"; did you mean "mtsm"?'),
                (["--method", "photons"], "--method", '"photons"; there are ', " mtsm, "),
                (["--points", 3], "--points", "found 3"),
                (["--points", 0], "--points"),
                (["--image", "0"], "--image"),
                (["--image", "40x0"], "--image"),
                (["--image", "wide"], "--image"),
                (["--image", "99999"], "--image"),
                (["--truth", 0], "--truth"),
                (["--truth", 5000], "--truth"),
                (["--repeats", 0], "--repeats"),
                (["--measured-pixels", 1], "--measured-pixels"),
                (["--targets", "0.1,low"], "--targets", '"0.1,low"', "a list such as"),
                (["--targets", "nan"], "--targets"),
                (["--targets", ""], "--targets"),
                (["--light-scales", "1,"], "--light-scales", '"1,"'),
                (["--light-scales", "inf"], "--light-scales"),
                (["--light-scales", "1,-2"], "--light-scales", "-2", "at least 0"),
                (["--error", "median"], "--error"),
                (["--camera-fov", 200], "--camera-fov"),
                (["--camera-position", "0,5,9", "--camera-fov", 0], "--camera-position", "field of view"),
                (["--camera-position", "0,5"], "--camera-position"),
                (["--camera-target", "0,5,0"], "--camera-position is missing"),
                (["--camera-position", "0,5,9", "--camera-target", "0,5,9"], "--camera-position", "target"),
                (["--camera-position", "0,5,0", "--camera-target", "0,0,0"], "--camera-position", "its up"),
                (["--camera-up", "0,0,0"], "--camera-up"),
                (["--normal-pass", "N.exr"], "--normal-pass", "position pass"),
                (["--light-target", "1,4,0"], "--light-target")):
            with self.subTest(arguments=arguments):
                self.fails(self.compare(*arguments), 2, *words, "--help")
                self.nothing_came_out()

    def test_what_is_needed(self):
        self.fails(run("compare"), 2, "INPUT")
        self.fails(run("compare", "table.obj", *LIGHT), 2, "-o: is required")
        self.fails(self.compare(light=[]), 2, "--light-position is missing")
        self.fails(self.compare(inputs=["none.obj"]), 3, "none.obj")
        self.fails(self.compare(inputs=["none.toml"], light=[]), 3, "none.toml")
        pathlib.Path("broken.obj").write_text("v 0 0 0\n")
        self.fails(self.compare(inputs=["broken.obj"]), 4, "broken.obj")
        self.nothing_came_out()

    def test_casters_that_cast_nothing(self):
        pathlib.Path("clear.obj").write_text("mtllib clear.mtl\nusemtl clear\n" + TABLE)
        pathlib.Path("clear.mtl").write_text("newmtl clear\nd 0\n")
        self.fails(self.compare(inputs=["clear.obj"]), 4, "hold nothing that casts")
        self.nothing_came_out()
        job()
        text = pathlib.Path("shot.toml").read_text().replace('file = "table.obj"', 'file = "table.obj"\nopacity = 0')
        pathlib.Path("shot.toml").write_text(text)
        self.fails(self.of_job(), 4, "nothing casts a shadow: an opacity of 0 lets all light through: give more than 0")
        self.nothing_came_out()

    def test_a_map_is_no_caster(self):
        self.good(run("bake", "table.obj", *LIGHT, "--resolution", 16, "--quiet", "-o", "key.mtsm"))
        self.fails(self.compare(inputs=["key.mtsm"]), 4, "key.mtsm: is a map already", "mtsm-query", "mtsm-dump")
        self.assertFalse(os.path.exists("out"))

    def test_a_camera_that_sees_nothing(self):
        self.fails(self.compare("--camera-position", "0,5,9", "--camera-target", "0,9,20"), 2,
                   "--camera-position: the camera at 0, 5, 9 that looks at 0, 9, 20 sees nothing",
                   "between -1, 0, -1 and 1, 1, 1")
        self.nothing_came_out()

    def test_a_light_among_the_casters_is_one_for_ray_tracing(self):
        among = ["--light-radius", "0.05", "--light-position", "0.5,0.5,0", "--light-scales", "1"]
        job()
        done = self.fails(self.of_job(*among), 2, "none of the methods can do this",
                          "inside the casters' bounds", "--projection cube")
        self.nothing_came_out()
        self.good(self.of_job(*among, "--projection", "cube", "--no-pictures", folder="cube"))
        self.assertLess(min(r["errors"]["image"]["mean"] for r in self.results("cube")["runs"]), 0.02)
        self.needs("embree")
        job(more=FLOOR + METHOD + '[[method]]\nname = "embree"\nsamples = [4, 16]\n')
        done = self.good(self.of_job(*among))
        j = self.results()
        self.assertEqual({r["method"] for r in j["runs"]}, {"embree"})
        self.assertEqual({f["label"].split()[0] for f in j["failed"]}, {"mtsm"})
        for failed in j["failed"]:
            self.assertIn("inside the casters' bounds", failed["reason"])
        self.assertIn("and 3 more", done.stdout)
        # The reason once, not once a run; and from the cache no other tables.
        self.assertEqual(done.stderr.count("inside the casters' bounds"), 1, done.stderr)
        again = self.good(self.of_job(*among))
        self.assertEqual(done.stdout, again.stdout)

    def test_a_light_inside_an_object_leaves_all_in_the_dark(self):
        corners = [(x, y, z) for x in (-1, 1) for y in (0, 2) for z in (-1, 1)]
        faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
        pathlib.Path("box.obj").write_text("".join("v %g %g %g\n" % c for c in corners) +
                                           "".join(f"f {f}\n" for f in faces))
        job()
        text = pathlib.Path("shot.toml").read_text()
        pathlib.Path("shot.toml").write_text(text.replace("table.obj", "box.obj"))
        done = self.good(self.of_job("--projection", "cube", "--light-position", "0,1.2,0", "--light-radius", "0.1",
                                     "--light-shape", "sphere", "--light-scales", "1"))
        self.assertRegex(done.stderr, r"warning: every point is dark under light 1 .* inside a caster")
        truth = read_exr("out/truth-1.exr")[2]["shadow"]
        self.assertEqual({t for t in truth if not math.isnan(t)}, {1.0})

    def test_folders_that_cannot_be_written(self):
        self.fails(self.compare(folder="table.obj"), 3, "table.obj: cannot make this folder", "a file has that name",
                   "such as -o out")
        self.fails(self.compare(folder="table.obj/out"), 3, "table.obj/out")
        self.fails(self.compare("--cache", "table.obj"), 3, "table.obj")
        self.assertEqual(pathlib.Path("table.obj").read_text(), TABLE)
        os.mkdir("closed")
        os.chmod("closed", 0o555)
        if os.getuid() == 0:
            try:
                subprocess.run([TOOLS["compare"], "--version"], preexec_fn=as_nobody, check=True,
                               capture_output=True)
            except (OSError, subprocess.SubprocessError):
                self.skipTest("the tools cannot be run as another user here")
        other = as_nobody if os.getuid() == 0 else None
        self.fails(self.compare("--no-cache", folder="closed", before=other), 3,
                   "closed: cannot write into this folder")
        self.assertEqual(os.listdir("closed"), [])

    def test_position_passes(self):
        zero, nan = [0.0] * 6, [math.nan] * 6
        job()
        small = ["--truth", 16, "--light-scales", "1"]
        write_exr("P.exr", 3, 2, {"P.X": nan, "P.Y": nan, "P.Z": nan})
        self.fails(self.of_job(*small, "--position-pass", "P.exr"), 4, "P.exr", "6 of 6 pixels have no position")
        write_exr("P.exr", 3, 2, {"P.X": zero, "P.Y": zero, "P.Z": zero, "A": zero})
        self.fails(self.of_job(*small, "--position-pass", "P.exr"), 4, "P.exr", "surface")
        self.fails(self.of_job(*small, "--position-pass", "none.exr"), 3, "none.exr")
        self.fails(self.of_job(*small, "--position-pass", "table.obj"), 4, "table.obj")
        write_exr("P.exr", 3, 2, {"P.X": zero, "P.Y": zero, "P.Z": [0, 0, 9, 9, math.nan, 0]})
        write_exr("N.exr", 2, 2, {"N.X": [0] * 4, "N.Y": [1] * 4, "N.Z": [0] * 4})
        self.fails(self.of_job(*small, "--position-pass", "P.exr", "--normal-pass", "N.exr"), 2, "N.exr")
        self.fails(self.of_job(*small, "--position-pass", "P.exr", "--points", 4), 2, "--points",
                   "one point a pixel")
        self.nothing_came_out()
        self.good(self.of_job(*small, "--position-pass", "P.exr"))
        scene = self.results()["scene"]
        self.assertEqual((scene["image"], scene["pixels"], scene["objectPixels"]), ([3, 2], 5, 5))
        shadow = read_exr("out/truth-1.exr")[2]["shadow"]
        self.assertTrue(math.isnan(shadow[4]))
        self.assertEqual(shadow[2:4], [0.0, 0.0])  # far from the table


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    for key, path in zip(("compare", "bake", "query"), sys.argv[1:4]):
        TOOLS[key] = os.path.abspath(path)
    TOOLS["methods"] = re.findall(r"(?m)^([\w-]+): ", run("compare", "--list-methods").stdout)
    unittest.main(argv=[sys.argv[0], *sys.argv[4:]])
