"""How loops walk down a grid: whole or in bands, a thread each; in strips while it is in files."""

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
        Bands of rows at a time. Never changes the result.
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
        self.at_once(
            lambda *band: self.in_order(function, height, width, *arrays, band=band),
            self.bands(height, width),
        )

    def in_order(
        self,
        function: Callable[[int, int], object],
        height: int,
        width: int,
        *arrays: NDArray[Any] | None,
        band: tuple[int, int] | None = None,
    ) -> None:
        """
        Call a function as `each` does, for rows that need those above to be done.

        Arrays of coarser grids, with fewer rows, leave RAM at the same pace. With a band only for
        the rows of that.
        """
        first, last = band or (0, height)
        if not self.scratch.has_files:
            function(first, last)
            return
        for start, stop in strips(last - first, width):
            function(first + start, first + stop)
            for array in arrays:
                if array is not None:
                    ends = (len(array) * (first + row) // height for row in (start, stop))
                    self.scratch.relax(array, *ends)

    def at_once(self, function: Callable[[int, int], object], bands: list[tuple[int, int]]) -> None:
        """Call a function for all bands, each in a thread."""
        if len(bands) == 1:
            function(*bands[0])
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, "emap")
        list(self._pool.map(lambda band: function(*band), bands))

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
