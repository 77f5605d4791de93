"""
Occupancy map of ROS 2 map_server: a grey picture (``.pgm``) and its description (``.yaml``).

========== ===== ====================================================================
column     grey  when
========== ===== ====================================================================
occupied   0     a voxel's centre lies between the two heights above the ground
free       254   none does, and there is a voxel of the ground; or the column is empty and
                 such a one is near, nearer than an occupied one
unknown    205   the rest: nothing near, only what is higher, no ground known
========== ===== ====================================================================

The first row is the northernmost. Lengths of the description are metres, whatever the CRS has.
Obstacles begin one and a half voxels above the ground at the least: level ground between two layers
of voxels, with the noise of its points, is in both.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from volatool.dem.distance import distance_cells
from volatool.dem.grid import MAX_CELLS, Grid
from volatool.errors import CodedWarning, CRSError, InputError, OptionError, ResourceError
from volatool.export.cells import Places, cell_chunks
from volatool.export.model import ExportOptions, Target
from volatool.export.placing import with_extent
from volatool.model import F64, I64, Bool
from volatool.scratch import Scratch
from volatool.units import Length
from volatool.vola.volume import Volume
from volatool.vola.window import half_open

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
ABOVE = (Length(Fraction(1, 5), "m"), Length(Fraction(2), "m"))
"""Default heights above the ground."""

NEAR = Length(Fraction(1, 2), "m")
"""Default reach of ground that was seen: between the points of a scan there are gaps."""

LEAST_CELLS = 1.5
"""Lowest obstacle, in voxels: the layer above the ground's also holds points of the ground."""

GROUND_CELL_M = Fraction(1, 2)
"""The ground of finer voxels is found on cells of at least so many metres, and is as good."""


@dataclass(frozen=True, slots=True)
class Columns:
    """
    The columns of a map.

    Parameters
    ----------
    low, high : tuple of 2 int
        First and last cell, x and y.
    grid : Grid
        The same in units of the CRS.
    """

    low: tuple[int, int]
    high: tuple[int, int]
    grid: Grid

    @classmethod
    def of(cls, volume: Volume) -> Columns:
        """Return the columns that hold the voxels of a volume of half-open cells."""
        low, high = np.full(2, 4**volume.depth), np.full(2, -1)
        for chunk in cell_chunks(volume):
            low = np.minimum(low, chunk.cells[:, :2].min(axis=0))
            high = np.maximum(high, chunk.cells[:, :2].max(axis=0))
        width, height = (int(size) for size in high - low + 1)
        if width * height > MAX_CELLS:
            raise ResourceError(
                f"the map would have {width} x {height} cells, at most {MAX_CELLS} are made; "
                "give --bounds or a coarser --level",
                "E_SIZE",
            )
        x, y, _, side = volume.cube.exact
        cell = side / 4**volume.depth
        left, top = x + int(low[0]) * cell, y + (int(high[1]) + 1) * cell
        grid = Grid(float(left), float(top), float(cell), width, height, (left, top, cell))
        return cls((int(low[0]), int(low[1])), (int(high[0]), int(high[1])), grid)

    def pixels(self, cells: NDArray[np.int32]) -> tuple[I64, I64]:
        """Return row and column of the picture for cells."""
        xy = cells[:, :2].astype(np.int64)
        return self.high[1] - xy[:, 1], xy[:, 0] - self.low[0]


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write the map.

    Parameters
    ----------
    volume : Volume
        What is mapped.
    target : Target
        Two files: ``.yaml`` and ``.pgm`` beside it.
    options : ExportOptions
        ``above``, heights of obstacles above the ground (0.2 m to 2 m), the highest included;
        ``ground``, an elevation model in the CRS of the volume, by default the one that `dem`
        makes of the volume; ``near``, how far from ground that was seen an empty column is free
        (0.5 m); ``local``, the origin counts from the cube's corner.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_NO_CRS``: metres are assumed; ``W_VOXEL_SIZE``: voxels are larger than the lower
        height; ``W_UNKNOWN``: most of the map is unknown.

    Raises
    ------
    CRSError
        ``E_GEOGRAPHIC``: degrees. ``E_CRS``: the elevation model is in another system.
    InputError
        ``E_NO_GROUND``: there is no ground to be found.
    OptionError
        The output has the picture's name, or ``E_CUBE``: all voxels are in one place.
    ResourceError
        ``E_SIZE``: too many columns.
    """
    if volume.crs.is_geographic:
        raise CRSError(
            "a map needs lengths, the volume is in degrees; make it with --to-crs utm",
            "E_GEOGRAPHIC",
        )
    if target.path.suffix.lower() == ".pgm":
        raise OptionError(
            f"{target.path}: is the picture's name; give that of the description, "
            f"{target.path.with_suffix('.yaml').name}"
        )
    with_extent(volume, "a map")
    target.refuse_existing(".pgm")  # before the work
    volume = half_open(volume)
    warnings = []
    metres = volume.crs.metres_per_unit_xy
    if metres is None:
        metres = Fraction(1)
        warnings.append(CodedWarning("W_NO_CRS", "no CRS tells the unit; metres are assumed"))
    columns = Columns.of(volume)
    low, high = (float(length.in_units(metres)) for length in options.above or ABOVE)
    cell_m, least = volume.cell() * float(metres), LEAST_CELLS * volume.cell()
    if high < least:
        raise InputError(
            f"voxels of {cell_m:.3g} m can't tell what stands up to {high * float(metres):.3g} m "
            "above the ground; raise the upper height of --above, or make a finer volume"
        )
    if low < least:
        warnings.append(
            CodedWarning(
                "W_VOXEL_SIZE",
                f"voxels are {cell_m:.3g} m: obstacles begin {LEAST_CELLS * cell_m:.3g} m above "
                f"the ground, not {low * float(metres):.3g} m",
            )
        )
        low = least
    ground = _ground(volume, columns.grid, options.ground) * float(volume.crs.z_ratio)
    near = float((options.near or NEAR).in_units(metres))
    image = occupancy(volume, columns, ground, low, high, near)
    n_unknown = int(np.count_nonzero(image == UNKNOWN))
    if 2 * n_unknown > image.size:
        told = f"{100 * n_unknown / image.size:.0f} % of the map is unknown"
        warnings.append(
            CodedWarning("W_UNKNOWN", f"{told}; a coarser --level has fewer holes", n_unknown)
        )
    picture = target.name(".pgm").name
    text = _description(volume, columns, metres, picture, bool(options.local))
    with target.stream() as stream:
        stream.write(text.encode())
    with target.stream(".pgm") as stream:
        stream.write(f"P5\n{columns.grid.width} {columns.grid.height}\n255\n".encode())
        stream.write(image.tobytes())
    return warnings


def occupancy(
    volume: Volume, columns: Columns, ground: F64, low: float, high: float, near: float = 0.0
) -> NDArray[np.uint8]:
    """
    Return the picture.

    Parameters
    ----------
    volume : Volume
        Of half-open cells.
    columns : Columns
        The part that is mapped.
    ground : (h, w) array of float64
        Height of the ground in each column, in the horizontal unit; NaN where unknown.
    low, high : float
        Obstacles above it, same unit, both included.
    near : float
        Distance to a column with ground up to which an empty one is free, same unit.

    Returns
    -------
    image : (h, w) array of uint8
        0 occupied, 254 free, 205 unknown; row 0 in the north.
    """
    seen: Bool = np.zeros(ground.shape, np.bool_)
    blocked: Bool = np.zeros(ground.shape, np.bool_)
    empty: Bool = ~np.isnan(ground)
    places = Places.of(volume)
    ratio = float(volume.crs.z_ratio)
    # heights are sums of rounded numbers: at a limit means at it
    slack = 1e-6 * volume.cell()
    for chunk in cell_chunks(volume):
        row, col = columns.pixels(chunk.cells)
        above = places.centers(chunk.cells)[:, 2] * ratio - ground[row, col]
        empty[row, col] = False
        within = (above >= low - slack) & (above <= high + slack)  # false for NaN
        blocked[row[within], col[within]] = True
        beneath = above < low - slack
        seen[row[beneath], col[beneath]] = True
    if near > 0 and seen.any():
        away = _distance(seen)
        empty &= away <= near / columns.grid.cell * (1 + 1e-6)  # float32: at the limit means at it
        if blocked.any():  # gaps in a hedge are no ways through it
            empty &= away < _distance(blocked)
        seen |= empty
    image = np.full(ground.shape, UNKNOWN, np.uint8)
    image[seen] = FREE
    image[blocked] = OCCUPIED
    return image


def _distance(cells: Bool) -> NDArray[np.float32]:
    """Return how far each cell is from the nearest one that is set, in cells."""
    return distance_cells(cells.view(np.uint8), 1, Scratch())


def _ground(volume: Volume, grid: Grid, name: str | None) -> F64:
    """Return the ground of each column, in the vertical unit."""
    if name is None:
        from volatool.dem.from_volume import ground_under

        metres = volume.crs.metres_per_unit_xy or Fraction(1)
        step = math.ceil(GROUND_CELL_M / (grid.exact[2] * metres))
        if step == 1:
            return ground_under(volume, grid)
        coarse = coarser(grid, step)
        return resampled(ground_under(volume, coarse), coarse, grid)
    from volatool.dem.accuracy import crs_of
    from volatool.dem.like import grid_like
    from volatool.dem.raster import read_dem

    path = Path(name)
    grid_like(path, volume.crs, "--ground")
    dem = read_dem(path)
    theirs, ours = crs_of(path).metres_per_unit_z, volume.crs.metres_per_unit_z
    factor = float(theirs / ours) if theirs and ours else 1.0
    return factor * resampled(dem.z.astype(np.float64), dem.grid, grid)


def coarser(grid: Grid, step: int) -> Grid:
    """Return the grid of cells so many times larger that covers another, from its upper left."""
    left, top, cell = grid.exact
    cell *= step
    width, height = -(-grid.width // step), -(-grid.height // step)
    return Grid(grid.left, grid.top, float(cell), width, height, (left, top, cell))


def resampled(z: F64, source: Grid, grid: Grid) -> F64:
    """
    Return a raster at the centres of other cells, bilinear.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights, NaN where void.
    source, grid : Grid
        Their cells; those that are wanted.

    Returns
    -------
    heights : (grid.height, grid.width) array of float64
        NaN off the raster and beside voids; within half a cell of the rim the outermost centres'
        value holds.
    """
    x = grid.left + (np.arange(grid.width) + 0.5) * grid.cell
    y = grid.top - (np.arange(grid.height) + 0.5) * grid.cell
    col, row = (x - source.left) / source.cell, (source.top - y) / source.cell
    off_x, off_y = (col < 0) | (col > source.width), (row < 0) | (row > source.height)
    left, right, part_x = _between(col, source.width)
    upper, lower, part_y = _between(row, source.height)
    across = z[:, left] * (1 - part_x) + z[:, right] * part_x
    heights: F64 = across[upper] * (1 - part_y)[:, None] + across[lower] * part_y[:, None]
    heights[off_y] = np.nan
    heights[:, off_x] = np.nan
    return heights


def _between(place: NDArray[np.floating[Any]], n_cells: int) -> tuple[I64, I64, F64]:
    """Return the cells whose centres a place lies between, and how far it is to the second."""
    at = np.clip(place - 0.5, 0, n_cells - 1)
    first = np.floor(at).astype(np.int64)
    part = at - first
    # a cell without weight need not have a value: NaN times 0 is NaN
    return first, np.where(part > 0, np.minimum(first + 1, n_cells - 1), first), part


def _description(
    volume: Volume, columns: Columns, metres: Fraction, picture: str, is_local: bool
) -> str:
    """Return the YAML that map_server loads."""
    cell = columns.grid.exact[2] * metres
    bottom = columns.grid.exact[1] - columns.grid.height * columns.grid.exact[2]
    corner = [columns.grid.exact[0] * metres, bottom * metres]
    cube = [value * metres for value in volume.cube.exact[:2]]
    shift = cube if is_local else [Fraction(0), Fraction(0)]
    x, y = (float(value - moved) for value, moved in zip(corner, shift, strict=True))
    crs = volume.crs.horizontal or "an unknown CRS"
    if is_local:
        far = ", ".join(repr(float(value)) for value in cube)
        told = f"# map frame: the cube's corner; {crs} is that plus [{far}] (metres)"
    else:
        told = f"# map frame: {crs} in metres; --local counts from the cube's corner"
    # quotes as JSON has them are YAML's too
    return (
        f"{told}\n"
        f"image: {json.dumps(picture)}\n"
        "mode: trinary\n"
        f"resolution: {float(cell)!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
