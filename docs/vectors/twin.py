"""
What a VOLA file holds, in plain Python: the trees, files and expectations of the test vectors.

Written from the text of docs/format.md; it imports nothing of volatool.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from fractions import Fraction
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
MAGIC = b"VOLATRL1"
PRESENT = 1 << 56
CONSTANT = {"byte": 7, "name": "present", "scale": 1.0, "offset": 0.0, "unit": "",
            "reduction": "constant"}  # fmt: skip
ENGINEERING = (
    'ENGCRS["local",EDATUM["local"],CS[Cartesian,3],AXIS["x",east],AXIS["y",north],'
    'AXIS["z",up],LENGTHUNIT["metre",1]]'
)


# ------------------------------------------------------------------------------------- cells


def exact(value: float) -> Fraction:
    """Return the number that a float's shortest decimal form says."""
    return Fraction(repr(float(value)))


def path_of(cell: tuple[int, int, int], level: int) -> tuple[int, ...]:
    """Return the bit numbers on the way from the root to a cell of a level."""
    digits = []
    for i in range(level):
        x, y, z = (value // 4 ** (level - 1 - i) % 4 for value in cell)
        digits.append(x + 4 * y + 16 * z)
    return tuple(digits)


def cell_of(path: tuple[int, ...]) -> tuple[int, int, int]:
    """Return the cell at the end of a path."""
    x = y = z = 0
    for digit in path:
        x, y, z = 4 * x + digit % 4, 4 * y + digit // 4 % 4, 4 * z + digit // 16
    return x, y, z


def mix(number: int) -> int:
    """Return 56 bits that look like chance (splitmix64)."""
    number = (number * 0x9E3779B97F4A7C15 + 0x9E3779B97F4A7C15) % 2**64
    number = (number ^ number >> 30) * 0xBF58476D1CE4E5B9 % 2**64
    number = (number ^ number >> 27) * 0x94D049BB133111EB % 2**64
    return (number ^ number >> 31) % 2**56


def some_voxels(depth: int, count: int, seed: int) -> list[tuple[int, int, int]]:
    """Return voxels that look like chance, in a few clusters."""
    side = 4**depth
    voxels = set()
    for i in range(count):
        centre, near = mix(seed + 1000 * (i % 3)), mix(seed + i + 7)
        spread = max(side // 4, 3)
        voxels.add(
            tuple(
                min(side - 1, (centre >> 16 * axis) % side // 2 + (near >> 16 * axis) % spread)
                for axis in range(3)
            )
        )
    return sorted(voxels)  # type: ignore[arg-type]


def mean_word(words: list[int]) -> int:
    """Return the mean of metadata words: halves up; byte 6 the most frequent, lowest of equals."""
    result = 0
    for byte in range(8):
        values = [word >> 8 * byte & 255 for word in words]
        if byte == 6:
            value = min(set(values), key=lambda code: (-values.count(code), code))
        else:
            value = (2 * sum(values) + len(values)) // (2 * len(values))
        result |= value << 8 * byte
    return result


class Tree:
    """
    Voxels as levels of blocks; level 1 is the root.

    Parameters
    ----------
    voxels : list of cells
        At the deepest level.
    depth : int
        Levels.
    seed : int or None
        Of the metadata words, None without.
    """

    def __init__(self, voxels: list[tuple[int, int, int]], depth: int, seed: int | None) -> None:
        self.depth = depth
        paths = sorted(path_of(voxel, depth) for voxel in voxels)
        self.blocks: list[dict[tuple[int, ...], int]] = []
        for level in range(depth):
            words: dict[tuple[int, ...], int] = {} if level else {(): 0}
            for path in paths:
                words[path[:level]] = words.get(path[:level], 0) | 1 << path[level]
            self.blocks.append(dict(sorted(words.items())))
        self.metadata: list[dict[tuple[int, ...], int]] | None = None
        if seed is not None:
            self.metadata = [
                {path: mix(seed + 64 * level + i) | PRESENT for i, path in enumerate(blocks)}
                for level, blocks in enumerate(self.blocks)
            ]
        self.voxels = [cell_of(path) for path in paths]

    def sparse(self) -> bytes:
        """Return the levels of a sparse file."""
        words: list[int] = []
        for level, blocks in enumerate(self.blocks):
            words += blocks.values()
            if self.metadata is not None:
                words += self.metadata[level].values()
        return struct.pack(f"<{len(words)}Q", *words)

    def counts(self) -> list[int]:
        """Return the blocks of each level."""
        return [len(blocks) for blocks in self.blocks]

    def voxel_metadata(self) -> list[int] | None:
        """Return the word of each voxel's block."""
        if self.metadata is None:
            return None
        return [self.metadata[-1][path_of(voxel, self.depth)[:-1]] for voxel in self.voxels]

    def levels(self) -> list[dict[str, Any]]:
        """Return what a reader finds."""
        return [
            {
                "blocks": len(blocks),
                "words": [f"{word:016x}" for word in blocks.values()],
                "metadata": None
                if self.metadata is None
                else [f"{word:016x}" for word in self.metadata[level].values()],
            }
            for level, blocks in enumerate(self.blocks)
        ]


class Dense:
    """
    The same tree as strips.

    Parameters
    ----------
    tree : Tree
        Its block words become those of the strips by the mean over the strip's cells.
    """

    def __init__(self, tree: Tree) -> None:
        self.tree = tree
        self.strips: list[dict[int, int]] = []
        self.metadata: list[dict[int, int]] = []
        for level in range(1, tree.depth + 1):
            words: dict[int, int] = {}
            beside: dict[int, list[int]] = {}
            for cell in self.cells(level):
                number, bit = divmod(self.linear(cell, level), 64)
                words[number] = words.get(number, 0) | 1 << bit
                if tree.metadata is not None:
                    block = path_of(cell, level)[:-1]
                    beside.setdefault(number, []).append(tree.metadata[level - 1][block])
            self.strips.append(dict(sorted(words.items())))
            self.metadata.append({number: mean_word(each) for number, each in beside.items()})

    def cells(self, level: int) -> list[tuple[int, int, int]]:
        """Return the cells set at a level, in VOLA order."""
        paths = sorted({path_of(voxel, self.tree.depth)[:level] for voxel in self.tree.voxels})
        return [cell_of(path) for path in paths]

    @staticmethod
    def linear(cell: tuple[int, int, int], level: int) -> int:
        """Return the place of a cell in the bit array of its level."""
        x, y, z = cell
        return x + y * 4**level + z * 16**level

    def body(self) -> bytes:
        """Return the levels of a dense file."""
        data = bytearray()
        for level in range(self.tree.depth):
            kinds = [self.strips] if self.tree.metadata is None else [self.strips, self.metadata]
            for strips in kinds:
                part = bytearray(8 * 64**level)
                for number, word in strips[level].items():
                    struct.pack_into("<Q", part, 8 * number, word)
                data += part
        return bytes(data)

    def voxel_metadata(self) -> list[int] | None:
        """Return the word of each voxel's strip, as the file has it."""
        if self.tree.metadata is None:
            return None
        depth = self.tree.depth
        return [self.metadata[-1][self.linear(v, depth) // 64] for v in self.tree.voxels]

    def levels(self) -> list[dict[str, Any]]:
        """Return what a reader that turns it into blocks finds: means over the blocks' cells."""
        found = self.tree.levels()
        if self.tree.metadata is None:
            return found
        for level, blocks in enumerate(self.tree.blocks, 1):
            beside: dict[tuple[int, ...], list[int]] = {block: [] for block in blocks}
            for cell in self.cells(level):
                word = self.metadata[level - 1][self.linear(cell, level) // 64]
                beside[path_of(cell, level)[:-1]].append(word)
            means = [mean_word(each) if each else 0 for each in beside.values()]
            found[level - 1]["metadata"] = [f"{word:016x}" for word in means]
        return found


# ------------------------------------------------------------------------------------- files


def header(
    depth: int,
    box: tuple[float, ...],
    *,
    mode: int = 0,
    nbits: int = 0,
    crs: int = 2000,
    place: tuple[float, float] = (0.0, 0.0),
    size: int = 80,
    version: int = 1,
) -> bytes:
    """Return 80 bytes."""
    return struct.pack("<IHBBII8d", size, version, mode, depth, nbits, crs, *place, *box)


def box_of(origin: tuple[float, ...], side: float) -> tuple[float, ...]:
    """Return the box that tells of a cube."""
    return (*origin, *(value + side for value in origin))


def ratio(value: Fraction) -> str:
    """Return it as the trailer has it."""
    return f"{value.numerator}/{value.denominator}"


def crs_part(**known: Any) -> dict[str, Any]:
    """Return the trailer's crs object."""
    empty = dict.fromkeys(
        ("wkt2", "horizontal", "vertical", "epsg", "unit_xy", "unit_z",
         "metres_per_unit_xy", "metres_per_unit_z")
    )  # fmt: skip
    return {**empty, "is_geographic": False, "source": "none", **known}


def trailer_part(
    cube: tuple[Fraction, ...], blocks: list[int], voxels: int, **known: Any
) -> dict[str, Any]:
    """Return the trailer's object."""
    return {
        "schema": "volatool.trailer/1",
        "generator": "volatool 0.1.0",
        "quantizer": "floor",
        "cube": {"origin": [ratio(v) for v in cube[:3]], "side": ratio(cube[3]), "snapped": False},
        "box": None,
        "crs": crs_part(),
        "channels": [],
        "points": None,
        "source": {"name": None, "bytes": None},
        "blocks": blocks,
        "voxels": voxels,
        **known,
    }


def canonical(content: dict[str, Any]) -> bytes:
    """Return JSON as volatool writes it."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def framed(body: bytes, text: bytes) -> bytes:
    """Return a file: header and levels, then the trailer."""
    length = struct.pack("<I", len(text))
    checks = struct.pack("<II", zlib.crc32(body), zlib.crc32(text))
    return body + MAGIC + length + text + checks + length + MAGIC[::-1]


def gzip_stored(data: bytes) -> bytes:
    """Return gzip of blocks that are not compressed: the same with every zlib."""
    pieces = [data[start : start + 0xFFFF] for start in range(0, len(data), 0xFFFF)] or [b""]
    packed = b"".join(
        struct.pack("<BHH", i == len(pieces) - 1, len(piece), len(piece) ^ 0xFFFF) + piece
        for i, piece in enumerate(pieces)
    )
    start = bytes.fromhex("1f8b08000000000000ff")
    return start + packed + struct.pack("<II", zlib.crc32(data), len(data) % 2**32)


# ------------------------------------------------------------------------- what is expected


def cube_of(data: bytes, content: dict[str, Any] | None) -> tuple[Fraction, ...]:
    """Return corner and side as exact numbers."""
    if content is not None:
        cube = content["cube"]
        return tuple(Fraction(text) for text in (*cube["origin"], cube["side"]))
    box = [exact(value) for value in struct.unpack_from("<6d", data, 32)]
    return (*box[:3], max(box[3 + axis] - box[axis] for axis in range(3)))


def z_ratio_of(content: dict[str, Any] | None) -> Fraction:
    """Return horizontal units per vertical unit."""
    crs = {} if content is None else content["crs"]
    xy, z = crs.get("metres_per_unit_xy"), crs.get("metres_per_unit_z")
    return Fraction(1) if xy is None or z is None else Fraction(z) / Fraction(xy)


def place_of(
    point: tuple[float, ...], cube: tuple[Fraction, ...], z_ratio: Fraction, depth: int, floor: bool
) -> tuple[int, int, int] | None:
    """Return the voxel that a point falls into by exact arithmetic, None outside."""
    side, size = cube[3], 4**depth
    voxel = []
    for axis in range(3):
        away = exact(point[axis]) * (z_ratio if axis == 2 else 1) - cube[axis]
        if not 0 <= away <= side:
            return None
        if not side:
            voxel.append(0)
        elif floor:
            voxel.append(min(size - 1, math.floor(away * size / side)))
        else:
            voxel.append(round(away * (size - 1) / side))  # halves to even
    return tuple(voxel)  # type: ignore[return-value]


def centres_of(
    voxels: list[tuple[int, int, int]],
    cube: tuple[Fraction, ...],
    z_ratio: Fraction,
    depth: int,
    floor: bool,
) -> list[list[float]]:
    """Return the best estimate of where the points of each voxel are."""
    size = 4**depth
    found = []
    for voxel in voxels:
        steps = [Fraction(2 * k + 1, 2 * size) if floor else Fraction(k, size - 1) for k in voxel]
        place = [cube[axis] + cube[3] * steps[axis] for axis in range(3)]
        found.append([float(place[0]), float(place[1]), float(place[2] / z_ratio)])
    return found


def expectation(
    data: bytes,
    what: Tree | Dense,
    content: dict[str, Any] | None,
    points: list[tuple[float, float, float]],
    warnings: list[str],
) -> dict[str, Any]:
    """Return the JSON of a file that can be read."""
    tree = what.tree if isinstance(what, Dense) else what
    floor = content is not None and content["quantizer"] == "floor"
    cube, z_ratio = cube_of(data, content), z_ratio_of(content)
    names = ("headersize", "version", "mode", "depth", "nbits", "crs", "lat", "lon")
    values = struct.unpack_from("<IHBBII8d", data)
    beside = what.voxel_metadata()
    tested = []
    for point in points:
        voxel = place_of(point, cube, z_ratio, tree.depth, floor)
        tested.append({"xyz": point, "voxel": voxel, "contained": voxel in tree.voxels})
    return {
        "header": {**dict(zip(names, values[:8], strict=True)), "box": values[8:]},
        "cube": {"origin": [ratio(v) for v in cube[:3]], "side": ratio(cube[3])},
        "z_ratio": ratio(z_ratio),
        "quantizer": "unknown" if content is None else content["quantizer"],
        "trailer": content,
        "warnings": warnings,
        "levels": what.levels(),
        "voxels": tree.voxels,
        "voxel_metadata": None if beside is None else [f"{word:016x}" for word in beside],
        "centres": centres_of(tree.voxels, cube, z_ratio, tree.depth, floor),
        "points": tested,
    }


class Vectors:
    """All files, by name."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.expected: dict[str, dict[str, Any]] = {}

    def good(
        self,
        name: str,
        title: str,
        data: bytes,
        what: Tree | Dense,
        content: dict[str, Any] | None = None,
        *,
        points: list[tuple[float, float, float]] | None = None,
        warnings: list[str] | None = None,
        rewritten: bool = True,
    ) -> bytes:
        """Add a file that can be read; `rewritten`: volatool writes the same bytes again."""
        found = expectation(data, what, content, points or [], warnings or [])
        self._add(name, title, data, {**found, "rewritten": rewritten})
        return data

    def packed(self, name: str, original: str) -> None:
        """Add a file of those that are there, through gzip."""
        data = gzip_stored(self.files[original])
        self.files[name] = data
        self.expected[name] = {
            **self.expected[original],
            "file": name,
            "title": f"{original} through gzip",
            "bytes": len(data),
            "sha256": hashlib.sha256(data).hexdigest(),
        }

    def bad(self, name: str, title: str, data: bytes, error: str) -> None:
        """Add a file that must be refused."""
        self._add(name, title, data, {"error": error})

    def _add(self, name: str, title: str, data: bytes, found: dict[str, Any]) -> None:
        self.expected[name] = {
            "file": name,
            "title": title,
            "bytes": len(data),
            "sha256": hashlib.sha256(data).hexdigest(),
            **found,
        }
        self.files[name] = data

    def write(self, folder: Path) -> None:
        """Write each file and its JSON."""
        for name, data in self.files.items():
            (folder / name).write_bytes(data)
            lines = [
                f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}"
                for key, value in self.expected[name].items()
            ]
            text = "{\n" + ",\n".join(lines) + "\n}\n"
            (folder / f"{name}.json").write_text(text, encoding="utf-8")
