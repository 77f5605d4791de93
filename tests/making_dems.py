"""Points for DEM tests: chunks from arrays and from the shared tiles."""

from __future__ import annotations

import numpy as np

from volatool.dem.gather import ROW, SurfaceGatherer, SurfacePoints
from volatool.model import PointChunk
from volatool.scratch import Scratch, Spool

DIMENSIONS = {"classification", "return_number"}


def chunk(x, y, z, start=0, scale=0.01, offset=0.0, **attributes):
    """Return a chunk of points given in units, stored at 0.01."""
    stored = [np.round((np.asarray(v, float) - offset) / scale).astype(np.int32) for v in (x, y, z)]
    given = {name: np.broadcast_to(np.uint8(v), len(stored[0])) for name, v in attributes.items()}
    return PointChunk(start, *stored, (scale,) * 3, (offset,) * 3, given)


def gather(*chunks, surface="auto", scratch=None, dimensions=DIMENSIONS):
    gatherer = SurfaceGatherer(surface, scratch or Scratch(), dimensions)
    for part in chunks:
        gatherer.add(part)
    return gatherer.result()


def ground(x, y, z, *, scale=0.01, offset=0.0, **kwargs):
    """Return surface points that are all ground."""
    return gather(chunk(x, y, z, scale=scale, offset=offset, classification=2), **kwargs)


def with_rows(points: SurfacePoints, rows) -> SurfacePoints:
    """Return the same points' metadata over other rows."""
    from dataclasses import replace

    spool = Spool(Scratch(), ROW)
    spool.append(np.ascontiguousarray(rows))
    return replace(points, spool=spool)


def from_file(path, surface="auto"):
    """Return the surface points of a LAS or LAZ file, read by laspy directly."""
    import laspy

    gatherer = SurfaceGatherer(surface, Scratch(), DIMENSIONS)
    with laspy.open(path) as file:
        scale, offset = tuple(file.header.scales.tolist()), tuple(file.header.offsets.tolist())
        start = 0
        for part in file.chunk_iterator(250_000):
            names = {name: np.array(getattr(part, name)).astype(np.uint8) for name in DIMENSIONS}
            stored = (np.ascontiguousarray(part[axis]) for axis in "XYZ")
            gatherer.add(PointChunk(start, *stored, scale, offset, names))
            start += len(part)
    return gatherer.result()


def hills(n=4000, size=60.0, seed=0):
    """Return x, y, z of random points on hills, multiples of 0.01."""
    rng = np.random.default_rng(seed)
    x, y = np.round(rng.uniform(0, size, (2, n)), 2)
    return x, y, np.round(100 + 3 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 0.03, n), 2)
