#!/usr/bin/env python3
"""mtsm-radiance as a user meets it: `radiance_test.py MTSM_RADIANCE [unittest arguments]`.

The scene is that of cli_test.py: a square of side 2, one unit above the floor.
"""
import json
import os
import pathlib
import sys
import unittest

import cli_test
from cli_test import TOOLS, full_disk, hair, read_exr, read_png, run

FLOOR = ["--receiver", "-4,0,4,8,0,0,0,0,-8"]
LIGHT = ["--light-radius", "0.3", "--light-position", "0,4,0"]
SMALL = ["--resolution", 32, "--quiet"]
OPTIONS = """--include --exclude --opacity --hair-width --receiver --polygon --receivers --light-shape
             --light-position --light-radius --light-size --light-angle --light-target --light-direction
             --light-up --radiance --light --samples --solid-angle --sampling --seed --no-cull --resolution
             --pixel-size --supersampling --reflectance --ambient --flat-tolerance --output --progressive
             --white --json --threads --quiet --version --help"""


class Radiance(cli_test.ToolTest):
    def radiance(self, *arguments, scene="scene.obj", receiver=FLOOR, light=LIGHT, **more):
        return run("radiance", scene, *receiver, *light, *SMALL, *arguments, **more)

    def report(self, *arguments, **more):
        return json.loads(self.good(self.radiance("--json", *arguments, **more)).stdout)

    def test_settings_that_leave_nothing_to_cast_are_named(self):
        for target in ([], ["--light-target", "0,0,0"]):
            done = self.radiance("-o", "a.exr", "--opacity", 0, *target)
            self.assertIn("warning: nothing casts a shadow: an opacity of 0 lets all light through", done.stderr)
            self.assertEqual(done.returncode, 0 if target else 2)

    def test_a_map_is_no_caster(self):
        pathlib.Path("key.mtsm").write_bytes(b"\x89MTSM\r\n\x1a\n")
        self.fails(self.radiance("-o", "a.exr", scene="key.mtsm"), 4, "key.mtsm: is a map already, no caster")
        self.leaves("scene.obj", "key.mtsm")

    def test_help_mentions_every_option_and_the_exit_codes(self):
        text = self.good(run("radiance", "--help")).stdout
        for option in OPTIONS.split():
            self.assertRegex(text, rf"(?<![\w-]){option}(?![\w-])")
        self.assertIn("Examples:", text)
        self.assertIn("Exit codes: 0 good", text)
        self.assertLessEqual(max(map(len, text.splitlines())), 100)
        self.assertRegex(self.good(run("radiance", "--version")).stdout, r"^mtsm-radiance \d+\.\d+\.\d+\n$")

    def test_the_shadow_of_a_square_is_where_it_belongs(self):
        self.good(self.radiance("--exclude", "floor", "-o", "a.exr"))
        width, height, channels = read_exr("a.exr")
        self.assertEqual((width, height), (32, 32))
        self.assertEqual(sorted(channels), ["B", "G", "R", "visibility"])
        # From half a unit of height 3 above the square its shadow is 4/3 as large as it is.
        for x, visible in ((0, 1.0), (8, 1.0), (12, 0.0), (16, 0.0), (19, 0.0), (23, 1.0)):
            self.assertAlmostEqual(channels["visibility"][16 * 32 + x], visible, msg=x)
            self.assertEqual(channels["R"][16 * 32 + x] > 0, visible > 0, x)
        # Axially below the light, unblocked: pi 0.3^2 / (pi 4^2) of its radiance 1, to a first order.
        self.good(self.radiance("--exclude", "square", "-o", "lit.exr"))
        lit = read_exr("lit.exr")[2]["R"][16 * 32 + 16]
        self.assertAlmostEqual(lit, 0.3 ** 2 / (0.3 ** 2 + 4 ** 2), delta=2e-4)

    def test_the_receiver_may_be_a_caster(self):
        self.good(self.radiance("-o", "a.exr"))
        self.good(self.radiance("-o", "b.exr", "--exclude", "floor"))
        self.assertEqual(read_exr("a.exr"), read_exr("b.exr"))

    def test_faces_of_a_mesh_are_receivers_by_name(self):
        report = self.report("-o", "a.png", receiver=["--receivers", "floor"])
        self.assertEqual([r["shape"] for r in report["receivers"]], ["parallelogram"])
        # The file's floor looks down, away from the light: that is said.
        done = self.good(self.radiance("-o", "a.png", receiver=["--receivers", "floor"]))
        self.assertIn("no light shines on its lit side", done.stderr)
        self.fails(self.radiance("-o", "a.png", receiver=["--receivers", "wall"]), 2, "floor", "square")

    def test_triangles_share_a_picture_and_polygons_have_their_own(self):
        report = self.report("-o", "a.exr", receiver=[
            "--polygon", "-4,0,4,4,0,4,-4,0,-4", "--polygon", "4,0,-4,-4,0,-4,4,0,4",
            "--polygon", "-4,0,4,4,0,4,4,0,-4,0,0,-6,-4,0,-4"])
        self.assertEqual([r["shape"] for r in report["receivers"]], ["triangle", "triangle", "polygon"])
        self.assertEqual([r["file"] for r in report["receivers"]], ["a-1.exr", "a-1.exr", "a-0.exr"])
        self.leaves("scene.obj", "a-0.exr", "a-1.exr")
        self.assertEqual(read_exr("a-1.exr")[:2], (37, 32))
        self.assertEqual(report["receivers"][0]["place"]["origin"], [0, 0])
        self.assertEqual(report["receivers"][1]["place"]["origin"], [1, 1])

    def test_several_lights_are_told_apart(self):
        report = self.report("-o", "a.exr", "--radiance", "1,0,0", "--light",
                             "radius=0.3 position=3,4,0 target=0,0,0 radiance=0,0,2", "--light",
                             "angle=1 direction=0,1,0 radiance=5", "--exclude", "floor")
        self.assertEqual([l["shape"] for l in report["lights"]], ["disk", "disk", "sun"])
        self.assertEqual(report["receivers"][0]["samples"], [64, 64, 0])  # the sun shines upwards
        channels = read_exr("a.exr")[2]
        self.assertEqual(sorted(channels),
                         ["B", "G", "R", "visibility.0", "visibility.1", "visibility.2"])
        self.assertEqual(max(channels["G"]), 0)
        for light, colour in (("visibility.0", "R"), ("visibility.1", "B")):
            for seen, value in zip(channels[light], channels[colour]):
                self.assertEqual(seen == 0, value == 0)

    def test_refinement_ends_with_the_same_picture(self):
        self.good(self.radiance("-o", "a.png"))
        done = self.good(run("radiance", "scene.obj", *FLOOR, *LIGHT, "--resolution", 32, "--progressive",
                             "-o", "b.png"))
        self.assertEqual(done.stderr.count("of each light"), 4)
        self.assertEqual(pathlib.Path("a.png").read_bytes(), pathlib.Path("b.png").read_bytes())

    def test_threads_and_culling_change_nothing(self):
        self.good(self.radiance("-o", "a.exr"))
        self.good(self.radiance("-o", "b.exr", "--threads", 1, "--no-cull"))
        self.assertEqual(pathlib.Path("a.exr").read_bytes(), pathlib.Path("b.exr").read_bytes())

    def test_samples_texels_and_flatness_are_reported(self):
        report = self.report("-o", "a.png", "--samples", 50)
        self.assertEqual(report["receivers"][0]["samples"], [64])  # rounded up to 8 x 8
        self.assertEqual(report["receivers"][0]["flatness"], "textured")
        report = json.loads(self.good(run("radiance", "scene.obj", *FLOOR, *LIGHT, "--pixel-size", 0.5,
                                          "--solid-angle", 0.001, "--exclude", "square", "--ambient", 1,
                                          "--white", 2, "--json", "-o", "a.png")).stdout)
        self.assertEqual(report["receivers"][0]["texels"], [16, 16])
        self.assertEqual(report["receivers"][0]["samples"], [25])  # 0.0176 sr below the light
        self.assertEqual(report["receivers"][0]["flatness"], "constant")
        self.assertEqual(read_png("a.png")[2][8][24:27], [188] * 3)  # half of white, as sRGB has it

    def test_hair_casts(self):
        pathlib.Path("a.hair").write_bytes(hair())
        self.good(self.radiance("-o", "a.exr", "--hair-width", "0.3", scene="a.hair"))
        self.assertLess(min(read_exr("a.exr")[2]["visibility"]), 0.2)
        self.fails(self.radiance("-o", "a.exr", "--opacity", "0.5", scene="a.hair"), 2, "--opacity")

    def test_wrong_command_lines_are_one_line(self):
        for arguments, words in (
                ([], ["-o is missing"]), (["-o", "a.jpg"], ["a.jpg", ".exr or .png"]),
                (["-o", "a.exr", "--white", 1], ["--white", ".png"]),
                (["-o", "a.exr", "--samples", 0], ["--samples", "1 to 65536"]),
                (["-o", "a.exr", "--samples", 9, "--solid-angle", 1], ["--samples"]),
                (["-o", "a.exr", "--pixel-size", 1e-9], ["--pixel-size"]),
                (["-o", "a.exr", "--reflectance", "-1"], ["--reflectance", "none below 0"]),
                (["-o", "a.exr", "--light", "radius=1"], ["--light-position", "missing"]),
                (["-o", "a.exr", "--light", "glow=1"], ["glow=1", "KEY=VALUE"]),
                (["-o", "a.exr", "--light", "radius=x position=0,1,0"], ["--light-radius", '"x"']),
                (["-o", "a.exr", "--polygon", "0,0,0,1,0,0"], ["6 numbers", "three corners"]),
                (["-o", "a.exr", "--polygon", "0,0,0,1,0,0,2,0,0"], ["--polygon", "no area"]),
                (["-o", "a.exr", "--receiver", "0,0,0,1,0,0,2,0,0"], ["--receiver 1", "no area"])):
            with self.subTest(arguments=arguments):
                if "--pixel-size" in arguments:
                    done = run("radiance", "scene.obj", *FLOOR, *LIGHT, *arguments)
                    self.fails(done, 2, "texels", "larger pixel size")
                else:
                    self.fails(self.radiance(*arguments), 2, *words)
        self.fails(run("radiance", "scene.obj", *LIGHT, "-o", "a.exr"), 2, "no receiver")
        self.fails(run("radiance", "none.obj", *FLOOR, *LIGHT, "-o", "a.exr"), 3, "none.obj")
        self.fails(self.radiance("-o", "there/is/none.exr"), 3, "there/is")
        pathlib.Path("bad.obj").write_text("f 1 2 3\n")
        self.fails(self.radiance("-o", "a.exr", scene="bad.obj"), 4, "bad.obj")
        self.leaves("scene.obj", "bad.obj")

    def test_a_full_disk_leaves_nothing_behind(self):
        self.fails(self.radiance("-o", "a.exr", before=full_disk(1000)), 3, "a.exr")
        self.leaves("scene.obj")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    TOOLS["radiance"] = os.path.abspath(sys.argv[1])
    unittest.main(argv=[sys.argv[0], *sys.argv[2:]])
