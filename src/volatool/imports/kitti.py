"""KITTI scans: records of four little-endian float32, x, y, z and a reflectance of 0 to 1.

Nothing but the suffix tells them from other binary files; the size must be whole records.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from volatool.errors import TruncatedError
from volatool.imports.model import Batch, ImportedPoints, ToolkitPoints, sliced
from volatool.imports.toolkit import words_of
from volatool.model import F64, U64
from volatool.options import ConvertOptions

RECORD_BYTES = 16


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a scan.

    Parameters
    ----------
    path : pathlib.Path
        The file; mapped, not held.
    options : ConvertOptions
        Not looked at.

    Raises
    ------
    TruncatedError
        The last record is not whole.
    """
    size = path.stat().st_size
    if size % RECORD_BYTES:
        raise TruncatedError(
            f"{size} bytes are not records of {RECORD_BYTES}: the file ends inside point "
            f"{size // RECORD_BYTES}, or is no KITTI scan"
        )
    records = np.memmap(path, "<f4", "r", shape=(size // RECORD_BYTES, 4))

    def batches(n_rows: int) -> Iterator[Batch]:
        return sliced(records[:, :3], {"intensity": records[:, 3]}, n_rows)

    def toolkit(with_metadata: bool) -> Iterator[tuple[F64, U64 | None]]:
        for batch in batches(1 << 18):
            words = None
            if with_metadata:
                # in float32, as the original: 255 times the value is cut, not rounded
                value = batch.attributes["intensity"].astype(np.float64)
                unit = np.clip((value + 0.2) / 1.2, 0.0, 1.0).astype(np.float32)
                grey = (unit * np.float32(255)).astype(np.int64)
                words = words_of(np.repeat(grey[:, None], 3, axis=1))
            yield batch.xyz, words

    return ImportedPoints(
        "kitti",
        batches,
        frozenset({"intensity"}),
        keeps_nan=True,
        toolkit=ToolkitPoints(3, toolkit),
    )
