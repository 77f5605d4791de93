"""What changed between two volumes, and what of it is more than the noise of a voxel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from volatool.errors import OptionError
from volatool.model import F64, I32, I64, U64, Bool
from volatool.vola.algebra import Pairing, aligned, pairings, voxel_edge
from volatool.vola.grid import is_rounded, same_grid
from volatool.vola.volume import Volume
from volatool.vola.words import ranks_of

MAX_NOISE = 4
"""Most voxels of noise: no farther than the neighbouring block."""

NOISE = 1
MIN_VOXELS = 4

By = Literal["column", "block"]


@dataclass(frozen=True, slots=True)
class Changes:
    """
    Changed voxels by place.

    Parameters
    ----------
    level : int
        Whose blocks (4 x 4 x 4 cells) the places are.
    by : str
        ``"block"``, or ``"column"``: all blocks above each other are one place.
    blocks : (n, 3) array of int32
        x, y, z of each place among the blocks of the level, in VOLA order; z is 0 for columns.
    added, removed : (n,) arrays of int64
        Voxels that only the second or only the first volume has.
    significant_added, significant_removed : (n,) arrays of int64
        Those of them that are not noise-like.
    first, last : (n,) arrays of int64
        Lowest and highest layer of voxels that changed.
    is_significant : (n,) array of bool
        At least the least number of voxels are not noise-like.
    """

    level: int
    by: By
    blocks: I32
    added: I64
    removed: I64
    significant_added: I64
    significant_removed: I64
    first: I64
    last: I64
    is_significant: Bool

    def __len__(self) -> int:
        return len(self.added)


@dataclass(frozen=True, slots=True)
class SurfaceChange:
    """
    How the highest voxels of columns of voxels moved.

    Parameters
    ----------
    n_both, n_added, n_removed : int
        Columns of voxels that both volumes have, only the second, only the first.
    raised, lowered : int
        Layers by which the highest voxel of columns of both went up, and down, summed over those
        that moved by more than the noise.
    net : int
        Layers up less layers down of all columns of both.
    """

    n_both: int
    n_added: int
    n_removed: int
    raised: int
    lowered: int
    net: int


@dataclass(frozen=True, slots=True)
class Difference:
    """
    What changed from one volume to another.

    Parameters
    ----------
    a, b : Volume
        The first and the second, on one grid and of one depth.
    is_resampled : bool
        Whether one had to be brought to the grid of the other.
    noise, min_voxels : int
        As given to `diff`.
    n_both, n_added, n_removed : int
        Voxels of both, of `b` only, of `a` only.
    n_significant_added, n_significant_removed : int
        Those that are not noise-like.
    changes : Changes
        By place.
    """

    a: Volume
    b: Volume
    is_resampled: bool
    noise: int
    min_voxels: int
    n_both: int
    n_added: int
    n_removed: int
    n_significant_added: int
    n_significant_removed: int
    changes: Changes

    def at_significant_places(self) -> tuple[int, int]:
        """Return how many voxels, noise-like or not, were added and removed at such places."""
        changes = self.changes
        chosen = changes.is_significant
        return int(changes.added[chosen].sum()), int(changes.removed[chosen].sum())

    def surface(self) -> SurfaceChange:
        """Compare the highest voxels of columns; worked out at each call."""
        return _surface_change(self.a, self.b, list(pairings(self.a, self.b, "or")), self.noise)

    def corners(self, blocks: I32, level: int) -> F64:
        """
        Return the lower corners of blocks, in units of the CRS (z in the vertical unit).

        Parameters
        ----------
        blocks : (n, 3) array of int
            x, y, z; that of the next block is the upper one.
        level : int
            Whose blocks they are.
        """
        return self.faces(np.asarray(blocks, np.float64) * 4 ** (self.a.depth - level + 1))

    def faces(self, voxels: F64) -> F64:
        """Return where voxels begin, (n, 3), in units of the CRS (z in the vertical unit)."""
        before = 0.5 if is_rounded(self.a) else 0.0  # around the places, or from them on
        step = float(voxel_edge(self.a))
        places: F64 = np.asarray(self.a.cube.origin) + (voxels - before) * step
        places[..., 2] /= float(self.a.crs.z_ratio)
        return places


def diff(
    a: Volume,
    b: Volume,
    *,
    noise: int = NOISE,
    min_voxels: int = MIN_VOXELS,
    level: int | None = None,
    by: By = "column",
    resample: bool = False,
) -> Difference:
    """
    Compare two volumes of one place.

    Parameters
    ----------
    a, b : Volume
        Before and after; on the same grid, as `vola.algebra.combine` takes them.
    noise : int
        A voxel that only one volume has is noise-like when the other has a voxel at most so many
        voxels away on every axis (1: among its 26 neighbours, in whatever block). 0: none is. At
        most 4.
    min_voxels : int
        So many voxels that are not noise-like make a place significant.
    level : int, optional
        Level whose blocks are the places; the deepest by default.
    by : str
        ``"column"`` or ``"block"``.
    resample : bool
        Bring `b` to the grid of `a` if it is on another one.

    Returns
    -------
    difference : Difference
        All counts exact. A surface that moves by one voxel, as point noise or another phase of
        the grid makes it, is noise-like throughout with ``noise=1``.

    Raises
    ------
    InputError, CRSError
        As `combine`.
    OptionError
        An option out of its range.
    """
    for volume in (a, b):
        if not isinstance(volume, Volume):
            raise OptionError(f"diff compares volumes (vt.open), got {type(volume).__name__}")
    _check(noise, min_voxels, by)
    is_resampled = not same_grid(a, b)
    a, b = aligned(a, b, resample=resample)
    level = a.depth if level is None else level
    if not 1 <= level <= a.depth:
        raise OptionError(f"--level must be 1 to {a.depth}, the levels to compare, got {level}")
    from volatool.kernels import algebra as kernels

    steps = list(pairings(a, b, "xor"))
    removed, added = kernels.part_words(steps[-1].words, a.levels[-1], steps[-1].blocks_a)
    n_added, n_removed = _count(added), _count(removed)
    far_added = _far(added, a, steps, noise, "a")
    far_removed = _far(removed, b, steps, noise, "b")
    found = [added, removed, far_added, far_removed]
    return Difference(
        a=a,
        b=b,
        is_resampled=is_resampled,
        noise=noise,
        min_voxels=min_voxels,
        n_both=len(a) - n_removed,
        n_added=n_added,
        n_removed=n_removed,
        n_significant_added=_count(far_added),
        n_significant_removed=_count(far_removed),
        changes=_changes(steps, found, level, by, min_voxels),
    )


def _check(noise: int, min_voxels: int, by: str) -> None:
    if not 0 <= noise <= MAX_NOISE:
        raise OptionError(f"--noise must be 0 to {MAX_NOISE} voxels, got {noise}")
    if min_voxels < 1:
        raise OptionError(f"--min-voxels must be at least 1, got {min_voxels}")
    if by not in ("column", "block"):
        raise OptionError(f"by must be 'column' or 'block', got {by!r}")


def _count(words: U64) -> int:
    return int(np.bitwise_count(words).sum(dtype=np.int64))


def _far(bits: U64, other: Volume, steps: list[Pairing], noise: int, which: str) -> U64:
    """Return the bits of the last level that have no voxel of the other volume near them."""
    if not noise:
        return bits
    from volatool.kernels import near as kernels

    # the root as the only cell of a block of its own, so that every level is a step alike
    cells = np.ones(1, np.uint64)
    own = steps[0].blocks_a if which == "a" else steps[0].blocks_b
    words, ranks = np.array([own[0] >= 0], np.uint64), np.zeros(1, np.int64)
    neighbours = np.full((1, 27), -1, np.int32)
    neighbours[0, 13] = 0
    for level, step in enumerate(steps):
        if level == len(steps) - 1:
            return np.asarray(
                kernels.far_bits(bits, cells, neighbours, words, ranks, other.levels[level], noise)
            )
        neighbours = kernels.neighbour_children(cells, neighbours, words, ranks, _count(cells))
        cells, words, ranks = step.words, other.levels[level], ranks_of(other.levels[level])
    raise AssertionError("a volume has at least one level")


def _block_cells(steps: list[Pairing]) -> I32:
    """x, y, z of the blocks of the last level among themselves."""
    from volatool.kernels.words import child_cells

    cells = np.zeros((1, 3), np.int32)
    for step in steps[:-1]:
        cells = child_cells(step.words, cells, _count(step.words))
    return cells


def _block_layers(steps: list[Pairing]) -> I32:
    """Layer of each block of the last level, in blocks."""
    from volatool.kernels.places import child_layers

    layers = np.zeros(1, np.int32)
    for step in steps[:-1]:
        layers = child_layers(step.words, layers, _count(step.words))
    return layers


def _changes(
    steps: list[Pairing], found: list[U64], level: int, by: By, min_voxels: int
) -> Changes:
    """Sum the blocks of the last level by place; places without a change are left out."""
    from volatool.kernels.places import sum_places

    places, blocks = _places(steps, level, by)
    held, sums = sum_places(places, _block_layers(steps), *found, len(blocks))
    added, removed, far_added, far_removed, first, last = sums
    return Changes(
        level=level,
        by=by,
        blocks=blocks[held] if len(held) < len(blocks) else blocks,
        added=added,
        removed=removed,
        significant_added=far_added,
        significant_removed=far_removed,
        first=first,
        last=last,
        is_significant=far_added + far_removed >= min_voxels,
    )


def _places(steps: list[Pairing], level: int, by: By) -> tuple[I32, I32]:
    """Place of each block of the last level, and x, y, z of the places."""
    if by == "block":
        blocks = _block_cells(steps[:level])
        places = np.arange(len(blocks), dtype=np.int32)
    else:
        places, blocks = _columns(steps[:level])
    for step in steps[level - 1 : -1]:
        places = np.repeat(places, np.bitwise_count(step.words))
    return places, blocks


def _columns(steps: list[Pairing]) -> tuple[I32, I32]:
    """Column of each block of the last level, and x, y, 0 of the columns."""
    from volatool.kernels.places import column_children, project_columns
    from volatool.kernels.words import child_cells

    columns, places = np.zeros(1, np.int32), np.zeros((1, 3), np.int32)
    for step in steps[:-1]:
        flat = project_columns(step.words, columns, len(places))
        columns = column_children(step.words, columns, flat, ranks_of(flat), _count(step.words))
        places = child_cells(flat, places, _count(flat))
    return columns, places


def _surface_change(a: Volume, b: Volume, steps: list[Pairing], noise: int) -> SurfaceChange:
    from volatool.kernels.algebra import pair_words
    from volatool.kernels.places import compare_tops, top_layers

    layers, last = _block_layers(steps), steps[-1]
    columns, places = _columns(steps)
    pair = (a.levels[-1], b.levels[-1], last.blocks_a, last.blocks_b)
    words = pair_words(*pair, 4), pair_words(pair[1], pair[0], pair[3], pair[2], 4)
    tops = (top_layers(columns, layers, one, len(places)) for one in words)
    return SurfaceChange(*compare_tops(*tops, noise).tolist())
