"""Whether volumes lie on the same grid of voxels, and what to say when they don't."""

from __future__ import annotations

from volatool.errors import CRSError, InputError
from volatool.vola.volume import Volume

SLACK = 1e-6
"""Corners that differ by less than this part of a voxel are the same: files without a trailer have
their cube in floating point."""


def is_rounded(volume: Volume) -> bool:
    """Whether voxels are places that points were rounded to (the original toolkit), not cells."""
    return volume.info.quantizer != "floor"


def describe_grid(volume: Volume) -> str:
    """Return a volume's grid in words."""
    cube = volume.cube
    text = f"side {cube.side:.12g} at {', '.join(f'{value:.12g}' for value in cube.origin)}"
    if is_rounded(volume):
        text += " (rounded as the original toolkit does)"
    return text


def check_crs(a: Volume, b: Volume) -> None:
    """
    Raise if the numbers of two volumes are not in the same reference system.

    Raises
    ------
    CRSError
        ``E_CRS``; one that is not known is taken to be the other's.
    """
    if a.crs == b.crs:
        return
    from volatool.points.crs import difference

    found = difference(a.crs, b.crs)
    if found is not None:
        raise CRSError(
            f"the volumes are in different reference systems: {found}; convert the points again, "
            "with --to-crs"
        )


def same_cube(a: Volume, b: Volume) -> bool:
    """Whether cubes and rounding agree, whatever the depths are."""
    slack = SLACK * a.cell(min(a.depth, b.depth))
    near = all(
        abs(one - other) <= slack for one, other in zip(a.cube.exact, b.cube.exact, strict=True)
    )
    return near and is_rounded(a) == is_rounded(b)


def same_grid(a: Volume, b: Volume) -> bool:
    """Whether two volumes are on the same grid, but for levels that one may drop."""
    return same_cube(a, b) and not (is_rounded(a) and a.depth != b.depth)


def check_grid(a: Volume, b: Volume) -> None:
    """
    Raise if two volumes are not on the same grid, but for their depths.

    Raises
    ------
    InputError
        ``E_GRID``, with both grids.
    CRSError
        ``E_CRS``.
    """
    check_crs(a, b)
    if not same_cube(a, b):
        raise InputError(
            f"the volumes are not on the same grid: {describe_grid(a)}, and {describe_grid(b)}; "
            "convert one with --cube-from the other, or resample (--resample)",
            "E_GRID",
        )
    if is_rounded(a) and a.depth != b.depth:
        raise InputError(
            f"volumes of the original toolkit of {a.depth} and {b.depth} levels are not on the "
            "same grid: it rounds to other places at each depth; resample (--resample)",
            "E_GRID",
        )
