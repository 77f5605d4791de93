"""
The voxel grid of binvox (``.binvox``, version 1) [Min2004]_, objects <-> bytes.

============== ===============================================================================
line           meaning
============== ===============================================================================
``#binvox 1``  the first line
``dim``        cells along x, z, y, in this order
``translate``  corner of the grid: x, y, z
``scale``      edge of the grid, of its longest side when the sides differ
``data``       the end of the text; after its line break pairs of bytes: a value, how often
============== ===============================================================================

Cells follow each other with y fastest, then z, then x. A value other than 0 is a cell that is set.
The middle of cell i of an axis is at ``translate + (i + 0.5) * scale / max(dim)``. There is no room
for comments: readers take the lines by their number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError
from volatool.formats.text_header import header_lines
from volatool.model import F64, I32, I64

MAX_SIDE = 1024
"""Cells along an axis that are written: what binvox itself has as its limit."""

MAX_CELLS = 1 << 28
"""Cells set that a file's runs are expanded to unless the caller says otherwise."""

FIRST_LINE = b"#binvox 1"

_MAX_TEXT = 1 << 12
_LONGEST_RUN = 255


@dataclass(frozen=True, slots=True, eq=False)
class BinvoxGrid:
    """
    A grid as a file has it: runs of cells.

    Parameters
    ----------
    shape : tuple of 3 int
        Cells along x, y, z.
    translate : tuple of 3 float
        Corner x, y, z.
    scale : float
        Edge of the longest side, greater than zero.
    values, counts : (n,) arrays of uint8
        The runs, y fastest, then z, then x. The counts add up to the cells of the grid.
    """

    shape: tuple[int, int, int]
    translate: tuple[float, float, float]
    scale: float
    values: NDArray[np.uint8]
    counts: NDArray[np.uint8]

    @property
    def cell(self) -> float:
        """Edge of a cell."""
        return self.scale / max(self.shape)

    @property
    def n_cells(self) -> int:
        """Cells that are set."""
        return int(self.counts[self.values != 0].sum(dtype=np.int64))

    def cells(self, limit: int = MAX_CELLS) -> I32:
        """
        Return the cells that are set.

        Parameters
        ----------
        limit : int
            Cells that may be returned.

        Returns
        -------
        cells : (n, 3) array of int32
            x, y, z from the corner, in the order of the file: ascending x, then z, then y.

        Raises
        ------
        ResourceError
            ``E_SIZE``: there are more.
        """
        n_cells = self.n_cells
        if n_cells > limit:
            raise ResourceError(
                f"the grid has {n_cells} cells set, more than {limit} are not expanded", "E_SIZE"
            )
        is_set = self.values != 0
        ends = np.cumsum(self.counts, dtype=np.int64)[is_set]
        counts = self.counts[is_set].astype(np.int64)
        # the k-th cell of all runs: its number in the grid is k, shifted run by run
        shifts = ends - np.cumsum(counts)
        places: I64 = np.arange(n_cells) + np.repeat(shifts, counts)
        x, z, y = np.unravel_index(places, _stored(self.shape))
        return np.column_stack([x, y, z]).astype(np.int32)

    def centers(self, limit: int = MAX_CELLS) -> F64:
        """
        Return the middles of the cells that are set.

        Parameters
        ----------
        limit : int
            As for `cells`.

        Returns
        -------
        centers : (n, 3) array of float64
            x, y, z in the unit of `translate` and `scale`.
        """
        middles = (self.cells(limit) + np.float64(0.5)) * self.cell
        centers: F64 = middles + np.asarray(self.translate)
        return centers


def _stored(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the lengths of x, z, y for those of x, y, z, and the other way round."""
    return shape[0], shape[2], shape[1]


def encode_binvox(cells: ArrayLike, side: int, translate: Sequence[float], scale: float) -> bytes:
    """
    Return the file of cells in a cubic grid.

    Parameters
    ----------
    cells : (n, 3) array of int
        x, y, z from the grid's corner, 0 to ``side - 1``. Repeats are fine.
    side : int
        Cells along each axis, 1 to `MAX_SIDE`.
    translate : sequence of 3 float
        Corner x, y, z.
    scale : float
        Edge of the grid, greater than zero.

    Returns
    -------
    data : bytes
        Numbers with all their digits: `parse_binvox` returns the same floats.

    Raises
    ------
    ResourceError
        ``E_SIZE``: more than `MAX_SIDE` cells a side.
    OptionError
        ``E_OPTION``: a cell outside the grid, or numbers that make no grid.
    """
    if side > MAX_SIDE:
        raise ResourceError(
            f"a binvox grid has at most {MAX_SIDE} cells a side, not {side}", "E_SIZE"
        )
    numbers = [float(value) for value in (*translate, scale)]
    if side < 1 or not all(map(math.isfinite, numbers)) or not scale > 0:
        raise OptionError(f"no grid of {side} cells a side has an edge of {scale} at {translate}")
    places = np.asarray(cells, np.int64).reshape(-1, 3)
    if len(places) and (places.min() < 0 or places.max() >= side):
        raise OptionError(f"cells must be 0 to {side - 1}, not {places.min()} to {places.max()}")
    order = np.unique((places[:, 0] * side + places[:, 2]) * side + places[:, 1])
    values, counts = _runs(order, side**3)
    x, y, z, edge = map(repr, numbers)
    lines = [FIRST_LINE.decode(), f"dim {side} {side} {side}"]
    lines += [f"translate {x} {y} {z}", f"scale {edge}", "data", ""]
    stored: bytes = np.column_stack([values, counts]).tobytes()
    return "\n".join(lines).encode() + stored


def _runs(order: I64, total: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return values and lengths, at most 255 each, of the runs of a set of ascending numbers."""
    breaks = np.flatnonzero(np.diff(order) != 1)
    edges = np.empty(2 * (len(breaks) + 1) if len(order) else 0, np.int64)
    if len(order):
        edges[0::2] = order[np.concatenate([[0], breaks + 1])]
        edges[1::2] = order[np.concatenate([breaks, [len(order) - 1]])] + 1
    lengths = np.diff(edges, prepend=0, append=total)  # not set, set, not set, ...
    pieces = -(-lengths // _LONGEST_RUN)  # none for a length of 0
    counts = np.full(pieces.sum(), _LONGEST_RUN, np.uint8)
    last = np.cumsum(pieces)[pieces > 0] - 1
    counts[last] = (lengths - _LONGEST_RUN * (pieces - 1))[pieces > 0]
    values = np.repeat(np.arange(len(lengths), dtype=np.int64) & 1, pieces).astype(np.uint8)
    return values, counts


def parse_binvox(data: bytes) -> BinvoxGrid:
    """
    Read a grid.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    grid : BinvoxGrid
        Its runs as they are stored; `BinvoxGrid.cells` expands them.

    Raises
    ------
    FormatError
        ``E_NOT_BINVOX``: another file, or another version; ``E_CORRUPT``: text that makes no
        sense, or runs beyond the grid, with their offset.
    TruncatedError
        ``E_TRUNCATED``: the file ends inside the text or the runs.
    """
    fields, start = _header(data)
    shape = _stored(_shape(*_field(fields, "dim", 3)))
    x, y, z = _numbers(*_field(fields, "translate", 3, "0 0 0"))
    (scale,) = _numbers(*_field(fields, "scale", 1, "1"))
    if scale <= 0:
        raise FormatError(f"the scale is {scale}, expected a number greater than 0")
    total = math.prod(shape)
    n_runs = (len(data) - start) // 2
    runs = np.frombuffer(data, np.uint8, 2 * n_runs, start).reshape(-1, 2)
    ends = np.cumsum(runs[:, 1], dtype=np.int64)
    used = int(np.searchsorted(ends, total)) + 1  # runs until the grid is full
    if used > n_runs:
        found = int(ends[-1]) if n_runs else 0
        raise TruncatedError(
            f"the grid has {total} cells, the file ends after {found} (offset {len(data)})"
        )
    if ends[used - 1] > total:
        raise FormatError(
            f"a run goes on after the last of the grid's {total} cells "
            f"(offset {start + 2 * (used - 1)})"
        )
    end = start + 2 * used
    if data[end:].strip():
        raise FormatError(f"{len(data) - end} bytes follow the last run (offset {end})")
    values, counts = np.ascontiguousarray(runs[:used].T)
    return BinvoxGrid(shape, (x, y, z), scale, values, counts)


def _header(data: bytes) -> tuple[dict[str, tuple[str, int]], int]:
    """Return the fields with their offsets and where the runs begin."""
    if data[: len(FIRST_LINE) + 1].rstrip() != FIRST_LINE:
        found = f"found {data[:32]!r}" if data else "the file is empty"
        raise FormatError(
            f"not a binvox file of version 1: expected {FIRST_LINE.decode()!r}, {found} (offset 0)",
            "E_NOT_BINVOX",
        )
    fields: dict[str, tuple[str, int]] = {}
    for offset, line in header_lines(data, _MAX_TEXT):
        name, _, value = line.decode("latin-1").strip().partition(" ")
        if name == "data":
            break
        fields.setdefault(name, (value, offset))  # binvox's own reader skips what it doesn't know
    return fields, offset + len(line) + 1


def _field(
    fields: dict[str, tuple[str, int]], name: str, n: int, default: str | None = None
) -> tuple[str, list[str], int]:
    """Return the name, the words and the offset of a line."""
    if name not in fields and default is None:
        raise FormatError(f"there is no line {name!r} before the data (offset 0)")
    value, offset = fields.get(name, (default or "", 0))
    words = value.split()
    if len(words) != n:
        raise FormatError(
            f"expected {n} numbers after {name!r}, found {value[:40]!r} (offset {offset})"
        )
    return name, words, offset


def _shape(name: str, words: list[str], offset: int) -> tuple[int, int, int]:
    if not all(word.isascii() and word.isdigit() and len(word) < 6 and int(word) for word in words):
        raise FormatError(
            f"expected three sides of 1 to 99999 cells after {name!r}, found "
            f"{' '.join(words)[:40]!r} (offset {offset})"
        )
    x, z, y = map(int, words)
    return x, z, y


def _numbers(name: str, words: list[str], offset: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise FormatError(
            f"expected numbers after {name!r}, found {' '.join(words)[:40]!r} (offset {offset})"
        )
    return numbers
