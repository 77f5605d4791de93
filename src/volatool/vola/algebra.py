"""Volumes from volumes: cut out a box, unite, intersect, subtract."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from volatool.errors import OptionError
from volatool.model import I64, U64, Bounds, as_fraction
from volatool.vola.grid import check_crs, check_grid, is_rounded, same_cube, same_grid
from volatool.vola.info import VolumeInfo
from volatool.vola.prune import cells_box, prune, pruned
from volatool.vola.rescale import Table, apply_table, common_channels
from volatool.vola.volume import Volume

_MODES = {"or": 0, "and": 1, "xor": 2, "sub": 3}
_FIRST = 4
OPERATIONS = tuple(_MODES)
"""What `combine` can do: union, intersection, symmetric difference, difference."""


def sides_of(
    bounds: Bounds | None, z: tuple[float, float] | None
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """
    Return lowest and highest x, y and z of a box; infinite where nothing is given.

    Parameters
    ----------
    bounds : Bounds, optional
        Rectangle; four numbers are taken too.
    z : tuple of 2 float, optional
        Lowest and highest.

    Raises
    ------
    OptionError
        They are no such numbers, or the lowest is above the highest.
    """
    try:
        box = bounds
        if box is None:
            box = Bounds(-math.inf, -math.inf, math.inf, math.inf)
        elif not isinstance(box, Bounds):
            box = Bounds(*map(float, box))
    except (TypeError, ValueError) as error:
        raise OptionError(f"bounds must be left, bottom, right, top; got {bounds!r}") from error
    try:
        low, high = (-math.inf, math.inf) if z is None else map(float, z)
    except (TypeError, ValueError) as error:
        raise OptionError(f"z must be lowest, highest; got {z!r}") from error
    if not low <= high:
        raise OptionError(f"z must be lowest, highest; got {low:g}, {high:g}")
    return (box.left, box.right), (box.bottom, box.top), (low, high)


def crop(
    volume: Volume, bounds: Bounds | None = None, *, z: tuple[float, float] | None = None
) -> Volume:
    """
    Return the part of a volume in a box, on the same grid.

    Parameters
    ----------
    volume : Volume
        What is cut.
    bounds : Bounds, optional
        Closed rectangle, in units of the CRS; may be infinite.
    z : tuple of 2 float, optional
        Lowest and highest, both included, in the vertical unit; may be infinite.

    Returns
    -------
    part : Volume
        The voxels whose cell meets the closed box. Cells are half-open (the last one of the cube
        is closed), so one that only ends at the box is not among them; of volumes of the original
        toolkit a cell is what it rounded to one place. Worked out on exact rationals. Metadata as
        `vola.prune.prune` has it. `info.n_points` is None and `info.box` the part's when voxels
        were lost.

    Raises
    ------
    OptionError
        The lowest z is above the highest, or one is not a number.
    """
    sides = sides_of(bounds, z)
    ranges = [_cells_between(volume, axis, *ends) for axis, ends in enumerate(sides)]
    if all(low <= 0 and high >= 4**volume.depth - 1 for low, high in ranges):
        return volume
    from volatool.kernels.algebra import box_bits

    first, last = np.array(ranges, np.int64).T.copy()
    depth = volume.depth
    blocks = volume.voxels(depth - 1) if depth > 1 else np.zeros((1, 3), np.int32)
    return pruned(volume, box_bits(volume.levels[-1], blocks, first, last))


def _cells_between(volume: Volume, axis: int, low: float, high: float) -> tuple[int, int]:
    """First and last cell of an axis that meet a closed interval; first > last if none does."""
    size = 4**volume.depth
    side = volume.cube.exact[3]
    ratio = volume.crs.z_ratio if axis == 2 else Fraction(1)

    def place(value: float) -> Fraction | None:
        """Place in the cube from 0 to 1; None if infinite."""
        if math.isinf(value):
            return None
        away = as_fraction(value) * ratio - volume.cube.exact[axis]
        return away / side if side else away

    start, stop = place(low), place(high)
    if (start is not None and start > (1 if side else 0)) or (stop is not None and stop < 0):
        return 0, -1
    if low == math.inf or high == -math.inf:
        return 0, -1
    if volume.info.quantizer == "floor":
        first = 0 if start is None else math.floor(start * size)
        last = size - 1 if stop is None else math.floor(stop * size)
    else:
        steps, half = size - 1, Fraction(1, 2)
        first = 0 if start is None else math.ceil(start * steps - half)
        last = size - 1 if stop is None else math.floor(stop * steps + half)
    if not side:  # one place, cell 0
        return 0, 0
    return max(min(first, size - 1), 0), min(last, size - 1)


@dataclass(frozen=True, slots=True)
class Pairing:
    """
    The blocks of one level of two volumes on one grid, side by side.

    Parameters
    ----------
    words : (n,) array of uint64
        What an operation makes of their occupancy words; above the last level the bits of cells
        that may not stay empty.
    blocks_a, blocks_b : (n,) arrays of int64
        Which block of either volume each is, -1 where it has none.
    """

    words: U64
    blocks_a: I64
    blocks_b: I64


def pairings(a: Volume, b: Volume, op: str) -> Iterator[Pairing]:
    """
    Walk down two trees at once.

    Parameters
    ----------
    a, b : Volume
        On the same grid, of the same depth.
    op : str
        One of `OPERATIONS`, or ``"first"`` for the blocks of `a` with their places in `b`.

    Yields
    ------
    pairing : Pairing
        Of each level, the root first. Only the last level's words are those of the operation: the
        words above follow every cell that may hold a voxel of the result.
    """
    from volatool.kernels import algebra as kernels

    last = _MODES.get(op, _FIRST)
    follow = {"or": 0, "xor": 0, "and": 1}.get(op, _FIRST)
    # an empty root says nothing: its metadata word must not weigh in a mean
    blocks_a, blocks_b = (np.array([0 if one.levels[0][0] else -1], np.int64) for one in (a, b))
    for level in range(a.depth):
        mode = last if level == a.depth - 1 else follow
        words = kernels.pair_words(a.levels[level], b.levels[level], blocks_a, blocks_b, mode)
        yield Pairing(words, blocks_a, blocks_b)
        if level < a.depth - 1:
            n_cells = int(np.bitwise_count(words).sum(dtype=np.int64))
            blocks_a, blocks_b = kernels.pair_children(
                words, a.levels[level], b.levels[level], blocks_a, blocks_b, n_cells
            )


def combine(a: Volume, b: Volume, op: str, *, resample: bool = False) -> Volume:
    """
    Return the union, intersection, symmetric difference or difference of two volumes.

    Parameters
    ----------
    a, b : Volume
        On the same grid: equal cubes in the same reference system (an unknown one is taken to be
        the same). Of different depths the smaller one is used.
    op : str
        ``"or"``, ``"and"``, ``"xor"`` or ``"sub"``: ``a | b``, ``a & b``, ``a ^ b``, ``a - b``.
    resample : bool
        Bring `b` to the grid of `a` first, where it is on another one (`vola.regrid.regrid`); what
        lies outside the cube of `a` is lost.

    Returns
    -------
    result : Volume
        In the cube of `a`; the voxels are exactly those of the operation on sets. The root word of
        an empty one is 0.

        ``and`` and ``sub`` take the metadata of `a`; ``or`` and ``xor`` have metadata when both
        volumes do, in the channels that both have, in a common scaling
        (`vola.rescale.common_channels`): a block that both have gets the mean of their words,
        halves up (of two classes the lower code), one that a single volume has gets that one's.
        Where voxels went away it is as `vola.prune.prune` says. `unite` weighs more than two
        volumes alike, which a chain of ``|`` does not.

        `info.n_points` is the sum for ``or``, else None.

    Raises
    ------
    InputError
        ``E_GRID``: not on the same grid.
    CRSError
        ``E_CRS``: in different reference systems.
    """
    if op not in _MODES:
        raise OptionError(f"no operation {op!r}; there are {', '.join(OPERATIONS)}")
    a, b = aligned(a, b, resample=resample)
    own = op in ("and", "sub")
    metadata_a, metadata_b = a.metadata_levels, b.metadata_levels
    channels, tables = common_channels([a.info.channels, b.info.channels])
    if own:
        channels = tuple(a.info.channels)
    elif metadata_b is None or _nothing_common(channels, (a, b)):
        metadata_a = None
    levels, metadata = [], []
    for level, pairing in enumerate(pairings(a, b, op)):
        levels.append(pairing.words)
        if metadata_a is None:
            continue
        if own:
            metadata.append(metadata_a[level][pairing.blocks_a])
        elif metadata_b is not None:
            from volatool.kernels.algebra import pair_means

            metadata.append(
                pair_means(
                    metadata_a[level],
                    metadata_b[level],
                    pairing.blocks_a,
                    pairing.blocks_b,
                    *tables,
                )
            )
    kept = _without_empty(levels, metadata if metadata_a is not None else None)
    result = Volume(*kept, a.cube, replace(a.info, channels=channels if kept[1] else ()))
    return replace(result, info=_described(op, [a, b], result))


def _nothing_common(channels: Sequence[object], volumes: Sequence[Volume]) -> bool:
    """Whether metadata of volumes that say what theirs is have no channel in common."""
    return not channels and any(volume.info.channels for volume in volumes)


def _without_empty(
    levels: list[U64], metadata: list[U64] | None
) -> tuple[tuple[U64, ...], tuple[U64, ...] | None]:
    if all(words.all() for words in levels):
        return tuple(levels), None if metadata is None else tuple(metadata)
    return prune(levels, levels[-1], metadata)


def _described(op: str, volumes: Sequence[Volume], result: Volume) -> VolumeInfo:
    """Return what is known of the result of an operation."""
    infos = [volume.info for volume in volumes]
    known = [info for info in infos if info.crs.wkt2 is not None] or [
        info for info in infos if info.crs.horizontal is not None
    ]
    info = replace(
        result.info,
        crs=(known or infos)[0].crs,
        epsg=next((info.epsg for info in infos if info.epsg is not None), None),
        generator=None,
        warnings=(),
        source_name=_names([info.source_name for info in infos], op),
    )
    sources = [(info.source_name, info.source_bytes) for info in infos]  # --split: one for many
    if op == "or":
        boxes = [info.box for info, one in zip(infos, volumes, strict=True) if len(one)]
        box = None
        if boxes and None not in boxes:
            columns = list(zip(*(box for box in boxes if box is not None), strict=True))
            box = (*map(min, columns[:3]), *map(max, columns[3:]))
        return replace(
            info,
            box=box,
            n_points=_total([info.n_points for info in infos]),
            source_bytes=_total([size for _, size in dict.fromkeys(sources)]),
        )
    box = infos[0].box if op in ("and", "sub") else None
    loose = replace(result, info=replace(info, box=box))
    return replace(info, box=cells_box(loose), n_points=None, source_bytes=None)


def _total(numbers: Sequence[int | None]) -> int | None:
    return None if None in numbers else sum(number for number in numbers if number is not None)


def _names(names: Sequence[str | None], op: str) -> str | None:
    """Return what the sources' names become: all of a few, the first and a number of many."""
    known = list(dict.fromkeys(name for name in names if name is not None))
    if len(known) > 4:
        return f"{known[0]} and {len(known) - 1} others"
    return {"or": " | ", "and": " & ", "xor": " ^ ", "sub": " - "}[op].join(known) or None


def aligned(a: Volume, b: Volume, *, resample: bool = False) -> tuple[Volume, Volume]:
    """
    Return two volumes on one grid and of one depth.

    Parameters
    ----------
    a, b : Volume
        In the same reference system.
    resample : bool
        Bring `b` to the grid of `a` where it is on another one. A volume of the original toolkit
        becomes one of cells: its place k of S, at ``k / (S - 1)`` of the side, lies in cell k.

    Raises
    ------
    InputError, CRSError
        As `combine`.
    """
    if resample:
        from volatool.vola.regrid import as_cells, regrid

        check_crs(a, b)
        if not same_grid(a, b):
            a = as_cells(a)
            if not same_cube(a, b):
                b = regrid(b, a.cube, a.depth)
    check_grid(a, b)
    depth = min(a.depth, b.depth)
    return a.truncated(depth), b.truncated(depth)


def unite(volumes: Sequence[Volume]) -> Volume:
    """
    Return the union of any number of volumes on one grid.

    Parameters
    ----------
    volumes : sequence of Volume
        At least one, as `combine` takes them.

    Returns
    -------
    union : Volume
        As `combine` returns it, but that the word of a block is the mean of those of all volumes
        that have it, each counting alike, class the most frequent: the order of the volumes does
        not matter to voxels or metadata. Of two volumes it is ``a | b``.
    """
    if not volumes:
        raise OptionError("a union needs at least one volume")
    depth = min(volume.depth for volume in volumes)
    for other in volumes[1:]:
        check_grid(volumes[0], other)
    volumes = [volume.truncated(depth) for volume in volumes]
    plain = [Volume(one.levels, None, volumes[0].cube, one.info) for one in volumes]
    union = _reduced(plain, lambda a, b: combine(a, b, "or"))
    channels, tables = common_channels([volume.info.channels for volume in volumes])
    metadata = None
    if all(one.has_metadata for one in volumes) and not _nothing_common(channels, volumes):
        metadata = _stacked_means(volumes, union, tables)
    kept = _without_empty(list(union.levels), metadata)
    info = replace(volumes[0].info, channels=channels if metadata else ())
    result = Volume(*kept, volumes[0].cube, info)
    return replace(result, info=_described("or", volumes, result))


def _reduced(volumes: list[Volume], join: Callable[[Volume, Volume], Volume]) -> Volume:
    """Join neighbours pair by pair: each voxel is copied log2(n) times, not n times."""
    while len(volumes) > 1:
        pairs = zip(volumes[::2], volumes[1::2], strict=False)
        rest = volumes[len(volumes) // 2 * 2 :]
        volumes = [join(a, b) for a, b in pairs] + rest
    return volumes[0]


def _stacked_means(volumes: Sequence[Volume], union: Volume, tables: Sequence[Table]) -> list[U64]:
    """Mean words of the blocks of a union over the volumes that have them."""
    from volatool.kernels.words import mean_words
    from volatool.vola.strips import group_starts

    places: list[list[I64]] = [[] for _ in union.levels]
    words: list[list[U64]] = [[] for _ in union.levels]
    for volume, table in zip(volumes, tables, strict=True):
        if not len(volume) and len(union):
            continue
        for level, pairing in enumerate(pairings(volume, union, "first")):
            places[level].append(pairing.blocks_b)
            words[level].append(apply_table(volume.metadata_words(level + 1), table))
    levels = []
    for level in range(union.depth):
        at, values = np.concatenate(places[level]), np.concatenate(words[level])
        order = np.argsort(at, kind="stable")
        levels.append(mean_words(values[order], group_starts(at[order].astype(np.uint64))))
    return levels


def voxel_edge(volume: Volume) -> Fraction:
    """
    Return the edge of a voxel, exactly.

    Parameters
    ----------
    volume : Volume
        Its CRS need not be known.

    Returns
    -------
    edge : Fraction
        Horizontal units; of a volume of the original toolkit the step between the places that it
        rounds to.
    """
    steps = 4**volume.depth - is_rounded(volume)
    edge: Fraction = volume.cube.exact[3] / steps
    return edge


def voxel_size(volume: Volume) -> Fraction:
    """Return what one voxel takes of space, exactly, in cubed horizontal units."""
    edge = voxel_edge(volume)
    size: Fraction = edge * edge * edge
    return size
