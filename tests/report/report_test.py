#!/usr/bin/env python3
"""Opens the report page in a real browser: `report_test.py MAKE_REPORT [unittest arguments]`.

The results are made here: small, with hostile names, missing values and runs without an answer, and
pictures of one colour each, so that what the slider shows can be read off the screen. Skipped (77) where
there is no Chromium.
"""
import copy
import json
import math
import pathlib
import re
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib

import browser

MAKE_REPORT = ""
HOSTILE = "</script><script>document.title='taken'</script><img src=x onerror=\"alert(1)\">&amp;"
WIDTH, HEIGHT = 60, 30
TRUTH, EMBREE, MAP, DIFFERENCE = (10, 20, 30), (200, 0, 0), (0, 200, 0), (0, 0, 200)
BUDGETS = (4, 16, 64)


def png(colour, width=WIDTH, height=HEIGHT):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = (b"\0" + bytes(colour) * width) * height
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def run(method, light, samples, mean, build, query, pictures=True):
    name = f"{light}-{method}-{samples}"
    errors = {key: {"mean": mean * k, "deviation": mean * k * 2, "p95": mean * k * 4, "p99": mean * k * 8,
                    "largest": min(1, mean * k * 20), "bias": -mean * k / 2}
              for key, k in (("image", 1), ("object", 2), ("imageCosine", 0.5), ("objectCosine", 0.75))}
    return {"id": name, "method": method, "label": f"{method} samples={samples}", "light": light,
            "settings": {"samples": samples, "lookup": HOSTILE, "list": [1, 2]},
            "build": {"seconds": build, "memoryBytes": 21000000},
            "query": {threads: {"median": query / k, "least": query / k * 0.9, "most": query / k * 1.2,
                                "repeats": 5} for threads, k in (("one", 1), ("all", 2))},
            "unanswered": 0, "errors": errors,
            "image": name + ".png" if pictures else None,
            "difference": name + "-difference.png" if pictures else None}


def fixture(folder):
    """Results in their full shape, and their pictures in `folder`."""
    lights = [{"name": name, "radius": radius, "shape": "disk", "text": "disk " + HOSTILE,
               "truth": {"samples": 4096, "seconds": 61.2, "cached": radius > 0.1, "image": f"truth-{i}.png"}}
              for i, (name, radius) in enumerate((("small", 0.07), (HOSTILE, 0.2)))]
    runs = []
    for light in range(2):
        (folder / f"truth-{light}.png").write_bytes(png(TRUTH))
        for samples in BUDGETS:
            runs.append(run("mtsm", light, samples, 0.04 / math.sqrt(samples), 1.0, 0.01 * samples))
            runs.append(run("embree", light, samples, 0.08 / math.sqrt(samples), 0.1, 0.02 * samples))
        runs.append(run("pcf", light, 1, 0.05, 0.2, 0.005, pictures=False))
    runs[0]["choice"] = {"text": "resolution 512, " + HOSTILE, "target": 0.02, "expected": 0.0125, "met": False}
    for entry, colour in ((r, MAP if r["method"] == "mtsm" else EMBREE) for r in runs if r["image"]):
        (folder / entry["image"]).write_bytes(png(colour))
        (folder / entry["difference"]).write_bytes(png(DIFFERENCE))
    nothing = run("distance-field", 0, 1, 0, 12, 0.5, pictures=False)  # answers nowhere: no errors
    nothing.update(errors=None, unanswered=1800)
    bare = {"id": "bare", "method": "single-sample", "label": HOSTILE, "light": 1}
    equal = [{"run": f"{light}-mtsm-{samples}", "rival": "embree", "threads": threads,
              "error": 0.04 / math.sqrt(samples), "seconds": 0.01 * samples, "firstFrameSeconds": 1 + 0.01 * samples, "rivalSeconds": seconds,
              "rivalFirstFrameSeconds": seconds and seconds + 0.1, "rivalLabel": HOSTILE,
              "ratio": seconds and seconds / (0.01 * samples),
              "firstFrameRatio": seconds and (seconds + 0.1) / (1 + 0.01 * samples)}
             for light in range(2) for threads in (1, 2)
             for samples, seconds in ((4, 0.32), (16, 0.08), (64, None))]
    targets = [{"light": light, "error": error, "cheapest": [
        {"method": r["method"], "label": r["label"], "seconds": r["query"]["one"]["median"],
         "firstFrameSeconds": r["query"]["one"]["median"] + r["build"]["seconds"]}
        for r in runs if r["light"] == light and r["errors"]["image"]["mean"] <= error]}
        for light in range(2) for error in (0.02, 0.01, 0.005, 0.002)]
    return {"format": "mtsm-compare", "version": 1,
            "scene": {"name": HOSTILE, "file": "scene.toml", "casters": [HOSTILE, "fur.hair"], "triangles": 316000,
                      "segments": 0, "voxels": 0, "image": [WIDTH, HEIGHT], "pointsPerPixel": 1, "points": 1700,
                      "pixels": 1700, "objectPixels": 400, "measuredPixels": 1024},
            "machine": {"processor": HOSTILE, "threads": 2, "software": "libmtsm"},
            "lights": lights,
            "methods": [{"name": name, "title": HOSTILE, "source": "[Xie07]"}
                        for name in ("mtsm", "pcf", "distance-field", "single-sample", "embree")],
            "runs": [nothing, *runs, bare], "failed": [{"label": HOSTILE, "light": 0, "reason": HOSTILE}],
            "equalError": equal, "targets": targets}


def make(results, folder):
    (folder / "results.json").write_text(json.dumps(results))
    page = subprocess.run([MAKE_REPORT, folder / "results.json", folder], capture_output=True, check=True).stdout
    (folder / "report.html").write_bytes(page)
    return folder / "report.html"


class ReportTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory(prefix="mtsm-report-")
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.results = fixture(cls.folder)
        cls.path = make(cls.results, cls.folder)
        cls.browser = browser.Browser(browser.find())

    @classmethod
    def tearDownClass(cls):
        cls.browser.__exit__()
        cls.temporary.cleanup()

    def open(self, path=None, **options):
        page = self.browser.open(path or self.path, **options)
        page.settle()
        self.addCleanup(self.is_clean, page)
        return page

    def is_clean(self, page):
        self.assertEqual(page.evaluate("document.documentElement.dataset.problems || ''"), "")
        self.assertEqual(page.evaluate("document.documentElement.dataset.ready || ''"), "yes")
        self.assertEqual(page.complaints(), [])

    def column(self, page, table, name):
        """The texts of a table's column, from the top."""
        return page.evaluate(
            f"(() => {{ const t = document.getElementById('{table}');"
            "const c = [...t.querySelectorAll('thead th')]"
            f".findIndex((h) => h.textContent === {json.dumps(name)});"
            "return [...t.tBodies[0].rows].map((r) => r.cells[c].textContent); })()")

    def divider(self, page):
        return int(page.evaluate("document.querySelector('.divider').getAttribute('aria-valuenow')"))

    def test_every_picture_loads_and_is_its_size(self):
        page = self.open()
        sizes = page.evaluate(
            "Promise.all([...document.querySelectorAll('script[data-picture]')].map(async (s) => {"
            "const i = new Image(); i.src = pictureUrl(s.dataset.picture); await i.decode();"
            "return [i.naturalWidth, i.naturalHeight]; }))")
        self.assertEqual(sizes, [[WIDTH, HEIGHT]] * (2 + 2 * 2 * 2 * len(BUDGETS)))
        shown = page.evaluate("[...document.images].map((i) => i.naturalWidth)")
        self.assertEqual(shown, [WIDTH, WIDTH])

    def test_the_slider_moves_by_mouse(self):
        page = self.open()
        left, top, width, height = page.box(".stage")
        middle = top + height / 2
        quarter = (left + width / 4, middle - 40)
        self.assertEqual(self.divider(page), 50)
        self.assertEqual(page.pixel(*quarter), TRUTH)
        page.drag((left + width / 2, middle), (left + width / 8, middle))
        self.assertIn(self.divider(page), (12, 13))
        self.assertEqual(page.pixel(*quarter), MAP)
        # A press beside it brings it there: the picture is no larger than its frame.
        page.drag((left + width * 3 / 4, middle), (left + width * 3 / 4, middle))
        self.assertEqual(self.divider(page), 75)
        self.assertEqual(page.pixel(*quarter), TRUTH)
        page.drag((left + width * 3 / 4, middle), (left + width + 10, middle))
        self.assertEqual(self.divider(page), 100)

    def test_the_slider_moves_by_keys(self):
        page = self.open()
        page.evaluate("document.querySelector('.divider').focus()")
        for key, expected in (("ArrowRight", 51), ("ArrowLeft", 50), ("PageUp", 60), ("End", 100),
                              ("ArrowRight", 100), ("Home", 0), ("ArrowLeft", 0)):
            page.key(key)
            self.assertEqual(self.divider(page), expected, key)
        left, top, width, height = page.box(".stage")
        self.assertEqual(page.pixel(left + width / 4, top + height / 4), MAP)

    def test_what_is_seen_is_what_was_chosen(self):
        page = self.open()
        left, top, width, height = page.box(".stage")
        on_left, on_right = (left + width / 4, top + 30), (left + width * 3 / 4, top + 30)
        page.choose("#picture-left", "0-embree-16")
        self.assertEqual((page.pixel(*on_left), page.pixel(*on_right)), (EMBREE, MAP))
        page.click("#right-as [data-value=difference]")
        left, top, width, height = page.box(".stage")
        self.assertEqual(page.pixel(left + width * 3 / 4, top + 30), DIFFERENCE)
        self.assertIn("difference", page.evaluate("document.querySelector('.captions').lastChild.textContent"))
        page.choose("#picture-light", 1)
        self.assertEqual(page.evaluate("document.querySelector('#picture-left').value"), "1-embree-16")
        # Runs that wrote no picture are not on offer.
        offered = page.evaluate("[...document.querySelector('#picture-left').options].map((o) => o.value)")
        pictured = [f"1-{method}-{n}" for method in ("mtsm", "embree") for n in BUDGETS]
        self.assertEqual(sorted(offered), sorted(["truth", *pictured]))

    def test_the_picture_zooms_and_pans(self):
        page = self.open(width=160)
        place = "(() => { const b = document.images[0].getBoundingClientRect(), " \
                "s = document.querySelector('.stage').getBoundingClientRect();" \
                "return [b.left - s.left, b.top - s.top, b.width, b.height].map(Math.round); })()"
        page.click("#zoom [data-value='4']")
        x, y, width, height = page.evaluate(place)
        self.assertEqual((width, height), (4 * WIDTH, 4 * HEIGHT))
        self.assertEqual(page.evaluate("document.images[0].style.imageRendering"), "pixelated")
        left, top, frame, tall = page.box(".stage")
        page.drag((left + 20, top + 20), (left + 40, top + 25))
        self.assertEqual(page.evaluate(place)[0], x + 20)
        page.key("ArrowRight")
        self.assertEqual(page.evaluate(place)[0], x - 20)
        page.drag((left + 20, top + 20), (left + 900, top + 900))  # not beyond its own edge
        self.assertLessEqual(page.evaluate(place)[0], 1)
        self.assertEqual(self.divider(page), 50)
        page.key("-")
        self.assertEqual(page.evaluate(place)[2], 2 * WIDTH)

    def test_texts_of_files_stay_texts(self):
        page = self.open()
        self.assertEqual(page.evaluate("document.querySelector('h1').textContent"), HOSTILE)
        self.assertTrue(page.evaluate("document.title").startswith(HOSTILE))
        self.assertEqual(page.evaluate("document.querySelectorAll('img').length"), 2)
        self.assertEqual(page.evaluate("document.querySelectorAll('script:not([type])').length"), 2)

    def test_nothing_in_the_page_leads_out(self):
        text = re.sub(r'<script type="[^"]*"[^>]*>.*?</script>', "", self.path.read_text(), flags=re.S)
        self.assertEqual(re.findall(r"\w*https?:|\burl\(|@import|\bfetch\(|\bimport\(", text), [])

    def test_tables_sort_by_a_column_and_what_is_missing_comes_last(self):
        page = self.open()
        means = [r["errors"]["image"]["mean"] for r in self.results["runs"] if r.get("errors")]
        head = "#error-table th:nth-child(3) button"
        for order in (sorted(means), sorted(means, reverse=True)):
            page.click(head)
            shown = self.column(page, "error-table", "Mean")
            self.assertEqual([float(text) for text in shown[:-2]], [float(f"{m:.3g}") for m in order])
            self.assertEqual(shown[-2:], ["\u2013", "\u2013"])
        self.assertEqual(page.evaluate(f"document.querySelector('{head}').closest('th').ariaSort"), "descending")

    def test_errors_are_those_of_the_chosen_pixels_and_weights(self):
        page = self.open()
        page.click("#error-table th:nth-child(3) button")
        least = 0.04 / math.sqrt(max(BUDGETS))
        for region, weight, factor in (("object", "", 2), ("object", "Cosine", 0.75), ("image", "Cosine", 0.5)):
            page.choose("#region", region)
            page.choose("#weight", weight)
            self.assertAlmostEqual(float(self.column(page, "error-table", "Mean")[0]), least * factor, places=5)

    def test_what_a_run_chose_stands_beside_its_errors(self):
        chose = self.column(self.open(), "error-table", "Chose")
        self.assertEqual([text for text in chose if text != "\u2013"],
                         [f"resolution 512, {HOSTILE}; expects 0.0125 for 0.02: missed"])
        without = copy.deepcopy(self.results)
        for entry in without["runs"]:
            entry.update(choice=None, image=None, difference=None)
        for light in without["lights"]:
            light.pop("truth")
        with tempfile.TemporaryDirectory() as folder:
            page = self.open(make(without, pathlib.Path(folder)))
            self.assertNotIn("Chose", page.evaluate("document.querySelector('#error-table thead').textContent"))

    def test_methods_and_lights_can_be_left_out(self):
        page = self.open()
        rows = "document.querySelectorAll('#error-table tbody tr').length"
        everything = len(self.results["runs"])
        self.assertEqual(page.evaluate(rows), everything)
        page.click("[data-method=mtsm]")
        self.assertEqual(page.evaluate(rows), everything - 2 * len(BUDGETS))
        page.choose("#light", 1)
        self.assertEqual(page.evaluate(rows), len(BUDGETS) + 2)
        page.click("[data-method=mtsm]")
        self.assertEqual(page.evaluate(rows), 2 * len(BUDGETS) + 2)

    def test_the_front_rings_the_runs_that_no_other_beats(self):
        page = self.open()
        rings = "[...document.querySelectorAll('#plots figure')].map((f) => f.querySelectorAll('.ring').length)"
        front = []
        for light in range(2):
            for build in (0, 1):
                answered = [r for r in self.results["runs"] if r["light"] == light and r.get("errors")]
                points = [(r["query"]["one"]["median"] + build * r["build"]["seconds"],
                           r["errors"]["image"]["mean"]) for r in answered]
                front.append(sum(not any(t <= time and e <= error and (t, e) != (time, error) for t, e in points)
                                 for time, error in points))
        self.assertEqual(page.evaluate(rings), [0] + front)

    def test_lines_over_the_radius_join_equal_settings(self):
        page = self.open()
        lines = "[...document.querySelectorAll('#plots figure')][0].querySelectorAll('.line').length"
        self.assertEqual(page.evaluate(lines), 3)
        page.click("#every-setting")
        self.assertEqual(page.evaluate(lines), 2 * len(BUDGETS) + 1)

    def test_the_answer_says_what_the_ratios_say(self):
        page = self.open()
        # Ratios on one thread are 8, 0.5 and none, twice; with the build 0.42 / 1.04 and 0.18 / 1.16.
        answer = page.evaluate("document.querySelector('.answer').textContent")
        self.assertEqual(answer,
                         "mtsm beats embree at equal error in 2 of 4 comparisons of query time on one thread "
                         "(embree takes 0.500 to 8.00 times as long, median 4.25). Counting the build, the first "
                         "frame, it is ahead in 0 of 4 (0.155 to 0.404 times as long, median 0.280). In 2 more, "
                         "no measured setting of embree reaches the error.")
        cells = page.evaluate("[...document.querySelectorAll('#cheapest tbody tr')].map((r) =>"
                              "[...r.cells].slice(1).map((c) => c.textContent))")
        self.assertIn("mtsm samples=4", cells[0][0])       # 40 ms for .02, and
        self.assertIn("embree samples=16", cells[0][0])    # 420 ms with what it builds
        self.assertEqual(cells[0][3], "no method measured")

    def test_hover_texts_name_the_run(self):
        page = self.open()
        left, top, width, height = page.box("#plots figure:nth-of-type(1) path[data-tip*='mtsm']")
        page.mouse("mouseMoved", left + width / 2, top + height / 2)
        page.settle()
        self.assertEqual(page.evaluate("document.getElementById('tip').hidden"), False)
        self.assertIn("samples=", page.evaluate("document.getElementById('tip').textContent"))

    def test_the_page_is_no_wider_than_its_window(self):
        for width in (1280, 800):
            page = self.open(width=width)
            self.assertLessEqual(page.evaluate("document.documentElement.scrollWidth"), width)

    def test_results_of_which_much_is_missing_make_a_page_too(self):
        bare = copy.deepcopy(self.results)
        for entry in bare["runs"]:
            for key in ("image", "difference", "errors", "query", "settings"):
                entry.pop(key, None)
        for light in bare["lights"]:
            light.pop("truth")
            light["radius"] = None
        bare.pop("methods")
        for results in ({}, bare, *({key: bare[key]} for key in ("lights", "runs", "equalError", "targets"))):
            with tempfile.TemporaryDirectory() as folder:
                page = self.open(make(results, pathlib.Path(folder)))
                self.assertIn("No pictures", page.evaluate("document.getElementById('pictures').textContent"))


if __name__ == "__main__":
    MAKE_REPORT = sys.argv.pop(1)
    if not browser.find():
        print("skipped: no chromium is installed (packages.txt lists it)")
        sys.exit(77)
    unittest.main()
