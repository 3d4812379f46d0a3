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
import re
import resource
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
import xml.dom.minidom
import zlib

GOLDEN = pathlib.Path(__file__).resolve().parent.parent / "golden"
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
               --light-radius --light-size --light-angle --light-name --projection --fov --near --far
               --resolution --subsamples --bias --cull --layers --tolerance --resets --color
               --keep-hidden --near-field --rounding --quality --target-error --opacity --include --exclude --texture --hair-width --hair-tip-width --hair-opacity
               --hair-scale --density-grid --density-scale --codec --level --tree --threads --max-memory
               --quiet --json --version --help""",
    "query": """--point --normal --points --rays --position --position-layer --normal-pass
                --normal-layer --plane --size --no-normal --output --samples --seed --bias --threshold
                --attenuation --light-shape --light-position --light-radius --light-size --light-angle --method
                --no-near-field --quantity --weight --adaptive --quality --target-error --error-channel --threads --max-memory --json --stats --quiet --version --help""",
    "dump": """--json --pixel --face --plot --output --image --channel --histogram --validate
               --max-memory --version --help""",
}


def hair(strands=3, points_per_strand=2, width=0.05, declared=None, declared_points=None, points=None):
    """Cem Yuksel's .hair: strands along z above the floor, side by side; counts may lie."""
    declared = strands if declared is None else declared
    declared_points = strands * points_per_strand if declared_points is None else declared_points
    if points is None:
        points = [c for s in range(strands) for k in range(points_per_strand)
                  for c in (0.2 * s - 0.2, 1.0, 2.0 * k / (points_per_strand - 1) - 1)]
    head = b"HAIR" + struct.pack("<IIII", declared & 0xffffffff, declared_points & 0xffffffff, 2,
                                 points_per_strand - 1)
    head += struct.pack("<fffff", width, 0.0, 1, 1, 1) + bytes(88)
    return head + struct.pack(f"<{len(points)}f", *points)


def tfx(strands=2, points_per_strand=4, declared=None):
    """AMD's TressFX 4: two strands of four points."""
    declared = strands if declared is None else declared
    head = struct.pack("<fIII", 4.0, declared, points_per_strand, 160) + bytes(144)
    points = b"".join(struct.pack("<ffff", s, 1, k, 1) for s in range(strands)
                      for k in range(points_per_strand))
    return head + points


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

def write_exr(path, width, height, channels, half=False):
    """Uncompressed scanlines of floats, or of half floats; channels: name -> values, row-major."""
    names = sorted(channels)
    kind, letter = (1, "e") if half else (2, "f")
    chlist = b"".join(n.encode() + b"\0" + struct.pack("<iiii", kind, 0, 1, 1) for n in names) + b"\0"
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
        data = b"".join(struct.pack(f"<{width}{letter}", *channels[n][y * width:(y + 1) * width]) for n in names)
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


def read_png(path):
    """(width, height, rows of bytes, bytes per pixel) of an 8-bit grey or RGB PNG."""
    data = pathlib.Path(path).read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack_from(">IIBB", body)
            assert depth == 8
            step = {0: 1, 2: 3}[colour]
        if kind == b"IDAT":
            packed += body
        at += size + 12
    raw = zlib.decompress(packed)
    size = width * step
    rows, above = [], [0] * size
    for y in range(height):
        filtering, *line = raw[y * (size + 1):(y + 1) * (size + 1)]
        for x in range(size):
            a, b = (line[x - step] if x >= step else 0), above[x]
            c = above[x - step] if x >= step else 0
            p = a + b - c
            paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            line[x] = (line[x] + (0, a, b, (a + b) // 2, paeth)[filtering]) & 255
        rows.append(line)
        above = line
    return width, height, rows, step


def grey_png(rows):
    """Eight-bit grey, rows from the top."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    pixels = zlib.compress(b"".join(b"\0" + bytes(row) for row in rows))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), 8, 0, 0, 0, 0))
            + chunk(b"IDAT", pixels) + chunk(b"IEND", b""))


def read_grey_png(path):
    width, height, rows, step = read_png(path)
    assert step == 1
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
        resolution = [] if "--resolution" in more else ["--resolution", 128]
        self.good(run("bake", "scene.obj", *LIGHT, "--exclude", "floor", *resolution, "--quiet", "-o", path, *more))

    def good(self, done):
        self.assertEqual(done.returncode, 0, done.stderr)
        return done

    def fails(self, done, code, *words):
        """Exit code `code` and one error line on stderr, with all of `words` in it."""
        self.assertEqual(done.returncode, code, done.stderr)
        lines = [l for l in done.stderr.splitlines() if ": error: " in l]
        self.assertEqual(len(lines), 1, done.stderr)
        self.assertRegex(lines[0], r"^mtsm-[a-z]+: error: ")
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

    def test_an_option_that_is_misspelt_or_given_twice_is_told_so(self):
        self.fails(run("bake", "scene.obj", *LIGHT, "--qualty", "final", "-o", "a.mtsm"), 2,
                   "--qualty: there is no such option; did you mean --quality?")
        self.fails(run("query", "a.mtsm", "--postion=p.exr"), 2, "did you mean --position?")
        done = self.fails(run("dump", "a.mtsm", "--supercalifragilistic"), 2, "there is no such option")
        self.assertNotIn("did you mean", done.stderr)
        self.fails(run("bake", "scene.obj", *LIGHT, "--resol", 64, "-o", "a.mtsm"), 2, "did you mean --resolution?")
        self.fails(run("bake", "scene.obj", *LIGHT, "--resolution", 64, "--resolution", 32, "-o", "a.mtsm"), 2,
                   "--resolution: is given more than once")

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
            self.fails(run(*command, "--max-memory", "1K"), 2, "key.mtsm", "1024", "more than the 1024 that --max-memory")
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


JOB = """output = "a.mtsm"
[light]
radius = 0.3
position = [0, 4, 0]
[map]
resolution = 64
[[caster]]
file = "scene.obj"
exclude = "floor"
"""


class Job(ToolTest):
    """Job files: what they may say, what wins, and what is wrong with them."""

    def job(self, text, *arguments):
        pathlib.Path("job.toml").write_text(text)
        return run("bake", "job.toml", *arguments)

    def wrong(self, text, code, *words):
        self.fails(self.job(text), code, *words)
        self.leaves("scene.obj", "job.toml")

    def test_a_job_makes_the_map_that_its_command_line_makes(self):
        self.good(self.job(JOB, "--quiet"))
        self.good(run("bake", "scene.obj", "--exclude", "floor", "--light-radius", 0.3, "--light-position",
                      "0,4,0", "--resolution", 64, "-o", "b.mtsm", "--quiet"))
        a, b = (json.loads(run("dump", name, "--json").stdout) for name in ("a.mtsm", "b.mtsm"))
        self.assertEqual(a["settings"], "mtsm-bake scene.obj {exclude = floor} --light-position 0,4,0 "
                                        "--light-radius 0.3 --resolution 64")
        for j in (a, b):
            for key in ("settings", "file", "bytes", "blocks"):
                del j[key]
        self.assertEqual(a, b)

    def test_the_command_line_wins(self):
        self.good(self.job(JOB, "--resolution", "32x16", "-o", "b.mtsm", "--light-radius", "0.25",
                           "--exclude", "square", "--rounding", 0, "--quiet"))
        self.leaves("scene.obj", "job.toml", "b.mtsm")
        j = json.loads(run("dump", "b.mtsm", "--json").stdout)
        self.assertEqual((j["width"], j["height"], j["light"]["radius"]), (32, 16, 0.25))
        self.assertAlmostEqual(j["zRange"][1], 4 + j["projections"][0]["eye"][1] - 4, places=5)
        self.good(self.job(JOB.replace("[map]", "target = [0, 0, 0]\n[map]"), "--light-direction", "0,-1,0"))
        # It also wins over what has no meaning beside it.
        rect = JOB.replace("radius = 0.3", 'shape = "rect"\nsize = [1, 1]').replace("64", "64\nfov = 90")
        for job, options, shape in ((JOB, ["--light-angle", 1, "--light-direction", "0,-1,0"], "sun"),
                                    (JOB, ["--light-shape", "point"], "point"),
                                    (JOB.replace("radius", 'shape = "sphere"\nradius'),
                                     ["--light-radius", 0.25], "sphere"),
                                    (rect, ["--light-radius", 0.25], "disk"),
                                    (rect, ["--projection", "cube"], "rect")):
            with self.subTest(options=options):
                self.good(self.job(job, *options))
                self.assertEqual(json.loads(run("dump", "a.mtsm", "--json").stdout)["light"]["shape"], shape)

    def test_every_option_of_the_help_is_a_key(self):
        for option in OPTIONS["bake"].split():
            key = option[2:]
            if key in ("version", "help"):
                continue
            with self.subTest(key=key):
                # Where it does not belong it is told where it does: so it is known.
                table = "map" if key.startswith("light-") else "light"
                self.wrong(f"[{table}]\n{key} = 1\n", 4, f'unknown key "{key}"', " belongs ")

    def test_every_setting_is_understood(self):
        os.makedirs("sub")
        pathlib.Path("grey.png").write_bytes(grey_png([[255]]))
        pathlib.Path("fur.hair").write_bytes(hair())
        self.good(self.job("""output = "sub/a.mtsm"
            threads = 2
            max-memory = "64M"
            quiet = true
            json = true
            [light]
            shape = "rect"
            size = [1, 0.5]
            position = [0, 4, 0]
            direction = [0, -1, 0]
            up = [0, 0, 1]
            [map]
            projection = "fit"
            fov = 60
            near = 0.5
            far = 10.0
            resolution = [64, 64]
            subsamples = 1
            bias = 0.1
            cull = "none"
            layers = 4
            tolerance = 0.02
            resets = 2
            color = false
            keep-hidden = true
            near-field = "none"
            rounding = 0.0
            codec = "zstd"
            level = 5
            tree = true
            [[caster]]
            file = "scene.obj"
            include = ["square", "floor"]
            exclude = "floor"
            texture = ["no*=", "*=grey.png"]
            opacity = 1.0
            rotate = [0, 90, 0]
            translate = [0, 0.5, 0]
            scale = 0.5
            [[caster]]
            file = "fur.hair"
            hair-width = 0.01
            hair-tip-width = 0.005
            hair-opacity = 0.5
            hair-scale = 0.25
            """))
        j = json.loads(run("dump", "sub/a.mtsm", "--json").stdout)
        self.assertEqual((j["width"], j["light"]["shape"], j["light"]["size"]), (64, "rect", [1, 0.5]))
        self.assertAlmostEqual(j["bias"], 0.1, places=6)
        # The square of side 2 at height 1, halved and raised by 0.5, is 3 below the light.
        back = j["projections"][0]["eye"][1] - 4
        self.assertAlmostEqual(j["zRange"][0] - back, 3, places=5)
        self.assertIn("TREE", [block["type"] for block in j["blocks"]])
        for word in ("--resets 2", "--tolerance 0.02", "--keep-hidden", "--tree", "transform = ", "include = square",
                     "texture = *=grey.png", "hair-width = 0.01, hair-tip-width = 0.005, hair-opacity = 0.5, "
                     "hair-scale = 0.25"):
            self.assertIn(word, j["settings"])

    def test_casters_are_moved_one_by_one(self):
        two = JOB + 'translate = [0, 1, 0]\n' + '[[caster]]\nfile = "scene.obj"\nexclude = "floor"\n' \
            'transform = [1,0,0,5, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n'
        self.good(self.job(two, "--quiet", "--light-target", "0,0,0"))
        for x, y in ((0, 1.5), (5, 0.5)):  # under either square
            row, = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", f"{x},{y},0").stdout))
            self.assertEqual(float(row["shadow"]), 1, (x, y))
        row, = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", "0,2.5,0").stdout))
        self.assertEqual(float(row["shadow"]), 0)

    def test_paths_are_relative_to_the_job(self):
        os.mkdir("jobs")
        pathlib.Path("jobs/j.toml").write_text(JOB.replace('"scene.obj"', '"../scene.obj"'))
        self.good(run("bake", "jobs/j.toml", "--quiet"))
        self.assertEqual(sorted(os.listdir("jobs")), ["a.mtsm", "j.toml"])

    def test_unknown_keys_get_a_suggestion(self):
        for wrong, place, words in (
                ('[map]\ntolerence = 0.1', "2:1", ['"tolerence" in [map]', 'did you mean "tolerance"?']),
                ('[map]\nkeep_hidden = true', "2:1", ['did you mean "keep-hidden"?']),
                ('tolerance = 0.1', "1:1", ['"tolerance" belongs in [map]']),
                ('[light]\nlight-radius = 1', "2:1", ['did you mean "radius"?']),
                ('[light]\ntolerance = 1', "2:1", ['"tolerance" belongs in [map]']),
                ('[lights]\nradius = 1', "1:2", ['did you mean "light"?']),
                ('[[casters]]\nfile = "a"', "1:3", ['did you mean "caster"?']),
                ('[[caster]]\nfile = "scene.obj"\nhair-widht = 1', "3:1", ['did you mean "hair-width"?']),
                ('[map]\nsupercalifragilistic = 1', "2:1", ["keys there are: ", "tolerance"])):
            with self.subTest(wrong=wrong):
                self.wrong(wrong + "\n", 4, f"job.toml:{place}: unknown key", *words)

    def test_wrong_values_are_told_with_place_found_and_expected(self):
        for wrong, place, words in (
                ('[map]\nresolution = "big"', "2:14", ['text ("big")', "pixels, such as 1024"]),
                ('[map]\nlayers = 2.5', "2:10", ["the number 2.5", "a whole number"]),
                ('[map]\ntolerance = nan', "2:13", ["nan", "a finite number"]),
                ('[map]\ncolor = 1', "2:9", ["the whole number 1", "true or false"]),
                ('[map]\nresets = "some"\n' + JOB.replace("[map]", "[x]"), "", ["unknown key"]),
                ('[light]\nposition = [1, 2]', "2:12", ["a list of 2 values", "three finite numbers"]),
                ('[light]\nposition = 1979-05-27', "2:12", ["a date", "three finite numbers"]),
                ('[light]\nshape = {a = 1}', "2:9", ["a table", "text"]),
                ('map = 3', "1:7", ["the whole number 3", "[map]"]),
                ('caster = "scene.obj"', "1:10", ["[[caster]]"]),
                ('[[caster]]\nopacity = 1', "1:1", ["no file"]),
                ('[[caster]]\nfile = "scene.obj"\ntransform = [1, 2, 3]', "3:13", ["16 finite numbers"]),
                ('[[caster]]\nfile = "scene.obj"\nscale = 0', "3:9", ["scene.obj", "invertible"]),
                ('[[caster]]\nfile = "scene.obj"\nopacity = 1.5', "3:11", ["opacity 1.5", "[0, 1]"]),
                ('[[caster]]\nfile = "scene.obj"\ndensity-scale = 2', "3:17", ["density-scale", "a volume"]),
                ('[[caster]]\nfile = "scene.obj"\nscale = 2\ntransform = [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]',
                 "4:13", ["exclude each other"]),
                ('x = = 1', "1:5", ["is not TOML"]),
                ('a = [[[[[[', "1:", ["is not TOML"]),
                ('[map]\nlayers = 1\nlayers = 2', "3:", ["is not TOML"])):
            with self.subTest(wrong=wrong):
                self.wrong(wrong + "\n", 4, f"job.toml:{place}", *words)
        # What the command line's own checks find has a place too.
        self.wrong(JOB.replace("radius = 0.3", "radius = -1"), 4, "job.toml:3:1: light.radius", '"-1"',
                   "at least 0")
        self.wrong(JOB.replace("64", "64\nresets = \"some\""), 4, "job.toml:7:1: map.resets", '"some"')
        self.wrong(JOB.replace("64", "[100000, 4]"), 4, "job.toml:6:1: map.resolution", "100000x4")
        self.wrong('max-memory = "12Q"\n' + JOB, 4, "job.toml:1:1: max-memory", '"12Q"')
        # So has what is wrong only beside something else.
        self.wrong(JOB.replace("64", "64\nnear = 5\nfar = 2"), 4, "job.toml:7:1: map.near", "less than far")
        self.wrong(JOB.replace("64", '64\ncodec = "none"\nlevel = 3'), 4, "job.toml:8:1: map.level")
        self.wrong(JOB.replace("radius = 0.3", 'shape = "sun"\nangle = 1'), 4, "light.position", "a sun light")
        self.fails(self.job(JOB.replace("64", "64\nfar = 2"), "--near", 5), 2, "--near")
        self.wrong(JOB.replace("radius = 0.3", "target = [0, 0, 0]\ndirection = [0, -1, 0]"), 4,
                   "exclude each other")

    def test_what_is_missing_is_told(self):
        self.wrong(JOB.replace("scene.obj", "none.obj"), 3, "job.toml:8:8", "none.obj")
        self.wrong("", 4, "job.toml", "[[caster]]")
        self.wrong(JOB.replace('output = "a.mtsm"', ""), 2, "-o", "required", "output = ")
        self.fails(run("bake", "none.toml"), 3, "none.toml", "No such file")
        self.fails(run("bake", "job.toml", "scene.obj", "-o", "a.mtsm"), 2, "give it alone")
        os.mkdir("folder.toml")
        self.fails(run("bake", "folder.toml"), 3, "folder.toml", "folder")

    def test_hostile_jobs_are_bad_files(self):
        nested = "a = " + "[" * 100000
        for text in (nested, ".".join("a" * 50000) + " = 1", "[" + ".".join("a" * 50000) + "]",
                     'output = "a\\u0000b"', "\0" * 100, "a" * 100000, "a.b" * 3000 + " = 1", '"\x1b[2J" = 1',
                     "x = " + "9" * 400, "[map]\nresolution = 99999999999999999999", "\ufeff[map"):
            with self.subTest(text=text[:20]):
                done = self.job(text)
                self.fails(done, 4, "job.toml")
                self.assertNotIn("\x1b", done.stderr)
        pathlib.Path("job.toml").write_bytes(bytes(range(256)))
        self.fails(run("bake", "job.toml"), 4, "job.toml")
        with open("job.toml", "wb") as file:
            file.truncate(1 << 33)  # sparse
        self.fails(run("bake", "job.toml"), 4, "16 MiB")


class Casters(ToolTest):
    """Hair and volumes on the command line, whole and broken."""

    def setUp(self):
        super().setUp()
        pathlib.Path("fur.hair").write_bytes(hair())

    def bake(self, *arguments):
        return run("bake", *arguments, *LIGHT, "--resolution", 64, "-o", "a.mtsm")

    def test_hair_is_read_and_counted(self):
        done = self.good(self.bake("fur.hair", "--hair-opacity", 0.5, "--json"))
        j = json.loads(done.stdout)
        self.assertEqual((j["casters"]["strands"], j["casters"]["segments"], j["casters"]["meshes"]),
                         (3, 3, 0))
        self.assertGreater(j["samples"], 0)
        self.assertIn("3 strands, 3 segments", done.stderr)
        done = self.good(self.bake("fur.hair", "scene.obj", "--exclude", "floor", "--hair-width", 0.1,
                                   "--hair-tip-width", 0))
        self.assertIn("1 mesh, 2 triangles; 3 strands, 3 segments", done.stderr)
        pathlib.Path("fur.tfx").write_bytes(tfx())
        self.assertIn("2 strands, 6 segments", self.good(self.bake("fur.tfx", "--hair-width", 0.1)).stderr)

    def test_strands_wider_than_their_segments_are_long_are_told(self):
        for width, told in ((1.9, False), (2.1, True)):
            done = self.good(self.bake("fur.hair", "--hair-width", width, "--hair-tip-width", width))
            text = f"strands are {width} wide and their segments 2 long"
            self.assertEqual(text in done.stderr, told, done.stderr)

    def test_a_job_gives_each_hair_file_its_own_width(self):
        pathlib.Path("job.toml").write_text("""[light]
            radius = 0.3
            position = [0, 4, 0]
            [[caster]]
            file = "fur.hair"
            hair-width = 0.1
            hair-opacity = 0.5
            [[caster]]
            file = "fur.hair"
            translate = [0, -0.5, 0]
            """)
        self.good(run("bake", "job.toml", "-o", "a.mtsm", "--quiet"))
        settings = json.loads(run("dump", "a.mtsm", "--json").stdout)["settings"]
        self.assertIn("fur.hair {hair-width = 0.1", settings)
        self.assertIn("fur.hair {transform = ", settings)

    def test_a_volume_is_read_and_its_grid_can_be_named(self):
        make = os.environ.get("MTSM_MAKE_SMOKE")
        if not make:
            self.skipTest("no generator of volumes was built")
        subprocess.run([make, "--size", "16", "-o", "smoke.vdb"], check=True, stderr=subprocess.DEVNULL)
        shadow = {}
        # Volumes have an error of their own, not that of hair.
        done = self.good(self.bake("smoke.vdb", "--target-error", 0.01, "--json"))
        self.assertNotIn("warning", done.stderr)
        self.assertAlmostEqual(json.loads(done.stdout)["quality"]["mapError"], 0.0004 * 1024 / 64, places=6)
        for scale in (1, 0.1):
            done = self.good(self.bake("smoke.vdb", "--density-scale", scale, "--json"))
            j = json.loads(done.stdout)
            self.assertEqual((j["casters"]["volumes"], j["casters"]["meshes"]), (1, 0))
            self.assertGreater(j["casters"]["voxels"], 100)
            self.assertIn("1 volume, ", done.stderr)
            row, = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", "0,0,0", "--samples", 1).stdout))
            shadow[scale] = float(row["shadow"])
        self.assertLess(shadow[0.1], shadow[1])
        self.good(self.bake("smoke.vdb", "--density-grid", "density"))
        self.fails(self.bake("smoke.vdb", "--density-grid", "heat"), 2, "smoke.vdb", '"heat"', "density")
        self.fails(self.bake("smoke.vdb", "--hair-width", 1), 2, "none of the inputs is hair")
        data = pathlib.Path("smoke.vdb").read_bytes()
        for cut in (100, len(data) // 2, len(data) - 10):
            pathlib.Path("cut.vdb").write_bytes(data[:cut])
            self.fails(self.bake("cut.vdb"), 4, "cut.vdb")

    def test_settings_that_leave_nothing_to_cast_are_named(self):
        for arguments, *words in (
                (["fur.hair", "--hair-width", 0], "a hair-width of 0 leaves strands out", "world units"),
                (["fur.hair", "--hair-opacity", 0], "a hair-opacity of 0 lets all light through", "more than 0"),
                (["scene.obj", "--opacity", 0], "an opacity of 0 lets all light through", "more than 0"),
                (["scene.obj", "fur.hair", "--opacity", 0, "--hair-width", 0], "an opacity of 0", "a hair-width of 0")):
            with self.subTest(arguments=arguments):
                done = self.fails(self.bake(*arguments), 4, "nothing casts a shadow: ", *words)
                self.assertNotIn("triangle", done.stderr)
        job = JOB.replace("scene.obj", "fur.hair").replace('exclude = "floor"', "hair-width = 0")
        pathlib.Path("job.toml").write_text(job)
        self.fails(run("bake", "job.toml"), 4, "a hair-width of 0 leaves strands out")
        self.leaves("scene.obj", "fur.hair", "job.toml")
        # One of several may be left out like this.
        self.good(self.bake("scene.obj", "fur.hair", "--hair-width", 0, "--quiet"))
        make = os.environ.get("MTSM_MAKE_SMOKE")
        if not make:
            self.skipTest("no generator of volumes was built")
        subprocess.run([make, "--size", "16", "-o", "smoke.vdb"], check=True, stderr=subprocess.DEVNULL)
        done = self.fails(self.bake("smoke.vdb", "--density-scale", 0), 4,
                          "nothing casts a shadow: a density-scale of 0 makes volumes empty: give more than 0")
        self.assertNotIn("triangle", done.stderr)

    def textured(self):
        """The square of SCENE with texture coordinates and two materials, and a mask of two halves."""
        pathlib.Path("card.obj").write_text(
            "v -1 1 -1\nv 1 1 -1\nv 1 1 1\nv -1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
            "mtllib card.mtl\nusemtl Leaf_2\nf 1/1 2/2 3/3 4/4\n")
        pathlib.Path("card.mtl").write_text("newmtl Leaf_2\nKd 0 1 0\n")
        pathlib.Path("half.png").write_bytes(grey_png([[0] * 8 + [255] * 8] * 16))

    def halves(self, map):
        """Shadow factors under the left and the right half of the square."""
        done = self.good(run("query", map, "--point", "-0.4,0,0", "--point", "0.4,0,0"))
        return [float(row["shadow"]) for row in csv.DictReader(io.StringIO(done.stdout))]

    def test_a_texture_is_given_to_materials_by_name(self):
        self.textured()
        for texture, shadows in ((["Leaf*=half.png"], [0, 1]), (["leaf*=half.png"], [1, 1]),
                                 (["*=half.png", "Leaf_2="], [1, 1]),
                                 (["*=", "Leaf_[0-9]=half.png"], [0, 1])):
            with self.subTest(texture=texture):
                options = [word for one in texture for word in ("--texture", one)]
                self.good(self.bake("card.obj", *options))
                self.assertEqual(self.halves("a.mtsm"), shadows)
                settings = json.loads(run("dump", "a.mtsm", "--json").stdout)["settings"]
                self.assertIn("--texture " + shlex.quote(texture[-1]), settings)
        os.mkdir("jobs")
        pathlib.Path("jobs/j.toml").write_text(
            'output = "a.mtsm"\n[light]\nradius = 0.3\nposition = [0, 4, 0]\n[map]\nresolution = 64\n'
            '[[caster]]\nfile = "../card.obj"\ntexture = "Leaf*=../half.png"\n')
        self.good(run("bake", "jobs/j.toml"))
        self.assertEqual(self.halves("jobs/a.mtsm"), [0, 1])
        self.good(run("bake", "jobs/j.toml", "--texture", "Leaf*="))
        self.assertEqual(self.halves("jobs/a.mtsm"), [1, 1])

    def test_a_texture_that_cannot_be_used_is_named(self):
        self.textured()
        for texture in ("half.png", "=half.png", ""):
            self.fails(self.bake("card.obj", "--texture", texture), 2, "--texture")
        self.fails(self.bake("card.obj", "--texture", "*=none.png"), 3, "--texture", "none.png", "folder")
        self.fails(self.bake("card.obj", "--texture", "*=card.mtl"), 3, "card.mtl", "texture")
        job = 'output = "a.mtsm"\n[[caster]]\nfile = "card.obj"\ntexture = '
        for value, code, words in (('"half.png"', 4, ["job.toml:4:11", '"half.png"', "PATTERN=IMAGE"]),
                                   ("[]", 4, ["job.toml:4:11", "a list of 0 values"]),
                                   ('["*=half.png", "*=none.png"]', 3, ["job.toml:4:11: texture", "none.png"])):
            pathlib.Path("job.toml").write_text(job + value + "\n")
            self.fails(run("bake", "job.toml"), code, *words)
        self.leaves("scene.obj", "fur.hair", "card.obj", "card.mtl", "half.png", "job.toml")

    def test_six_faces_make_one_map(self):
        done = self.good(run("bake", "scene.obj", "--light-shape", "point", "--light-position", "0,2,0",
                             "--projection", "cube", "--resolution", 32, "-o", "a.mtsm", "--json"))
        self.assertEqual(json.loads(done.stdout)["faces"], 6)
        rows = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", "0.1,0.5,0.1", "--point",
                                              "3,1.5,0.1").stdout))
        self.assertEqual([float(row["shadow"]) for row in rows], [1, 0])

    def test_options_of_a_kind_need_an_input_of_that_kind(self):
        for option in ("--opacity", "--include", "--exclude", "--density-scale", "--density-grid"):
            self.fails(self.bake("fur.hair", option, "1"), 2, option, "none of the inputs")
        self.fails(self.bake("fur.hair", "--texture", "*="), 2, "--texture", "none of the inputs")
        pathlib.Path("a.ply").write_text("ply\n")
        for option in ("--hair-width", "--hair-scale", "--hair-opacity"):
            self.fails(self.bake("a.ply", option, "1"), 2, option, "none of the inputs is hair")
        self.fails(self.bake("fur.hair", "--hair-tip-width", 1), 2, "hair-tip-width needs hair-width")
        self.fails(self.bake("fur.hair", "--hair-scale", 0), 2, "hair-scale")

    def test_hostile_files_are_one_line_and_keep_the_old_map(self):
        pathlib.Path("a.mtsm").write_text("the old map")
        nan, huge = math.nan, 10**12
        hostile = {
            "cut.hair": hair()[:100], "empty.hair": b"", "text.hair": b"this is no hair at all" * 20,
            "short.hair": hair()[:-4], "many.hair": hair(declared=huge, declared_points=huge),
            "most.hair": hair(declared=2**32 - 1, declared_points=2**32 - 1),
            "wrong.hair": hair(declared_points=5), "negative.hair": hair(width=-1),
            "width.hair": hair(width=nan), "nan.hair": hair(points=[nan] * 18),
            "cut.tfx": tfx()[:50], "empty.tfx": b"", "many.tfx": tfx(declared=2**31 - 1),
            "cut2.tfx": tfx()[:-8],
            "empty.vdb": b"", "text.vdb": b"this is no volume" * 100,
            "magic.vdb": b" BDV\0\0\0\0" + bytes(20), "noise.vdb": b" BDV\0\0\0\0" + bytes(range(256)) * 9}
        for name, data in hostile.items():
            with self.subTest(name=name):
                pathlib.Path(name).write_bytes(data)
                self.fails(self.bake(name), 4, name if name != "nan.hair" else "")
                self.assertEqual(pathlib.Path("a.mtsm").read_text(), "the old map")
        self.leaves("scene.obj", "fur.hair", "a.mtsm", *hostile)
        self.fails(self.bake("none.vdb"), 3, "none.vdb")
        self.fails(self.bake("none.hair"), 3, "none.hair")
        self.fails(self.bake("none.obj"), 3, "none.obj")

    def test_six_faces_exclude_what_has_no_meaning_for_them(self):
        cube = ["scene.obj", "--projection", "cube"]
        self.fails(self.bake(*cube, "--fov", 60), 2, "--fov", "cube")
        self.fails(run("bake", *cube, *LIGHT, "--resolution", "64x32", "-o", "a.mtsm"), 2, "--resolution",
                   "square")
        self.fails(run("bake", *cube, "--light-angle", 1, "--light-direction", "0,-1,0", "-o", "a.mtsm"), 2,
                   "--projection", "sun")

    def test_the_summary_says_what_the_settings_lost(self):
        layers = "".join(f"v {x} {y} {z}\n" for y in (0.2, 0.4, 0.6, 0.8)
                         for x, z in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
        faces = "".join(f"f {i} {i + 1} {i + 2} {i + 3}\n" for i in (1, 5, 9, 13))
        pathlib.Path("sheets.obj").write_text(layers + faces)
        j = json.loads(self.good(self.bake("sheets.obj", "--layers", 3, "--json")).stdout)
        self.assertEqual(j["maxLayers"], 3)
        self.assertGreater(j["samples"], 0)
        self.assertGreater(j["droppedByLayers"] + j["droppedHidden"], 0)
        done = self.good(self.bake("sheets.obj", "--opacity", 0.5, "--tolerance", 0, "--json"))
        j = json.loads(done.stdout)
        self.assertEqual((j["toleranceAsked"], j["toleranceReached"], j["droppedByLayers"]), (0, 0, 0))
        self.assertEqual(j["layers"], j["samples"])
        self.assertGreater(j["peakMemory"], 1 << 20)
        for word in ("tolerance 0, reached 0", "in 1 pass", "dropped nothing", "of memory"):
            self.assertIn(word, done.stderr)
        row, = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", "0,0,0", "--method", "scalar").stdout))
        self.assertAlmostEqual(float(row["shadow"]), 1 - 0.5 ** 4, places=5)
        row, = csv.DictReader(io.StringIO(run("query", "a.mtsm", "--point", "0,0,0", "--attenuation",
                                              "subtract").stdout))
        self.assertAlmostEqual(float(row["shadow"]), 1 - 0.5 ** 4, places=5)
        j = json.loads(run("dump", "a.mtsm", "--json").stdout)
        self.assertEqual((j["opaqueTiles"], j["translucentTiles"], j["layerSamples"]),
                         (0, j["tiles"] - j["emptyTiles"], j["samples"]))


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

    def test_a_light_that_reaches_into_casters_is_told(self):
        for height, reaches in ((1.2, True), (2, False)):
            done = self.good(self.bake("--light-shape", "sphere", "--light-radius", 0.3, "--projection", "cube",
                                       "--light-position", f"0,{height},0", "--resolution", 64))
            self.assertEqual("warning: the light reaches into casters" in done.stderr, reaches, done.stderr)

    def test_the_height_of_a_rect_is_up(self):
        def axis(*options):
            self.good(self.bake("--light-size", "1.6,0.6", *options, "--quiet"))
            return json.loads(run("dump", "a.mtsm", "--json").stdout)["light"]["up"]

        for position, direction, up in (("3,4,0.5", "-3,-3,-0.5", (0, 1, 0)), ("0,4,0", "0,-1,0", (0, 0, 1))):
            d = [float(x) for x in direction.split(",")]
            along = sum(a * b for a, b in zip(up, d)) / sum(a * a for a in d)
            across = [a - along * b for a, b in zip(up, d)]
            length = math.sqrt(sum(a * a for a in across))
            found = axis("--light-position", position, "--light-direction", direction)
            for a, b in zip(found, across):
                self.assertAlmostEqual(a, b / length, places=6)
        found = axis("--light-position", "3,4,0.5", "--light-direction", "-3,-3,-0.5", "--light-up", "0,0,1")
        self.assertGreater(found[2], 0.9)

    def test_trees_are_kept_when_asked_for_and_queries_answer_the_same(self):
        for options in ([], ["--opacity", "0.5"], ["--near-field", "none"]):
            self.bake_map("without.mtsm", *options)
            self.bake_map("with.mtsm", "--tree", *options)
            dumped = json.loads(run("dump", "with.mtsm", "--json").stdout)
            self.assertIn("TREE", [block["type"] for block in dumped["blocks"]])
            self.assertRegex(self.good(run("dump", "with.mtsm", "--validate")).stdout, "^OK")
            outputs = []
            for name in ("without", "with"):
                query = ["query", f"{name}.mtsm", "--plane", "-2,0,-2,4,0,0,0,0,4", "--size", "20x20",
                         "--samples", 32, "-o", "s.csv", "--json"]
                told = json.loads(self.good(run(*query)).stdout)
                outputs.append((pathlib.Path("s.csv").read_text(), told["memoryBytes"]))
            self.assertEqual(*outputs)
        # Queries that do not go through them have the layers.
        for options in (["--method", "pcf"], ["--attenuation", "subtract"], ["--no-near-field"]):
            done = [self.good(run("query", f"{name}.mtsm", "--point", "0.3,0,0.2", *options)).stdout
                    for name in ("without", "with")]
            self.assertEqual(*done)

    def test_says_what_trees_take(self):
        done = self.good(self.bake(*LIGHT, "--tree", "--json"))
        self.assertGreater(json.loads(done.stdout)["trees"]["bytes"], 0)
        self.assertIn("trees: ", done.stderr)
        self.assertEqual(json.loads(self.good(self.bake(*LIGHT, "--json")).stdout)["trees"]["bytes"], 0)
        pathlib.Path("tiny.obj").write_text("v 0.001 1 0.001\nv 0.0011 1 0.001\nv 0.001 1 0.0011\nf 1 2 3\n")
        done = self.good(run("bake", "tiny.obj", *LIGHT, "--light-target", "0,0,0", "--fov", 20, "--resolution", 8,
                             "--tree", "-o", "a.mtsm"))
        self.assertIn("warning: no trees: ", done.stderr)
        self.assertNotIn("TREE", run("dump", "a.mtsm").stdout)

    def test_a_near_field_is_kept_within_its_size_or_not_at_all(self):
        for size in ("auto", "1M", 10000):
            done = self.good(self.bake(*LIGHT, "--near-field", size, "--json"))
            near = json.loads(done.stdout)["nearField"]
            self.assertEqual((near["kept"], near["triangles"], near["reason"]), (True, 4, ""))
            self.assertIn("near field: 4 triangles", done.stderr)
            dumped = json.loads(run("dump", "a.mtsm", "--json").stdout)
            self.assertEqual(dumped["nearField"]["triangles"], 4)
            self.assertEqual(dumped["nearField"]["memoryBytes"], near["bytes"])
            self.assertIn("NEAR", [block["type"] for block in dumped["blocks"]])
            self.assertIn("4 triangles in ", run("dump", "a.mtsm").stdout)
        done = self.good(self.bake(*LIGHT, "--near-field", 100, "--json"))
        self.assertFalse(json.loads(done.stdout)["nearField"]["kept"])
        self.assertIn("warning: no near field: it takes about 1M: --near-field 1M would hold it", done.stderr)
        done = self.good(self.bake(*LIGHT, "--near-field", "1M", "--opacity", 0.5))
        self.assertIn("near field: 4 triangles", done.stderr)
        self.assertIn("CARD", run("dump", "a.mtsm").stdout)
        done = self.good(self.bake(*LIGHT, "--near-field", "1M", "--opacity", 0.5, "--color"))
        self.assertIn("warning: no near field: only casters that are all opaque", done.stderr)
        done = self.good(self.bake(*LIGHT, "--near-field", "auto", "--opacity", 0.5, "--color"))
        self.assertIn("no near field: only casters", done.stderr)
        self.assertNotIn("warning", done.stderr)
        done = self.good(self.bake(*LIGHT))  # auto
        self.assertIn("near field: 4 triangles", done.stderr)
        done = self.good(self.bake(*LIGHT, "--near-field", "none"))
        self.assertNotIn("near field", done.stderr)
        self.assertEqual(json.loads(run("dump", "a.mtsm", "--json").stdout)["nearField"]["chunks"], 0)
        for wrong in ("0", "lots", "-1", "auto "):
            self.fails(self.bake(*LIGHT, "--near-field", wrong), 2, "--near-field", wrong, "auto or none")

    def test_what_is_no_mesh_is_a_bad_file(self):
        pathlib.Path("text.ply").write_text("this is no mesh at all\n")
        self.fails(run("bake", "text.ply", *LIGHT, "-o", "a.mtsm"), 4, "text.ply")
        pathlib.Path("empty.obj").write_text("# nothing\n")
        self.fails(run("bake", "empty.obj", *LIGHT, "-o", "a.mtsm"), 4, "empty.obj", "repair the file")
        pathlib.Path("smoke.nvdb").write_text("no volume that can be read\n")
        self.fails(run("bake", "smoke.nvdb", *LIGHT, "-o", "a.mtsm"), 5, "smoke.nvdb", ".hair", ".vdb", "convert")
        self.leaves("scene.obj", "text.ply", "empty.obj", "smoke.nvdb")

    def test_a_mesh_of_nan_is_a_bad_file(self):
        pathlib.Path("nan.ply").write_text(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
            "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
            "nan nan nan\nnan nan nan\nnan nan nan\n3 0 1 2\n")
        self.fails(run("bake", "nan.ply", *LIGHT, "-o", "a.mtsm"), 4)
        self.leaves("scene.obj", "nan.ply")

    def test_resolution_and_other_numbers_are_checked(self):
        for option, value in (("--resolution", "0"), ("--resolution", "0x16"), ("--resolution", "40000"),
                              ("--resolution", "1x2x3"), ("--layers", "0"), ("--layers", "2000000"), ("--tolerance", "1.5"),
                              ("--tolerance", "nan"), ("--resets", "-1"), ("--resets", "some"), ("--subsamples", "0"),
                              ("--subsamples", "9"), ("--projection", "globe"), ("--hair-width", "-1"),
                              ("--hair-opacity", "2"), ("--hair-scale", "nan"), ("--density-scale", "-1"),
                             
                              ("--opacity", "1.5"), ("--opacity", "nan"), ("--bias", "-1"),
                              ("--level", "20"), ("--fov", "180"), ("--fov", "0"), ("--near", "inf"),
                              ("--cull", "sideways"), ("--codec", "rar"), ("--max-memory", "lots"),
                              ("--light-up", "1,2"), ("--light-up", "0,0,0"), ("--threads", "-1")):
            with self.subTest(option=option, value=value):
                self.fails(self.bake(*LIGHT, option, value), 2, option)
        self.fails(self.bake(*LIGHT, "--near", 3, "--far", 2), 2, "near must be less than far")
        # What a map of that size takes whatever is in it: four bytes a pixel at least.
        done = self.fails(self.bake(*LIGHT, "--max-memory", "1M"), 2, "needs at least", "1048576")
        self.assertGreaterEqual(int(re.search(r"at least (\d+)", done.stderr)[1]), 4 * 1024 * 1024)
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
        self.fails(self.bake(*LIGHT, "--light-direction", "0,0,0"), 2, "--light-direction", "found 0, 0, 0", "no length",
                   "expected X,Y,Z")
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
        for size, line in (("0,1", True), ("1,0", True), ("1,1", False)):
            done = self.good(self.bake("--light-size", size, "--light-position", "0,4,0", "--quiet"))
            self.assertEqual("it is a line" in done.stderr, line, size)

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
        self.assertEqual(rows[0]["tmax"], math.inf)
        # What was asked comes back as it was, so that rows can be joined by it.
        text = "ox,oy,oz,dx,dy,dz,tmax\n3,0.1,0,2,5,3,7.5\n3,0,0,0,0,0,1\n"
        out = self.good(run("query", "key.mtsm", "--rays", "-", stdin=text)).stdout
        self.assertEqual([line.rsplit(",", 1)[0] for line in out.splitlines()], text.splitlines())
        done = self.good(run("query", "key.mtsm", "--rays", "-", "--stats",
                             stdin="ox,oy,oz,dx,dy,dz,tmax\n0,0,0,0,1,0,-1\n0,0,0,0,1,0,0\n"))
        self.assertIn("1 ray has a tmax below 0", done.stderr)
        self.assertIn("2 rays, ", done.stderr)
        self.assertNotIn("points", done.stderr)
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
        self.assertEqual((j["points"], j["notFinite"]), (len(xs) - 2, 1))
        w, h, channels = read_exr("s.exr")
        self.assertEqual((w, h), (width, height))
        lines = "".join(f"{x!r},0,{z!r},0,1,0\n" for x, z in zip(xs, zs))
        expected = [r["shadow"] for r in self.rows("--points", "-", stdin="x,y,z,nx,ny,nz\n" + lines)]
        self.assertGreater(max(expected), 0.9)
        expected[middle] = expected[middle + 1] = 0  # no surface: lit
        for got, want in zip(channels["shadow"], expected):
            self.assertAlmostEqual(got, want, places=6)

        bare, named = ({c: [0] * 4 for c in names} for names in (("R", "G", "B"), ("P.X", "P.Y", "P.Z")))
        for path, channels, half, warnings in (
                ("half.exr", named, True, ['half.exr: layer "P" has half floats']), ("named.exr", named, False, []),
                ("bare.exr", bare, False, ["bare.exr: the one unnamed layer is read as positions"])):
            write_exr(path, 2, 2, channels, half)
            done = self.good(run("query", "key.mtsm", "--position", path, "-o", "s.exr"))
            self.assertEqual(done.stderr.count("warning"), len(warnings), done.stderr)
            self.assertIn(f"{path}: no normals: ", done.stderr)
            for warning in warnings:
                self.assertIn(warning, done.stderr)
        done = self.good(run("query", "key.mtsm", "--position", "named.exr", "--normal-pass", "bare.exr", "-o", "s.exr"))
        self.assertNotIn("no normals", done.stderr)
        self.assertIn("bare.exr: the one unnamed layer is read as normals", done.stderr)
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

    def test_a_position_pass_without_a_position_is_a_bad_file(self):
        zero, nan, inf = [0.0] * 6, [math.nan] * 6, [math.inf] * 6
        one, query = [1.0] * 6, ["query", "key.mtsm", "--position", "p.exr", "-o", "s.exr"]
        for x, alpha, *words in (
                (nan, None, 'p.exr: layer "P": 6 of 6 pixels have no position (NaN or infinite); give the file that has them, '
                            "or name their layer with --position-layer"),
                (inf, one, "6 of 6 pixels"), (nan, [0, 0, 1, 1, 1, 1], "4 of 4 pixels where alpha is above 0")):
            write_exr("p.exr", 3, 2, {"P.X": x, "P.Y": zero, "P.Z": zero, **({"A": alpha} if alpha else {})})
            self.fails(run(*query), 4, *words)
        self.leaves("scene.obj", "key.mtsm", "p.exr")
        # Background is nobody's mistake, whether alpha knows of it or not.
        part = [0, 0, math.nan, math.nan, math.nan, math.nan]
        for alpha in (None, one, [1, 1, 0, 0, 0, 0], [1, 1, 1, 0, 0, 0]):
            write_exr("p.exr", 3, 2, {"P.X": part, "P.Y": zero, "P.Z": zero, **({"A": alpha} if alpha else {})})
            self.assertEqual(self.good(run(*query, "--quiet")).stderr, "", alpha)
            self.assertEqual(read_exr("s.exr")[2]["shadow"], [1, 1, 0, 0, 0, 0])
        # But alpha that shows more than there are positions for is worth a word.
        write_exr("p.exr", 3, 2, {"P.X": part, "P.Y": zero, "P.Z": zero, "A": [1, 1, 1, 1, 1, 0]})
        self.assertIn("3 of 5 pixels where alpha is above 0 have no position (NaN or infinite) and are lit",
                      self.good(run(*query)).stderr)
        write_exr("p.exr", 3, 2, {"P.X": zero, "P.Y": zero, "P.Z": zero, "A": zero})
        self.assertIn("warning: p.exr: alpha is 0 in all 6 pixels", self.good(run(*query)).stderr)
        self.assertEqual(read_exr("s.exr")[2]["shadow"], zero)

    def test_json_and_stats(self):
        done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--point", "3,0,0", "--json",
                             "--stats", "--samples", 16))
        j = json.loads(done.stdout)
        self.assertEqual((j["points"], j["rays"], j["notFinite"]), (2, 32, 0))
        self.assertEqual([v["shadow"] for v in j["values"]], [1, 0])
        self.assertGreater(j["memoryBytes"], 1000)
        for word in ("2 points", "32 rays", "rays per second", "may be truncated", "; it takes "):
            self.assertIn(word, done.stderr)
        for quantity in ("shadow", "visibility"):
            done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--json", "--quantity", quantity))
            self.assertEqual([list(v) for v in json.loads(done.stdout)["values"]], [[quantity]])
        done = self.good(run("query", "key.mtsm", "--point", "0,0,0", "--stats", "--quiet"))
        self.assertIn("rays per second", done.stderr)
        self.assertIn("1 point, 64 rays", done.stderr)
        self.assertIn("expected mean error: 0 of the samples", done.stderr)
        self.assertIn("to make the map ready", done.stderr)
        many = "x,y,z\n" + "9,0,9\n" * 10001
        self.fails(run("query", "key.mtsm", "--points", "-", "--json", stdin=many), 2, "10 000")
        self.assertEqual(self.good(run("query", "key.mtsm", "--point", "0,0,0")).stderr, "")

    def test_a_map_that_takes_long_to_be_made_ready_says_so_first(self):
        self.bake_map("large.mtsm", "--near-field", "none", "--resolution", 2560)
        said = r"^mtsm-query: making the map ready for queries \([\d ]+ layers\) \.\.\.$"
        self.assertRegex(self.good(run("query", "large.mtsm", "--point", "0,0,0")).stderr, said)
        for arguments in (["--points", "-"], ["--point", "0,0,0", "--quiet"], ["--point", "0,0,0", "--method", "scalar"]):
            done = self.good(run("query", "large.mtsm", *arguments, stdin="x,y,z\n"))
            self.assertEqual(done.stderr, "", arguments)

    def test_expected_errors_stand_beside_the_factors(self):
        plane = ["--plane", "-2,0,-2,4,0,0,0,0,4", "--size", "24x24", "--samples", 16]
        self.good(run("query", "key.mtsm", *plane, "-o", "plain.exr"))
        self.assertEqual(sorted(read_exr("plain.exr")[2]), ["shadow", "visibility"])
        self.good(run("query", "key.mtsm", *plane, "--error-channel", "-o", "e.exr"))
        channels = read_exr("e.exr")[2]
        self.assertEqual(sorted(channels), ["shadow", "shadow.error", "visibility"])
        self.assertEqual(channels["shadow"], read_exr("plain.exr")[2]["shadow"])
        for shadow, error in zip(channels["shadow"], channels["shadow.error"]):
            self.assertEqual(error > 0, 0 < shadow < 1)
        rows = self.rows("--point", "0,0,0", "--point", "1.3,0,0", "--error-channel")
        self.assertEqual(rows[0]["error"], 0)
        self.assertGreater(rows[1]["error"], 0)
        done = self.good(run("query", "key.mtsm", "--point", "1.3,0,0", "--error-channel", "--json"))
        self.assertGreater(json.loads(done.stdout)["values"][0]["error"], 0)
        self.fails(run("query", "key.mtsm", *plane, "--error-channel", "-o", "e.png"), 2, "--error-channel", ".exr")
        self.fails(run("query", "key.mtsm", "--point", "0,0,0", "--samples", 3, "--error-channel"), 2, "4 samples")

    def test_settings_by_the_error_that_is_asked_for(self):
        done = self.good(run("bake", "scene.obj", "--exclude", "floor", *LIGHT, "--target-error", 0.01, "-o", "q.mtsm", "--json"))
        self.assertIn("for a mean error of 0.01", done.stderr)
        j = json.loads(done.stdout)
        self.assertEqual((j["width"], j["nearField"]["kept"]), (512, True))
        self.assertAlmostEqual(j["quality"]["targetError"], 0.01)
        self.assertLess(j["quality"]["mapError"], 0.01)
        done = self.good(run("bake", "scene.obj", "--exclude", "floor", *LIGHT, "--quality", "final", "--resolution", 64, "-o", "q.mtsm"))
        self.assertIn("rasterised 64 x 64", done.stderr)
        self.assertNotIn("--resolution 1024", done.stderr)
        self.assertIn("; raise --resolution, or hold it against the truth", done.stderr)
        # What lets light through has no near field in colour: the map has to be finer.
        for color, kind, side in (([], "kept whole", 512), (["--color"], "that let light through: ", 1024)):
            done = self.good(run("bake", "scene.obj", "--exclude", "floor", "--opacity", 0.5, *color, *LIGHT, "--target-error", 0.02, "-o", "c.mtsm", "--json"))
            self.assertIn(kind, done.stderr)
            self.assertEqual((json.loads(done.stdout)["width"], json.loads(done.stdout)["nearField"]["kept"]), (side, not color))
        done = self.good(run("bake", "scene.obj", "--exclude", "floor", *LIGHT, "--quality", "final", "--resolution", 64,
                             "--near-field", "none", "-o", "n.mtsm"))
        self.assertIn("not kept beside the layers", done.stderr)
        self.assertIn("leave --near-field out", done.stderr)
        self.assertNotIn("kept whole", done.stderr)
        plane = ["--plane", "-2,0,-2,4,0,0,0,0,4", "--size", "64x64", "--json", "-o", "e.exr"]
        rays = []
        for error in (0.05, 0.002):
            done = self.good(run("query", "q.mtsm", *plane, "--target-error", error))
            self.assertIn("for a mean error of", done.stderr)
            j = json.loads(done.stdout)
            self.assertLess(j["sampleError"], error)
            rays.append(j["rays"])
        self.assertLess(rays[0], rays[1])
        # The map is coarser than it was asked to be: to bake it again would not help.
        done = self.good(run("query", "q.mtsm", *plane, "--target-error", 0.001))
        self.assertIn("the map was baked for it", done.stderr)
        self.assertNotIn("the same --target-error", done.stderr)
        for map, error in (("q.mtsm", 0.0005), ("key.mtsm", 0.001)):
            done = self.good(run("query", map, *plane, "--target-error", error))
            self.assertIn("bake the map with the same --target-error", done.stderr)
        self.fails(run("query", "q.mtsm", *plane, "--target-error", 2), 2, "--target-error")
        self.fails(run("query", "q.mtsm", *plane, "--quality", "best"), 2, "draft")
        self.fails(run("query", "q.mtsm", *plane, "--quality", "draft", "--method", "pcf"), 2, "--method trace")
        self.fails(run("bake", "scene.obj", *LIGHT, "--quality", "draft", "--target-error", 0.1, "-o", "q.mtsm"), 2, "--quality")

    def test_a_normal_or_a_ray_without_direction_is_told(self):
        self.fails(run("query", "key.mtsm", "--point", "0,0,0", "--normal", "0,0,0"), 2, "--normal", "direction")
        done = self.good(run("query", "key.mtsm", "--points", "-", stdin="x,y,z,nx,ny,nz\n0,0,0,0,1,0\n0,0,0,0,0,0\n"))
        self.assertIn("1 point has a normal of no length", done.stderr)
        done = self.good(run("query", "key.mtsm", "--rays", "-", stdin="ox,oy,oz,dx,dy,dz\n0,0,0,0,1,0\n0,0,0,0,0,0\n"))
        self.assertIn("1 ray has no direction", done.stderr)

    def test_a_map_with_three_channels_answers_in_colour(self):
        path = GOLDEN / "three_channels.mtsm"
        j = json.loads(run("dump", path, "--json").stdout)
        p = j["projections"][0]
        at = lambda x, y, z: [p["eye"][k] + x * p["right"][k] + y * p["up"][k] + z * p["forward"][k]
                              for k in range(3)]
        z = 1.5 * j["zRange"][1]  # a plane behind all layers, across the window
        corner = at(*((edge - p["offset"][k]) / p["scale"][k] * (z if p["kind"] == "perspective" else 1)
                      for k, edge in ((0, 0), (1, j["height"]))), z)
        u = [c * j["width"] / p["scale"][0] * z for c in p["right"]]
        v = [-c * j["height"] / p["scale"][1] * z for c in p["up"]]
        plane = ["--plane", ",".join(map(repr, corner + u + v)), "--size", "16x8", "--no-normal",
                 "--samples", 4]
        self.good(run("query", path, *plane, "-o", "a.exr"))
        width, height, channels = read_exr("a.exr")
        self.assertEqual(sorted(channels),
                         ["B", "G", "R", "visibility.B", "visibility.G", "visibility.R"])
        self.assertNotEqual(channels["R"], channels["B"])
        for c in "RGB":
            for shadow, visibility in zip(channels[c], channels["visibility." + c]):
                self.assertAlmostEqual(shadow + visibility, 1, places=6)
        self.good(run("query", path, *plane, "-o", "a.csv"))
        rows = list(csv.DictReader(pathlib.Path("a.csv").read_text().splitlines()))
        for c in "rgb":
            for row, s in zip(rows, channels[c.upper()]):
                self.assertAlmostEqual(float(row["shadow_" + c]), s, places=7)
        self.good(run("query", path, *plane, "-o", "a.png", "--quantity", "shadow"))
        w, h, pixels, step = read_png("a.png")
        self.assertEqual((w, h, step), (16, 8, 3))
        self.assertEqual([v for row in pixels for v in row[2::3]],
                         [int(math.floor(255 * s + 0.5)) for s in channels["B"]])
        point = ",".join(rows[70][c] for c in "xyz")
        done = self.good(run("query", path, "--point", point, "--samples", 4, "--json", "--quantity",
                             "visibility"))
        value, = json.loads(done.stdout)["values"]
        self.assertEqual(len(value["visibility"]), 3)
        ray = "ox,oy,oz,dx,dy,dz\n" + point + "," + ",".join(repr(-c) for c in p["forward"]) + "\n"
        row, = csv.DictReader(io.StringIO(self.good(run("query", path, "--rays", "-", stdin=ray)).stdout))
        self.assertIn("visibility_r", row)

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
        self.assertAlmostEqual(j["zRange"][0], 3 + back, places=3)  # rounded
        self.assertAlmostEqual(j["zRange"][1], 3 + back, places=3)

    def test_layers_that_no_point_of_the_light_sees_are_counted(self):
        done = self.good(run("bake", "scene.obj", *LIGHT, "--resolution", 128, "--json", "-o", "both.mtsm"))
        hidden = json.loads(done.stdout)["droppedHidden"]
        self.assertGreater(hidden, 0)  # the floor below the square
        attributes = json.loads(run("dump", "both.mtsm", "--json").stdout)["attributes"]
        self.assertEqual(attributes, {"hiddenLayers": hidden, "rounding": [1 / 64]})
        counted = f"{hidden:,}".replace(",", " ")
        self.assertIn(f"hidden layers       {counted} dropped: ", run("dump", "both.mtsm").stdout)

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
        # Every ray crosses the quad once, whatever the bias; the fast trace keeps its depth to 1/1024.
        self.assertAlmostEqual(json.loads(done.stdout)["values"][0]["shadow"], 0.5, delta=4e-4)
        done = self.good(run("query", "half.mtsm", "--point", "0,0,0", "--json", "--method", "scalar"))
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

    def test_what_is_damaged_is_told_with_the_way_out(self):
        whole = pathlib.Path("key.mtsm").read_bytes()
        near = whole.index(b"NEAR")
        for place, sound in ((whole.index(b"TILE") + 60, False), (near + 60, True)):
            damaged = bytearray(whole)
            damaged[place] ^= 1
            pathlib.Path("bad.mtsm").write_bytes(damaged)
            for command in (["dump", "bad.mtsm"], ["query", "bad.mtsm", "--point", "0,0,0"]):
                done = self.fails(run(*command), 4, "bad.mtsm", "checksum", "copy the file again or bake it again")
                self.assertEqual("--no-near-field" in done.stderr, sound, done.stderr)
        done = self.good(run("query", "bad.mtsm", "--point", "0,0,0", "--no-near-field"))
        self.assertEqual(done.stdout, run("query", "key.mtsm", "--point", "0,0,0", "--no-near-field").stdout)
        self.assertRegex(done.stdout, "0,0,0,1,0")

    def test_of_damaged_trees_others_are_made(self):
        self.bake_map("tree.mtsm", "--tree")
        damaged = bytearray(pathlib.Path("tree.mtsm").read_bytes())
        damaged[damaged.index(b"TREE") + 60] ^= 1
        pathlib.Path("bad.mtsm").write_bytes(damaged)
        query = ["--point", "0.3,0,0.2"]
        done = self.good(run("query", "bad.mtsm", *query))
        for words in ("warning: bad.mtsm: block TREE at offset", "checksum", "now trees are made of the layers"):
            self.assertIn(words, done.stderr)
        self.assertEqual(done.stdout, run("query", "tree.mtsm", *query).stdout)
        for command in (["dump", "bad.mtsm"], ["dump", "bad.mtsm", "--validate"]):
            self.fails(run(*command), 4, "bad.mtsm", "block TREE", "only the trees are damaged: mtsm-query makes its own")

    def refuses_as_map(self, path, *words):
        for command in (["dump", path], ["dump", path, "--validate"], ["query", path, "--point", "0,0,0"]):
            done = self.fails(run(*command), 4, *words)
        return done

    def test_casters_are_told_to_be_baked(self):
        pathlib.Path("bunny.ply").write_text("ply\n")
        pathlib.Path("fur").write_bytes(hair())
        pathlib.Path("points.csv").write_text("plymouth,0,0\n")
        self.assertNotIn("a mesh", self.refuses_as_map("points.csv", "points.csv").stderr)
        for path, what, target in (("scene.obj", "a mesh", "scene"), ("bunny.ply", "a mesh", "bunny"),
                                   ("fur", "hair", "fur")):
            self.refuses_as_map(path, f"{path}: is {what}, not a map: bake it with mtsm-bake {path} --light-position X,Y,Z "
                                f"--light-radius R -o {target}.mtsm")

    def test_what_else_is_no_map_is_told_where_it_belongs(self):
        pathlib.Path("shot.toml").write_text(JOB)
        pathlib.Path("grey.png").write_bytes(grey_png([[255]]))
        pathlib.Path("renamed.mtsm").write_bytes(grey_png([[255]]))
        write_exr("p.exr", 1, 1, {"P.X": [0], "P.Y": [0], "P.Z": [0]})
        pathlib.Path("points.csv").write_text("x,y,z\n0,0,0\n")
        pathlib.Path("notes.txt").write_text("no map at all\n")
        self.refuses_as_map("shot.toml", "shot.toml: is a job file, not a map: bake it with mtsm-bake shot.toml -o shot.mtsm")
        for path in ("grey.png", "renamed.mtsm", "p.exr"):
            self.refuses_as_map(path, f"{path}: is a picture, not a map", "mtsm-bake", "--position")
        self.refuses_as_map("points.csv", "points.csv: is a table, not a map", "--points", "--rays")
        self.refuses_as_map("notes.txt", "notes.txt", "is not an MTSM file", "a map is a .mtsm file that mtsm-bake wrote")

    def test_a_map_is_no_caster(self):
        shutil.copy("key.mtsm", "renamed.obj")
        for path in ("key.mtsm", "renamed.obj"):
            self.fails(run("bake", path, *LIGHT, "-o", "a.mtsm"), 4, f"{path}: is a map already, no caster", "mtsm-query",
                       "mtsm-dump")
        pathlib.Path("job.toml").write_text(JOB.replace("scene.obj", "key.mtsm"))
        self.fails(run("bake", "job.toml"), 4, "key.mtsm: is a map already")
        self.leaves("scene.obj", "key.mtsm", "renamed.obj", "job.toml")

    def test_commands_that_are_told_can_be_pasted_into_a_shell(self):
        os.mkdir("bin")
        os.symlink(TOOLS["bake"], "bin/mtsm-bake")
        for name in ("my scene.obj", "it's.obj", "$HOME `a` \"b\".obj", "a;b&c.obj"):
            shutil.copy("scene.obj", name)
            done = self.fails(run("query", name, "--point", "0,0,0"), 4, "bake it with mtsm-bake ")
            line = re.search("bake it with (.*)$", done.stderr, re.M)[1].replace("X,Y,Z", "0,4,0").replace(" R ", " 0.3 ")
            self.assertEqual(shlex.split(line)[1], name)
            made = subprocess.run(line + " --resolution 16", shell=True, capture_output=True, text=True,
                                  env={**os.environ, "PATH": os.path.abspath("bin") + ":" + os.environ["PATH"]})
            self.assertEqual(made.returncode, 0, line + "\n" + made.stderr)
            # So can what a map remembers.
            settings = json.loads(run("dump", name[:-4] + ".mtsm", "--json").stdout)["settings"]
            self.assertEqual(shlex.split(settings)[:2], ["mtsm-bake", name])

    def test_bytes_are_told_by_plane_and_what_was_left_out(self):
        j = json.loads(self.good(run("dump", "key.mtsm", "--json")).stdout)
        planes = {p["name"]: p for p in j["planes"]}
        self.assertEqual(set(planes), {"counts", "z", "v", "n"})
        self.assertEqual((planes["v"]["planes"], planes["v"]["leftOut"]), (0, j["opaqueTiles"]))
        self.assertEqual(planes["v"]["leftOutBytes"], 4 * j["layers"])
        self.assertEqual(planes["z"]["decodedBytes"], 4 * j["layers"])
        self.assertEqual(planes["counts"]["leftOut"], j["emptyTiles"])
        self.assertEqual(j["translucentTiles"], 0)
        text = self.good(run("dump", "key.mtsm")).stdout
        for word in ("plane v", "left out of", "where it would take", "translucent"):
            self.assertIn(word, text)

    def test_three_channels_are_shown_as_three(self):
        path = GOLDEN / "three_channels.mtsm"
        self.assertIn("3 channels", self.good(run("dump", path)).stdout)
        j = json.loads(run("dump", path, "--json").stdout)
        self.good(run("dump", path, "--image", "a.exr", "--channel", "visibility"))
        width, height, channels = read_exr("a.exr")
        self.assertEqual(sorted(channels), ["B", "G", "R", "visibility"])
        for r, g, b, mean in zip(*(channels[n] for n in ("R", "G", "B", "visibility"))):
            self.assertAlmostEqual((r + g + b) / 3, mean, places=6)
        self.good(run("dump", path, "--image", "a.png", "--channel", "visibility"))
        w, h, rows, step = read_png("a.png")
        self.assertEqual((w, h, step), (j["width"], j["height"], 3))
        for at, name in enumerate("RGB"):
            self.assertEqual([v for row in rows for v in row[at::3]],
                             [int(math.floor(255 * v + 0.5)) for v in channels[name]])
        deepest = max(range(len(channels["R"])), key=lambda i: 1 - channels["R"][i])
        text = self.good(run("dump", path, "--pixel", f"{deepest % width},{deepest // width}")).stdout
        self.assertIn("v red", text)
        self.assertIn("v blue", text)

    def test_each_of_six_faces_can_be_shown(self):
        path = GOLDEN / "six_faces.mtsm"
        for face in range(6):
            self.assertIn(f"face {face}: ",
                          self.good(run("dump", path, "--pixel", "0,0", "--face", face)).stdout)
            self.good(run("dump", path, "--image", "a.exr", "--face", face))
        self.fails(run("dump", path, "--pixel", "0,0", "--face", 6), 2, "--face")

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
