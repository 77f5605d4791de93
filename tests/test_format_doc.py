"""docs/format.md says what the code does: its tables, sizes and worked example can't rot."""

from __future__ import annotations

import json
import re
import struct
import zlib
from pathlib import Path

import making_volumes as making
import pytest

import volatool
from volatool.cube import MAX_DEPTH
from volatool.formats import dense, header, sparse, stream, trailer
from volatool.formats.header import Header
from volatool.vola.metadata import Ranges, Scaling
from volatool.vola.volume import MAX_LEVELS

DOCS = Path(__file__).resolve().parents[1] / "docs"
TEXT = (DOCS / "format.md").read_text(encoding="utf-8")


def section(number: int) -> str:
    found = re.search(rf"^## {number}\. .*?(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[0]


def rows(text: str) -> list[list[str]]:
    """Return the cells of all table rows but the heads."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if not set("".join(row)) <= set("-: ")][1:]


def example(name: str) -> str:
    found = re.search(rf"<!-- example: {name} -->\n```\w+\n(.*?)\n```", TEXT, re.DOTALL)
    assert found is not None
    return found[1]


def example_file() -> bytes:
    """Return the file that the worked example's dumps make."""
    data = bytearray()
    for line in example("hex").splitlines():
        assert int(line[:8], 16) == len(data)
        data += bytes.fromhex(line[10:57])
    text = example("json").encode()
    frame = b"VOLATRL1" + struct.pack("<I", len(text))
    return bytes(data) + frame + text + bytes.fromhex(example("end"))


def test_the_dumps_are_the_vector() -> None:
    """Byte for byte, and the frame is as section 8 says."""
    data = example_file()
    assert data == (DOCS / "vectors" / "sparse2-example.vol").read_bytes()
    body, text = data[:128], example("json").encode()
    assert data[128:] == trailer.frame(text, zlib.crc32(body))
    assert "`b2 02 00 00` (690 bytes" in TEXT
    assert struct.pack("<I", len(text)).hex(" ") == "b2 02 00 00"
    assert len(text) == 690
    assert f"0x{zlib.crc32(b'123456789'):X}" in section(8)


def test_what_the_example_tells_is_so() -> None:
    """Voxels, metadata, heights, places."""
    volume = volatool.open(example_file())
    assert volume.voxels().tolist() == [[0, 0, 0], [1, 0, 0], [15, 15, 15]]
    assert hex(int(volume.metadata()[2])) == "0x1060000ff000000"
    assert "0x01060000ff000000" in section(15)
    assert volume.channel("height")[2] == 25.9375
    assert volume.channel("class")[2] == 6
    assert volume.centers()[2].tolist() == [115.5, 215.5, 25.5]
    assert volume.contains([[116.0, 216.0, 26.0], [102.0, 200.0, 10.0]]).tolist() == [True, False]
    assert volume.cell_indices([[102.0, 200.0, 10.0]]).tolist() == [[2, 0, 0]]


def test_the_header_table_is_the_layout() -> None:
    """Offsets, types and names, in order."""
    codes = {"u32": "I", "u16": "H", "u8": "B", "f64": "d"}
    at, layout = 0, "<"
    for offset, kind, *_ in rows(section(2)):
        assert int(offset) == at
        layout += codes[kind]
        at += struct.calcsize("<" + codes[kind])
    assert at == header.HEADER_BYTES
    assert struct.calcsize(layout) == 80
    given = Header(1, 2, 1, 2994, 44.0, -123.0, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    names = [row[2] for row in rows(section(2))]
    fields = dict(zip(names, struct.unpack(layout, given.to_bytes()), strict=True))
    assert fields == {
        "headersize": 80, "version": 1, "mode": 1, "depth": 2, "nbits": 1, "crs": 2994,
        "lat": 44.0, "lon": -123.0,
        "minx": 1.0, "miny": 2.0, "minz": 3.0, "maxx": 4.0, "maxy": 5.0, "maxz": 6.0,
    }  # fmt: skip


def keys(content: dict[str, object], above: str = "") -> set[str]:
    found: set[str] = set()
    for key, value in content.items():
        found |= keys(value, f"{above}{key}.") if isinstance(value, dict) else {f"{above}{key}"}
    return found


def test_the_trailer_table_has_all_keys() -> None:
    """Those that are written, no others; each of them is needed for reading."""
    table = rows(section(8)[section(8).index("All keys") :])
    told = {key for row in table for key in re.findall(r"`([^`]+)`", row[0])}
    content = json.loads(trailer.describe(making.random_volume(2, 9), [1, 9]))
    assert told == keys(content)
    volume = making.random_volume(2, 9)
    given = Header.of(volume, 0)
    trailer.interpret(content, given)
    for path in told - {"blocks", "voxels"}:  # these two are held against the levels
        changed = json.loads(json.dumps(content))
        *above, last = path.split(".")
        del (changed[above[0]] if above else changed)[last]
        with pytest.raises(volatool.VolatoolError):
            trailer.interpret(changed, given)
    more = {**content, "new": {"quantizer": 1}, "crs": {**content["crs"], "more": None}}
    trailer.interpret(more, given)


def test_the_channels_are_those_that_are_written() -> None:
    """Bytes, names and reductions."""
    all_of_them = ("rgb", "height", "returns", "intensity", "class")
    scaling = Scaling.of(all_of_them, Ranges(0, 510, 65535, 510), 1.0, 0.0)
    written = [(c["byte"], c["name"], c["reduction"]) for c in scaling.channels]
    told = []
    for numbers, names, *_, reduction in rows(section(6)):
        for byte, name in zip(numbers.split(", "), names.split(", "), strict=True):
            told.append((int(byte), name, reduction.split(":")[0]))
    assert told == written
    assert f"0x{int(sparse.SAFE_WORD):016x}" in section(6)


def test_sizes_and_limits_are_the_codes() -> None:
    """Tables and numbers of the text."""
    table = rows(section(14))
    assert len(table) == 6
    for depth, size, without, with_words in table:
        numbers = [int(text.replace(",", "")) for text in (depth, size, without, with_words)]
        deep = numbers[0]
        assert numbers[1:] == [
            4**deep,
            dense.dense_bytes(deep, False),
            dense.dense_bytes(deep, True),
        ]
    assert f"reads up to {MAX_LEVELS} and writes up to {MAX_DEPTH}" in section(2)
    assert f"{trailer.MAX_TRAILER:,}" in section(8)
    assert str(trailer.MAX_TRAILER) in section(10)
    assert trailer.FRAME_BYTES == 32
    assert stream.SIZE_LIMIT == 1 << 30
