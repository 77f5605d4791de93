"""The rows of the VOLA paper's Table 1 that can be checked, checked on a volume; and Figure 8."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from volatool.encodings import DENSE_LIMIT_BYTES, Encoding, write_volume
from volatool.formats.header import HEADER_BYTES
from volatool.formats.registry import open_volume
from volatool.model import U64
from volatool.occupancy.levels import dense_bytes
from volatool.papers.vola_lookups import RUNS, dense_found, descent
from volatool.papers.vola_printed import TABLE_1
from volatool.papers.vola_scene import surface
from volatool.vola.volume import Volume
from volatool.vola.words import popcount

HOLDS, IN_PART, NOT_MEASURED = "holds", "in part", "not measured"

_CELLS = 4096


class Claim(NamedTuple):
    """
    A row of Table 1.

    Parameters
    ----------
    row : str
        As the paper calls it.
    verdict : str
        `HOLDS`, `IN_PART` or `NOT_MEASURED`.
    evidence : str
        What was checked.
    """

    row: str
    verdict: str
    evidence: str


def claims(volume: Volume) -> list[Claim]:
    """
    Check the rows of Table 1 on a volume.

    Parameters
    ----------
    volume : Volume
        Without metadata, of a depth whose dense form is small.

    Returns
    -------
    claims : list of Claim
        In the paper's order. A check that fails raises AssertionError: it would be a bug of ours.
    """
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 4**volume.depth, (_CELLS, 3))
    cells[::2] = volume.voxels()[rng.integers(0, volume.n_voxels, len(cells[::2]))]
    checks: dict[str, Callable[[], tuple[str, str]]] = {
        "bit sequence": _bit_sequence,
        "modular traversal": lambda: _modular(volume),
        "variable depth": lambda: _variable_depth(volume),
        "dense search O(1)": lambda: _dense(volume, cells),
        "sparse search O(h)": lambda: _sparse(volume, cells),
        "embedded support": lambda: _embedded(volume),
        "look-up table": lambda: _table(volume),
        "easily saved": lambda: _saved(volume),
        "implicit": lambda: _implicit(volume),
        "cacheable": lambda: _cacheable(volume),
        "hierarchical memory": lambda: _hierarchical(volume),
    }
    return [Claim(row, *checks[row]()) for row in TABLE_1]


def _check(is_true: bool, what: str) -> None:
    if not is_true:
        raise AssertionError(f"Table 1: {what}")


def _bit_sequence() -> tuple[str, str]:
    x, y, z = np.meshgrid(*[np.arange(4)] * 3, indexing="ij")
    bits = x + 4 * y + 16 * z
    _check(sorted(bits.ravel()) == list(range(64)), "a block's bits are not its cells")
    return HOLDS, "x + 4 y + 16 z gives each of the 64 cells of a block a bit of its own"


def _modular(volume: Volume) -> tuple[str, str]:
    cells = volume.voxels().astype(np.int64)
    keys = np.zeros(len(cells), np.uint64)
    for level in range(volume.depth):
        own = cells // 4 ** (volume.depth - 1 - level) % 4
        keys = keys << np.uint64(6) | (own @ [1, 4, 16]).astype(np.uint64)
    _check(np.array_equal(keys, volume.keys()), "digits of the path are not remainders by 4")
    return HOLDS, (
        "quotients and remainders by 4 of x, y, z are the path from the root: equal to the stored "
        f"order for {len(cells):,} voxels"
    )


def _variable_depth(volume: Volume) -> tuple[str, str]:
    for depth in range(1, volume.depth + 1):
        part = volume.truncated(depth)
        parents = np.unique(volume.keys() >> np.uint64(6 * (volume.depth - depth)))
        _check(np.array_equal(part.keys(), parents), f"level {depth} is not that of its children")
    return HOLDS, f"cut off at any of {volume.depth} levels it is the volume of that depth, exactly"


def _dense(volume: Volume, cells: Any) -> tuple[str, str]:
    found = np.empty(len(cells), np.bool_)
    work = dense_found(volume, cells, found)
    assert work is not None
    work()
    _check(np.array_equal(found, volume.contains_cells(cells)), "dense and sparse differ")
    return HOLDS, "one word read at an address got by shifts, at any depth"


def _sparse(volume: Volume, cells: Any) -> tuple[str, str]:
    found = descent(volume, cells)() >= 0
    _check(np.array_equal(found, volume.contains_cells(cells)), "sparse look-ups differ")
    return IN_PART, (
        "one word and one running count a level, if counts are kept beside the words (8 bytes a "
        "word in memory, none in the file); without them all words before are counted: see C11"
    )


def _embedded(volume: Volume) -> tuple[str, str]:
    size = 8 * sum(map(len, volume.levels))
    return IN_PART, (
        f"integers and shifts only; {volume.n_voxels:,} voxels take {size:,} bytes, with counts "
        f"{2 * size:,}. No device was at hand"
    )


def _table(volume: Volume) -> tuple[str, str]:
    from volatool.kernels import lookup

    words = volume.levels[-1]
    table = np.bitwise_count(np.arange(1 << 16, dtype=np.uint16))
    counts = lookup.count_by_table(words, table), lookup.count_by_arithmetic(words)
    _check(counts == (popcount(words),) * 2, "a table counts other bits")
    return HOLDS, "bits of a word by a table of 65,536 entries: the same counts as by arithmetic"


def _saved(volume: Volume) -> tuple[str, str]:
    data = packed(volume, "sparse")
    again = open_volume(data)
    same = all(map(np.array_equal, again.levels, volume.levels))
    _check(same, "what is written is not what is read")
    return HOLDS, "the file is the words as they lie in memory, after 80 bytes of header"


def _implicit(volume: Volume) -> tuple[str, str]:
    blocks = sum(map(len, volume.levels))
    words = np.concatenate(volume.levels)
    _check(depth_of_words(words) == volume.depth, "the words don't tell where levels begin")
    return HOLDS, (
        f"no pointers and no coordinates: {64 * blocks / volume.n_voxels:.2f} bits a voxel, all "
        "levels. The depth follows from the counts of bits; cube and CRS do not (C11)"
    )


def _cacheable(volume: Volume) -> tuple[str, str]:
    siblings = np.diff(np.flatnonzero(np.diff(volume.block_keys() >> np.uint64(6))))
    mean = float(siblings.mean()) if len(siblings) else 1.0
    return HOLDS, (
        f"blocks of one parent stand side by side, {mean:.1f} on average (8 words a cache line)"
    )


def _hierarchical(volume: Volume) -> tuple[str, str]:
    whole = packed(volume, "sparse")[HEADER_BYTES:]
    for depth in range(1, volume.depth):
        size = 8 * sum(map(len, volume.levels[:depth]))
        part = packed(volume.truncated(depth), "sparse")[HEADER_BYTES:]
        _check(part[:size] == whole[:size], "a coarser volume is not the front of the file")
    share = 100 * sum(map(len, volume.levels[:-1])) / sum(map(len, volume.levels))
    return HOLDS, (
        "each level is one stretch; the coarser volume is the file's front (all but the last "
        f"level: {share:.1f} % of it)"
    )


def depth_of_words(words: U64) -> int | None:
    """
    Return the depth of a sparse body without metadata, from its words alone.

    Parameters
    ----------
    words : (n,) array of uint64
        All levels' words.

    Returns
    -------
    depth : int or None
        None if they are not the words of whole levels.
    """
    start, size, depth = 0, 1, 0
    while start < len(words) and size:
        level = words[start : start + size]
        if len(level) < size:
            return None
        start, size, depth = start + size, popcount(level), depth + 1
    return depth if start == len(words) else None


def packed(volume: Volume, kind: str) -> bytes:
    """
    Return a volume as the bytes of a file.

    Parameters
    ----------
    volume : Volume
        What is packed, without its metadata.
    kind : str
        ``"sparse"`` or ``"dense"``.
    """
    stream = io.BytesIO()
    write_volume(stream, volume, Encoding(kind, 1, "none"))
    return stream.getvalue()


def packing_times(
    points: int, depths: tuple[int, ...] = (2, 3, 4), runs: int = RUNS
) -> list[dict[str, Any]]:
    """
    Time packing and unpacking (Figure 8): a volume to the bytes of a file, and back.

    Parameters
    ----------
    points : int
        Points of the surface.
    depths : tuple of int
        Those whose dense form is larger than `DENSE_LIMIT_BYTES` are timed sparse only.
    runs : int
        Timed runs.

    Returns
    -------
    rows : list of dict
        Per depth CPU seconds, medians: ``sparse_pack_s``, ``sparse_unpack_s``, ``dense_pack_s``,
        ``dense_unpack_s``; the last two None where too large.
    """
    whole = surface(points)
    rows = []
    for depth in depths:
        volume = whole.truncated(depth)
        row: dict[str, Any] = {"depth": depth, "voxels": volume.n_voxels}
        for kind in ("sparse", "dense"):
            row[f"{kind}_pack_s"] = row[f"{kind}_unpack_s"] = None
            if kind == "dense" and dense_bytes(depth) > DENSE_LIMIT_BYTES:
                continue
            data = packed(volume, kind)
            row[f"{kind}_pack_s"] = _seconds(partial(packed, volume, kind), runs)
            row[f"{kind}_unpack_s"] = _seconds(partial(open_volume, data), runs)
        rows.append(row)
    return rows


def _seconds(work: Callable[[], object], runs: int) -> float:
    """Return the median CPU time of a run."""
    laps = []
    work()
    for _ in range(runs):
        begin = time.process_time()
        work()
        laps.append(time.process_time() - begin)
    return float(np.median(laps))
