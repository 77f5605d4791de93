"""The recommended depth, and the reason for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from volatool.cube import Cube
from volatool.errors import CodedWarning, OptionError
from volatool.model import LevelCounts
from volatool.occupancy.levels import occupancy_of

MIN_OCCUPANCY = 0.15
"""The default threshold [Byrne2018]_, section 5.2."""

MIN_DEPTH = 2
"""What is chosen when no level passes."""

_MOST_VOXELS = 0.9  # of the points: from there on nearly every point has a voxel of its own
_LEAST_OCCUPANCY = 0.02
_BORDERLINE = 0.01


@dataclass(frozen=True, slots=True)
class Choice:
    """
    A depth and why it was taken.

    Parameters
    ----------
    depth : int
        Number of levels.
    rule : str
        ``"occupancy"``, ``"fixed"``, ``"resolution"``, ``"budget"``, ``"dataset"`` or ``"volume"``.
    threshold : float or None
        Least occupancy asked for, of the rule ``"occupancy"``.
    margin : float or None
        Occupancy of the chosen level less the threshold; negative when it falls short.
    cell : float
        Edge of a voxel, in the unit of the cube.
    reason : str
        One sentence for people.
    occupancy : float or None
        Of the chosen level.
    next_level : int or None
        The level below, if it was counted, ...
    next_occupancy : float or None
        ... and its occupancy.
    warnings : tuple of CodedWarning
        ``W_LOW_OCCUPANCY`` when no level passed.
    """

    depth: int
    rule: str
    threshold: float | None
    margin: float | None
    cell: float
    reason: str
    occupancy: float | None = None
    next_level: int | None = None
    next_occupancy: float | None = None
    warnings: tuple[CodedWarning, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the ``choice`` object of the report."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        del values["warnings"]  # they stand with all others of the report
        return values


def stop_level(counts: Sequence[LevelCounts], n_points: int, max_depth: int | None = None) -> int:
    """
    Return the last level worth showing.

    Parameters
    ----------
    counts : sequence of LevelCounts
        Of levels 1, 2, ...
    n_points : int
        Points that made the voxels.
    max_depth : int, optional
        Not beyond this one.

    Returns
    -------
    level : int
        The first level with more voxels than 0.9 x points or (but for level 1, which shows the
        shape of the box) an occupancy below 2 %; the last one there is, or `max_depth`, if none.
        At least 2, if there are two.
    """
    last = min(len(counts), max_depth or len(counts))
    for level, count in enumerate(counts[:last], 1):
        is_sparse = level > 1 and occupancy_of(count) < _LEAST_OCCUPANCY
        if count.voxels > _MOST_VOXELS * n_points or is_sparse:
            return min(max(level, MIN_DEPTH), last)
    return last


def deepest_passing(occupancies: Sequence[float], threshold: float = MIN_OCCUPANCY) -> int | None:
    """
    Return the deepest level that passes with all levels from 2 down to it; None if 2 doesn't.

    Parameters
    ----------
    occupancies : sequence of float
        Of levels 1, 2, ...; level 1 is exempt.
    threshold : float
        Least occupancy.

    Examples
    --------
    >>> deepest_passing([0.525, 0.871, 0.483, 0.355, 0.1472])
    4
    """
    deepest = None
    for level, occupancy in enumerate(occupancies[1:], 2):
        if occupancy < threshold:
            break
        deepest = level
    return deepest


def choose_depth(
    counts: Sequence[LevelCounts],
    n_points: int,
    *,
    cube: Cube,
    threshold: float = MIN_OCCUPANCY,
    max_depth: int | None = None,
) -> Choice:
    """
    Choose by occupancy: rule ``auto``.

    Parameters
    ----------
    counts : sequence of LevelCounts
        Of levels 1, 2, ...
    n_points : int
        Points that made the voxels.
    cube : Cube
        The extent.
    threshold : float
        Least occupancy.
    max_depth : int, optional
        Not deeper than this.

    Returns
    -------
    choice : Choice
        The deepest level down to the stop level (`stop_level`) that passes with all levels from 2
        down to it; 2 with a warning if none does, 1 if only that one is allowed.
    """
    stop = stop_level(counts, n_points, max_depth)
    occupancies = [occupancy_of(count) for count in counts[:stop]]
    depth = deepest_passing(occupancies, threshold)
    warnings: tuple[CodedWarning, ...] = ()
    if depth is None:
        depth = min(MIN_DEPTH, stop)
        lead = f"no level reaches {threshold:.4g} occupancy, so depth {depth} is taken"
        if stop >= MIN_DEPTH:
            warnings = (
                CodedWarning(
                    "W_LOW_OCCUPANCY",
                    f"{lead} (occupancy {occupancies[depth - 1]:.2%}); the points are too few or "
                    "too scattered for this cube",
                ),
            )
    else:
        lead = f"level {depth} is the deepest with occupancy of at least {threshold:.4g}"
    choice = _with_levels(depth, "occupancy", lead, counts[:stop], cube, threshold)
    return replace(choice, warnings=warnings)


def fixed_depth(depth: int, cube: Cube, counts: Sequence[LevelCounts] = ()) -> Choice:
    """Return the choice of ``--depth N``."""
    return _with_levels(depth, "fixed", f"depth {depth} was asked for", counts, cube)


def own_depth(depth: int, cube: Cube, counts: Sequence[LevelCounts] = ()) -> Choice:
    """Return the choice of an imported grid or mesh, which has a depth of its own."""
    return _with_levels(depth, "fixed", f"depth {depth} is that of the cells read", counts, cube)


def depth_for_resolution(cube: Cube, cell: float, max_depth: int) -> int:
    """
    Return the depth whose cells come nearest to an edge length without being coarser.

    Parameters
    ----------
    cube : Cube
        The extent.
    cell : float
        Edge, unit of the cube. Greater than zero.
    max_depth : int
        Deepest level possible.

    Raises
    ------
    OptionError
        The edge is not greater than zero, or finer than the cells of `max_depth`.
    """
    if not cell > 0:
        raise OptionError(f"a resolution must be greater than zero, got {cell:g}")
    for depth in range(1, max_depth + 1):
        if cube.cell(depth) <= cell:
            return depth
    raise OptionError(
        f"a resolution of {cell:g} needs more than {max_depth} levels in a cube of side "
        f"{cube.side:g} (level {max_depth} has cells of {cube.cell(max_depth):g}); give a coarser "
        "one, a shorter --cube or --split, or raise --max-depth"
    )


def resolution_depth(
    cube: Cube, cell: float, max_depth: int, counts: Sequence[LevelCounts] = ()
) -> Choice:
    """Return the choice of ``--resolution LENGTH``."""
    depth = depth_for_resolution(cube, cell, max_depth)
    lead = f"level {depth} has the coarsest cells not above {cell:g}"
    return _with_levels(depth, "resolution", lead, counts, cube)


def budget_depth(
    size_of: Callable[[int], int],
    budget_bytes: int,
    cube: Cube,
    max_depth: int,
    counts: Sequence[LevelCounts] = (),
) -> Choice:
    """
    Return the choice of ``--budget BYTES``.

    Parameters
    ----------
    size_of : callable
        Size of the file at a depth, bytes; called with 1, 2, ... until one doesn't fit.
    budget_bytes : int
        The most it may have.
    cube : Cube
        The extent.
    max_depth : int
        Deepest level possible.
    counts : sequence of LevelCounts, optional
        For the occupancy in the report.

    Raises
    ------
    OptionError
        ``E_BUDGET``: not even depth 1 fits.
    """
    depth, size = 0, 0
    for level in range(1, max_depth + 1):
        next_size = size_of(level)
        if next_size > budget_bytes:
            break
        depth, size = level, next_size
    else:
        next_size = 0
    if not depth:
        raise OptionError(
            f"a budget of {budget_bytes} bytes is too small: depth 1 needs {next_size}", "E_BUDGET"
        )
    lead = f"depth {depth} with {size} bytes is the deepest within {budget_bytes}"
    if next_size:
        lead += f" (depth {depth + 1} needs {next_size})"
    return _with_levels(depth, "budget", lead, counts, cube)


def dataset_depth(
    summary: Mapping[str, Any], cube: Cube, counts: Sequence[LevelCounts] = ()
) -> Choice:
    """
    Return the choice of ``--depth-from DATASET.json``.

    Parameters
    ----------
    summary : mapping
        A report or summary with a ``choice`` that has a ``depth``.
    cube : Cube
        The extent.
    counts : sequence of LevelCounts, optional
        For the occupancy in the report.

    Raises
    ------
    OptionError
        There is no depth in it.
    """
    choice = summary.get("choice")
    depth = choice.get("depth") if isinstance(choice, Mapping) else None
    if not isinstance(depth, int) or isinstance(depth, bool) or depth < 1:
        raise OptionError("--depth-from: the file has no choice.depth; give one that stats wrote")
    lead = f"depth {depth} was chosen for the whole data set"
    return _with_levels(depth, "dataset", lead, counts, cube)


def volume_depth(depth: int, name: str, cube: Cube, counts: Sequence[LevelCounts] = ()) -> Choice:
    """Return the choice of ``--cube-from VOLUME``: the depth of that volume."""
    return _with_levels(depth, "volume", f"{name} has {depth} levels", counts, cube)


def _with_levels(
    depth: int,
    rule: str,
    lead: str,
    counts: Sequence[LevelCounts],
    cube: Cube,
    threshold: float | None = None,
) -> Choice:
    """Fill in the occupancies of the chosen level and of the next one, and say them."""
    occupancy = occupancy_of(counts[depth - 1]) if depth <= len(counts) else None
    next_occupancy = occupancy_of(counts[depth]) if depth < len(counts) else None
    margin = None
    parts = [lead]
    if occupancy is not None:
        text = f"occupancy {occupancy:.2%}"
        if threshold is not None:
            margin = occupancy - threshold
            text += f" against {threshold:.2%}"
            if abs(margin) < _BORDERLINE:
                text += ", borderline"
        parts.append(text)
    if next_occupancy is not None:
        parts.append(f"level {depth + 1} has {next_occupancy:.2%}")
    return Choice(
        depth=depth,
        rule=rule,
        threshold=threshold,
        margin=margin,
        cell=cube.cell(depth),
        reason="; ".join(parts),
        occupancy=occupancy,
        next_level=depth + 1 if next_occupancy is not None else None,
        next_occupancy=next_occupancy,
    )
