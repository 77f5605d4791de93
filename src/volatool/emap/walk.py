"""How loops walk down a grid: in one call, in strips while arrays live in files, or by threads."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from numpy.typing import NDArray

from volatool.emap.system import strips
from volatool.scratch import Scratch

BAND_CELLS = 1 << 16
"""Nodes below which a thread more costs more than it does."""


class Walk:
    """
    Calls kernels for all rows of a grid.

    Parameters
    ----------
    scratch : Scratch
        Where the arrays live.
    threads : int
        Bands of rows at a time, while all arrays are in RAM. Never changes the result.
    """

    def __init__(self, scratch: Scratch, threads: int = 1) -> None:
        self.scratch = scratch
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None

    def bands(self, height: int, width: int) -> list[tuple[int, int]]:
        """
        Return (first row, last row + 1) of what each thread does.

        Examples
        --------
        >>> Walk(Scratch(), threads=2).bands(1001, 1000)
        [(0, 500), (500, 1001)]
        """
        n = 1
        if self.threads > 1 and not self.scratch.has_files:
            n = max(1, min(self.threads, height * width // BAND_CELLS, height // 2))
        edges = [height * k // n // 2 * 2 for k in range(n)] + [height]
        return list(itertools.pairwise(edges))

    def each(
        self,
        function: Callable[[int, int], object],
        height: int,
        width: int,
        *arrays: NDArray[Any] | None,
    ) -> None:
        """
        Call a function for all rows of a grid.

        Parameters
        ----------
        function : callable
            Takes first row and last row + 1; rows are independent of each other.
        height, width : int
            Of the grid.
        arrays : arrays or None
            What it uses, by rows: those in files may leave RAM behind it.
        """
        bands = self.bands(height, width)
        if len(bands) > 1:
            self.at_once(function, bands)
        else:
            self.in_order(function, height, width, *arrays)

    def in_order(
        self,
        function: Callable[[int, int], object],
        height: int,
        width: int,
        *arrays: NDArray[Any] | None,
    ) -> None:
        """
        Call a function as `each` does, for rows that need those above to be done.

        Arrays of coarser grids, with fewer rows, leave RAM at the same pace.
        """
        if not self.scratch.has_files:
            function(0, height)
            return
        for start, stop in strips(height, width):
            function(start, stop)
            for array in arrays:
                if array is not None:
                    rows = len(array)
                    self.scratch.relax(array, start * rows // height, stop * rows // height)

    def at_once(self, function: Callable[[int, int], object], bands: list[tuple[int, int]]) -> None:
        """Call a function for all bands, each in a thread."""
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, "emap")
        list(self._pool.map(lambda band: function(*band), bands))

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
