#!/usr/bin/env python3
"""Pins what the tools say and return: `cli_test.py MTSM_BAKE MTSM_QUERY MTSM_DUMP [unittest arguments]`.

Algorithms are tested in the library; here it is exit codes (0 good, 2 usage, 3 input or output, 4 bad
file, 5 unsupported), messages, and that bake, query and dump work together on a scene whose shadow is
known: a square over a floor.
"""
import base64
import csv
import io
import json
import math
import os
import pathlib
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
import xml.dom.minidom
import zlib

TOOLS = {}  # "bake" -> path, filled by the command line
NOBODY = 65534

SCENE = """o square
v -1 1 -1
v 1 1 -1
v 1 1 1
v -1 1 1
f 1 2 3 4
o floor
v -5 0 -5
v 5 0 -5
v 5 0 5
v -5 0 5
f 5 6 7 8
"""
LIGHT = ["--light-radius", "0.3", "--light-position", "0,4,0"]


def gltf_with_lights():
    """The square of SCENE, a point light "Lamp" above it and a sun "Sun" that shines along -y."""
    corners = struct.pack("<12f", -1, 1, -1, 1, 1, -1, 1, 1, 1, -1, 1, 1)
    data = corners + struct.pack("<6H", 0, 1, 2, 0, 2, 3)
    half = math.sqrt(0.5)
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2]}],
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "point", "name": "Lamp"}, {"type": "directional", "name": "Sun"}]}},
        "nodes": [{"name": "square", "mesh": 0},
                  {"name": "Lamp", "translation": [0, 4, 0],
                   "extensions": {"KHR_lights_punctual": {"light": 0}}},
                  {"name": "Sun", "rotation": [-half, 0, 0, half],
                   "extensions": {"KHR_lights_punctual": {"light": 1}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                       "min": [-1, 1, -1], "max": [1, 1, 1]},
                      {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": 48},
                        {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"byteLength": 60, "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(data).decode()}]})

OPTIONS = {
    "bake": """--output --light-shape --light-position --light-target --light-direction --light-up
               --light-radius --light-size --light-angle --light-name --fov --near --far --resolution
               --layers --bias --opacity --cull --include --exclude --codec --level --threads
               --max-memory --quiet --json --version --help""",
    "query": """--point --normal --points --rays --position --position-layer --normal-pass
                --normal-layer --plane --size --no-normal --output --samples --seed --bias --threshold
                --light-shape --light-position --light-radius --light-size --light-angle --method
                --quantity --weight --threads --max-memory --json --stats --quiet --version --help""",
    "dump": """--json --pixel --face --plot --output --image --channel --histogram --validate
               --max-memory --version --help""",
}


def run(tool, *arguments, stdin=None, before=None, stdout=subprocess.PIPE):
    """Runs a tool in the current folder; `before` is called in the child."""
    return subprocess.run([TOOLS[tool], *map(str, arguments)], input=stdin, stdout=stdout,
                          stderr=subprocess.PIPE, text=True, preexec_fn=before, timeout=300)


def full_disk(size):
    """What a full disk looks like: no file may grow beyond `size` bytes."""
    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    return limit


def as_nobody():
    os.setgid(NOBODY)
    os.setuid(NOBODY)


# --- just enough EXR and PNG -------------------------------------------------------------------------

def write_exr(path, width, height, channels):
    """Uncompressed float scanlines; channels: name -> values, row-major."""
    names = sorted(channels)
    chlist = b"".join(n.encode() + b"\0" + struct.pack("<iiii", 2, 0, 1, 1) for n in names) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    attributes = [("channels", "chlist", chlist), ("compression", "compression", b"\0"),
                  ("dataWindow", "box2i", window), ("displayWindow", "box2i", window),
                  ("lineOrder", "lineOrder", b"\0"), ("pixelAspectRatio", "float", struct.pack("<f", 1)),
                  ("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
                  ("screenWindowWidth", "float", struct.pack("<f", 1))]
    head = struct.pack("<II", 20000630, 2)
    for name, kind, value in attributes:
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value
    head += b"\0"
    lines = []
    for y in range(height):
        data = b"".join(struct.pack(f"<{width}f", *channels[n][y * width:(y + 1) * width]) for n in names)
        lines.append(struct.pack("<iI", y, len(data)) + data)
    offset = len(head) + 8 * height
    table = b""
    for line in lines:
        table += struct.pack("<Q", offset)
        offset += len(line)
    pathlib.Path(path).write_bytes(head + table + b"".join(lines))


def read_exr(path):
    """(width, height, channels) of a ZIP-compressed float scanline file."""
    data = pathlib.Path(path).read_bytes()
    at = 8
    attributes = {}
    while data[at]:
        end = data.index(0, at)
        name = data[at:end].decode()
        end = data.index(0, end + 1)
        size, = struct.unpack_from("<I", data, end + 1)
        attributes[name] = data[end + 5:end + 5 + size]
        at = end + 5 + size
    at += 1
    assert attributes["compression"] == b"\3", "ZIP is expected"
    names, c = [], 0
    while attributes["channels"][c]:
        end = attributes["channels"].index(0, c)
        names.append(attributes["channels"][c:end].decode())
        c = end + 17
    x0, y0, x1, y1 = struct.unpack("<iiii", attributes["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = {n: [] for n in names}
    for block in range((height + 15) // 16):
        offset, = struct.unpack_from("<Q", data, at + 8 * block)
        _, size = struct.unpack_from("<iI", data, offset)
        rows = min(16, height - 16 * block)
        raw = data[offset + 8:offset + 8 + size]
        if size < rows * width * 4 * len(names):
            packed = bytearray(zlib.decompress(raw))
            for i in range(1, len(packed)):
                packed[i] = (packed[i - 1] + packed[i] - 128) & 255
            half = (len(packed) + 1) // 2
            plain = bytearray(len(packed))
            plain[0::2], plain[1::2] = packed[:half], packed[half:]
            raw = bytes(plain)
        values = struct.unpack(f"<{rows * width * len(names)}f", raw)
        for y in range(rows):
            for k, name in enumerate(names):
                start = (y * len(names) + k) * width
                channels[name] += values[start:start + width]
    return width, height, channels


def read_grey_png(path):
    """(width, height, rows) of an 8-bit grey PNG."""
    data = pathlib.Path(path).read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack_from(">IIBB", body)
            assert (depth, colour) == (8, 0)
        if kind == b"IDAT":
            packed += body
        at += size + 12
    raw = zlib.decompress(packed)
    rows, above = [], [0] * width
    for y in range(height):
        filtering, *line = raw[y * (width + 1):(y + 1) * (width + 1)]
        for x in range(width):
            a, b = (line[x - 1] if x else 0), above[x]
            c = above[x - 1] if x else 0
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            line[x] = (line[x] + (0, a, b, (a + b) // 2, paeth)[filtering]) & 255
        rows.append(line)
        above = line
    return width, height, rows


class ToolTest(unittest.TestCase):
    """A fresh folder per test with the scene in it, and a map of the square alone where asked for."""

    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="mtsm-cli-")
        os.chmod(self.folder, 0o755)
        os.chdir(self.folder)
        pathlib.Path("scene.obj").write_text(SCENE)

    def tearDown(self):
        os.chdir("/")
        shutil.rmtree(self.folder)

    def bake_map(self, path="key.mtsm", *more):
        self.good(run("bake", "scene.obj", *LIGHT, "--exclude", "floor", "--resolution", 128, "--quiet",
                      "-o", path, *more))

    def good(self, done):
        self.assertEqual(done.returncode, 0, done.stderr)
        return done

    def fails(self, done, code, *words):
        """Exit code `code` and one error line on stderr, with all of `words` in it."""
        self.assertEqual(done.returncode, code, done.stderr)
        lines = [l for l in done.stderr.splitlines() if ": error: " in l]
        self.assertEqual(len(lines), 1, done.stderr)
        self.assertRegex(lines[0], r"^mtsm-(bake|query|dump): error: ")
        for word in words:
            self.assertIn(word, lines[0])
        return done

    def leaves(self, *names):
        """The folder holds these files and nothing else, no temporary in particular."""
        self.assertEqual(sorted(os.listdir(".")), sorted(names))


class EveryTool(ToolTest):
    def test_help_mentions_every_option_and_the_exit_codes(self):
        for tool, options in OPTIONS.items():
            text = self.good(run(tool, "--help")).stdout
            for option in options.split():
                self.assertRegex(text, rf"(?<![\w-]){option}(?![\w-])", tool)
            self.assertIn("Examples:", text)
            self.assertIn("Exit codes: 0 good, 2 usage, 3 input or output failed, 4 bad file, "
                          "5 unsupported", text)
            self.assertLessEqual(max(map(len, text.splitlines())), 100)

    def test_version_goes_to_stdout(self):
        for tool in OPTIONS:
            self.assertRegex(self.good(run(tool, "--version")).stdout, rf"^mtsm-{tool} \d+\.\d+\.\d+\n$")

    def test_an_unknown_option_and_no_arguments_are_usage_errors(self):
        for tool in OPTIONS:
            self.fails(run(tool, "--bogus"), 2, "--help")
            self.fails(run(tool), 2, "required")

    def test_a_missing_file_is_an_io_error_that_names_it(self):
        self.fails(run("bake", "none.obj", *LIGHT, "-o", "a.mtsm"), 3, "none.obj", "No such file")
        self.fails(run("query", "none.mtsm", "--point", "0,0,0"), 3, "none.mtsm", "No such file")
        self.fails(run("dump", "none.mtsm"), 3, "none.mtsm", "No such file")
        self.leaves("scene.obj")

    def test_max_memory_bounds_what_a_map_takes(self):
        self.bake_map()
        for command in (["query", "key.mtsm", "--point", "0,0,0"], ["dump", "key.mtsm"],
                        ["dump", "key.mtsm", "--validate"], ["dump", "key.mtsm", "--pixel", "1,1"]):
            self.good(run(*command, "--max-memory", "64M"))
            self.fails(run(*command, "--max-memory", "1K"), 2, "key.mtsm", "1024", "ReadLimits::maxBytes",
                       "--max-memory")
            self.fails(run(*command, "--max-memory", "lots"), 2, "--max-memory")

    def test_an_empty_value_is_a_usage_error(self):
        self.bake_map()
        for command in (["dump", "key.mtsm", "--pixel", ""], ["dump", "key.mtsm", "--plot", ""],
                        ["dump", "key.mtsm", "--image", ""], ["query", "key.mtsm", "--points", ""],
                        ["query", "key.mtsm", "--point", "0,0,0", "-o", ""],
                        ["query", "key.mtsm", "--point", "0,0,+-1"]):
            with self.subTest(command=command):
                self.fails(run(*command), 2, [word for word in command if word.startswith("-")][-1][-6:])

    def test_text_of_a_file_cannot_steer_a_terminal(self):
        nasty = "a\x1b[2J\u009b2Jb"
        shutil.copy("scene.obj", nasty + ".obj")
        self.good(run("bake", nasty + ".obj", *LIGHT, "-o", "a.mtsm", "--quiet"))
        for command in (["dump", "a.mtsm"], ["dump", "a.mtsm", "--json"]):
            text = self.good(run(*command)).stdout
            self.assertFalse([c for c in text if c != "\n" and (c < " " or "\x7f" <= c <= "\x9f")])
            self.assertIn("1b[2J", text)
        self.assertIn(nasty, json.loads(run("dump", "a.mtsm", "--json").stdout)["settings"])

    def test_a_signal_ends_a_tool_that_reads_from_a_pipe(self):
        self.bake_map()
        for stop in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            process = subprocess.Popen([TOOLS["query"], "key.mtsm", "--points", "-", "-o", "a.csv"],
                                       stdin=subprocess.PIPE, stderr=subprocess.PIPE)
            process.stdin.write(b"x,y,z\n" + b"0,0,0\n" * 100000)  # more than a pipe holds: it reads
            process.stdin.flush()
            process.send_signal(stop)
            self.assertEqual(process.wait(timeout=60), -stop)
            process.stdin.close()
            process.stderr.close()
        self.leaves("scene.obj", "key.mtsm")

    def test_a_signal_that_was_ignored_stays_ignored(self):
        self.bake_map()
        process = subprocess.Popen([TOOLS["query"], "key.mtsm", "--points", "-"], text=True,
                                   stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
        process.stdin.write("x,y,z\n" + "0,0,0\n" * 100000)
        process.stdin.flush()
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=60)
        self.assertEqual(process.returncode, 0)

    def test_a_signal_while_a_map_is_written_leaves_no_temporary(self):
        lines = []  # a bumpy floor, which compresses slowly
        for y in range(200):
            for x in range(200):
                lines.append(f"v {x * 0.02 - 2} {(x * 7919 + y * 104729) % 997 / 2000} {y * 0.02 - 2}")
        for y in range(199):
            for x in range(199):
                i = y * 200 + x + 1
                lines.append(f"f {i} {i + 1} {i + 201} {i + 200}")
        pathlib.Path("bumpy.obj").write_text("\n".join(lines))
        for stop in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            process = subprocess.Popen(
                [TOOLS["bake"], "bumpy.obj", *LIGHT, "--resolution", "1024", "--level", "19", "--threads", "1",
                 "-o", "a.mtsm"], stderr=subprocess.PIPE, text=True)
            while process.poll() is None and not any(n.endswith(".part") for n in os.listdir(".")):
                pass
            process.send_signal(stop)
            rest = process.communicate(timeout=120)[1]
            self.assertEqual(process.returncode, 3, rest)
            self.assertIn("cancelled", rest)
            self.leaves("scene.obj", "bumpy.obj")

    def test_a_pipe_can_be_the_output_wherever_it_lies(self):
        self.bake_map()
        os.mkfifo("pipe.mtsm")
        reader = subprocess.Popen(["cat", "pipe.mtsm"], stdout=subprocess.PIPE)
        before = as_nobody if os.getuid() == 0 else None  # whom a folder may be locked for
        os.chmod("pipe.mtsm", 0o666)
        os.chmod(".", 0o555)
        try:
            done = run("bake", "scene.obj", *LIGHT, "--exclude", "floor", "--resolution", 128, "--quiet",
                       "-o", "pipe.mtsm", before=before)
        except (PermissionError, subprocess.SubprocessError):
            reader.kill()
            self.skipTest("the tools cannot be run as another user here")
        finally:
            os.chmod(".", 0o755)
            if os.path.exists("pipe.mtsm") and reader.poll() is None:
                os.close(os.open("pipe.mtsm", os.O_WRONLY | os.O_NONBLOCK))
        self.good(done)
        self.assertEqual(len(reader.communicate(timeout=60)[0]), os.path.getsize("key.mtsm"))

    def test_a_full_stdout_is_reported(self):
        if not os.path.exists("/dev/full"):
            self.skipTest("no /dev/full")
        self.bake_map()
        for command in (["query", "key.mtsm", "--point", "0,0,0"],
                        ["query", "key.mtsm", "--point", "0,0,0", "--json"], ["dump", "key.mtsm"],
                        ["dump", "key.mtsm", "--plot", "3,3"], ["dump", "--help"]):
            with open("/dev/full", "w") as full:
                self.fails(run(*command, stdout=full), 3, "standard output")


class Bake(ToolTest):
    def bake(self, *arguments, **more):
        return run("bake", "scene.obj", "-o", "a.mtsm", *arguments, **more)

    def test_says_what_it_did_on_stderr_and_nothing_on_stdout(self):
        done = self.good(self.bake(*LIGHT))
        self.assertEqual(done.stdout, "")
        for word in ("disk, radius 0.3", "2 meshes", "4 triangles", "1024 x 1024", "samples", "dropped",
                     "wrote a.mtsm", "layers"):
            self.assertIn(word, done.stderr)
        self.leaves("scene.obj", "a.mtsm")

    def test_quiet_is_quiet(self):
        done = self.good(self.bake(*LIGHT, "--quiet"))
        self.assertEqual((done.stdout, done.stderr), ("", ""))

    def test_json_is_one_object_on_stdout(self):
        done = self.good(self.bake(*LIGHT, "--resolution", "64x32", "--json", "--quiet"))
        j = json.loads(done.stdout)
        self.assertEqual((j["width"], j["height"], j["maxLayers"]), (64, 32, 5))
        self.assertEqual(j["light"]["shape"], "disk")
        self.assertEqual((j["casters"]["meshes"], j["casters"]["triangles"]), (2, 4))
        self.assertEqual(j["bytes"], os.path.getsize("a.mtsm"))
        self.assertEqual(done.stderr, "")

    def test_the_file_is_the_same_from_any_number_of_threads(self):
        for threads in (1, 2, 8):
            self.bake_map(f"{threads}.mtsm", "--threads", threads)
        one = pathlib.Path("1.mtsm").read_bytes()
        self.assertEqual(one, pathlib.Path("2.mtsm").read_bytes())
        self.assertEqual(one, pathlib.Path("8.mtsm").read_bytes())

    def test_what_is_no_mesh_is_a_bad_file(self):
        pathlib.Path("text.ply").write_text("this is no mesh at all\n")
        self.fails(run("bake", "text.ply", *LIGHT, "-o", "a.mtsm"), 4, "text.ply")
        pathlib.Path("empty.obj").write_text("# nothing\n")
        self.fails(run("bake", "empty.obj", *LIGHT, "-o", "a.mtsm"), 4, "empty.obj")
        self.leaves("scene.obj", "text.ply", "empty.obj")

    def test_a_mesh_of_nan_is_a_bad_file(self):
        pathlib.Path("nan.ply").write_text(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
            "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            "nan nan nan\nnan nan nan\nnan nan nan\n3 0 1 2\n")
        self.fails(run("bake", "nan.ply", *LIGHT, "-o", "a.mtsm"), 4)
        self.leaves("scene.obj", "nan.ply")

    def test_resolution_and_other_numbers_are_checked(self):
        for option, value in (("--resolution", "0"), ("--resolution", "0x16"), ("--resolution", "40000"),
                              ("--resolution", "1x2x3"), ("--layers", "0"), ("--layers", "65"),
                              ("--opacity", "1.5"), ("--opacity", "nan"), ("--bias", "-1"),
                              ("--level", "20"), ("--fov", "180"), ("--fov", "0"), ("--near", "inf"),
                              ("--cull", "sideways"), ("--codec", "rar"), ("--max-memory", "lots"),
                              ("--light-up", "1,2"), ("--light-up", "0,0,0"), ("--threads", "-1")):
            with self.subTest(option=option, value=value):
                self.fails(self.bake(*LIGHT, option, value), 2, option)
        self.fails(self.bake(*LIGHT, "--near", 3, "--far", 2), 2, "near must be less than far")
        self.fails(self.bake(*LIGHT, "--codec", "none", "--level", 3), 2, "--level")
        self.leaves("scene.obj")

    def test_light_options_must_suit_the_light(self):
        place = ["--light-position", "0,4,0"]
        self.fails(self.bake(), 2, "--light-position is missing", "--light-position 2,5,3")
        self.fails(self.bake("--light-radius", 1), 2, "--light-position is missing")
        self.fails(self.bake(*LIGHT, "--light-size", "1,1"), 2, "--light-size", "a disk light has none")
        self.fails(self.bake("--light-shape", "rect", *LIGHT), 2, "--light-radius",
                   "its size is --light-size W,H")
        self.fails(self.bake("--light-shape", "point", *LIGHT), 2, "--light-radius")
        self.fails(self.bake("--light-shape", "disk", *place), 2, "--light-radius R")
        self.fails(self.bake("--light-shape", "sphere", *place, "--light-angle", 3), 2, "--light-angle")
        self.fails(self.bake("--light-radius", -1, *place), 2, "--light-radius")
        self.fails(self.bake("--light-radius", "inf", *place), 2, "--light-radius")
        self.fails(self.bake("--light-position", "0,nan,0"), 2, "--light-position")
        self.fails(self.bake("--light-size", "1,-1", *place), 2, "--light-size")
        self.fails(self.bake(*LIGHT, "--light-direction", "0,0,0"), 2, "--light-direction", "no length")
        self.fails(self.bake(*LIGHT, "--light-target", "0,4,0"), 2, "--light-target")
        self.fails(self.bake(*LIGHT, "--light-target", "0,0,0", "--light-direction", "0,-1,0"), 2,
                   "excludes")
        self.fails(self.bake("--light-angle", 1), 2, "--light-direction is missing")
        sun = ["--light-angle", 1, "--light-direction", "0,-1,0"]
        self.fails(self.bake(*sun, "--fov", 40), 2, "--fov")
        self.fails(self.bake(*sun, *place), 2, "--light-position")
        self.fails(self.bake("--light-angle", 180, "--light-direction", "0,-1,0"), 2, "--light-angle")
        self.fails(self.bake("--light-name", "Key"), 2, "Key", "no light")
        self.leaves("scene.obj")
        for light in (["--light-shape", "point", *place], ["--light-size", "1,0.5", *place],
                      ["--light-shape", "sphere", "--light-radius", "0.2", *place], sun):
            self.good(self.bake(*light, "--resolution", 16))

    def test_a_light_of_no_size_is_a_point_and_says_so(self):
        done = self.good(self.bake("--light-radius", 0, "--light-position", "0,4,0", "--quiet"))
        self.assertIn("warning", done.stderr)
        self.assertIn("zero", done.stderr)

    def test_a_light_inside_the_casters_needs_a_field_of_view(self):
        inside = ["--light-radius", "0.1", "--light-position", "0,0.5,0", "--light-direction", "0,-1,0"]
        self.fails(self.bake(*inside), 2, "inside", "--fov")
        self.leaves("scene.obj")
        self.good(self.bake(*inside, "--fov", 90))

    def test_a_light_is_taken_from_the_file_and_changed_by_options(self):
        pathlib.Path("lit.gltf").write_text(gltf_with_lights())

        def light(*options):
            done = self.good(run("bake", "lit.gltf", "-o", "a.mtsm", "--resolution", 16, "--json", *options))
            return json.loads(done.stdout)["light"]

        lamp = light("--light-name", "Lamp")
        self.assertEqual((lamp["shape"], lamp["position"]), ("point", [0, 4, 0]))
        lamp = light("--light-name", "Lamp", "--light-shape", "sphere", "--light-radius", "0.2")
        self.assertEqual((lamp["shape"], lamp["position"], lamp["radius"]), ("sphere", [0, 4, 0], 0.2))
        sun = light("--light-name", "Sun", "--light-angle", 2)
        self.assertEqual((sun["shape"], round(sun["angularDiameterDegrees"], 9)), ("sun", 2))
        for got, want in zip(sun["direction"], (0, -1, 0)):
            self.assertAlmostEqual(got, want, places=6)
        self.fails(run("bake", "lit.gltf", "-o", "b.mtsm", "--light-name", "Key"), 2, "Key", "Lamp", "Sun")
        self.fails(run("bake", "lit.gltf", "-o", "b.mtsm", "--light-name", "Sun", "--light-radius", 1), 2,
                   "--light-radius")

    def test_casters_are_chosen_by_name(self):
        done = self.fails(self.bake(*LIGHT, "--include", "tree*"), 2, "square", "floor")
        done = self.good(self.bake(*LIGHT, "--include", "sq*", "--json"))
        self.assertEqual(json.loads(done.stdout)["casters"]["meshes"], 1)

    def test_a_bad_output_is_found_before_the_work_is_done(self):
        self.fails(run("bake", "scene.obj", *LIGHT, "-o", "no/such/a.mtsm"), 3, "no/such")
        self.fails(run("bake", "scene.obj", *LIGHT, "-o", "."), 3, "folder")
        self.fails(run("bake", "scene.obj", *LIGHT, "-o", "scene.obj"), 2, "also an input")
        self.assertEqual(pathlib.Path("scene.obj").read_text(), SCENE)
        # Found early: not even the missing input was looked at.
        self.fails(run("bake", "none.obj", *LIGHT, "-o", "no/a.mtsm"), 3, "no/a.mtsm")

    def test_an_unwritable_folder_is_an_io_error(self):
        os.mkdir("locked", 0o555)
        before = as_nobody if os.getuid() == 0 else None
        try:
            if run("bake", "--version", before=before).returncode != 0:
                self.skipTest("the tools cannot be run as another user here")
        except (PermissionError, subprocess.SubprocessError):
            self.skipTest("the tools cannot be run as another user here")
        self.fails(run("bake", "scene.obj", *LIGHT, "-o", "locked/a.mtsm", before=before), 3,
                   "locked", "Permission denied")
        self.assertEqual(os.listdir("locked"), [])

    def test_a_full_disk_is_an_io_error_and_leaves_the_old_map(self):
        self.bake_map("a.mtsm")
        old = pathlib.Path("a.mtsm").read_bytes()
        done = self.bake(*LIGHT, "--codec", "none", "--resolution", 512, "--light-target", "0.1,0,0.3",
                         before=full_disk(1024))
        self.fails(done, 3, "a.mtsm")
        self.assertEqual(pathlib.Path("a.mtsm").read_bytes(), old)
        self.leaves("scene.obj", "a.mtsm")

    def test_a_bad_later_input_leaves_no_half_map(self):
        pathlib.Path("bad.glb").write_bytes(b"glTF\2\0\0\0\xff\xff\xff\xff" + bytes(100))
        self.fails(run("bake", "scene.obj", "bad.glb", *LIGHT, "-o", "a.mtsm"), 4, "bad.glb")
        self.leaves("scene.obj", "bad.glb")


class Query(ToolTest):
    def setUp(self):
        super().setUp()
        self.bake_map()

    def rows(self, *arguments, **more):
        text = self.good(run("query", "key.mtsm", *arguments, **more)).stdout
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(io.StringIO(text))]

    def test_under_the_square_it_is_dark_and_far_away_it_is_lit(self):
        rows = self.rows("--point", "0,0,0", "--point", "3,0,0", "--normal", "0,1,0", "--point", "-3,0,-3")
        self.assertEqual([(r["x"], r["shadow"], r["visibility"]) for r in rows],
                         [(0, 1, 0), (3, 0, 1), (-3, 0, 1)])

    def test_the_edge_of_the_shadow_is_half_dark(self):
        # The plane through the light's centre and the square's edge meets the floor at x = 4/3; there
        # the edge cuts the disk in halves. The map moves the edge by up to half a texel, 2 / 126 / 2: that
        # is 0.032 on the light, and 2 r 0.032 / (pi r^2) of its area.
        row, = self.rows("--point", f"{4 / 3},0,0", "--normal", "0,1,0", "--samples", 1024)
        self.assertAlmostEqual(row["shadow"], 0.5, delta=0.07)

    def test_exactly_one_kind_of_input(self):
        self.fails(run("query", "key.mtsm"), 2, "no kind of input", "--point")
        self.fails(run("query", "key.mtsm", "--point", "0,0,0", "--rays", "-"), 2, "more than one kind")
        for arguments in (["--point", "1,2"], ["--point", "1,2,nan"], ["--point", "a,b,c"],
                          ["--normal", "0,1,0"], ["--point", "0,0,0", "--size", 4],
                          ["--point", "0,0,0", "--normal-pass", "n.exr"],
                          ["--plane", "0,0,0,1,0,0,0,0,1"], ["--plane", "1,2", "--size", 4, "-o", "a.png"],
                          ["--plane", "0,0,0,1,0,0,2,0,0", "--size", 4, "-o", "a.png"],
                          ["--plane", "0,0,0,1,0,0,0,0,1", "--size", "0x4", "-o", "a.png"],
                          ["--plane", "0,0,0,1,0,0,0,0,1", "--size", 4],
                          ["--plane", "0,0,0,1,0,0,0,0,1", "--size", 4, "-o", "a.jpg"],
                          ["--point", "0,0,0", "-o", "a.png"], ["--point", "0,0,0", "--samples", 0],
                          ["--point", "0,0,0", "--samples", 5000], ["--point", "0,0,0", "--seed", -1],
                          ["--point", "0,0,0", "--threshold", 1], ["--point", "0,0,0", "--bias", -1],
                          ["--point", "0,0,0", "--method", "magic"],
                          ["--point", "0,0,0", "--weight", "cosine"]):
            with self.subTest(arguments=arguments):
                self.fails(run("query", "key.mtsm", *arguments), 2)
        self.leaves("scene.obj", "key.mtsm")

    def test_another_light_must_lie_within_the_map_s(self):
        self.fails(run("query", "key.mtsm", "--point", "0,0,0", "--light-radius", 5), 2, "0.3")
        self.fails(run("query", "key.mtsm", "--point", "0,0,0", "--light-size", "1,1"), 2, "--light-size")
        # With a light of no size the shadow has an edge, at 4/3.
        rows = self.rows("--point", "1.25,0,0", "--point", "1.42,0,0", "--light-radius", 0)
        self.assertEqual([r["shadow"] for r in rows], [1, 0])

    def test_points_come_from_a_file_or_from_stdin(self):
        text = "z,name,y,x\n0,a,0,0\n# lit\n0,b,0,3\n"
        pathlib.Path("p.csv").write_text(text)
        expected = [{"x": 0, "y": 0, "z": 0, "shadow": 1, "visibility": 0},
                    {"x": 3, "y": 0, "z": 0, "shadow": 0, "visibility": 1}]
        self.assertEqual(self.rows("--points", "p.csv"), expected)
        self.assertEqual(self.rows("--points", "-", stdin=text), expected)
        self.good(run("query", "key.mtsm", "--points", "p.csv", "-o", "out.csv", "--quantity", "shadow"))
        self.assertEqual(pathlib.Path("out.csv").read_text(), "x,y,z,shadow\n0,0,0,1\n3,0,0,0\n")
        self.assertEqual(self.rows("--points", "-", stdin="x,y,z\n"), [])
        row, = self.rows("--points", "-", stdin="x,y,z\nnan,0,inf\n")
        self.assertEqual(row["shadow"], 0)

    def test_a_bad_line_is_named(self):
        self.fails(run("query", "key.mtsm", "--points", "-", stdin="x,y,z\n1,2,3\n1,two,3\n"), 4,
                   "standard input:3:3", '"two"')
        self.fails(run("query", "key.mtsm", "--points", "scene.obj"), 4, "scene.obj:1:1")
        self.fails(run("query", "key.mtsm", "--rays", "none.csv"), 3, "none.csv")

    def test_rays_are_blocked_up_to_tmax(self):
        rows = self.rows("--rays", "-", stdin="ox,oy,oz,dx,dy,dz,tmax\n0,0,0,0,2,0,\n0,0,0,0,2,0,0.75\n"
                                              "0,0,0,0,2,0,1.5\n3,0,0,0,1,0,inf\n")
        self.assertEqual([r["visibility"] for r in rows], [0, 1, 0, 1])
        self.assertEqual(rows[0]["dy"], 1)
        self.assertEqual(rows[0]["tmax"], math.inf)
        self.fails(run("query", "key.mtsm", "--rays", "-", "--samples", 4, stdin=""), 2, "--samples")

    def test_a_plane_becomes_a_picture_with_its_corners_where_they_belong(self):
        plane = ["--plane", "-2,0,2,4,0,0,0,0,-4", "--size", "40x20", "--seed", 3]
        self.good(run("query", "key.mtsm", *plane, "-o", "a.exr"))
        width, height, channels = read_exr("a.exr")
        self.assertEqual((width, height, sorted(channels)), (40, 20, ["shadow", "visibility"]))
        for s, v in zip(channels["shadow"], channels["visibility"]):
            self.assertAlmostEqual(s + v, 1, places=6)
        self.good(run("query", "key.mtsm", *plane, "-o", "a.csv"))
        table = csv.DictReader(pathlib.Path("a.csv").read_text().splitlines())
        rows = [{k: float(v) for k, v in row.items()} for row in table]
        self.assertEqual(len(rows), 800)
        self.assertEqual((rows[0]["x"], rows[0]["y"], rows[0]["z"]), (-1.95, 0, 1.9))
        self.assertEqual((rows[41]["x"], rows[41]["z"]), (-2 + 4 * 1.5 / 40, 2 - 4 * 1.5 / 20))
        self.assertEqual([r["shadow"] for r in rows], [float(f"{s:.9g}") for s in channels["shadow"]])

        self.good(run("query", "key.mtsm", *plane, "-o", "a.png"))
        width, height, grey = read_grey_png("a.png")
        self.assertEqual((width, height), (40, 20))
        self.assertEqual(sum(grey, []), [int(math.floor(255 * v + 0.5)) for v in channels["visibility"]])
        self.assertEqual((grey[0][0], grey[10][20]), (255, 0))
        self.good(run("query", "key.mtsm", *plane, "-o", "b.png", "--quantity", "shadow"))
        inverse = read_grey_png("b.png")[2]
        self.assertEqual((inverse[0][0], inverse[10][20]), (0, 255))

    def test_a_position_pass_gives_what_its_points_give(self):
        width, height = 6, 5
        xs = [-2 + 0.7 * (i % width) for i in range(width * height)]
        zs = [-2 + 0.8 * (i // width) for i in range(width * height)]
        xs = [struct.unpack("<f", struct.pack("<f", x))[0] for x in xs]
        zs = [struct.unpack("<f", struct.pack("<f", z))[0] for z in zs]
        ys = [0.0] * len(xs)
        alpha = [1.0] * len(xs)
        middle = 2 * width + 3  # the darkest
        alpha[middle] = 0.0
        xs[middle + 1] = math.nan
        one = [1.0] * len(xs)
        write_exr("p.exr", width, height, {"ViewLayer.Position.X": xs,
                                           "ViewLayer.Position.Y": ys, "ViewLayer.Position.Z": zs, "A": alpha, "N.X": ys, "N.Y": one,
                                           "N.Z": ys})
        passes = ["--position", "p.exr", "--normal-pass", "p.exr"]
        done = self.good(run("query", "key.mtsm", *passes, "-o", "s.exr", "--stats", "--quiet", "--json"))
        self.assertIn('positions from layer "ViewLayer.Position", normals from layer "N"', done.stderr)
        j = json.loads(done.stdout)
        self.assertEqual((j["positionLayer"], j["normalLayer"]), ("ViewLayer.Position", "N"))
        w, h, channels = read_exr("s.exr")
        self.assertEqual((w, h), (width, height))
        lines = "".join(f"{x!r},0,{z!r},0,1,0\n" for x, z in zip(xs, zs))
        expected = [r["shadow"] for r in self.rows("--points", "-", stdin="x,y,z,nx,ny,nz\n" + lines)]
        self.assertGreater(max(expected), 0.9)
        expected[middle] = expected[middle + 1] = 0  # no surface: lit
        for got, want in zip(channels["shadow"], expected):
            self.assertAlmostEqual(got, want, places=6)

        write_exr("bare.exr", 2, 2, {"R": [0] * 4, "G": [0] * 4, "B": [0] * 4})
        self.good(run("query", "key.mtsm", "--position", "bare.exr", "-o", "s.exr"))
        self.fails(run("query", "key.mtsm", "--position", "bare.exr", "--normal-pass", "./bare.exr", "-o",
                       "s.exr"), 2, "--normal-pass", "--normal-layer")
        write_exr("q.exr", 2, 2, {"a.P.X": [0] * 4, "a.P.Y": [0] * 4, "a.P.Z": [0] * 4, "b.P.X": [3] * 4,
                                  "b.P.Y": [0] * 4, "b.P.Z": [3] * 4})
        self.fails(run("query", "key.mtsm", "--position", "q.exr", "-o", "s.exr"), 2, "--position-layer",
                   "a.P.X")
        self.good(run("query", "key.mtsm", "--position", "q.exr", "--position-layer", "b.P", "-o", "s.exr"))
        self.assertEqual(read_exr("s.exr")[2]["shadow"], [0] * 4)
        self.fails(run("query", "key.mtsm", "--position", "q.exr", "--position-layer", "b.P",
                       "--normal-pass", "p.exr", "-o", "s.exr"), 2, "6 x 5", "2 x 2")
        self.fails(run("query", "key.mtsm", "--position", "scene.obj", "-o", "s.exr"), 4, "scene.obj")

    def test_json_and_stats(self):
        done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--point", "3,0,0", "--json",
                             "--stats", "--samples", 16))
        j = json.loads(done.stdout)
        self.assertEqual((j["points"], j["rays"], j["notFinite"]), (2, 32, 0))
        self.assertEqual([v["shadow"] for v in j["values"]], [1, 0])
        for word in ("2 points", "32 rays", "rays per second", "may be truncated"):
            self.assertIn(word, done.stderr)
        for quantity in ("shadow", "visibility"):
            done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--json", "--quantity", quantity))
            self.assertEqual([list(v) for v in json.loads(done.stdout)["values"]], [[quantity]])
        done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--stats", "--quiet"))
        self.assertIn("rays per second", done.stderr)
        many = "x,y,z\n" + "9,0,9\n" * 10001
        self.fails(run("query", "key.mtsm", "--points", "-", "--json", stdin=many), 2, "10 000")
        self.assertEqual(self.good(run("query", "key.mtsm", "--point", "0,0,0")).stderr, "")

    def test_the_answer_does_not_depend_on_threads(self):
        plane = ["--plane", "-2,0,2,4,0,0,0,0,-4", "--size", 32]
        for threads in (1, 2, 8):
            self.good(run("query", "key.mtsm", *plane, "--threads", threads, "-o", f"{threads}.csv"))
        one = pathlib.Path("1.csv").read_text()
        self.assertEqual(one, pathlib.Path("2.csv").read_text())
        self.assertEqual(one, pathlib.Path("8.csv").read_text())

    def test_a_full_disk_leaves_nothing_behind(self):
        plane = ["--plane", "-2,0,2,4,0,0,0,0,-4", "--size", 128]
        for name in ("a.csv", "a.exr"):
            self.fails(run("query", "key.mtsm", *plane, "-o", name, before=full_disk(256)), 3, name)
        self.leaves("scene.obj", "key.mtsm")

    def test_an_interrupt_stops_it_and_leaves_nothing_behind(self):
        process = subprocess.Popen(
            [TOOLS["query"], "key.mtsm", "--plane", "-2,0,2,4,0,0,0,0,-4", "--size", "4000", "--samples",
             "4096", "--threads", "1", "-o", "a.png"], stderr=subprocess.PIPE, text=True)
        first = process.stderr.readline()  # progress, after two seconds
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=120)
        self.assertRegex(first, r"^mtsm-query: tracing: \d+ %$")
        self.assertEqual(process.returncode, -signal.SIGINT)
        self.leaves("scene.obj", "key.mtsm")


class Dump(ToolTest):
    def setUp(self):
        super().setUp()
        self.bake_map()

    def test_the_summary_says_what_and_how(self):
        text = self.good(run("dump", "key.mtsm")).stdout
        for word in ("128 x 128 pixels, 1 face", "disk, radius 0.3", "MTSM 1.0", "world units",
                     "--light-radius 0.3", "--exclude floor", "plane z"):
            self.assertIn(word, text)
        self.assertNotIn("key.mtsm -o", text)

    def test_json_holds_the_map_s_description(self):
        j = json.loads(self.good(run("dump", "key.mtsm", "--json")).stdout)
        self.assertEqual((j["width"], j["height"], j["faces"], j["channels"]), (128, 128, 1, 1))
        self.assertEqual(j["light"], {"shape": "disk", "position": [0, 4, 0], "direction": [0, -1, 0],
                                      "radius": 0.3})
        self.assertEqual(j["pixels"], 128 * 128)
        self.assertEqual(sum(j["layerHistogram"]), j["pixels"])
        self.assertEqual(sum(i * n for i, n in enumerate(j["layerHistogram"])), j["layers"])
        self.assertEqual(j["bytes"], os.path.getsize("key.mtsm"))
        self.assertEqual(j["samplesDropped"], 0)
        # The square lies 3 below the light, and the eye further back by radius / tan(fov / 2).
        back = j["projections"][0]["eye"][1] - 4
        self.assertGreater(back, 0)
        self.assertAlmostEqual(j["zRange"][0], 3 + back, places=5)
        self.assertAlmostEqual(j["zRange"][1], 3 + back, places=5)

    def test_a_pixel_s_layers(self):
        text = self.good(run("dump", "key.mtsm", "--pixel", "64,64")).stdout
        self.assertRegex(text, r"pixel \(64, 64\), face 0: 1 layer\n")
        self.assertIn("reset", text)
        j = json.loads(self.good(run("dump", "key.mtsm", "--pixel", "64,64", "--json")).stdout)
        self.assertEqual(len(j["layers"]), 1)
        self.assertEqual((j["layers"][0]["v"], j["layers"][0]["n"], j["layers"][0]["reset"]), ([0], 1, True))
        for bad in ("128,0", "0,128", "1", "-1,0", "1.5,0", "1,2,3"):
            self.fails(run("dump", "key.mtsm", "--pixel", bad), 2, "--pixel")
        self.fails(run("dump", "key.mtsm", "--pixel", "1,1", "--face", 1), 2, "--face")

    def test_half_transparent_casters_keep_what_passes(self):
        self.bake_map("half.mtsm", "--opacity", "0.5")
        j = json.loads(self.good(run("dump", "half.mtsm", "--pixel", "64,64", "--json")).stdout)
        self.assertEqual([(l["v"], l["reset"]) for l in j["layers"]], [([0.5], False)])
        done = self.good(run("query", "half.mtsm", "--point", "0,0,0", "--json"))
        # Every ray crosses the quad once, whatever the bias.
        self.assertAlmostEqual(json.loads(done.stdout)["values"][0]["shadow"], 0.5, delta=1e-6)

    def test_a_plot_is_svg(self):
        self.good(run("dump", "key.mtsm", "--plot", "64,64", "-o", "p.svg"))
        svg = xml.dom.minidom.parse("p.svg").documentElement
        self.assertEqual(svg.tagName, "svg")
        self.assertEqual(len(svg.getElementsByTagName("circle")), 1)
        self.assertEqual(self.good(run("dump", "key.mtsm", "--plot", "64,64")).stdout,
                         pathlib.Path("p.svg").read_text())
        self.fails(run("dump", "key.mtsm", "-o", "p.svg"), 2, "--plot")
        self.fails(run("dump", "key.mtsm", "--plot", "64,64", "-o", "p.png"), 2, "SVG")

    def test_images_show_every_channel(self):
        j = json.loads(run("dump", "key.mtsm", "--json").stdout)
        for channel in ("layers", "zmin", "zmax", "visibility", "count"):
            self.good(run("dump", "key.mtsm", "--image", "a.exr", "--channel", channel))
            width, height, channels = read_exr("a.exr")
            self.assertEqual((width, height, list(channels)), (128, 128, [channel]))
            values = channels[channel]
            if channel in ("layers", "count"):
                self.assertEqual(sum(values), j["layers"])
            if channel == "visibility":
                self.assertEqual(values.count(1.0), j["emptyPixels"])
            done = self.good(run("dump", "key.mtsm", "--image", "a.png", "--channel", channel))
            self.assertRegex(done.stderr, rf"{channel}: black is .*, white is ")
            self.assertEqual(read_grey_png("a.png")[:2], (128, 128))
        self.fails(run("dump", "key.mtsm", "--image", "a.gif"), 2, ".png")
        self.fails(run("dump", "key.mtsm", "--channel", "zmin"), 2, "--image")

    def test_the_histogram_counts_pixels(self):
        text = self.good(run("dump", "key.mtsm", "--histogram")).stdout
        rows = [line.split()[:2] for line in text.splitlines()[1:]]
        self.assertEqual(sum(int(n) for _, n in rows), 128 * 128)
        self.assertIn("#", text)

    def test_views_exclude_each_other(self):
        self.fails(run("dump", "key.mtsm", "--validate", "--histogram"), 2, "excludes")
        self.fails(run("dump", "key.mtsm", "--json", "--plot", "1,1"), 2, "--json")

    def test_validate_finds_damage_and_every_tool_refuses_it(self):
        self.assertRegex(self.good(run("dump", "key.mtsm", "--validate")).stdout, "^OK key.mtsm")
        whole = pathlib.Path("key.mtsm").read_bytes()
        for cut in (0, 10, 64, len(whole) // 2, len(whole) - 1):
            pathlib.Path("cut.mtsm").write_bytes(whole[:cut])
            self.fails(run("dump", "cut.mtsm", "--validate"), 4, "cut.mtsm")
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 0x10
        pathlib.Path("flip.mtsm").write_bytes(flipped)
        self.fails(run("dump", "flip.mtsm", "--validate"), 4, "flip.mtsm")
        self.fails(run("dump", "cut.mtsm"), 4, "cut.mtsm")
        self.fails(run("query", "cut.mtsm", "--point", "0,0,0"), 4, "cut.mtsm")
        self.fails(run("dump", "scene.obj", "--validate"), 4, "scene.obj")

    def test_a_newer_major_version_is_unsupported(self):
        newer = bytearray(pathlib.Path("key.mtsm").read_bytes())
        newer[8:10] = struct.pack("<H", struct.unpack_from("<H", newer, 8)[0] + 1)
        pathlib.Path("newer.mtsm").write_bytes(newer)
        for command in (["dump", "newer.mtsm"], ["dump", "newer.mtsm", "--validate"],
                        ["query", "newer.mtsm", "--point", "0,0,0"]):
            self.fails(run(*command), 5, "newer.mtsm", "2.0")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    for key, path in zip(("bake", "query", "dump"), sys.argv[1:4]):
        TOOLS[key] = os.path.abspath(path)
    unittest.main(argv=[sys.argv[0], *sys.argv[4:]])
