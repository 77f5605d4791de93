"""Real tiles: our files through a reader that behaves as the original's does."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import golden_cases as golden
import numpy as np
import pytest
import toolkit_reader as toolkit

from volatool.cube import Cube
from volatool.formats import dense, sparse
from volatool.formats.registry import open_volume
from volatool.model import PointChunk, as_fraction
from volatool.points.reader import open_points
from volatool.vola.builder import VolaBuilder
from volatool.vola.volume import Volume

pytestmark = pytest.mark.shared

FEET = "tiles/4_6_crop.las"
MEGAPLOT = "golden/inputs/lidR-Megaplot.laz"


def built(path: Path, depth: int) -> tuple[Volume, np.ndarray]:
    """Return the volume of a tile and its points."""
    names = ("classification", "number_of_returns", "intensity")
    with open_points(path) as source:
        ratio = source.crs.z_ratio
        chunks = list(source.chunks(names))
        box = [end(chunks, axis, ratio) for end in (lowest, highest) for axis in range(3)]
        with VolaBuilder(
            Cube.around(box),
            depth,
            channels=("height", "returns", "intensity", "class"),
            keep_depth=depth,
            z_ratio=ratio,
            crs=source.crs,
        ) as builder:
            assert sum(builder.add(chunk) for chunk in chunks) == 0
            volume = builder.build().volume(depth)
    return volume, np.concatenate([chunk.xyz() for chunk in chunks])


def lowest(chunks: list[PointChunk], axis: int, ratio: Fraction) -> Fraction:
    """Return the least coordinate of an axis, exactly."""
    return exact(chunks[0], axis, min(int(stored(chunk, axis).min()) for chunk in chunks), ratio)


def highest(chunks: list[PointChunk], axis: int, ratio: Fraction) -> Fraction:
    """Return the greatest coordinate of an axis, exactly."""
    return exact(chunks[0], axis, max(int(stored(chunk, axis).max()) for chunk in chunks), ratio)


def stored(chunk: PointChunk, axis: int) -> np.ndarray:
    return (chunk.x, chunk.y, chunk.z)[axis]


def exact(chunk: PointChunk, axis: int, value: int, ratio: Fraction) -> Fraction:
    scale, offset = as_fraction(chunk.scale[axis]), as_fraction(chunk.offset[axis])
    return (value * scale + offset) * (ratio if axis == 2 else 1)


@pytest.mark.parametrize("depth", [2, 3, 4])
@pytest.mark.parametrize("name", [FEET, MEGAPLOT])
def test_the_original_reads_our_files_right(shared: Path, name: str, depth: int) -> None:
    """All voxels, all metadata, and all points lie in the cells that it reports."""
    volume, xyz = built(shared / name, depth)
    stream = io.BytesIO()
    sparse.write(stream, volume)
    found = toolkit.read(stream.getvalue())
    corners = np.array(found.coordinates())
    assert np.array_equal(found.words, volume.metadata())
    assert np.allclose(corners, volume.cube.corners(volume.voxels(), depth), rtol=0, atol=1e-6)
    # the points against the reported cells, with an ulp of the coordinates
    cell = volume.cube.cell(depth)
    ratio = np.array([1.0, 1.0, float(volume.crs.z_ratio)])
    places = (xyz * ratio - np.asarray(volume.cube.origin)) / cell
    low = {tuple(row) for row in np.rint((corners - volume.cube.origin) / cell).astype(int)}
    for slack in (1e-6, -1e-6):
        cells = np.clip(np.floor(places + slack), 0, 4**depth - 1).astype(int)
        missing = {tuple(row) for row in cells} - low
        assert not missing or slack < 0


@pytest.mark.parametrize(
    "name",
    [FEET, MEGAPLOT, "tiles/autzen_trim.las", "tiles/laserchicken-AHN3.laz", "odd/nocrs.las"],
)
@pytest.mark.parametrize("depth", [1, 5, 8])
def test_every_point_of_a_tile_is_contained(shared: Path, name: str, depth: int) -> None:
    """Lookup by float coordinates agrees with the exact quantizer, after a trip to bytes too."""
    volume, xyz = built(shared / name, depth)
    assert volume.contains(xyz).all()
    stream = io.BytesIO()
    sparse.write(stream, volume)
    again = open_volume(stream.getvalue())
    assert again.contains(xyz).all()
    assert len(np.unique(again.find(again.cell_indices(xyz)))) == len(again)
    assert again.info.channels == volume.info.channels
    assert again.crs == volume.crs
    if depth < 4:
        dense.write(stream := io.BytesIO(), volume)
        assert np.array_equal(open_volume(stream.getvalue()).keys(), volume.keys())


@pytest.mark.parametrize("name", ["4_6_crop", "lonestar9", "megaplot"])
def test_points_lie_in_the_voxels_that_the_toolkit_gave_them(shared: Path, name: str) -> None:
    """Golden files and their inputs: ties too are decided as the toolkit did."""
    cases = {case["file"]: case for case in golden.expected(shared)["cases"]}
    for depth in (1, 3, 4):
        case = cases[f"{name}-s{depth}.vol"]
        with open_points(golden.input_path(shared, case["input"])) as source:
            xyz = np.concatenate([chunk.xyz() for chunk in source.chunks(())])
        volume = open_volume(golden.stored(shared, case))
        assert volume.contains(xyz).all()
        assert len(np.unique(volume.find(volume.cell_indices(xyz)))) == len(volume)
