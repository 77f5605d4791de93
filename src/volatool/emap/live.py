"""A surface kept up to date with scans: evidence for ever, heights for the window asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from volatool.dem.grid import MAX_CELLS, Grid, grid_for
from volatool.emap.blocks import FARTHEST, Blocks
from volatool.emap.multigrid import Hierarchy
from volatool.emap.solve import SolveInfo, solve
from volatool.emap.system import Springs
from volatool.emap.uncertainty import BATCH, MAX_SAMPLES, SAMPLES
from volatool.emap.uncertainty import TOL as SAMPLE_TOL
from volatool.errors import OptionError, ResourceError
from volatool.model import F64, Bool, Bounds, as_fraction
from volatool.scratch import Scratch

STIFFNESS = 10.0
"""Bending stiffness ``kb`` over a point's: for scans of many points a cell."""

TENSION = 1e-5
"""Stretching over bending stiffness: only what holds a surface that hangs on a point or two."""

MARGIN = 20
"""Cells around a window that are solved with it; returns there hold its rim."""

MAX_BYTES = 1 << 30
"""Default ceiling of the evidence's memory."""


@dataclass(frozen=True, slots=True)
class ScanCount:
    """
    What became of a scan's points.

    Parameters
    ----------
    n_points : int
        Rows of the scan.
    n_used : int
        Added to the evidence.
    n_invalid : int
        With a coordinate that is not finite.
    n_far : int
        Farther from the sensor than the radius.
    n_outside : int
        Outside the bounds.
    """

    n_points: int
    n_used: int
    n_invalid: int
    n_far: int
    n_outside: int


@dataclass(frozen=True, slots=True)
class Window:
    """
    The surface in a rectangle, row 0 in the north.

    Parameters
    ----------
    grid : Grid
        Where the cells are.
    z : (h, w) array of float64
        Heights at the cells' centres; NaN while no point is in or near the window.
    count : (h, w) array of uint32
        Points ever seen in each cell, forgotten ones included.
    info : SolveInfo or None
        How the solve went; None without points.
    """

    grid: Grid
    z: F64
    count: NDArray[np.uint32]
    info: SolveInfo | None

    @property
    def x(self) -> F64:
        """Centres of the columns, west to east."""
        columns = np.arange(self.grid.width, dtype=np.float64)
        return self.grid.left + (columns + 0.5) * self.grid.cell

    @property
    def y(self) -> F64:
        """Centres of the rows, north to south."""
        rows = np.arange(self.grid.height, dtype=np.float64)
        return self.grid.top - (rows + 0.5) * self.grid.cell

    @property
    def bounds(self) -> Bounds:
        """Outer edges."""
        return self.grid.bounds

    @property
    def measured(self) -> Bool:
        """Which cells hold a point; the others' heights are the springs' alone."""
        return self.count > 0


class EMap:
    """
    An elevation map that scans are added to and heights are asked of, in any order.

    What is kept is not the surface but what the points say about it, for all places ever seen
    (see `volatool.emap.blocks`). So the surface after any number of scans, in any order, is the
    one of all their points at once, and no error of an earlier surface lives on.

    Parameters
    ----------
    bounds : Bounds or 4 floats, optional
        left, bottom, right, top of the surface, widened to whole cells; points outside are
        ignored. By default the map has no bounds and `z` covers what was seen, or the last
        `window`.
    cell : float
        Edge of a cell. Cells lie on multiples of it.
    sigma : float
        Standard deviation of a point's height, same unit; for points that don't bring their own.
    k_surface : float, optional
        Stiffness of the surface ``kb cell^2`` over that of a point, in the square of the unit;
        ``10 cell^2`` by default. With preset ``"paper"``: ``km``, 0.1 by default.
    ell : float, optional
        Length beyond which tension rules over bending, ``km = k_surface / ell^2``; by default
        316 cells, which is next to none.
    preset : str
        ``"emap"``, or ``"paper"``: stretching springs only, points pull on the nearest node, and
        windows have no margin.
    attach : str, optional
        ``"bilinear"`` or ``"nearest"``, whatever the preset says.
    springs : Springs, optional
        In place of `k_surface`, `ell`, `preset` and `attach`.
    radius : float, optional
        Returns horizontally farther from the sensor than this are ignored; `update` needs the
        sensor's place then.
    margin : int, optional
        Cells around a window that are solved with it.
    forget : float
        Factor, 0 to 1, on all earlier evidence at each scan. 1 forgets nothing and is the only
        value for which the order of scans does not matter.
    max_weight : float, optional
        Bound of the weight of all points between four nodes, in points of standard deviation
        `sigma`: what is known of a place can then change after about so many new points.
    tol : float
        Stop of the solver: largest estimated error of a height.
    max_bytes : int
        Ceiling of the evidence's memory; about 120 bytes a cell seen.

    Attributes
    ----------
    n_scans : int
        Scans added, empty ones included.

    Notes
    -----
    Units of x, y and z must be the same. Energy and symbols: docs/explanation/emap.md.

    Examples
    --------
    >>> import numpy as np
    >>> m = EMap((0, 0, 4, 4), cell=0.5)
    >>> x, y = np.random.default_rng(0).uniform(0, 4, (2, 500))
    >>> m.update(np.column_stack([x, y, 0.5 * x])).n_used
    500
    >>> m.z.shape, round(float(m.z[0, 0]), 2)
    ((8, 8), 0.13)
    """

    def __init__(
        self,
        bounds: Bounds | tuple[float, float, float, float] | None = None,
        cell: float = 0.25,
        *,
        sigma: float = 0.05,
        k_surface: float | None = None,
        ell: float | None = None,
        preset: str = "emap",
        attach: str | None = None,
        springs: Springs | None = None,
        radius: float | None = None,
        margin: int | None = None,
        forget: float = 1.0,
        max_weight: float | None = None,
        tol: float = 1e-4,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        for name, value in (("cell", cell), ("sigma", sigma), ("tol", tol)):
            _check_positive(name, value)
        for name, limit in (("radius", radius), ("max_weight", max_weight), ("ell", ell)):
            if limit is not None:
                _check_positive(name, limit)
        if not 0 < forget <= 1:
            raise OptionError(f"forget must be greater than 0 and at most 1, got {forget}")
        if margin is not None and margin < 0:
            raise OptionError(f"margin must not be negative, got {margin}")
        self.cell = float(cell)
        self.sigma_point = float(sigma)
        self.radius = radius
        self.tol = tol
        self.springs = springs or _springs(preset, attach, self.cell, k_surface, ell)
        self.margin = margin if margin is not None else 0 if preset == "paper" else MARGIN
        most = math.inf if max_weight is None else max_weight * self.springs.weight
        self._blocks = Blocks(self.springs, forget, most, max_bytes)
        self.n_scans = 0
        self._zero: float | None = None
        self._bounds: Grid | None = None
        if bounds is not None:
            box = bounds if isinstance(bounds, Bounds) else Bounds(*bounds)
            self._bounds = grid_for(box, self.cell)
        self._grid = self._bounds
        self._last: _Solved | None = None

    def update(
        self,
        scan: ArrayLike,
        *,
        weights: ArrayLike | None = None,
        sigma: ArrayLike | None = None,
        origin: ArrayLike | None = None,
    ) -> ScanCount:
        """
        Add a scan.

        Parameters
        ----------
        scan : (n, 3 or more) array of float
            World x, y, z in its first columns. Rows that are not finite are dropped and counted.
            May be empty: with ``forget < 1`` that still makes the earlier scans fade.
        weights : (n,) array or float, optional
            Factor on the stiffness of each point's spring.
        sigma : (n,) array or float, optional
            Standard deviation of each point's height, in place of the map's.
        origin : (2 or 3,) array, optional
            The sensor's x, y (z is not used), for `radius`.

        Returns
        -------
        count : ScanCount
            What became of the points.

        Raises
        ------
        OptionError
            The arrays don't fit each other.
        ResourceError
            ``E_MEMORY``: the evidence would pass `max_bytes`; nothing has changed.
        """
        with np.errstate(invalid="ignore"):  # signalling NaNs
            points = np.asarray(scan, np.float64)
        if points.size == 0:
            points = points.reshape(0, 3)
        if points.ndim != 2 or points.shape[1] < 3:
            raise OptionError(f"a scan has rows of x, y, z, got an array of shape {points.shape}")
        n = len(points)
        stiffness = self._stiffness(n, weights, sigma)
        x, y, z = points[:, 0], points[:, 1], points[:, 2]
        keep: Bool = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
        n_valid = int(np.count_nonzero(keep))
        col, row = x / self.cell, -(y / self.cell)
        if self.radius is not None:
            if origin is None:
                raise OptionError("a map with a radius needs the sensor's origin with each scan")
            centre = np.asarray(origin, np.float64)
            with np.errstate(invalid="ignore", over="ignore"):
                keep &= (x - centre[0]) ** 2 + (y - centre[1]) ** 2 <= self.radius**2
        n_near = int(np.count_nonzero(keep))
        with np.errstate(invalid="ignore"):
            keep &= self._inside(col, row)
        n_used = int(np.count_nonzero(keep))
        if n_used < n:
            col, row, z = col[keep], row[keep], z[keep]
            stiffness = stiffness if len(stiffness) == 1 else stiffness[keep]
        if self._zero is None and n_used:
            self._zero = float(np.round(np.mean(z)))  # counting from near by keeps digits
        heights = np.ascontiguousarray(z - (self._zero or 0.0))
        self._blocks.add(np.ascontiguousarray(col), np.ascontiguousarray(row), heights, stiffness)
        self.n_scans += 1
        return ScanCount(n, n_used, n - n_valid, n_valid - n_near, n_near - n_used)

    def window(
        self, centre: ArrayLike, size: float | tuple[float, float], margin: int | None = None
    ) -> Window:
        """
        Return the surface round a place; `z`, `count` and the rest then are those of it.

        Parameters
        ----------
        centre : (2 or 3,) array
            x, y.
        size : float or 2 floats
            Width, or width and height, rounded to whole cells.
        margin : int, optional
            Cells around it that are solved with it; the map's own by default.

        Returns
        -------
        window : Window
            On whole cells: it rolls by cells, nodes stay where they are in the world.
        """
        width, height = size if isinstance(size, tuple) else (size, size)
        shape = []
        for length in (height, width):
            _check_positive("size", length)
            shape.append(max(1, round(length / self.cell)))
        self._grid = self._around(centre, shape[0], shape[1])
        return self._window(self._grid, margin)

    def solve_window(
        self, centre: ArrayLike, n_nodes: int, margin: int | None = None
    ) -> tuple[F64, F64, F64]:
        """
        Return the heights of ``n_nodes x n_nodes`` nodes round a place.

        Parameters
        ----------
        centre : (2 or 3,) array
            x, y.
        n_nodes : int
            Nodes along a side.
        margin : int, optional
            Cells around the window that are solved with it; the map's own by default.

        Returns
        -------
        z : (n, n) array of float64
            Row 0 in the north, column 0 in the west; NaN while no point is near.
        x, y : (n,) arrays of float64
            Of the columns, ascending, and of the rows, descending.
        """
        if n_nodes < 1:
            raise OptionError(f"a window needs nodes, got {n_nodes}")
        window = self._window(self._around(centre, n_nodes, n_nodes), margin)
        return window.z, window.x, window.y

    def whole(self, scratch: Scratch | None = None) -> Window | None:
        """
        Return the surface of the bounds, or of all that was seen, solved afresh.

        Parameters
        ----------
        scratch : Scratch, optional
            Where the solver's grids live: over budget in temporary files.

        Returns
        -------
        window : Window or None
            None while no point was seen there.
        """
        extent = self._blocks.extent()
        grid = self._bounds
        if grid is None and extent is not None:
            grid = self._grid_at(*extent)
        if grid is None:
            return None
        window = self._window(grid, None, Scratch() if scratch is None else scratch)
        return window if window.count.any() else None

    @property
    def grid(self) -> Grid | None:
        """Cells of `z`: the last window's, else the bounds', else what was seen so far."""
        if self._grid is not None:
            return self._grid
        extent = self._blocks.extent()
        return None if extent is None else self._grid_at(*extent)

    @property
    def surface(self) -> Window:
        """The surface on `grid`, solved when something has changed."""
        grid = self.grid
        if grid is None:
            raise OptionError("the map is empty and has no bounds: add a scan first")
        return self._window(grid, None)

    @property
    def z(self) -> F64:
        """Heights on `grid`, row 0 in the north; NaN without points."""
        return self.surface.z

    @property
    def count(self) -> NDArray[np.uint32]:
        """Points ever seen in each cell of `grid`."""
        return self.surface.count

    @property
    def measured(self) -> Bool:
        """Cells of `grid` that hold a point."""
        return self.surface.measured

    @property
    def sigma(self) -> F64:
        """Standard error of `z` on `grid`, to about 12 %; worked out anew each time."""
        return self.standard_error()

    def standard_error(
        self,
        n_samples: int = SAMPLES,
        *,
        grid: Grid | None = None,
        scratch: Scratch | None = None,
    ) -> F64:
        """
        Return how sure heights are.

        Parameters
        ----------
        n_samples : int
            Random surfaces, 1 to 64: each is a solve; right to ``1 / sqrt(2 n_samples)``.
        grid : Grid, optional
            Of which cells, as a `Window` has it; those of `z` by default.
        scratch : Scratch, optional
            Where the solver's grids live.

        Returns
        -------
        sigma : (h, w) array of float64
            Standard errors, unit of the heights, for points as good as their `sigma` says; NaN
            without points. Evidence that has faded counts as weaker.
        """
        from volatool.kernels import chance

        if not 1 <= n_samples <= MAX_SAMPLES:
            raise OptionError(f"samples must be 1 to {MAX_SAMPLES}, got {n_samples}")
        grid = self.surface.grid if grid is None else grid
        scratch = Scratch() if scratch is None else scratch
        pad, (top, left) = self.margin, self._corner(grid)
        top, left = top - pad, left - pad
        height, width = max(2, grid.height + 2 * pad), max(2, grid.width + 2 * pad)
        evidence = self._blocks.evidence(top, left, height, width, scratch)
        if not evidence.data[:, 0].any():
            return np.full((grid.height, grid.width), np.nan)
        kb, km = self.springs.kb, self.springs.km
        tol = SAMPLE_TOL / math.sqrt(self.springs.weight)
        hierarchy = Hierarchy(evidence, self.springs, scratch)
        total = np.zeros((grid.height, grid.width))
        for first in range(0, n_samples, BATCH):
            n = min(BATCH, n_samples - first)
            forces = scratch.zeros((height, width, n), np.float32)
            chance.surface_forces(kb, km, top, left, first, 0, height, forces)
            self._blocks.pull(top, left, first, forces)
            for k in range(n):
                evidence.right[:] = forces[:, :, k]
                z, _ = solve(evidence, self.springs, tol=tol, hierarchy=hierarchy)
                total += z[pad : pad + grid.height, pad : pad + grid.width] ** 2
                scratch.free(z)
            scratch.free(forces)
        hierarchy.free()
        evidence.free()
        unit = self.sigma_point * math.sqrt(self.springs.weight)
        return np.asarray(unit * np.sqrt(total / n_samples), np.float64)

    @property
    def bounds(self) -> Bounds | None:
        """Outer edges of `grid`; None while the map is empty and has no bounds."""
        grid = self.grid
        return None if grid is None else grid.bounds

    @property
    def n_bytes(self) -> int:
        """Memory of the evidence."""
        return self._blocks.n_bytes

    def heights_at(self, xy: ArrayLike) -> F64:
        """
        Return the last surface's height at places.

        Parameters
        ----------
        xy : (n, 2 or more) array
            x, y.

        Returns
        -------
        z : (n,) array of float64
            As the points' springs see it; NaN outside the window and its margin, and before any
            surface was asked for.
        """
        from volatool.kernels import spring

        places = np.asarray(xy, np.float64)
        out = np.full(len(places), np.nan)
        last = self._last
        if last is not None and len(places):
            col = np.ascontiguousarray(places[:, 0] / self.cell - last.left)
            row = np.ascontiguousarray(-(places[:, 1] / self.cell) - last.top)
            is_nearest = self.springs.is_nearest
            spring.interpolate(last.z, col, row, is_nearest, 0, len(last.z), out)
            out += self._zero or 0.0
        return out

    def drop_beyond(self, centre: ArrayLike, distance: float) -> int:
        """
        Forget all evidence farther from a place than a distance, in whole blocks.

        Parameters
        ----------
        centre : (2 or 3,) array
            x, y.
        distance : float
            What is nearer stays; so may what is up to a block (32 cells) farther.

        Returns
        -------
        n_bytes : int
            Memory given back.
        """
        place = np.asarray(centre, np.float64) / self.cell
        before = self.n_bytes
        self._blocks.drop_beyond(float(-place[1]), float(place[0]), distance / self.cell)
        self._last = None
        return before - self.n_bytes

    def _stiffness(self, n: int, weights: ArrayLike | None, sigma: ArrayLike | None) -> F64:
        result = np.full(1, self.springs.weight)
        if weights is not None:
            result = result * np.asarray(weights, np.float64)
        if sigma is not None:
            with np.errstate(divide="ignore"):
                result = result * (self.sigma_point / np.asarray(sigma, np.float64)) ** 2
        if result.shape not in ((1,), (n,)):
            raise OptionError(f"{n} points can't have weights or sigmas of shape {result.shape}")
        if not np.all(np.isfinite(result) & (result >= 0)):
            raise OptionError("weights must be finite and not negative, sigmas greater than zero")
        return np.ascontiguousarray(result)

    def _inside(self, col: F64, row: F64) -> Bool:
        if self._bounds is None:
            inside: Bool = (np.abs(col) < FARTHEST) & (np.abs(row) < FARTHEST)
            return inside
        top, left = self._corner(self._bounds)
        inside = (col >= left) & (col <= left + self._bounds.width)
        inside &= (row >= top) & (row <= top + self._bounds.height)
        return inside

    def _corner(self, grid: Grid) -> tuple[int, int]:
        """Row and column of a grid's first cell."""
        left, top, cell = grid.exact
        return int(-top / cell), int(left / cell)

    def _grid_at(self, top: int, left: int, height: int, width: int) -> Grid:
        if height * width > MAX_CELLS:
            raise ResourceError(
                f"the surface would have {width} x {height} cells; ask for a smaller window",
                "E_SIZE",
            )
        cell = as_fraction(self.cell)
        exact = (left * cell, -top * cell, cell)
        return Grid(float(exact[0]), float(exact[1]), self.cell, width, height, exact)

    def _around(self, centre: ArrayLike, height: int, width: int) -> Grid:
        place = np.asarray(centre, np.float64) / self.cell
        if place.shape not in ((2,), (3,)) or not np.all(np.abs(place[:2]) < FARTHEST):
            raise OptionError(f"the centre of a window must be x, y, got {centre!r}")
        left = math.floor(float(place[0]) - width / 2 + 0.5)
        top = math.floor(-float(place[1]) - height / 2 + 0.5)
        return self._grid_at(top, left, height, width)

    def _window(self, grid: Grid, margin: int | None, scratch: Scratch | None = None) -> Window:
        pad = self.margin if margin is None else margin
        if pad < 0:
            raise OptionError(f"margin must not be negative, got {pad}")
        top, left = self._corner(grid)
        count = self._blocks.counts(top, left, grid.height, grid.width)
        # a solve needs 2 x 2 nodes
        pad_height, pad_width = max(2, grid.height + 2 * pad), max(2, grid.width + 2 * pad)
        solved = self._solved(top - pad, left - pad, pad_height, pad_width, scratch)
        inner = solved.z[pad : pad + grid.height, pad : pad + grid.width]
        return Window(grid, inner + (self._zero or 0.0), count, solved.info)

    def _solved(
        self, top: int, left: int, height: int, width: int, scratch: Scratch | None
    ) -> _Solved:
        last = None if scratch is not None else self._last
        if last is not None and last.key == (self.n_scans, top, left, height, width):
            return last
        evidence = self._blocks.evidence(top, left, height, width, scratch)
        if not evidence.data[:, 0].any():
            return _Solved(self.n_scans, top, left, np.full((height, width), np.nan), None)
        start = None if last is None else last.moved(top, left, height, width)
        z, info = solve(evidence, self.springs, tol=self.tol, start=start, consume=True)
        solved = _Solved(self.n_scans, top, left, z, info)
        if scratch is None:
            self._last = solved
        return solved


@dataclass(frozen=True, slots=True)
class _Solved:
    """A solve, with margin; heights counted from the map's zero."""

    n_scans: int
    top: int
    left: int
    z: F64
    info: SolveInfo | None

    @property
    def key(self) -> tuple[int, int, int, int, int]:
        """What the heights depend on."""
        return (self.n_scans, self.top, self.left, *self.z.shape)

    def moved(self, top: int, left: int, height: int, width: int) -> F64 | None:
        """Return these heights on another window, its nearest rim beyond; None if far apart."""
        rows = np.arange(top, top + height) - self.top
        cols = np.arange(left, left + width) - self.left
        h, w = self.z.shape
        common = (
            np.count_nonzero((rows >= 0) & (rows < h)),
            np.count_nonzero((cols >= 0) & (cols < w)),
        )
        if 2 * common[0] * common[1] < height * width:
            return None
        moved: F64 = self.z[np.clip(rows, 0, h - 1)][:, np.clip(cols, 0, w - 1)]
        return np.ascontiguousarray(moved)


def _springs(
    preset: str, attach: str | None, cell: float, k_surface: float | None, ell: float | None
) -> Springs:
    if preset not in ("emap", "paper"):
        raise OptionError(f"preset must be emap or paper, got {preset!r}")
    if attach not in (None, "bilinear", "nearest"):
        raise OptionError(f"attach must be bilinear or nearest, got {attach!r}")
    is_nearest = attach == "nearest" or (attach is None and preset == "paper")
    if preset == "paper":
        return Springs(0.0, 0.1 if k_surface is None else k_surface, 1.0, is_nearest)
    kb = STIFFNESS if k_surface is None else k_surface / cell**2
    km = TENSION * kb if ell is None else kb * (cell / ell) ** 2
    return Springs(kb, km, 1.0, is_nearest)


def _check_positive(name: str, value: Any) -> None:
    if not (math.isfinite(value) and value > 0):
        raise OptionError(f"{name} must be greater than zero, got {value}")
