"""PLY files: the vertices as points, or the surface of the faces when ``--mesh`` asks for it.

Vertices are mapped (binary) or read in blocks of lines (ascii). Only faces, and vertices that stand
behind lists of other elements or hold lists, are read by plyfile (extra ``mesh``), as a whole.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import FormatError, OptionError, TruncatedError
from volatool.formats.origin import find_origin
from volatool.imports.columns import Columns
from volatool.imports.model import (
    Batch,
    ImportedPoints,
    mapped,
    plain_toolkit,
    role_of,
)
from volatool.imports.text import Layout, table_batches
from volatool.model import I64
from volatool.options import ConvertOptions

MAX_HEADER_BYTES = 1 << 16

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS = {"red", "green", "blue"}


@dataclass(slots=True)
class _Element:
    """Name, count and properties: (name, type) of scalars, (name, None) of lists."""

    name: str
    count: int
    properties: list[tuple[str, str | None]]
    least_bytes: int = 0

    @property
    def has_lists(self) -> bool:
        return any(kind is None for _, kind in self.properties)


@dataclass(frozen=True, slots=True)
class _Header:
    """Byte order ("" for ascii), elements in order, and where the data begin."""

    order: str
    elements: list[_Element]
    data_start: int
    comments: list[str]

    def find(self, name: str) -> _Element | None:
        return next((element for element in self.elements if element.name == name), None)


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a PLY file.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        ``mesh``: ``"auto"`` and ``"vertices"`` take the vertices.

    Raises
    ------
    FormatError, TruncatedError
        Not such a file; it can't hold what its header claims.
    OptionError
        ``E_NO_EXTRA``; ``mesh`` asks for faces and there are none.
    """
    header = _header(path)
    vertex = header.find("vertex")
    if vertex is None:
        raise FormatError("has no vertices, so no points", "E_NOT_IMPORT")
    if options.mesh in ("sample", "voxelize"):
        return _surface(path, header, options)
    roles = _roles(vertex)
    names = frozenset(role for role in roles if role not in "xyz")
    before = header.elements[: header.elements.index(vertex)]
    if vertex.has_lists or any(element.has_lists for element in before):
        columns = _by_plyfile(path, roles)

        def batches(n_rows: int) -> Iterator[Batch]:
            return _cut(columns, names, n_rows)

    elif header.order:
        dtype = _dtype(vertex, header.order)
        start = header.data_start + sum(e.count * e.least_bytes for e in before)
        records = mapped(path, dtype, start, vertex.count)

        def batches(n_rows: int) -> Iterator[Batch]:
            return _cut({role: records[str(k)] for role, k in roles.items()}, names, n_rows)

    else:

        def batches(n_rows: int) -> Iterator[Batch]:
            return _ascii(path, header, vertex, roles, n_rows)

    points = ImportedPoints("ply", batches, names, keeps_nan=True, toolkit=plain_toolkit(batches))
    _remember(points, header)
    return points


def _remember(points: ImportedPoints, header: _Header) -> None:
    """Put back what a comment of our own export keeps: CRS, place and, of points, the cube."""
    origin = find_origin(header.comments)
    if origin is None:
        return
    points.crs = origin.info.crs
    if header.find("face") is None:
        points.grid = (origin.cube, origin.depth)
    shift = next((line.split()[1:] for line in header.comments if line.startswith("shift ")), None)
    if shift is None:
        return
    try:
        x, y, z = (float(word) for word in shift)
    except ValueError as error:
        raise FormatError(f"the comment 'shift {' '.join(shift)[:60]}' makes no sense") from error
    local = points.batches

    def batches(n_rows: int) -> Iterator[Batch]:
        for batch in local(n_rows):
            yield replace(batch, xyz=batch.xyz + np.array([x, y, z]))

    points.batches = batches


def _header(path: Path) -> _Header:
    """Read the header; every count in it fits the file."""
    with path.open("rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if head[:3] != b"ply" or head[3:4] not in (b"\n", b"\r"):
        raise FormatError(f"is no PLY file: it starts with {head[:4]!r}", "E_NOT_IMPORT")
    end = head.find(b"end_header")
    line_end = head.find(b"\n", end)
    if end < 0 or line_end < 0:
        if len(head) < MAX_HEADER_BYTES:
            raise TruncatedError(f"ends in its header, at byte {len(head)}, before end_header")
        raise FormatError("has no end_header where a PLY header ends")
    order = None
    elements: list[_Element] = []
    comments: list[str] = []
    for number, line in enumerate(head[:end].decode("latin-1").splitlines(), 1):
        words = line.split()
        try:
            if words and words[0] == "comment":
                comments.append(line.partition(" ")[2])
            if not words or number == 1 or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format":
                order = _ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[0] == "property":
                _add_property(elements[-1], words)
            else:
                raise ValueError(f"{words[0]!r} is no word of a PLY header")
        except (KeyError, ValueError, IndexError) as error:
            raise FormatError(f"header line {number}: {line[:60]!r} ({error})") from error
    if order is None:
        raise FormatError("its header has no format line")
    header = _Header(order, elements, line_end + 1, comments)
    _check_size(header, path.stat().st_size)
    return header


def _add_property(element: _Element, words: list[str]) -> None:
    if words[1] == "list":
        element.properties.append((words[4], None))
        element.least_bytes += int(_TYPES[words[2]][1])
        _ = _TYPES[words[3]]
    else:
        element.properties.append((words[2], _TYPES[words[1]]))
        element.least_bytes += int(_TYPES[words[1]][1])


def _check_size(header: _Header, size: int) -> None:
    """Refuse counts that the file can't hold."""
    at = header.data_start
    for element in header.elements:
        # ascii: a digit and a separator for each value; the last line need not end
        least = element.least_bytes if header.order else 2 * len(element.properties)
        if element.count < 0 or at + element.count * least > size + 1:
            raise TruncatedError(
                f"claims {element.count} of element {element.name}, more than its {size} bytes "
                "can hold"
            )
        at += element.count * least


def _roles(vertex: _Element) -> dict[str, int]:
    """Return the numbers of the properties that are axes or attributes."""
    roles: dict[str, int] = {}
    for k, (name, kind) in enumerate(vertex.properties):
        role = role_of(name)
        if role is not None and kind is not None:
            roles.setdefault(role, k)
    missing = [axis for axis in "xyz" if axis not in roles]
    if missing:
        raise FormatError(f"its vertices have no {', '.join(missing)}", "E_NOT_IMPORT")
    if not roles.keys() >= _COLOURS:
        roles = {role: k for role, k in roles.items() if role not in _COLOURS}
    return roles


def _dtype(element: _Element, order: str) -> np.dtype[Any]:
    # by number: names may repeat
    return np.dtype([(str(k), f"{order}{kind}") for k, (_, kind) in enumerate(element.properties)])


def _cut(columns: dict[str, NDArray[Any]], names: frozenset[str], n_rows: int) -> Iterator[Batch]:
    for at in range(0, len(columns["x"]), n_rows):
        part = slice(at, at + n_rows)
        with np.errstate(invalid="ignore"):  # signalling NaNs
            xyz = np.column_stack([columns[axis][part].astype(np.float64) for axis in "xyz"])
        values = {name: columns[name][part] for name in sorted(names)}
        yield Batch(at, xyz, {k: v.astype(v.dtype.newbyteorder("=")) for k, v in values.items()})


def _ascii(
    path: Path, header: _Header, vertex: _Element, roles: dict[str, int], n_rows: int
) -> Iterator[Batch]:
    with path.open("rb") as file:
        line = file.read(header.data_start).count(b"\n") + 1
        start = header.data_start
        for element in header.elements[: header.elements.index(vertex)]:
            for _ in range(element.count):
                start += len(file.readline())
                line += 1
    attributes = {role: k for role, k in roles.items() if role not in "xyz"}
    columns = Columns((roles["x"], roles["y"], roles["z"]), attributes)
    layout = Layout(start, line, None, len(vertex.properties), None)
    is_float32 = [vertex.properties[roles[axis]][1] == "f4" for axis in "xyz"]
    n_read = 0
    for batch in table_batches(path, layout, columns, n_rows, limit=vertex.count):
        for axis in range(3):
            if is_float32[axis]:  # as plyfile and the binary form have them
                batch.xyz[:, axis] = batch.xyz[:, axis].astype(np.float32)
        n_read += len(batch.xyz)
        yield batch
    if n_read < vertex.count:
        raise TruncatedError(f"ends at vertex {n_read} of {vertex.count}")


def _by_plyfile(path: Path, roles: dict[str, int]) -> dict[str, NDArray[Any]]:
    vertices = _plyfile(path)["vertex"]
    return {role: vertices.data[vertices.properties[k].name] for role, k in roles.items()}


def _plyfile(path: Path) -> Any:
    try:
        import plyfile
    except ImportError as error:
        raise OptionError(
            f"{path.name}: its lists need plyfile: pip install 'volatool[mesh]'", "E_NO_EXTRA"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy, of lines without numbers
            return plyfile.PlyData.read(path, mmap=False)
    except (plyfile.PlyParseError, ArithmeticError, ValueError, IndexError, MemoryError) as error:
        raise FormatError(f"its data can't be read ({error})") from error


def _surface(path: Path, header: _Header, options: ConvertOptions) -> ImportedPoints:
    """Return the points of the faces' surface."""
    from volatool.imports.mesh import surface_points

    face = header.find("face")
    if face is None or not face.count:
        raise OptionError(
            f"{path.name}: has no faces for --mesh {options.mesh}; without it vertices are taken"
        )
    data = _plyfile(path)
    vertices = np.column_stack([data["vertex"].data[axis].astype(np.float64) for axis in "xyz"])
    lists = [name for name, kind in face.properties if kind is None and "ind" in name]
    if not lists:
        raise FormatError("its faces have no list of vertex indices")
    return surface_points("ply", vertices, _triangles(data["face"].data[lists[0]]), options)


def _triangles(polygons: NDArray[Any]) -> I64:
    """Return polygons as fans of triangles."""
    fans = [np.empty((0, 3), np.int64)]
    sizes = np.array([len(polygon) for polygon in polygons])
    for size in np.unique(sizes[sizes >= 3]):
        same = np.stack(list(polygons[sizes == size])).astype(np.int64)
        fans += [same[:, [0, k, k + 1]] for k in range(1, int(size) - 1)]
    return np.concatenate(fans)
