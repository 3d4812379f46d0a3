#!/usr/bin/env python3
"""Reads an MTSM file, checks everything, prints all of it as JSON.

    reader.py FILE               the whole map: header, attributes, every pixel's layers
    reader.py --quiet FILE       only the checks
    reader.py --self-test FILE   checks that the file, cut or changed anywhere, is refused

A second reader, written from mtsm-format.md alone and sharing nothing with libmtsm: where
the two disagree, one of them or the text is wrong. It is slow and holds the whole file in
memory. Needs Python 3.8 and something that decodes zstd: the standard library from 3.14
on, the module `zstandard` or `zstd`, or the command `zstd`.

Exit status: 0 good, 2 usage, 3 the file cannot be read, 4 the file is bad, 5 it is of a
version that this reader does not know. Section numbers (S 5.2) are those of mtsm-format.md.

JSON has no infinities and no NaN: they are printed as the strings "inf", "-inf" and
"nan:" with the 16 hexadecimal digits of the double. All other numbers are printed so that
reading them as doubles gives the stored bits. A pixel is a list of layers
[z, [v of each channel], n].
"""

import argparse
import json
import math
import struct
import subprocess
import sys

MASK64 = (1 << 64) - 1


class Bad(Exception):
    """The file is not what it claims to be."""


class Unsupported(Exception):
    """The file is of a kind that this reader does not know."""


def need(condition, message):
    if not condition:
        raise Bad(message)


# --- XXH3-64, seed 0, default secret (S 2.3) ---------------------------------------------------

SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671f"
    "cb79e64eccc0e578825ad07dccff7221b8084674f743248ee03590e6813a264c"
    "3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364"
    "eac5ac8334d3ebc3c581a0fffa1363eb170ddd51b7f0da49d316552629d4689e"
    "2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e")
P32_1, P32_2, P32_3 = 0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D
P64_1, P64_2, P64_3 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9
P64_4, P64_5 = 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5
MIX_1, MIX_2 = 0x165667919E3779F9, 0x9FB21C651E98DF25


def u32(data, at):
    return int.from_bytes(data[at:at + 4], "little")


def u64(data, at):
    return int.from_bytes(data[at:at + 8], "little")


def key64(at):
    return u64(SECRET, at)


def fold(a, b):
    """Both halves of the 128-bit product, combined."""
    product = a * b
    return (product & MASK64) ^ (product >> 64)


def avalanche(h):
    h ^= h >> 37
    h = h * MIX_1 & MASK64
    return h ^ (h >> 32)


def avalanche_xxh64(h):
    h ^= h >> 33
    h = h * P64_2 & MASK64
    h ^= h >> 29
    h = h * P64_3 & MASK64
    return h ^ (h >> 32)


def rotate(h, bits):
    return (h << bits | h >> (64 - bits)) & MASK64


def mix16(data, at, secret_at):
    return fold(u64(data, at) ^ key64(secret_at), u64(data, at + 8) ^ key64(secret_at + 8))


def xxh3_short(data):
    """0 to 16 bytes."""
    n = len(data)
    if n == 0:
        return avalanche_xxh64(key64(56) ^ key64(64))
    if n <= 3:
        combined = data[0] << 16 | data[n >> 1] << 24 | data[n - 1] | n << 8
        return avalanche_xxh64(combined ^ (u32(SECRET, 0) ^ u32(SECRET, 4)))
    if n <= 8:
        h = (u32(data, n - 4) | u32(data, 0) << 32) ^ (key64(8) ^ key64(16))
        h ^= rotate(h, 49) ^ rotate(h, 24)
        h = h * MIX_2 & MASK64
        h ^= (h >> 35) + n
        h = h * MIX_2 & MASK64
        return h ^ (h >> 28)
    low = u64(data, 0) ^ key64(24) ^ key64(32)
    high = u64(data, n - 8) ^ key64(40) ^ key64(48)
    swapped = int.from_bytes(low.to_bytes(8, "little"), "big")
    return avalanche((n + swapped + high + fold(low, high)) & MASK64)


def xxh3_middle(data):
    """17 to 240 bytes."""
    n = len(data)
    h = n * P64_1
    if n <= 128:
        for i in reversed(range((n - 1) // 32 + 1)):
            h += mix16(data, 16 * i, 32 * i) + mix16(data, n - 16 * (i + 1), 32 * i + 16)
        return avalanche(h & MASK64)
    for i in range(8):
        h += mix16(data, 16 * i, 16 * i)
    h = avalanche(h & MASK64)
    for i in range(8, n // 16):
        h += mix16(data, 16 * i, 16 * (i - 8) + 3)
    return avalanche(h + mix16(data, n - 16, 136 - 17) & MASK64)


def xxh3_long(data):
    """More than 240 bytes: stripes of 64 bytes, blocks of 16 stripes."""
    n = len(data)
    acc = [P32_3, P64_1, P64_2, P64_3, P64_4, P32_2, P64_5, P32_1]

    def accumulate(at, secret_at):
        lanes = struct.unpack_from("<8Q", data, at)
        keys = struct.unpack_from("<8Q", SECRET, secret_at)
        for i in range(8):
            mixed = lanes[i] ^ keys[i]
            acc[i ^ 1] = acc[i ^ 1] + lanes[i] & MASK64
            acc[i] = acc[i] + (mixed & 0xFFFFFFFF) * (mixed >> 32) & MASK64

    blocks = (n - 1) // 1024
    for block in range(blocks):
        for stripe in range(16):
            accumulate(1024 * block + 64 * stripe, 8 * stripe)
        for i in range(8):
            acc[i] = (acc[i] ^ acc[i] >> 47 ^ key64(128 + 8 * i)) * P32_1 & MASK64
    for stripe in range((n - 1 - 1024 * blocks) // 64):
        accumulate(1024 * blocks + 64 * stripe, 8 * stripe)
    accumulate(n - 64, 192 - 64 - 7)
    h = n * P64_1
    for i in range(4):
        h += fold(acc[2 * i] ^ key64(11 + 16 * i), acc[2 * i + 1] ^ key64(19 + 16 * i))
    return avalanche(h & MASK64)


def xxh3_64(data):
    if len(data) <= 16:
        return xxh3_short(data)
    if len(data) <= 240:
        return xxh3_middle(data)
    return xxh3_long(data)


try:
    import xxhash  # the same, faster
    checksum = xxhash.xxh3_64_intdigest
except ImportError:
    checksum = xxh3_64


# --- zstd (S 6.3) ------------------------------------------------------------------------------


def find_zstd():
    """A function that decodes one frame, whose content size is known, to bytes."""
    try:
        from compression import zstd  # Python 3.14
        return lambda frame, size: zstd.decompress(frame)
    except ImportError:
        pass
    try:
        import zstandard
        return lambda frame, size: zstandard.ZstdDecompressor().decompress(frame, size)
    except ImportError:
        pass
    try:
        import zstd
        return lambda frame, size: zstd.decompress(frame)
    except ImportError:
        pass
    return lambda frame, size: subprocess.run(
        ["zstd", "-d", "-q", "-c"], input=frame, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, check=True).stdout


def zstd_frame(data):
    """(content size, length) of the frame that data begins with: RFC 8878, 3.1.1."""
    need(data[:4] == b"\x28\xb5\x2f\xfd" and len(data) >= 6, "no zstd frame")
    descriptor = data[4]
    single = descriptor >> 5 & 1
    size_bytes = (1 if single else 0, 2, 4, 8)[descriptor >> 6]
    need(size_bytes > 0, "a zstd frame that does not state its content size")
    at = 5 + (0 if single else 1)
    id_bytes = (0, 1, 2, 4)[descriptor & 3]  # an id of 0 stands for none
    need(not any(data[at:at + id_bytes]), "a zstd frame that wants a dictionary")
    at += id_bytes
    content = int.from_bytes(data[at:at + size_bytes], "little")
    content += 256 if size_bytes == 2 else 0
    at += size_bytes
    last = False
    while not last:
        need(at + 3 <= len(data), "a zstd frame that is cut off")
        block = int.from_bytes(data[at:at + 3], "little")
        last = block & 1
        at += 3 + (1 if block >> 1 & 3 == 1 else block >> 3)
    at += 4 if descriptor >> 2 & 1 else 0
    return content, at


def decompress(frame, size):
    content, length = zstd_frame(frame)
    need(content == size, "a zstd frame of %d bytes, not %d" % (content, size))
    need(length == len(frame), "more or less than one zstd frame")
    try:
        decoded = find_zstd()(frame, size)
    except Exception as error:
        raise Bad("zstd: %s" % error)
    need(len(decoded) == size, "zstd gave %d bytes, not %d" % (len(decoded), size))
    return decoded


# --- bytes -------------------------------------------------------------------------------------


class Cursor:
    """Takes fields off the front of some bytes."""

    def __init__(self, data, what):
        self.data, self.what, self.at = data, what, 0

    def bytes(self, n):
        need(n <= len(self.data) - self.at, "%s: reaches past its end" % self.what)
        self.at += n
        return self.data[self.at - n:self.at]

    def fields(self, form):
        """Little-endian, without padding, as struct has it; one field alone or a tuple."""
        values = struct.unpack("<" + form, self.bytes(struct.calcsize("<" + form)))
        return values[0] if len(values) == 1 else values

    def zeros(self, n):
        need(not any(self.bytes(n)), "%s: reserved bytes are not zero" % self.what)

    def text(self, n):
        try:
            return self.bytes(n).decode("utf-8")
        except UnicodeDecodeError:
            raise Bad("%s: a text is not UTF-8" % self.what)

    def end(self, growable=False):
        """Only a later minor version may have added something."""
        need(growable or self.at == len(self.data), "%s: bytes are left over" % self.what)


def padded(n):
    return n + 7 & ~7


def bits(x):
    return struct.pack("<d", x)


def f32(x):
    """Rounded to binary32; infinite where that is too small for it."""
    try:
        return struct.unpack("<f", struct.pack("<f", x))[0]
    except OverflowError:
        return math.inf


def f32_of_upper(half):
    """The f32 of which these are the upper 16 bits."""
    return struct.unpack("<f", struct.pack("<I", half << 16))[0]


# --- the file ----------------------------------------------------------------------------------

MAGIC = b"\x89MTSM\r\n\x1a"
FINISHED = b"MTSM END"
HEADER = 32  # bytes of a block header
TRAILER = 32
KNOWN = {b"HEAD": 1, b"ATTR": 0, b"NEAR": 0, b"HAIR": 0, b"CARD": 0, b"TREE": 0, b"HIER": 1,
         b"TOTL": 1}  # flags
MAX_SIDE = 32768
MAX_PIXEL_LAYERS = 1 << 20
MAX_DIRECTORY = 65536
MAX_PART_CHUNKS = 4096
TREE_PART_BYTES = 1 << 18
GROUP_COLUMNS = ["4f", "4H", "4H", "4H", "4H", "4H", "4H", "4f", "4f", "4H", "4I", "4I", "4B", "4B"]
HAS_V, HAS_N = 1, 2


class File:
    def __init__(self, data, max_bytes):
        self.data, self.max_bytes = data, max_bytes
        self.out, self.minor = {}, 0
        try:
            self.read_all()
        except Bad as error:
            if self.minor == 0:
                raise
            # S 11: what is not understood may be what the newer version brought
            raise Unsupported("is of version 1.%d, newer than the 1.0 that this reader knows: %s"
                              % (self.minor, error))

    def read_all(self):
        self.read_prefix()
        self.read_trailer()
        self.read_index()
        self.check_coverage()
        self.read_directory()
        self.read_tiles()
        self.read_trees()
        self.check_totals()
        self.check_hierarchy()

    # S 3
    def read_prefix(self):
        need(self.data, "is empty")
        need(self.data[:8] == MAGIC[:len(self.data)], "is not an MTSM file")
        if len(self.data) >= 12:
            major, minor = struct.unpack_from("<HH", self.data, 8)
            if major > 1:
                raise Unsupported("has format version %d.%d by its prefix" % (major, minor))
        prefix = Cursor(self.data[:64], "prefix")
        need(len(self.data) >= 64, "is cut off within its prefix")
        self.prefix_checksum = u64(self.data, 56)
        need(self.prefix_checksum == checksum(self.data[:56]), "prefix: damaged")
        prefix.bytes(8)
        major, minor, size = prefix.fields("HHI")
        need(major == 1, "prefix: version %d.%d has never been" % (major, minor))
        self.minor = minor
        self.width, self.height, self.faces, self.channels, self.tile_size = prefix.fields("5I")
        prefix.zeros(20)
        need(size == 64, "prefix: a size of %d" % size)
        need(1 <= self.width <= MAX_SIDE and 1 <= self.height <= MAX_SIDE,
             "prefix: %d x %d pixels" % (self.width, self.height))
        need(self.faces in (1, 6), "prefix: %d faces" % self.faces)
        need(self.channels in (1, 3), "prefix: %d channels" % self.channels)
        need(self.tile_size in (8, 16, 32, 64, 128, 256), "prefix: tile size")
        self.tiles_x = -(-self.width // self.tile_size)
        self.tiles_y = -(-self.height // self.tile_size)
        self.tile_count = self.faces * self.tiles_y * self.tiles_x
        need(self.width * self.height * self.faces * 8 <= self.max_bytes,
             "more pixels than --max-bytes allows")
        self.out.update(
            version=[major, self.minor], width=self.width, height=self.height,
            faces=self.faces, channels=self.channels, tileSize=self.tile_size)

    # S 9
    def read_trailer(self):
        need(len(self.data) >= 64 + TRAILER, "trailer: missing, the file is cut off")
        trailer = self.data[-TRAILER:]
        self.index_at, length = struct.unpack_from("<QQ", trailer)
        need(trailer[16:24] == FINISHED, "trailer: no finished mark at the end")
        need(u64(trailer, 24) == checksum(trailer[:24]), "trailer: damaged")
        need(length == len(self.data), "trailer: the file has another length")
        self.end = length - TRAILER
        need(self.index_at % 8 == 0 and 64 <= self.index_at <= self.end - HEADER,
             "trailer: the index cannot lie at offset %d" % self.index_at)

    # S 4
    def block(self, what, kind, flags, offset, length=None, payload_checksum=None):
        """The payload of the block at this offset, everything about the block checked.
        None stands for what is not known yet."""
        what = "%s at offset %d" % (what, offset)
        header = self.data[offset:offset + HEADER]
        need(len(header) == HEADER and u64(header, 24) == checksum(header[:24]),
             "%s: the block header is damaged" % what)
        has_kind, has_flags, has_length, has_checksum = struct.unpack("<4sIQQ", header[:24])
        need(has_kind == kind, "%s: there is a block %r instead" % (what, has_kind))
        need(has_flags == flags, "%s: other flags" % what)
        need(length in (None, has_length), "%s: another length than in the index" % what)
        need(payload_checksum in (None, has_checksum),
             "%s: another checksum than in the index" % what)
        start, stop = offset + HEADER, offset + HEADER + has_length
        need(padded(stop) <= self.end, "%s: reaches past the end" % what)
        payload = self.data[start:stop]
        need(checksum(payload) == has_checksum, "%s: the content is damaged" % what)
        need(not any(self.data[stop:padded(stop)]), "%s: the padding is not zero" % what)
        return payload

    # S 8
    def read_index(self):
        payload = self.block("index: block INDX", b"INDX", 1, self.index_at)
        need(padded(self.index_at + HEADER + len(payload)) == self.end,
             "index: does not end at the trailer")
        index = Cursor(payload, "index")
        prefix_checksum, blocks = index.fields("QI")
        index.zeros(4)
        tiles = index.fields("Q")
        need(prefix_checksum == self.prefix_checksum, "index: belongs to another prefix")
        need(blocks <= MAX_DIRECTORY, "index: %d blocks" % blocks)
        need(tiles == self.tile_count, "index: %d tiles, not %d" % (tiles, self.tile_count))
        need(len(payload) == 24 + 32 * blocks + 32 * tiles, "index: has another length")
        self.directory = [index.fields("4sIQQQ") for _ in range(blocks)]
        self.tiles = [index.fields("QQIIQ") for _ in range(tiles)]
        for kind, flags, _, _, _ in self.directory:
            need(kind not in (b"TILE", b"INDX"), "index: %r in the directory" % kind)
            need(flags in (0, 1), "index: block %r: unknown flags" % kind)
            if kind not in KNOWN and flags == 1:
                raise Unsupported("block %r cannot be passed over and is unknown" % kind)
            need(kind not in KNOWN or flags == KNOWN[kind],
                 "index: block %r: flags are not those of its type" % kind)
        kinds = [entry[0] for entry in self.directory]
        for kind in (b"HEAD", b"HIER", b"TOTL"):
            need(kinds.count(kind) == 1, "index: not one block %r" % kind)
        for kind in (b"ATTR", b"NEAR", b"HAIR", b"CARD", b"TREE"):
            need(kinds.count(kind) <= 1, "index: more than one block %r" % kind)
        need(kinds[0] == b"HEAD" and self.directory[0][2] == 64,
             "index: block HEAD is not the first")
        offsets = [entry[2] for entry in self.directory]
        need(offsets == sorted(offsets), "index: blocks are not in the order of the file")
        decoded = 0
        for i, (offset, length, layers, planes, payload_checksum) in enumerate(self.tiles):
            if offset == 0:
                need((length, layers, planes, payload_checksum) == (0, 0, 0, 0),
                     "index: empty %s whose entry is not zero" % self.tile_name(i))
                continue
            face, tx, ty, w, h = self.tile_place(i)
            need(1 <= layers <= w * h * MAX_PIXEL_LAYERS and planes <= (HAS_V | HAS_N),
                 "index: %s: impossible layers or planes" % self.tile_name(i))
            decoded += 4 * layers * (2 + self.channels)
        need(decoded <= self.max_bytes, "more layers than --max-bytes allows")

    def check_coverage(self):
        """Blocks fill the file from prefix to index without gap or overlap: S 8.3."""
        extents = [(offset, length, "block %r" % kind)
                   for kind, _, offset, length, _ in self.directory]
        extents += [(entry[0], entry[1], self.tile_name(i))
                    for i, entry in enumerate(self.tiles) if entry[0]]
        at = 64
        for offset, length, what in sorted(extents):
            need(offset == at, "index: %s at offset %d, not %d" % (what, offset, at))
            at = padded(offset + HEADER + length)
        need(at == self.index_at, "index: a gap or overlap before the index")

    def read_directory(self):
        readers = {b"HEAD": self.read_head, b"ATTR": self.read_attributes,
                   b"TOTL": self.read_totals, b"HIER": self.read_hierarchy,
                   b"NEAR": self.read_near, b"HAIR": self.read_hair,
                   b"CARD": self.read_cards}
        self.out["attributes"] = []
        self.out["nearField"] = [[] for _ in range(self.faces)]
        self.out["nearHair"] = [[] for _ in range(self.faces)]
        self.out["nearSheets"] = None
        self.out["trees"] = self.trees = None
        for kind, flags, offset, length, payload_checksum in self.directory:
            name = "block %s" % kind.decode("latin-1")
            payload = self.block(name, kind, flags, offset, length, payload_checksum)
            if kind == b"TREE":  # of which much follows from the rest
                self.trees = Cursor(payload, "%s at offset %d" % (name, offset))
            if kind in readers:
                readers[kind](Cursor(payload, "%s at offset %d" % (name, offset)))

    # S 5.1
    def read_head(self, c):
        depth, rule, shape = c.fields("III")
        if depth != 0 or rule not in (0, 1):
            raise Unsupported("depth meaning %d, visibility rule %d" % (depth, rule))
        bias_per_depth = c.fields("f")
        light = dict(shape=shape, position=c.fields("3d"), direction=c.fields("3d"),
                     up=c.fields("3d"), radius=c.fields("d"), size=c.fields("2d"),
                     angularDiameter=c.fields("d"))
        bias, asked, most, resets, metres = c.fields("ffIId")
        self.check_light(light)
        need(0 <= bias < math.inf, "HEAD: bias %r" % bias)
        need(0 <= bias_per_depth < math.inf, "HEAD: bias %r per depth" % bias_per_depth)
        need(0 <= asked <= 1, "HEAD: tolerance %r" % asked)
        need(0 <= metres < math.inf, "HEAD: metres per unit %r" % metres)
        faces = []
        for _ in range(self.faces):
            kind = c.fields("I")
            c.zeros(4)
            face = dict(kind=kind, eye=c.fields("3d"), right=c.fields("3d"),
                        up=c.fields("3d"), forward=c.fields("3d"), scale=c.fields("2d"),
                        offset=c.fields("2d"), near=c.fields("d"), far=c.fields("d"))
            self.check_projection(face)
            faces.append(face)
        software = c.text(c.fields("I"))
        settings = c.text(c.fields("I"))
        c.end(self.minor > 0)
        self.out.update(
            depthMeaning=depth, visibilityRule=rule, light=light, bias=bias,
            biasPerDepth=bias_per_depth,
            toleranceAsked=asked, maxLayers=most, resets=resets, metresPerUnit=metres,
            projections=faces, software=software, settings=settings)

    @staticmethod
    def check_light(light):
        def finite(*numbers):
            return all(map(math.isfinite, numbers))
        need(light["shape"] <= 4, "HEAD: light shape %d" % light["shape"])
        need(finite(*light["position"], *light["direction"], *light["up"]),
             "HEAD: the light's vectors are not finite")
        need(1e-30 < math.sqrt(sum(x * x for x in light["direction"])) < math.inf,
             "HEAD: the light's direction has no length")
        need(all(finite(x) and x >= 0 for x in (light["radius"], *light["size"])),
             "HEAD: the light's size")
        need(0 <= light["angularDiameter"] < math.pi, "HEAD: the light's angular diameter")

    @staticmethod
    def check_projection(face):
        def dot(a, b):
            return sum(x * y for x, y in zip(a, b))
        right, up, forward = axes = face["right"], face["up"], face["forward"]
        cross = (forward[1] * up[2] - forward[2] * up[1],
                 forward[2] * up[0] - forward[0] * up[2],
                 forward[0] * up[1] - forward[1] * up[0])
        need(face["kind"] in (0, 1), "HEAD: projection kind %d" % face["kind"])
        need(all(map(math.isfinite, face["eye"])), "HEAD: the eye is not finite")
        need(all(abs(dot(axes[i], axes[j]) - (i == j)) < 1e-9
                 for i in range(3) for j in range(i + 1)) and dot(cross, right) > 0,
             "HEAD: right, up, forward are not unit vectors at right angles")
        (sx, sy), offset = face["scale"], face["offset"]
        need(0 < sx < math.inf and -math.inf < sy < 0 and all(map(math.isfinite, offset)),
             "HEAD: raster scale and offset")
        need(0 <= face["near"] < math.inf and face["far"] > face["near"], "HEAD: near and far")

    # S 5.2
    def read_attributes(self, c):
        count = c.fields("I")
        c.zeros(4)
        names = set()
        for _ in range(count):
            kind, name_length = c.fields("BB")
            c.zeros(6)
            length = c.fields("Q")
            name = c.text(name_length)
            need(name and name not in names, "%s: name %r is empty or there twice" % (c.what, name))
            names.add(name)
            value = Cursor(c.bytes(length), "%s: attribute %r" % (c.what, name))
            if kind == 0:
                self.add_attribute(name, "text", value.text(length))
            elif kind == 1:
                self.add_attribute(name, "integer", value.fields("q"))
            elif kind == 2:
                need(length % 8 == 0, "%s: no multiple of 8 bytes" % value.what)
                doubles = struct.unpack("<%dd" % (length // 8), value.bytes(length))
                self.add_attribute(name, "doubles", list(doubles))
            else:
                need(self.minor > 0, "%s: unknown type %d" % (value.what, kind))
                continue
            value.end()
        c.end(self.minor > 0)

    def add_attribute(self, name, kind, value):
        self.out["attributes"].append(dict(name=name, type=kind, value=value))

    # S 5.3
    def read_totals(self, c):
        layers, samples, dropped, z_min, z_max, reached, flags = c.fields("QQQfffI")
        c.end(self.minor > 0)
        need(0 <= reached <= 1, "%s: tolerance %r" % (c.what, reached))
        need(flags <= 1, "%s: unknown flags" % c.what)
        self.out.update(layers=layers, samples=samples, samplesDropped=dropped, zMin=z_min,
                        zMax=z_max, toleranceReached=reached, castersClipped=bool(flags))

    # S 7
    def read_hierarchy(self, c):
        faces, levels = c.fields("II")
        self.levels = max(self.tiles_x - 1, self.tiles_y - 1).bit_length() + 1
        need(faces == self.faces and levels == self.levels, "%s: other levels" % c.what)
        self.hierarchy = []
        for _ in range(faces):
            w, h = self.tiles_x, self.tiles_y
            for _ in range(levels):
                self.hierarchy.append([c.fields("ff") for _ in range(w * h)])
                w, h = (w + 1) // 2, (h + 1) // 2
        c.end()

    # S 7.2
    def read_near(self, c):
        for face, part, n, points in self.near_parts(
                c, 312, lambda n, points: 72 * n + 6 * points,
                lambda n, points: n <= points <= 48 * n):
            self.out["nearField"][face] += self.read_near_part(part, n, points)

    # S 7.3
    def read_hair(self, c):
        faces = self.out["projections"]
        for face, part, n, _ in self.near_parts(c, 284, lambda n, _: 284 * n,
                                                lambda _, points: points == 0):
            most = 0.5 if faces[face]["kind"] == 0 else math.inf
            self.out["nearHair"][face] += self.read_hair_part(part, n, most)

    # S 7.4
    def read_cards(self, c):
        need(self.faces == 1 and self.channels == 1 and self.out["visibilityRule"] == 0,
             "%s: not a map of sheets with one face and one channel" % c.what)
        count = c.fields("I")
        records = [c.fields("IIIIffQ") for _ in range(count)]
        textures = []
        for i, (w, h, wrap_u, wrap_v, cutoff, opacity, stored) in enumerate(records):
            what = "%s, texture %d" % (c.what, i)
            need(1 <= w <= 16384 and 1 <= h <= 16384 and wrap_u <= 2 and wrap_v <= 2,
                 "%s: %d x %d texels, wraps %d and %d" % (what, w, h, wrap_u, wrap_v))
            need(math.isfinite(cutoff) and 0 <= opacity <= 1,
                 "%s: cutoff %r, opacity %r" % (what, cutoff, opacity))
            need(1 <= stored <= w * h, "%s: stores %d bytes" % (what, stored))
            need(w * h <= self.max_bytes, "larger textures than --max-bytes allows")
            textures.append(dict(width=w, height=h, wrap=(wrap_u, wrap_v), cutoff=cutoff,
                                 opacity=opacity))
        for texture, record in zip(textures, records):
            data, size = c.bytes(record[6]), record[0] * record[1]
            texture["texels"] = list(data if len(data) == size else decompress(data, size))
        triangles = []
        inner = Cursor(c.bytes(c.fields("Q")), c.what + ", triangles")
        for _, part, n, points in self.near_parts(inner, 312, lambda n, p: 72 * n + 6 * p,
                                                  lambda n, p: n <= p <= 48 * n):
            triangles += self.read_near_part(part, n, points)
        chunks = []
        for _, part, n, _ in self.near_parts(c, 216, lambda n, _: 216 * n,
                                             lambda _, points: points == 0):
            chunks += self.read_card_part(part, n, count)
        need(len(chunks) == len(triangles), "%s: %d chunks of coordinates for %d of triangles"
             % (c.what, len(chunks), len(triangles)))
        self.out["nearSheets"] = dict(textures=textures, triangles=triangles, chunks=chunks)

    @classmethod
    def read_card_part(cls, part, n, textures):
        """A list of chunks, each texture, triangles, low, step and q as [corner][axis][triangle]."""
        words = cls.shuffled(part, 6 * n, "I")
        coordinates = cls.shuffled(part, 96 * n, "H")
        part.end()
        chunks = []
        for k in range(n):
            word = words[k::n]
            low = struct.unpack("<2f", struct.pack("<2I", *word[2:4]))
            step = struct.unpack("<2f", struct.pack("<2I", *word[4:6]))
            need(word[0] < textures and 1 <= word[1] <= 16, "%s: chunk %d: texture %d, %d triangles"
                 % (part.what, k, word[0], word[1]))
            cls.check_grid(part, k, low, step)
            q = coordinates[96 * k:96 * k + 96]
            chunks.append(dict(texture=word[0], triangles=word[1], low=low, step=step,
                               q=[[list(q[32 * corner + 16 * axis:32 * corner + 16 * axis + 16])
                                   for axis in range(2)] for corner in range(3)]))
        return chunks

    def near_parts(self, c, memory, size_of, may_have):
        """Yields (face, content, chunks, points) of each part."""
        faces, part_chunks = c.fields("II")
        need(faces == self.faces, "%s: %d faces" % (c.what, faces))
        need(1 <= part_chunks <= MAX_PART_CHUNKS,
             "%s: parts of %d chunks" % (c.what, part_chunks))
        chunks = [c.fields("Q") for _ in range(faces)]
        need(sum(chunks) * memory <= self.max_bytes, "more chunks than --max-bytes allows")
        parts = [(face, min(part_chunks, chunks[face] - first))
                 for face in range(faces) for first in range(0, chunks[face], part_chunks)]
        records = [c.fields("II") for _ in parts]
        for i, ((face, n), (points, stored)) in enumerate(zip(parts, records)):
            part = Cursor(c.bytes(stored), "%s, part %d" % (c.what, i))
            need(may_have(n, points), "%s: %d points" % (part.what, points))
            size = size_of(n, points)
            need(1 <= stored <= size, "%s: stores %d bytes" % (part.what, stored))
            if stored < size:
                try:
                    part.data = decompress(part.data, size)
                except Bad as error:
                    raise Bad("%s: %s" % (part.what, error))
            yield face, part, n, points
        c.end()

    @staticmethod
    def shuffled(part, count, form):
        size = struct.calcsize(form)
        data = part.bytes(count * size)
        return struct.unpack("<%d%s" % (count, form), bytes(
            data[j * count + i] for i in range(count) for j in range(size)))

    @staticmethod
    def check_grid(part, k, low, step):
        # What 65535 steps come to, rounded as S 7.2 has it; beyond f32 is infinite.
        for a, b in zip(low, step):
            need(math.isfinite(a) and 0 <= b and f32(a + f32(65535 * b)) < math.inf,
                 "%s: chunk %d: low %r, step %r" % (part.what, k, a, b))

    @classmethod
    def read_hair_part(cls, part, n, most):
        """A list of chunks, each low, step, halfStep and q as [end][axis][segment]."""
        def signed(r):
            return r // 2 if r % 2 == 0 else -(r + 1) // 2

        floats = cls.shuffled(part, 7 * n, "f")
        words = cls.shuffled(part, 112 * n, "H")
        halves = part.bytes(32 * n)
        part.end()
        chunks = []
        for k in range(n):
            low, step, half_step = floats[k:3 * n:n], floats[3 * n + k:6 * n:n], floats[6 * n + k]
            cls.check_grid(part, k, low, step)
            need(0 <= half_step and f32(255 * half_step) <= most and
                 f32(255 * half_step) < math.inf,
                 "%s: chunk %d: halfStep %r" % (part.what, k, half_step))
            word = [words[16 * (i * n + k):16 * (i * n + k) + 16] for i in range(7)]
            end = [[[], [], []], [[], [], []]]
            for axis in range(3):
                before = 0
                for t in range(16):
                    before = (before + signed(word[axis][t])) % 65536
                    end[0][axis].append(before)
                    end[1][axis].append((before + signed(word[3 + axis][t])) % 65536)
            half = [list(halves[16 * (e * n + k):16 * (e * n + k) + 16]) for e in range(2)]
            chunks.append(dict(low=low, step=step, halfStep=half_step, end=end, half=half,
                               opacity=list(word[6])))
        return chunks

    @classmethod
    def read_near_part(cls, part, n, points):
        """A list of chunks, each low, step and q as [corner][axis][triangle]."""
        floats = cls.shuffled(part, 6 * n, "f")
        ago = part.bytes(48 * n)
        residuals = cls.shuffled(part, 3 * points, "H")
        part.end()
        chunks, at = [], 0
        for k in range(n):
            low, step = floats[k:3 * n:n], floats[3 * n + k::n]
            cls.check_grid(part, k, low, step)
            known = []
            q = [[[0] * 16 for _ in range(3)] for _ in range(3)]
            for i in range(48):
                back = ago[48 * k + i]
                need(back <= len(known) and (back or at < points),
                     "%s: chunk %d: corner %d names no point" % (part.what, k, i))
                if back == 0:
                    before = known[-1] if known else (0, 0, 0)
                    new = [residuals[axis * points + at] for axis in range(3)]
                    new = [r // 2 if r % 2 == 0 else -(r + 1) // 2 for r in new]
                    known.append([(g + d) % 65536 for g, d in zip(before, new)])
                    at, back = at + 1, 1
                for axis in range(3):
                    q[i % 3][axis][i // 3] = known[-back][axis]
            chunks.append(dict(low=low, step=step, corner=q))
        need(at == points, "%s: points that no corner names" % part.what)
        return chunks

    # S 7.5
    def read_trees(self):
        c = self.trees
        if c is None or c.fields("I") != 1:
            return
        kind, faces = c.fields("II")
        c.zeros(4)
        patches = not any(any(v) for face in self.pixels for row in face for pixel in row
                          for _, v, _ in pixel)
        need(kind == (0 if patches else 1), "%s: trees of kind %d" % (c.what, kind))
        need(faces == self.faces, "%s: %d faces" % (c.what, faces))
        need(1 <= sum(entry[2] for entry in self.tiles) <= 1 << 28,
             "%s: trees of a map that has none" % c.what)
        sizes = []  # of the arrays to come: records, and the columns of one
        records = [(self.patch_record if patches else self.density_record)(c, sizes)
                   for _ in range(faces)]
        need(sum(n * sum(struct.calcsize("<" + form) for form in columns)
                 for n, columns in sizes) <= self.max_bytes, "larger trees than --max-bytes allows")
        arrays = iter(self.tree_arrays(c, sizes))
        take = self.patch_tree if patches else self.density_tree
        self.out["trees"] = [take(record, arrays, "%s, face %d" % (c.what, face))
                             for face, record in enumerate(records)]

    @staticmethod
    def tree_arrays(c, sizes):
        """Yields each array as a list of its columns, each a list of numbers."""
        parts = []
        for a, (n, columns) in enumerate(sizes):
            size = sum(struct.calcsize("<" + form) for form in columns)
            each = TREE_PART_BYTES // size
            parts += [(a, min(each, n - first), size) for first in range(0, n, each)]
        lengths = [c.fields("I") for _ in parts]
        arrays = [[[] for _ in columns] for _, columns in sizes]
        for i, ((a, n, size), stored) in enumerate(zip(parts, lengths)):
            need(1 <= stored <= n * size, "%s, part %d: stores %d bytes" % (c.what, i, stored))
            data = c.bytes(stored)
            if stored < n * size:
                try:
                    data = decompress(data, n * size)
                except Bad as error:
                    raise Bad("%s, part %d: %s" % (c.what, i, error))
            part = Cursor(data, c.what)
            for column, form in zip(arrays[a], sizes[a][1]):
                count = struct.calcsize("<" + form) // struct.calcsize("<" + form[-1])
                column += File.shuffled(part, n * count, form[-1])
        c.end()
        return arrays

    def patch_record(self, c, sizes):
        groups, covers, lowest, highest, piece_size = c.fields("QQfff")
        c.zeros(4)
        need(groups < 1 << 28 and 16 <= covers < 1 << 32,
             "%s: %d groups, %d rows of texels" % (c.what, groups, covers))
        need(groups == 0 or all(map(math.isfinite, (lowest, highest, piece_size))),
             "%s: a range or a size of pieces" % c.what)
        levels, side = [], 16
        while not levels or levels[-1] > 1:
            levels.append(-(-self.width // side) * -(-self.height // side))
            side *= 2
        if len(levels) > 1:
            levels[0] = 0
        sizes += [(sum(levels), ["I", "I"]), (groups, GROUP_COLUMNS), (covers, ["H"])]
        return dict(width=self.width, height=self.height, levels=levels, lowest=lowest, highest=highest, pieceSize=piece_size)

    @staticmethod
    def patch_tree(tree, arrays, what):
        group, groups_and_slots = next(arrays)
        columns, (covers,) = next(arrays), next(arrays)
        count = len(columns[0]) // 4
        names = ("w", "above", "below", "u0", "v0", "u1", "v1", "gradientU", "gradientV",
                 "residual", "children", "cover", "childGroups", "kind")
        tree.update(zip(names, columns))
        tree["covers"] = covers
        tree["tiles"] = [(g, n & (1 << 28) - 1, n >> 28) for g, n in zip(group, groups_and_slots)]
        half = [[f32_of_upper(x) for x in tree[name]] for name in ("above", "below", "residual")]

        def patches(first, groups, slots, where):
            need(groups == 0 or first + groups <= count, "%s: %s: a list of what is not there"
                 % (what, where))
            for k in range(groups):
                for slot in range(4):
                    if k + 1 < groups or slots >> slot & 1:
                        yield 4 * (first + k) + slot

        def square(i):
            side = 16
            while side > 4 and all(tree[a][i] // (side // 2) == (tree[b][i] - 1) // (side // 2)
                                   for a, b in (("u0", "u1"), ("v0", "v1"))):
                side //= 2
            return side

        in_tile, below_tile, below_child = set(), set(), set()
        for t, tile in enumerate(tree["tiles"]):
            for i in patches(*tile, "tile %d" % t):
                need(i not in in_tile, "%s: a patch in two lists" % what)
                in_tile.add(i)
        for i in range(4 * count):
            if half[0][i] == -math.inf:
                continue
            where = "patch %d" % i
            numbers = [tree[name][i] for name in ("w", "gradientU", "gradientV")]
            need(all(map(math.isfinite, numbers + [h[i] for h in half])),
                 "%s: %s: not finite" % (what, where))
            level = tree["kind"][i] & 31
            need(level < len(tree["levels"]), "%s: %s: level %d" % (what, where, level))
            side = 16 << level
            for a, b, limit in (("u0", "u1", tree["width"]), ("v0", "v1", tree["height"])):
                low, high = tree[a][i], tree[b][i]
                need(low < high and low < limit and low // side == (high - 1) // side,
                     "%s: %s: a box not in a tile" % (what, where))
            shared, bumpy = tree["kind"][i] & 32, tree["kind"][i] & 128
            need(not bumpy or (level == 0 and square(i) == 4), "%s: %s: bumpy" % (what, where))
            rows = 4 * ((tree["v1"][i] - tree["v0"][i]) >> level) if shared else 0
            need(tree["cover"][i] + rows + 16 <= len(covers), "%s: %s: rows" % (what, where))
            known = below_tile if i in in_tile else below_child
            children = tree["children"][i]
            for child in patches(children & (1 << 28) - 1, tree["childGroups"][i], children >> 28,
                                 where):
                need(child not in in_tile and child not in known,
                     "%s: %s: a child in two lists" % (what, where))
                known.add(child)
                lower = tree["kind"][child] & 31
                need(half[0][child] == -math.inf or lower < level or
                     (lower == level == 0 and square(child) < square(i)),
                     "%s: %s: a child that is no smaller" % (what, where))
        return tree

    def density_record(self, c, sizes):
        levels = [(self.width, self.height)]
        while levels[-1] != (1, 1):
            levels.append(tuple((n + 1) // 2 for n in levels[-1]))
        need(self.width * self.height <= 1 << 28, "%s: too many pixels" % c.what)
        sheets = self.out["nearSheets"]
        beside = self.faces == 1 and (self.out["nearHair"][0] or sheets and sheets["chunks"])
        levels = levels[min(len(levels) - 1, 1 if beside else 0):]
        result = []
        for name in ("media", "sheets"):
            present, low, high = c.fields("Iff")
            c.zeros(4)
            need(present <= 1 and (low < high and math.isfinite(low) and math.isfinite(high)
                                   if present else True), "%s: %s: a pyramid" % (c.what, name))
            need(not present or name == "sheets" or self.out["visibilityRule"] == 1,
                 "%s: media in a map of sheets" % c.what)
            pyramid = dict(low=low, high=high, levels=[]) if present else None
            texels = []
            for w, h in levels if present else []:
                words, base, step = c.fields("Qff")
                need(words < 1 << 32 and math.isfinite(base) and 0 < step < math.inf,
                     "%s: %s: a level" % (c.what, name))
                pyramid["levels"].append(dict(words=words, base=base, step=step))
                texels.append(-(-w // 8) * -(-h // 8) * 64)
            result.append((pyramid, texels))
            if present:
                sizes += [(sum(texels), ["I", "I"])]
                sizes += [(level["words"], ["I"]) for level in pyramid["levels"]]
        return result

    @staticmethod
    def density_tree(record, arrays, what):
        for pyramid, texels in record:
            if pyramid is None:
                continue
            (ranges, words), at = next(arrays), 0
            for level, count in zip(pyramid["levels"], texels):
                level["range"], level["begin"], begin = ranges[at:at + count], [], 0
                for n in words[at:at + count]:
                    level["begin"].append(begin)
                    begin += n
                need(begin == level["words"], "%s: lists of %d words of %d"
                     % (what, begin, level["words"]))
                (level["slabs"],) = next(arrays)
                at += count
        return dict(media=record[0][0], sheets=record[1][0])

    # S 6
    def tile_place(self, i):
        tx, ty = i % self.tiles_x, i // self.tiles_x % self.tiles_y
        return (i // self.tiles_x // self.tiles_y, tx, ty,
                min(self.tile_size, self.width - tx * self.tile_size),
                min(self.tile_size, self.height - ty * self.tile_size))

    def tile_name(self, i):
        return "tile face %d (%d, %d)" % self.tile_place(i)[:3]

    def read_tiles(self):
        self.pixels = [[[[] for _ in range(self.width)] for _ in range(self.height)]
                       for _ in range(self.faces)]
        for i, (offset, length, layers, planes, payload_checksum) in enumerate(self.tiles):
            if offset == 0:
                continue
            name = self.tile_name(i)
            payload = self.block(name, b"TILE", 1, offset, length, payload_checksum)
            c = Cursor(payload, "%s at offset %d" % (name, offset))
            self.read_tile(c, self.tile_place(i), layers, planes)
        self.out["pixels"] = self.pixels

    def read_tile(self, c, place, layers, planes):
        face, tx, ty, w, h = place
        need(c.fields("IIIHHII") == (face, tx, ty, w, h, layers, planes),
             "%s: says other than the index" % c.what)
        channels = range(self.channels) if planes & HAS_V else ()
        kinds = [(0, 0), (1, 0)] + [(2, k) for k in channels] + [(3, 0)] * (planes >> 1)
        need(c.fields("I") == len(kinds), "%s: another number of planes" % c.what)
        c.zeros(4)
        records = [self.read_plane_record(c, kind, w * h if kind[0] == 0 else layers)
                   for kind in kinds]
        counts, begin, values = None, None, {}
        for kind, record in zip(kinds, records):
            plane = self.read_plane(c, kind, record, begin, w)
            if kind[0] == 0:
                begin = [0]
                for count in plane:
                    begin.append(begin[-1] + count)
                need(begin[-1] == layers and max(plane) <= MAX_PIXEL_LAYERS,
                     "%s: layers of the pixels do not add up" % c.what)
            values[kind] = plane
        c.end()
        for p in range(w * h):
            x, y = tx * self.tile_size + p % w, ty * self.tile_size + p // w
            pixel = [(values[1, 0][i],
                      [values[2, k][i] if channels else 0.0 for k in range(self.channels)],
                      values[3, 0][i] if planes & HAS_N else 1)
                     for i in range(begin[p], begin[p + 1])]
            self.check_pixel(pixel, "%s, pixel %d" % (c.what, p))
            self.pixels[face][y][x] = pixel

    # S 6.2
    def read_plane_record(self, c, kind, elements):
        what = "%s, plane %d.%d" % ((c.what,) + kind)
        has_kind, channel, encoding, filtering, size, shift = c.fields("6B")
        c.zeros(2)
        constant = c.fields("I")
        c.zeros(4)
        stored, decoded = c.fields("QQ")
        need((has_kind, channel) == kind, "%s: is announced as another" % what)
        need(size in ((4,) if kind[0] in (1, 2) else (1, 2, 4)), "%s: element size" % what)
        need(decoded == elements * size, "%s: decoded length %d" % (what, decoded))
        need(encoding <= 2 and filtering <= 3, "%s: unknown encoding or filter" % what)
        need(encoding == 2 or filtering == 0, "%s: filter without compression" % what)
        need(filtering != 1 or size > 1, "%s: shuffle of single bytes" % what)
        need(filtering < 2 or kind[0] in (1, 2), "%s: differences of integers" % what)
        need(shift <= (31 if filtering >= 2 else 0), "%s: shift %d" % (what, shift))
        need(encoding == 1 or constant == 0, "%s: a constant without use" % what)
        need(constant >> 8 * size == 0, "%s: the constant does not fit" % what)
        need((stored == decoded, stored == 0, stored < decoded)[encoding],
             "%s: stored length %d" % (what, stored))
        return encoding, filtering, size, shift, constant, stored, decoded

    # S 6.3, 6.4
    def read_plane(self, c, kind, record, begin, w):
        encoding, filtering, size, shift, constant, stored, decoded = record
        what = "%s, plane %d.%d" % ((c.what,) + kind)
        data, n = c.bytes(stored), decoded // size
        if encoding == 1:
            elements = [constant] * n
        else:
            if encoding == 2:
                try:
                    data = decompress(data, decoded)
                except Bad as error:
                    raise Bad("%s: %s" % (what, error))
            if filtering:
                data = bytes(data[j * n + i] for i in range(n) for j in range(size))
            elements = list(struct.unpack("<%d%s" % (n, {1: "B", 2: "H", 4: "I"}[size]), data))
        if filtering >= 2:
            self.add_guesses(elements, begin, w, filtering == 3)
            elements = [b << shift & 0xFFFFFFFF for b in elements]
        if kind[0] in (1, 2):
            elements = struct.unpack("<%df" % n, struct.pack("<%dI" % n, *elements))
        return elements

    @staticmethod
    def add_guesses(elements, begin, w, delta):
        def layer(x, y, k):
            """Bits of layer k of a pixel, None if there is none."""
            if x < 0 or y < 0:
                return None
            i = begin[y * w + x] + k
            return elements[i] if i < begin[y * w + x + 1] else None

        for p in range(len(begin) - 1):
            x, y = p % w, p // w
            for k in range(begin[p + 1] - begin[p]):
                left, above, corner = layer(x - 1, y, k), layer(x, y - 1, k), layer(x - 1, y - 1, k)
                if delta and k > 0:
                    guess = elements[begin[p] + k - 1]
                elif None not in (left, above, corner):
                    guess = left + above - corner
                elif left is not None:
                    guess = left
                elif above is not None:
                    guess = above
                else:
                    guess = elements[begin[p] + k - 1] if k else 0
                r = elements[begin[p] + k]
                difference = -(r + 1 >> 1) if r & 1 else r >> 1
                elements[begin[p] + k] = guess + difference & 0xFFFFFFFF

    # S 6.5
    def check_pixel(self, pixel, what):
        z_before, v_before = 0.0, [1.0] * self.channels
        for z, v, n in pixel:
            need(0 < z < math.inf and z >= z_before, "%s: depth %r" % (what, z))
            need(all(0 <= a <= b for a, b in zip(v, v_before)), "%s: visibility %r" % (what, v))
            need(n >= 1, "%s: no samples" % what)
            z_before, v_before = z, v if any(v) else [1.0] * self.channels

    # S 7, 5.3
    def ranges(self):
        """The hierarchy that the layers give, in the order of the file."""
        size = self.tile_size
        result = []
        for face in self.pixels:
            level, w, h = [], self.tiles_x, self.tiles_y
            for ty in range(h):
                for tx in range(w):
                    inside = [pixel for row in face[ty * size:(ty + 1) * size]
                              for pixel in row[tx * size:(tx + 1) * size] if pixel]
                    level.append((min((p[0][0] for p in inside), default=math.inf),
                                  max((p[-1][0] for p in inside), default=-math.inf)))
            result.append(level)
            for _ in range(self.levels - 1):
                half_w, half_h = (w + 1) // 2, (h + 1) // 2
                coarse = []
                for y in range(half_h):
                    for x in range(half_w):
                        below = [level[j * w + i] for j in range(2 * y, min(2 * y + 2, h))
                                 for i in range(2 * x, min(2 * x + 2, w))]
                        coarse.append((min(r[0] for r in below), max(r[1] for r in below)))
                level, w, h = coarse, half_w, half_h
                result.append(level)
        return result

    def check_hierarchy(self):
        need(self.ranges() == self.hierarchy, "block HIER: is not that of the layers")

    def check_totals(self):
        layers = [layer for face in self.pixels for row in face for p in row for layer in p]
        need(self.out["layers"] == len(layers), "block TOTL: another number of layers")
        z_min = min((layer[0] for layer in layers), default=math.inf)
        z_max = max((layer[0] for layer in layers), default=-math.inf)
        need((self.out["zMin"], self.out["zMax"]) == (z_min, z_max),
             "block TOTL: another depth range")


def printable(value):
    """The same with what JSON cannot say as strings."""
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value):
            return "nan:%016x" % struct.unpack("<Q", bits(value))[0]
        return "inf" if value > 0 else "-inf"
    if isinstance(value, dict):
        return {key: printable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [printable(item) for item in value]
    return value


def read(data, max_bytes=1 << 30):
    """All of a file's bytes as a dictionary. Raises Bad, Unsupported."""
    return printable(File(data, max_bytes).out)


def self_test(data):
    """Cuts these bytes at every length and changes every one: nothing may be accepted."""
    def accepted(changed):
        try:
            read(changed)
            return True
        except (Bad, Unsupported):
            return False

    need(accepted(data), "self test: the file itself is refused")
    for n in range(len(data)):
        need(not accepted(data[:n]), "self test: accepted the first %d bytes" % n)
        need(not accepted(data[:n] + bytes([data[n] ^ 1 << n % 8]) + data[n + 1:]),
             "self test: accepted a changed byte %d" % n)


def main():
    parser = argparse.ArgumentParser(description="Reads and checks an MTSM file.")
    parser.add_argument("file")
    parser.add_argument("--quiet", action="store_true", help="print nothing if it is good")
    parser.add_argument("--self-test", action="store_true", help="damage it everywhere")
    parser.add_argument("--max-bytes", type=int, default=1 << 30, help="of decoded layers")
    options = parser.parse_args()
    try:
        with open(options.file, "rb") as file:
            data = file.read()
        content = read(data, options.max_bytes)
        if options.self_test:
            self_test(data)
    except OSError as error:
        print("%s: %s" % (options.file, error.strerror), file=sys.stderr)
        return 3
    except Bad as error:
        print("%s: %s" % (options.file, error), file=sys.stderr)
        return 4
    except Unsupported as error:
        print("%s: %s: a newer reader is needed" % (options.file, error), file=sys.stderr)
        return 5
    if not (options.quiet or options.self_test):
        json.dump(content, sys.stdout, allow_nan=False)
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
