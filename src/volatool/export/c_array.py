"""A C99 header that holds the bytes of a ``.vol`` file, for devices without files."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

from volatool._version import __version__
from volatool.errors import CodedWarning, OptionError, ResourceError
from volatool.export.model import ExportOptions, Target
from volatool.formats import sparse
from volatool.formats.header import HEADER_BYTES
from volatool.units import format_size
from volatool.vola.volume import Volume

LIMIT_BYTES = 1 << 20
"""Bytes of the array unless ``--limit`` says otherwise; their text is five times as long."""

_ROW = 16
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_KEYWORDS = frozenset({
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else",
    "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register",
    "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "typedef",
    "union", "unsigned", "void", "volatile", "while", "_Bool", "_Complex", "_Imaginary",
    "alignas", "alignof", "bool", "class", "constexpr", "delete", "false", "namespace", "new",
    "nullptr", "operator", "private", "protected", "public", "template", "this", "throw",
    "true", "try", "typeid", "typename", "using", "virtual",
})  # fmt: skip
"""Of C, and of C++ where such a header may end up too."""

_TEXT = """\
/* {n_voxels} voxels of {cell} {unit}, {depth} levels, {crs}. Made by volatool {version}.
 *
 * {name}_vol is a .vol file of {size} bytes, as docs/format.md of volatool has it; vola.h reads it:
 *
 *     vola v;
 *     vola_open(&v, {name}_vol, {macro}_VOL_SIZE, VOLA_CHECK_ALL);
 *
 * {name}_word(level, i) and {name}_meta(level, i) are its words, on machines of any byte order.
 * Define {macro}_STORAGE to place the array, for example
 * static const __attribute__((section(".flash"))).
 */
#ifndef {macro}_VOL_H
#define {macro}_VOL_H

#include <stdint.h>

#define {macro}_DEPTH {depth}
#define {macro}_GRID {grid}L /* cells along an edge of the cube: 4^depth */
#define {macro}_VOXELS {n_voxels}UL
#define {macro}_HAS_METADATA {has_metadata}
#define {macro}_EPSG {epsg}L /* horizontal; 2000: not known */
#define {macro}_CORNER_X ({x!r}) /* of the cube, in the horizontal unit, z too */
#define {macro}_CORNER_Y ({y!r})
#define {macro}_CORNER_Z ({z!r})
#define {macro}_SIDE {side!r}
#define {macro}_CELL {cell_exact!r}
#define {macro}_Z_RATIO {ratio!r} /* horizontal units per vertical unit */
#define {macro}_VOL_SIZE {size}UL

#ifndef {macro}_STORAGE
#define {macro}_STORAGE static const
#endif

/* blocks of each level, the root first, and where its occupancy words begin; {meta_told} */
static const uint32_t {name}_blocks[{macro}_DEPTH] = {{{blocks}}};
static const uint32_t {name}_offset[{macro}_DEPTH] = {{{offsets}}};

/* the second member is for the alignment: to 8 bytes where a uint64_t has it */
{macro}_STORAGE union {{
    unsigned char bytes[{macro}_VOL_SIZE];
    uint64_t align;
}} {name}_data = {{{{
"""

_END = """\
}}}};

#define {name}_vol ({name}_data.bytes)

static inline uint64_t {name}_at(uint32_t offset) {{
    uint64_t word = 0;
    uint32_t i;
    for (i = 8; i > 0; i--) word = word << 8 | {name}_vol[offset + i - 1];
    return word;
}}

/* occupancy word i of a level, 1 to {macro}_DEPTH; bit lx + 4 ly + 16 lz */
static inline uint64_t {name}_word(int level, uint32_t i) {{
    return {name}_at({name}_offset[level - 1] + 8 * i);
}}
{meta}
#endif
"""

_META = """
/* metadata word i of a level: byte c is channel c ({channels}) */
static inline uint64_t {name}_meta(int level, uint32_t i) {{
    return {name}_at({name}_offset[level - 1] + 8 * ({name}_blocks[level - 1] + i));
}}
"""


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write the header.

    Parameters
    ----------
    volume : Volume
        What is written; with its metadata and trailer.
    target : Target
        One file.
    options : ExportOptions
        ``name``, by default the file's name; ``limit``, bytes of the array (1 MiB).

    Returns
    -------
    warnings : list of CodedWarning

    Raises
    ------
    OptionError
        The name is no identifier.
    ResourceError
        ``E_SIZE``: the array would be larger than the limit.
    """
    name = _name(options.name, target.stem)
    blocks = [len(words) for words in volume.levels]
    limit = min(options.limit or LIMIT_BYTES, 2**32 - 1)  # offsets have 32 bits
    least = sparse.sparse_bytes(blocks, volume.has_metadata)
    if least > limit:
        raise ResourceError(
            f"the array would take {format_size(least)}, at most {format_size(limit)} are "
            "written; give a coarser --level, --bounds, or a larger --limit",
            "E_SIZE",
        )
    body = io.BytesIO()
    sparse.write(body, volume)
    data = body.getvalue()
    if len(data) > limit:
        raise ResourceError(
            f"the array would take {format_size(len(data))}, at most {format_size(limit)} are "
            "written; give a larger --limit",
            "E_SIZE",
        )
    with target.stream() as stream:
        stream.write(_head(volume, name, data, blocks).encode())
        for row in _rows(data):
            stream.write(row)
        stream.write(_end(volume, name).encode())
    return []


def _name(given: str | None, stem: str) -> str:
    """Return the identifier that is given, or one made of the file's name."""
    if given is None:
        name = re.sub(r"[^A-Za-z0-9_]", "_", stem)
        name = f"v_{name}" if not name or name[0].isdigit() or name[0] == "_" else name
        return f"{name}_" if name in _KEYWORDS else name
    if not _IDENTIFIER.fullmatch(given) or given in _KEYWORDS:
        raise OptionError(f"--name {given}: is no identifier of C")
    return given


def _head(volume: Volume, name: str, data: bytes, blocks: list[int]) -> str:
    width = 16 if volume.has_metadata else 8
    offsets = [HEADER_BYTES + width * sum(blocks[:level]) for level in range(len(blocks))]
    x, y, z = volume.cube.origin
    crs = volume.crs
    parts = [part for part in (crs.horizontal, crs.vertical) if part]
    return _TEXT.format(
        name=name,
        macro=name.upper(),
        version=__version__,
        n_voxels=len(volume),
        cell=f"{volume.cell():.10g}",
        unit=_comment(crs.unit_xy or "(unit unknown)"),
        crs=_comment(" + ".join(parts) or "no CRS"),
        depth=volume.depth,
        grid=4**volume.depth,
        has_metadata=int(volume.has_metadata),
        epsg=int.from_bytes(data[12:16], "little"),
        x=x,
        y=y,
        z=z,
        side=volume.cube.side,
        cell_exact=volume.cell(),
        ratio=float(crs.z_ratio),
        size=len(data),
        meta_told="its metadata words follow them" if volume.has_metadata else "no metadata",
        blocks=", ".join(map(str, blocks)),
        offsets=", ".join(map(str, offsets)),
    )


def _comment(text: str) -> str:
    """Return a text that can't end a comment, or go on in the next line."""
    plain = text.encode("ascii", "replace").decode()
    return re.sub(r"[^ -~]|\*/|/\*|\?\?|\\", "?", plain)[:200]


def _rows(data: bytes) -> Iterator[bytes]:
    """Yield the bytes as numbers, sixteen a line."""
    for start in range(0, len(data), _ROW):
        row = data[start : start + _ROW]
        yield (",".join(f"0x{byte:02x}" for byte in row) + ",\n").encode()


def _end(volume: Volume, name: str) -> str:
    meta = ""
    if volume.has_metadata:
        names = [f"{channel['byte']} {channel['name']}" for channel in volume.info.channels]
        channels = _comment(", ".join(names) or "not known")
        meta = _META.format(name=name, channels=channels)
    return _END.format(name=name, macro=name.upper(), meta=meta)
