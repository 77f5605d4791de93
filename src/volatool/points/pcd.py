"""Point Cloud Data files of PCL: the x, y, z of ascii, binary and binary_compressed ones.

https://pointclouds.org/documentation/tutorials/pcd_file_format.html. The VIEWPOINT is not applied.
"""

from __future__ import annotations

from dataclasses import dataclass

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
class _Header:
    """What the header says; `places` are the columns of x, y and z in ascii data."""

    names: list[str]
    record: np.dtype[np.void]
    places: list[int]
    n_columns: int
    n_points: int
    kind: str
    data_start: int


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
    header = _header(data)
    readers = {"ascii": _ascii, "binary": _records, "binary_compressed": _packed}
    with np.errstate(invalid="ignore"):  # a signalling NaN is a point without a return too
        return readers[header.kind](data, header)


def _header(data: bytes) -> _Header:
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
    return _checked(entries, start)


def _checked(entries: dict[str, list[str]], data_start: int) -> _Header:
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
    if n_points < 0 or n_points > MAX_POINTS:
        raise ResourceError(f"claims {n_points} points; a scan has at most {MAX_POINTS}", "E_SIZE")
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
    places = [int(starts[k]) for k in axes]
    return _Header(
        [str(k) for k in axes], record, places, int(starts[-1]), n_points, kind, data_start
    )


def _ascii(data: bytes, header: _Header) -> F64:
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
            out[k] = [float(words[place]) for place in header.places]
        except ValueError as error:
            kind = TruncatedError if k == len(lines) - 1 else FormatError
            raise kind(f"point {k} of {header.n_points}: {error}") from error
    return out


def _records(data: bytes, header: _Header) -> F64:
    size = header.record.itemsize
    n_there = (len(data) - header.data_start) // size
    if n_there < header.n_points:
        raise TruncatedError(f"ends at point {n_there} of {header.n_points}, byte {len(data)}")
    records = np.frombuffer(data, header.record, header.n_points, header.data_start)
    return np.column_stack([records[name][:, 0].astype(np.float64) for name in header.names])


def _packed(data: bytes, header: _Header) -> F64:
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
    columns, at = {}, 0
    for name in header.record.names or ():
        dtype, _ = header.record.fields[name][:2]  # type: ignore[index]
        if name in header.names:
            columns[name] = np.frombuffer(out, dtype.base, header.n_points, at).astype(np.float64)
        at += dtype.itemsize * header.n_points
    return np.column_stack([columns[name] for name in header.names])
