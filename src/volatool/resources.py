"""What the process and the machine have: resident memory, cores; and how a ceiling is kept."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from volatool.errors import ResourceError
from volatool.units import format_size

if TYPE_CHECKING:
    from volatool.scratch import Scratch

DEFAULT_MEMORY_BYTES = 1 << 30
"""Ceiling when none is given."""

RESERVE_BYTES = 40 << 20
"""Kept free below the ceiling for what no budget counts: decoder buffers, chunk temporaries."""

RASTER_BYTES = 88 << 20
"""Kept free below the ceiling for GDAL: its code, its block cache, overviews of a COG."""

MIN_BUDGET_BYTES = 12 << 20
"""Working arrays need at least this much."""


_LARGE_LIBRARY_BYTES = 8 << 20


def rss_bytes() -> int:
    """Return the resident memory of this process now, in bytes (its peak where unknown)."""
    with contextlib.suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")
    return peak_rss_bytes()


def peak_rss_bytes() -> int:
    """
    Return the largest resident memory this process has had, in bytes.

    Notes
    -----
    On Linux not ``ru_maxrss``: that counts what the process was before it became this program, so
    that a large parent shows in its children.
    """
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def n_cores() -> int:
    """Return how many cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def n_threads() -> int:
    """Return how many threads this process may start: its cores, or its share of a pool's."""
    share = os.environ.get("RAYON_NUM_THREADS", "")  # what the LAZ decoder goes by
    return min(n_cores(), int(share)) if share.isdecimal() and int(share) else n_cores()


def working_budget(ceiling_bytes: int, with_dem: bool = True) -> int:
    """
    Return how much of a memory ceiling is left for working arrays.

    Parameters
    ----------
    ceiling_bytes : int
        For the whole process.
    with_dem : bool
        An elevation model will be made.

    Raises
    ------
    ResourceError
        ``E_MEMORY``: the ceiling is too low for the process to work at all.
    """
    _load_libraries(with_dem)
    return_freed_memory()
    used = rss_bytes()
    least = used + RESERVE_BYTES // 2 + MIN_BUDGET_BYTES
    if least > ceiling_bytes:
        raise ResourceError(
            f"a ceiling of {format_size(ceiling_bytes)} can't be kept: this process needs at "
            f"least {format_size(least)}; raise --memory"
        )
    return max(MIN_BUDGET_BYTES, ceiling_bytes - used - RESERVE_BYTES)


def budget_for_rasters(scratch: Scratch, ceiling_bytes: int) -> None:
    """
    Lower a budget to what is left now, before rasters are made that stay until they are written.

    Parameters
    ----------
    scratch : Scratch
        With a budget; arrays that are in RAM already stay there.
    ceiling_bytes : int
        For the whole process.

    Notes
    -----
    Code of kernels that came in since `working_budget` is counted, freed memory is not.
    """
    if scratch.budget_bytes is None:
        return
    return_freed_memory()
    left = ceiling_bytes - (rss_bytes() - scratch.used_bytes) - RASTER_BYTES
    scratch.budget_bytes = min(scratch.budget_bytes, max(MIN_BUDGET_BYTES, left))


def _load_libraries(with_dem: bool) -> None:
    """Load what a conversion loads anyway, so that it is counted before memory is shared out."""
    import numpy as np

    from volatool.kernels import census, collect, levels, quantize, reduce, words

    del census, collect, levels, reduce, words
    if with_dem:
        from volatool.kernels import (
            binning,
            conjugate,
            contiguity,
            ground,
            multigrid,
            product,
            spring,
            surface,
            sweep,
        )

        del binning, conjugate, contiguity, ground, multigrid, product, spring, surface, sweep
    quantize.key_cells(np.zeros(1, np.uint64), 1)  # the first kernel brings in the compiler


def return_freed_memory() -> None:
    """
    Make the C library give freed memory back, now and from now on.

    glibc raises its threshold for mapped blocks as large arrays come and go and then keeps the
    freed ones; a fixed threshold keeps the resident size equal to what is in use.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        m_mmap_threshold, m_trim_threshold = -3, -1
        libc.mallopt(m_mmap_threshold, 256 << 10)
        libc.mallopt(m_trim_threshold, 1 << 20)
        libc.malloc_trim(0)


def drop_library_code() -> None:
    """
    Let the code of large libraries leave RAM until it is used again (Linux).

    Of numba's compiler some 50 MiB stay resident after the kernels are loaded and are not needed
    to run them. Only read-only executable mappings of files are touched: their pages are the
    file's, so that nothing can be lost.
    """
    madv_dontneed = 4
    with contextlib.suppress(OSError, AttributeError, ValueError):
        libc = ctypes.CDLL(None)
        libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
            fields = line.split(maxsplit=5)
            if len(fields) < 6 or fields[1] != "r-xp" or not fields[5].startswith("/"):
                continue
            start, stop = (int(end, 16) for end in fields[0].split("-"))
            if stop - start >= _LARGE_LIBRARY_BYTES:
                libc.madvise(start, stop - start, madv_dontneed)


@dataclass(frozen=True, slots=True)
class Usage:
    """
    What a run took; the ``resources`` object of the report.

    Parameters
    ----------
    seconds : float
        Wall time.
    points_per_second : float
        Points read over wall time.
    peak_rss_bytes : int
        Largest resident memory of the process.
    workers : int
        Processes that worked.
    """

    seconds: float
    points_per_second: float
    peak_rss_bytes: int
    workers: int = 1

    def to_dict(self) -> dict[str, float | int]:
        """Return the JSON object."""
        return {
            "seconds": round(self.seconds, 3),
            "points_per_second": round(self.points_per_second),
            "peak_rss_bytes": self.peak_rss_bytes,
            "workers": self.workers,
        }
