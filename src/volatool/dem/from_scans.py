"""The elevation model of a live map, to be written like any other."""

from __future__ import annotations

import numpy as np

from volatool.dem.distance import FILLED, MEASURED, VOID, fill_flags
from volatool.dem.surfaces import MAX_GAP_CELLS, Dem
from volatool.emap.live import EMap
from volatool.model import CrsInfo
from volatool.scratch import Scratch

SURFACE = "emap"
"""Neither a DTM nor a DSM: whatever the sensor saw."""


def dem_of_scans(
    m: EMap,
    crs: CrsInfo,
    *,
    max_gap: float | None = None,
    with_sigma: bool = False,
    scratch: Scratch | None = None,
) -> Dem | None:
    """
    Return the model of all that a map has seen, or of its bounds.

    Parameters
    ----------
    m : EMap
        The map.
    crs : CrsInfo
        Its coordinates' CRS.
    max_gap : float, optional
        No cell farther than this from a measured one is filled, see `fill_flags`; 10 cells by
        default. In the unit of the map.
    with_sigma : bool
        Tell standard errors too: 32 more solves.
    scratch : Scratch, optional
        Where the grids live.

    Returns
    -------
    dem : Dem or None
        None while no point was seen there.

    Raises
    ------
    ResourceError
        ``E_SIZE``: too many cells.
    """
    scratch = Scratch() if scratch is None else scratch
    surface = m.whole(scratch)
    if surface is None:
        return None
    grid, count = surface.grid, surface.count
    shape = count.shape
    flag = scratch.zeros(shape, np.uint8)
    flag[:] = np.where(count > 0, MEASURED, VOID)
    gap = MAX_GAP_CELLS if max_gap is None else max_gap / grid.cell
    fill_flags(flag, gap, 2.0, scratch)
    z = scratch.zeros(shape, np.float32)
    z[:] = np.where(flag == VOID, np.nan, surface.z)
    known = z[flag != VOID]
    sigma = None
    if with_sigma:
        sigma = scratch.zeros(shape, np.float32)
        sigma[:] = m.standard_error(grid=grid, scratch=scratch)
        sigma[flag == VOID] = np.nan
    return Dem(
        z,
        flag,
        count,
        grid,
        crs,
        SURFACE,
        "scans",
        solver={} if surface.info is None else surface.info.to_dict(),
        z_min=float(known.min()),
        z_max=float(known.max()),
        cells_measured=int(np.count_nonzero(flag == MEASURED)),
        cells_filled=int(np.count_nonzero(flag == FILLED)),
        cells_void=int(np.count_nonzero(flag == VOID)),
        sigma=sigma,
        scratch=scratch,
    )
