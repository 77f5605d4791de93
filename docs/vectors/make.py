"""
Make the test vectors of docs/format.md: ``python docs/vectors/make.py [FOLDER]``.

Plain Python from the text of the specification, with twin.py beside it; nothing of volatool is
imported, so that the two can be held against each other. The same bytes come out always.
"""

from __future__ import annotations

import json
import math
import struct
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

from twin import (
    CONSTANT,
    ENGINEERING,
    HERE,
    MAGIC,
    Dense,
    Tree,
    Vectors,
    box_of,
    canonical,
    crs_part,
    framed,
    header,
    ratio,
    some_voxels,
    trailer_part,
)

ORIGIN = (100.0, 200.0, 10.0)
BOX = box_of(ORIGIN, 16.0)
CUBE = (Fraction(100), Fraction(200), Fraction(10), Fraction(16))
POINTS = [
    (100.0, 200.0, 10.0),
    (100.5, 200.5, 10.5),
    (116.0, 216.0, 26.0),
    (103.9, 212.25, 25.0),
    (99.0, 200.0, 10.0),
    (108.0, 208.0, 27.0),
]


def with_trailer(body: bytes, what: Tree | Dense, **known: Any) -> tuple[bytes, dict[str, Any]]:
    """Return a file and its trailer's object."""
    tree = what.tree if isinstance(what, Dense) else what
    blocks = tree.counts() if what is tree else [64**level for level in range(tree.depth)]
    cube = known.pop("cube", CUBE)
    content = trailer_part(cube, blocks, len(tree.voxels), **known)
    return framed(body, canonical(content)), content


def add_toolkit(vectors: Vectors) -> None:
    """Files as the original toolkit writes them: no trailer."""
    box = (0.0, 0.0, 0.0, 3.0, 2.0, 1.0)
    tree = Tree([(x, x % 3, x // 2) for x in range(4)] + [(3, 3, 3)], 1, None)
    points = [(0.5, 0.0, 0.0), (1.5, 1.0, 0.9), (2.5, 2.0, 1.0), (3.0, 3.0, 3.0), (3.1, 0.0, 0.0)]
    vectors.good("toolkit1.vol", "depth 1, no metadata, no trailer: points are rounded",
                 header(1, box) + tree.sparse(), tree, points=points, rewritten=False)  # fmt: skip
    tree = Tree(some_voxels(2, 20, 3), 2, 5)
    box = (500000.25, 4649776.5, 101.75, 500031.5, 4649839.0, 110.25)
    data = header(2, box, nbits=1, crs=32633, place=(42.0, 15.0)) + tree.sparse()
    points = [(500000.25, 4649776.5, 101.75), (500020.0, 4649800.0, 150.0), (0.0, 0.0, 0.0)]
    vectors.good("toolkit2-metadata.vol", "depth 2 with metadata and an EPSG code, no trailer",
                 data, tree, points=points, rewritten=False)  # fmt: skip
    tree = Tree([(0, 0, 0)], 2, None)
    place = (7.0, 8.0, 9.0)
    vectors.good("toolkit2-point.vol", "one place only: a cube without extent",
                 header(2, box_of(place, 0.0)) + tree.sparse(), tree,
                 points=[place, (7.0, 8.0, 9.5)], rewritten=False)  # fmt: skip
    tree = Tree(some_voxels(2, 9, 8), 2, 0)
    assert tree.metadata is not None
    tree.metadata = [dict.fromkeys(words, 0) for words in tree.metadata]
    whole = tree.metadata
    tree.metadata = None
    data = header(2, BOX, nbits=1) + tree.sparse()
    tree.metadata = whole
    vectors.good("toolkit2-zero-metadata.vol",
                 "all metadata words were zero and left out: read as zeros, with a warning",
                 data, tree, warnings=["W_ZERO_METADATA"], rewritten=False)  # fmt: skip
    tree = Tree([(0, 0, 0), (9, 9, 9)], 2, None)
    first = next(iter(tree.blocks[1]))
    tree.blocks[1][first] = 0
    tree.voxels = tree.voxels[1:]
    vectors.good("toolkit2-empty-block.vol",
                 "a stored block without cells; harmless without metadata",
                 header(2, BOX) + tree.sparse(), tree, warnings=["W_EMPTY_BLOCKS"],
                 rewritten=False)  # fmt: skip


def add_sparse(vectors: Vectors) -> None:
    """Sparse files with a trailer, as volatool writes them."""
    tree = Tree([], 3, 11)
    data, content = with_trailer(header(3, BOX, nbits=1) + tree.sparse(), tree)
    vectors.good("sparse3-empty.vol", "no voxel: one word of zero and its metadata word",
                 data, tree, content, points=POINTS)  # fmt: skip
    cells = [(4 + x, 8 + y, z) for x in range(4) for y in range(4) for z in range(4)]
    tree = Tree(cells, 2, None)
    data, content = with_trailer(header(2, BOX) + tree.sparse(), tree)
    vectors.good("sparse2-full-block.vol", "64 voxels in one block", data, tree, content,
                 points=[*POINTS, (104.0, 208.0, 10.0), (107.99, 211.99, 13.99)])  # fmt: skip
    ends = (0, 63)
    tree = Tree([(x, y, z) for x in ends for y in ends for z in ends], 3, None)
    data, content = with_trailer(header(3, BOX) + tree.sparse(), tree)
    vectors.good("sparse3-corners.vol", "the eight corner voxels of depth 3", data, tree, content,
                 points=[*POINTS, (116.0, 200.0, 10.0), (115.75, 200.0, 25.9)])  # fmt: skip
    tree = Tree(some_voxels(3, 40, 21), 3, 22)
    local = {
        "crs": crs_part(wkt2=ENGINEERING, horizontal="local", unit_xy="metre", unit_z="metre",
                        metres_per_unit_xy="1/1", metres_per_unit_z="1/1", source="wkt"),
        "channels": [
            {"byte": 3, "name": "height", "scale": 0.0625, "offset": 10.0, "unit": "metre",
             "reduction": "mean"},
            {"byte": 6, "name": "class", "scale": 1.0, "offset": 0.0, "unit": "",
             "reduction": "mode"},
            CONSTANT,
        ],
        "box": [100.0, 200.0, 10.0, 116.0, 215.5, 25.9375],
        "points": 1234,
        "source": {"name": "Straße 7.laz", "bytes": 56789},
    }  # fmt: skip
    data, content = with_trailer(header(3, BOX, nbits=1) + tree.sparse(), tree, **local)
    vectors.good("sparse3-metadata.vol", "depth 3 with metadata, channels and a local CRS",
                 data, tree, content, points=POINTS)  # fmt: skip
    vectors.packed("sparse3-metadata.vol.gz", "sparse3-metadata.vol")
    tree = Tree([(0, 0, 0), (1, 0, 0), (511, 512, 513), (1000, 3, 700), (1023, 1023, 1023)], 5, 31)
    data, content = with_trailer(header(5, BOX, nbits=1) + tree.sparse(), tree)
    vectors.good("sparse5-metadata.vol", "depth 5 with metadata", data, tree, content,
                 points=[*POINTS, (115.64, 200.04, 20.95)])  # fmt: skip
    add_example(vectors)
    add_feet(vectors)
    add_third(vectors)
    add_foreign(vectors)


def add_example(vectors: Vectors) -> None:
    """Add the worked example of docs/format.md."""
    tree = Tree([(0, 0, 0), (1, 0, 0), (15, 15, 15)], 2, 0)
    # bytes: 3 height, 6 class, 7 always 1
    words = [0x0102000055000000, 0x0102000000000000, 0x01060000FF000000]
    tree.metadata = [{(): words[0]}, dict(zip(tree.blocks[1], words[1:], strict=True))]
    channels = [
        {
            "byte": 3,
            "name": "height",
            "scale": 0.0625,
            "offset": 10.0,
            "unit": "metre",
            "reduction": "mean",
        },
        {
            "byte": 6,
            "name": "class",
            "scale": 1.0,
            "offset": 0.0,
            "unit": "",
            "reduction": "mode",
        },
        CONSTANT,
    ]
    start = header(2, BOX, nbits=1)
    data, content = with_trailer(start + tree.sparse(), tree, channels=channels, points=3)
    points = [
        (100.5, 200.5, 10.5),
        (101.5, 200.0, 10.0),
        (102.0, 200.0, 10.0),
        (116.0, 216.0, 26.0),
    ]
    vectors.good("sparse2-example.vol", "the worked example of the specification", data, tree,
                 content, points=points)  # fmt: skip


def add_feet(vectors: Vectors) -> None:
    """Heights in another unit than the plane."""
    tree = Tree(some_voxels(2, 25, 41), 2, 42)
    wkt = (HERE / "EPSG-2994+6360.wkt").read_text(encoding="utf-8").strip()
    foot, us_foot = Fraction(3048, 10000), Fraction(1200, 3937)
    # the cube's corner is 400 US survey feet high, told in feet
    cube = (Fraction(637000), Fraction(4850000), 400 * us_foot / foot, Fraction(10))
    origin = tuple(float(value) for value in cube[:3])
    crs = crs_part(
        wkt2=wkt, horizontal="EPSG:2994", vertical="EPSG:6360", epsg=2994, unit_xy="foot",
        unit_z="US survey foot", metres_per_unit_xy=ratio(foot), metres_per_unit_z=ratio(us_foot),
        source="wkt",
    )  # fmt: skip
    start = header(2, box_of(origin, 10.0), nbits=1, crs=2994, place=(44.0, -123.0))
    data, content = with_trailer(start + tree.sparse(), tree, cube=cube, crs=crs)
    points = [
        (637000.1, 4850000.1, 400.1),
        (637009.9, 4850009.9, 409.9),
        (637001.0, 4850001.0, 400.9),
        (637005.0, 4850005.0, 410.1),
        (637005.0, 4850005.0, 399.9),
    ]
    vectors.good("sparse2-feet.vol", "a compound CRS: feet in the plane, US survey feet in height",
                 data, tree, content, points=points)  # fmt: skip


def add_third(vectors: Vectors) -> None:
    """Take a cube that no floats can tell."""
    tree = Tree(some_voxels(1, 6, 51), 1, None)
    cube = (Fraction(1, 3), Fraction(-2, 7), Fraction(0), Fraction(10, 3))
    origin, side = tuple(float(value) for value in cube[:3]), float(cube[3])
    start = header(1, box_of(origin, side))
    data, content = with_trailer(start + tree.sparse(), tree, cube=cube)
    points = [(0.4, -0.2, 0.1), (2.1, 1.5, 1.7), (3.5, 2.9, 3.2), (3.7, 0.0, 0.0)]
    vectors.good("sparse1-thirds.vol", "corner and side are ratios that no float has",
                 data, tree, content, points=points)  # fmt: skip


def add_foreign(vectors: Vectors) -> None:
    """Trailers that volatool would not write so, but reads."""
    tree = Tree(some_voxels(2, 12, 61), 2, 62)
    body = header(2, BOX, nbits=1) + tree.sparse()
    _, content = with_trailer(body, tree)
    content = {
        "voxels": content.pop("voxels"),
        "zz": {"quantizer": "no", "list": [1, [2, '"']]},
        **content,
        "generator": 'other "writer" \\ 2',
    }
    text = json.dumps(content, indent=1).encode()
    vectors.good("sparse2-foreign.vol", "unknown keys, another order, blanks and escapes",
                 framed(body, text), tree, content, points=POINTS, rewritten=False)  # fmt: skip
    cut, _ = with_trailer(body, tree)
    vectors.good("sparse2-cut-trailer.vol",
                 "cut exactly before the trailer: nothing tells it from a file of the toolkit",
                 cut[: len(body)], tree, points=POINTS, rewritten=False)  # fmt: skip
    text = canonical({**content, "quantizer": "toolkit"})
    vectors.good("sparse2-rounded.vol", "a trailer that says the points were rounded",
                 framed(body, text), tree, {**content, "quantizer": "toolkit"}, points=POINTS,
                 rewritten=False)  # fmt: skip


def add_dense(vectors: Vectors) -> None:
    """Dense files."""
    tree = Tree([(0, 0, 0), (3, 0, 0), (1, 2, 3), (3, 3, 3)], 1, None)
    dense = Dense(tree)
    vectors.good("dense1.dvol", "depth 1: the same words as sparse",
                 header(1, BOX, mode=1) + dense.body(), dense, points=POINTS,
                 rewritten=False)  # fmt: skip
    tree = Tree(some_voxels(2, 30, 71), 2, 72)
    dense = Dense(tree)
    data, content = with_trailer(header(2, BOX, mode=1, nbits=1) + dense.body(), dense)
    vectors.good("dense2-metadata.dvol", "depth 2 with the words of strips", data, dense, content,
                 points=POINTS)  # fmt: skip
    tree = Tree([(0, 0, 0), (63, 63, 63), (63, 0, 0), (17, 33, 5)], 3, None)
    dense = Dense(tree)
    data, content = with_trailer(header(3, BOX, mode=1) + dense.body(), dense)
    vectors.good("dense3.dvol", "depth 3: a strip is a row", data, dense, content,
                 points=POINTS)  # fmt: skip
    dense = Dense(Tree([], 2, None))
    data, content = with_trailer(header(2, BOX, mode=1) + dense.body(), dense)
    vectors.good("dense2-empty.dvol", "no voxel", data, dense, content)


def add_bad_headers(vectors: Vectors) -> None:
    """Files whose first 80 bytes are refused."""
    tree = Tree([(1, 2, 3)], 1, None)
    body = tree.sparse()
    nan = (*BOX[:5], math.nan)
    below = (*BOX[:5], 9.0)
    huge = (-1.7e308, 0.0, 0.0, 1.7e308, 0.0, 0.0)
    for name, title, start, error in [
        ("headersize", "96 bytes of header", header(1, BOX, size=96), "E_NOT_VOLA"),
        ("version", "version 2", header(1, BOX, version=2), "E_NOT_VOLA"),
        ("mode", "mode 2", header(1, BOX, mode=2), "E_CORRUPT"),
        ("depth0", "no level", header(0, BOX), "E_CORRUPT"),
        ("depth16", "more levels than are read", header(16, BOX), "E_SIZE"),
        ("nbits2", "two metadata words per block", header(1, BOX, nbits=2), "E_CORRUPT"),
        ("box-nan", "a box that is not finite", header(1, nan), "E_CORRUPT"),
        ("box-below", "maximum below minimum", header(1, below), "E_CORRUPT"),
        ("box-huge", "an extent beyond a float64", header(1, huge), "E_CORRUPT"),
    ]:
        vectors.bad(f"bad-{name}.vol", title, start + body, error)
    vectors.bad("bad-empty.vol", "no byte", b"", "E_NOT_VOLA")
    vectors.bad("bad-cut-header.vol", "40 bytes", header(1, BOX)[:40], "E_TRUNCATED")


def add_bad_levels(vectors: Vectors) -> None:
    """Files whose levels are cut or contradict themselves."""
    tree = Tree(some_voxels(2, 30, 81), 2, 82)
    body = header(2, BOX, nbits=1) + tree.sparse()
    vectors.bad("bad-cut-level.vol", "cut inside a word of level 2", body[: 80 + 16 + 20],
                "E_TRUNCATED")  # fmt: skip
    vectors.bad("bad-cut-metadata.vol", "the last metadata word is missing", body[:-8],
                "E_TRUNCATED")  # fmt: skip
    vectors.bad("bad-trailing.vol", "5 bytes after the last level", body + b"12345", "E_CORRUPT")
    first = 80 + 16
    vectors.bad("bad-zero-word.vol", "a word of zero below the root, with metadata",
                body[:first] + bytes(8) + body[first + 8 :], "E_CORRUPT")  # fmt: skip
    assert tree.metadata is not None
    last = tree.metadata[1]
    gone = list(last)[len(last) // 2]
    kept = b"".join(struct.pack("<Q", word) for path, word in last.items() if path != gone)
    vectors.bad("bad-dropped-word.vol", "one metadata word was zero and left out",
                body[: -8 * len(last)] + kept, "E_TRUNCATED")  # fmt: skip
    full = struct.pack("<Q", 2**64 - 1)
    vectors.bad("bad-bomb.vol", "65 full words of depth 15 claim 4096 more",
                header(15, BOX) + 65 * full, "E_TRUNCATED")  # fmt: skip
    vectors.bad("bad-bomb.dvol", "a dense file of depth 15 in one word",
                header(15, BOX, mode=1) + full, "E_TRUNCATED")  # fmt: skip
    dense = Dense(Tree([(0, 0, 0), (15, 15, 15)], 2, None))
    good = bytearray(header(2, BOX, mode=1) + dense.body())
    vectors.bad("bad-dense-short.dvol", "the last word is missing", bytes(good[:-8]),
                "E_TRUNCATED")  # fmt: skip
    orphan = good.copy()
    orphan[88 + 8 * 10] |= 1
    vectors.bad("bad-dense-orphan.dvol", "a voxel whose cell above is not set", bytes(orphan),
                "E_CORRUPT")  # fmt: skip
    childless = good.copy()
    childless[81] |= 1
    vectors.bad("bad-dense-childless.dvol", "a cell without a voxel in it", bytes(childless),
                "E_CORRUPT")  # fmt: skip


def add_bad_trailers(vectors: Vectors) -> None:
    """Files with a trailer that is cut, damaged, or tells of something else."""
    tree = Tree(some_voxels(2, 15, 91), 2, 92)
    body = header(2, BOX, nbits=1) + tree.sparse()
    whole, content = with_trailer(body, tree)
    text = canonical(content)
    cut = whole[: len(body) + 100]
    vectors.bad("bad-cut-trailer.vol", "cut inside the JSON", cut, "E_TRUNCATED")
    vectors.bad("bad-cut-magic.vol", "cut inside the trailer's magic", whole[: len(body) + 3],
                "E_TRUNCATED")  # fmt: skip
    vectors.bad("bad-after-trailer.vol", "a byte after the trailer", whole + b"\n", "E_CORRUPT")
    changed = bytearray(whole)
    changed[len(body) - 8] ^= 1
    vectors.bad("bad-crc-levels.vol", "a bit of the last metadata word is not what it was",
                bytes(changed), "E_CORRUPT")  # fmt: skip
    changed = bytearray(whole)
    changed[len(body) + 20] ^= 1
    vectors.bad("bad-crc-json.vol", "a bit of the JSON is not what it was", bytes(changed),
                "E_CORRUPT")  # fmt: skip
    changed = bytearray(whole)
    changed[-9] ^= 1
    vectors.bad("bad-length.vol", "the two lengths differ", bytes(changed), "E_CORRUPT")
    long = body + MAGIC + struct.pack("<I", 1 << 20) + text
    vectors.bad("bad-long-trailer.vol", "a trailer of more than a mebibyte", long, "E_CORRUPT")
    for name, title, change in [
        ("schema", "a trailer of a later schema", {"schema": "volatool.trailer/2"}),
        ("blocks", "block counts that are not those of the levels", {"blocks": [1, 2]}),
        ("quantizer", "a rule that is not known", {"quantizer": "ceil"}),
        ("cube", "a cube that is not the header's box",
         {"cube": {"origin": ["0/1", "0/1", "0/1"], "side": "16/1", "snapped": False}}),
    ]:  # fmt: skip
        text = canonical({**content, **change})
        vectors.bad(f"bad-{name}.vol", title, framed(body, text), "E_CORRUPT")


def all_vectors() -> Vectors:
    """Return all of them."""
    vectors = Vectors()
    for add in (add_toolkit, add_sparse, add_dense, add_bad_headers, add_bad_levels,
                add_bad_trailers):  # fmt: skip
        add(vectors)
    return vectors


if __name__ == "__main__":
    all_vectors().write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
