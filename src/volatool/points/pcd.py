"""Point Cloud Data files of PCL, ascii, binary and binary_compressed: header, records, x, y, z.

https://pointclouds.org/documentation/tutorials/pcd_file_format.html. The VIEWPOINT is not applied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.errors import FormatError, ResourceError, TruncatedError
from volatool.model import F64

MAX_POINTS = 1 << 26
"""More points in one scan are refused from the header."""

MAX_HEADER_BYTES = 1 << 16

MAX_RECORD_BYTES = 1 << 14

_KEYS = frozenset(
    ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT")
) | {"POINTS", "DATA"}
_KINDS = {"F": "f", "U": "u", "I": "i"}
_SIZES = {"F": (4, 8), "U": (1, 2, 4, 8), "I": (1, 2, 4, 8)}


@dataclass(frozen=True, slots=True)
class PcdHeader:
    """
    What the header says.

    Parameters
    ----------
    fields : list of str
        Names; they may repeat (``_`` pads).
    record : numpy dtype
        Of a point: fields called by their number, ``"0"``, ``"1"`` ..., each of COUNT values.
    starts : list of int
        First column of each field in ascii data, and the number of columns.
    xyz : list of int
        Numbers of the fields x, y and z.
    n_points : int
        As claimed.
    kind : str
        ``"ascii"``, ``"binary"`` or ``"binary_compressed"``.
    data_start : int
        Byte behind the header.
    """

    fields: list[str]
    record: np.dtype[np.void]
    starts: list[int]
    xyz: list[int]
    n_points: int
    kind: str
    data_start: int

    @property
    def n_columns(self) -> int:
        """Values of a point in ascii data."""
        return self.starts[-1]


def parse_pcd(data: bytes) -> F64:
    """
    Return the points of a PCD file.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    xyz : (n, 3) array of float64
        Rows may be NaN: organized clouds mark directions without a return so.

    Raises
    ------
    FormatError, TruncatedError, ResourceError
        ``E_CORRUPT``, ``E_TRUNCATED`` with the offset, ``E_SIZE``; without the file's name.
    """
    header = read_header(data)
    readers = {"ascii": _ascii, "binary": _records, "binary_compressed": _packed}
    with np.errstate(invalid="ignore"):  # a signalling NaN is a point without a return too
        return readers[header.kind](data, header)


def read_header(data: bytes, max_points: int = MAX_POINTS) -> PcdHeader:
    """
    Return the header.

    Parameters
    ----------
    data : bytes
        The file, or its first `MAX_HEADER_BYTES` + 1 bytes.
    max_points : int
        More are refused.

    Raises
    ------
    FormatError, TruncatedError, ResourceError
        As for `parse_pcd`.
    """
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = data.find(b"\n", start, start + MAX_HEADER_BYTES)
        if end < 0 or end > MAX_HEADER_BYTES:
            if len(data) <= MAX_HEADER_BYTES:
                raise TruncatedError(f"ends in its header, at byte {len(data)}, before DATA")
            raise FormatError("has no DATA line where a PCD header ends")
        line = data[start:end]
        try:
            words = line.decode("ascii").split()
        except UnicodeDecodeError as error:
            raise FormatError(f"header line at byte {start} is not text") from error
        if words and not words[0].startswith("#"):
            if words[0] not in _KEYS:
                raise FormatError(
                    f"header line at byte {start} is {line[:40]!r}, not of a PCD file"
                )
            entries[words[0]] = words[1:]
        start = end + 1
    return _checked(entries, start, max_points)


def _checked(entries: dict[str, list[str]], data_start: int, max_points: int) -> PcdHeader:
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    n = len(names)
    try:
        sizes = [int(word) for word in entries["SIZE"]]
        counts = [int(word) for word in entries.get("COUNT", ["1"] * n)]
        kinds = entries["TYPE"]
        width, height = (int(entries.get(key, ["1"])[0]) for key in ("WIDTH", "HEIGHT"))
        n_points = int(entries["POINTS"][0]) if "POINTS" in entries else width * height
        kind = entries["DATA"][0]
    except (KeyError, ValueError, IndexError) as error:
        raise FormatError(f"its header lacks an entry or a number ({error})") from error
    if not n or {len(sizes), len(counts), len(kinds)} != {n}:
        raise FormatError(f"FIELDS, SIZE, TYPE and COUNT name {n} and other numbers of fields")
    for size, count, letter in zip(sizes, counts, kinds, strict=True):
        if size not in _SIZES.get(letter, ()) or not 0 < count <= MAX_RECORD_BYTES:
            raise FormatError(f"a field of TYPE {letter}, SIZE {size}, COUNT {count} can't be read")
    if sum(size * count for size, count in zip(sizes, counts, strict=True)) > MAX_RECORD_BYTES:
        raise FormatError(f"a point would take more than {MAX_RECORD_BYTES} bytes")
    if n_points < 0 or n_points > max_points:
        raise ResourceError(f"claims {n_points} points; a scan has at most {max_points}", "E_SIZE")
    if kind not in ("ascii", "binary", "binary_compressed"):
        raise FormatError(f"DATA {kind} is not ascii, binary or binary_compressed")
    starts = np.concatenate(([0], np.cumsum(counts)))
    axes = []
    for axis in "xyz":
        if axis not in names or counts[names.index(axis)] != 1:
            raise FormatError(f"has no field {axis} of one value, only {' '.join(names)[:80]}")
        axes.append(names.index(axis))
    # fields by number: names may repeat ("_" pads)
    record = np.dtype(
        [
            (str(k), f"<{_KINDS[letter]}{size}", (count,))
            for k, (letter, size, count) in enumerate(zip(kinds, sizes, counts, strict=True))
        ]
    )
    return PcdHeader(names, record, starts.tolist(), axes, n_points, kind, data_start)


def _ascii(data: bytes, header: PcdHeader) -> F64:
    rows = data[header.data_start :].split(b"\n")
    lines = [line for line in rows if line.strip()]
    if len(lines) < header.n_points:
        raise TruncatedError(f"ends at point {len(lines)} of {header.n_points}, byte {len(data)}")
    out = np.empty((header.n_points, 3))
    for k in range(header.n_points):
        words = lines[k].split()
        try:
            if len(words) != header.n_columns:
                raise ValueError(f"{len(words)} values instead of {header.n_columns}")
            out[k] = [float(words[header.starts[k]]) for k in header.xyz]
        except ValueError as error:
            kind = TruncatedError if k == len(lines) - 1 else FormatError
            raise kind(f"point {k} of {header.n_points}: {error}") from error
    return out


def _records(data: bytes, header: PcdHeader) -> F64:
    check_size(len(data), header)
    records = np.frombuffer(data, header.record, header.n_points, header.data_start)
    return np.column_stack([records[str(k)][:, 0].astype(np.float64) for k in header.xyz])


def check_size(n_bytes: int, header: PcdHeader) -> None:
    """Raise if binary data of so many bytes, the header included, lack points."""
    n_there = (n_bytes - header.data_start) // header.record.itemsize
    if n_there < header.n_points:
        raise TruncatedError(f"ends at point {n_there} of {header.n_points}, byte {n_bytes}")


def _packed(data: bytes, header: PcdHeader) -> F64:
    columns = unpack(data, header, header.xyz)
    return np.column_stack([columns[k].astype(np.float64) for k in header.xyz])


def unpack(data: bytes, header: PcdHeader, fields: list[int]) -> dict[int, NDArray[Any]]:
    """
    Return fields of binary_compressed data, which stand one behind the other.

    Parameters
    ----------
    data : bytes
        The whole file.
    header : PcdHeader
        Its header.
    fields : list of int
        Numbers of those wanted.

    Returns
    -------
    columns : dict of int to (n,) array
        The first value of each field, as stored; of COUNT 1 without copy.

    Raises
    ------
    FormatError, TruncatedError
        The sizes don't agree, or the packed bytes are damaged.
    """
    from volatool.kernels import lzf

    start = header.data_start
    if len(data) < start + 8:
        raise TruncatedError(f"ends before the packed points, at byte {len(data)}")
    n_packed, n_bytes = (int(word) for word in np.frombuffer(data, "<u4", 2, start))
    expected = header.n_points * header.record.itemsize
    if n_bytes != expected:
        raise FormatError(f"byte {start}: {n_bytes} bytes packed, the points take {expected}")
    if len(data) < start + 8 + n_packed:
        raise TruncatedError(
            f"ends at byte {len(data)}; its packed points go on to {start + 8 + n_packed}"
        )
    if n_bytes > 264 * n_packed:  # no LZF reference stands for more
        raise FormatError(f"byte {start}: {n_packed} packed bytes can't hold {n_bytes}")
    packed: NDArray[np.uint8] = np.frombuffer(data, np.uint8, n_packed, start + 8)
    out = np.empty(n_bytes, np.uint8)
    n_out = lzf.decompress(packed.copy(), out)  # a copy: read-only is another kernel signature
    if n_out != n_bytes:
        fault = start + 8 + (n_packed if n_out >= 0 else -1 - n_out)
        raise FormatError(f"packed points are damaged at byte {fault}")
    columns: dict[int, NDArray[Any]] = {}
    at = 0
    for k, name in enumerate(header.record.names or ()):
        dtype, _ = header.record.fields[name][:2]  # type: ignore[index]
        count = dtype.itemsize // dtype.base.itemsize
        if k in fields:
            values = np.frombuffer(out, dtype.base, header.n_points * count, at)
            columns[k] = values[::count]
        at += dtype.itemsize * header.n_points
    return columns
