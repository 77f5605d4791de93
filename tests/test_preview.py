"""The preview picture: what must be seen on it, and that odd tiles don't break it."""

from __future__ import annotations

import io
import time
from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image

from volatool.cube import Cube
from volatool.model import CrsInfo
from volatool.pictures import marks
from volatool.pictures.relief import _blocks, _light
from volatool.preview import render
from volatool.vola.volume import Volume, VolumeInfo


@dataclass(frozen=True)
class FakeGrid:
    cell: float


@dataclass(frozen=True)
class FakeDem:
    z: np.ndarray
    flag: np.ndarray
    grid: FakeGrid = FakeGrid(1.0)
    surface: str = "dtm"


def volume_of(cells: np.ndarray, depth: int, rgb: np.ndarray | None = None) -> Volume:
    """A volume with these cells; the colour of a block is that of its first cell."""
    keys = np.zeros(len(cells), np.uint64)
    x, y, z = np.asarray(cells, np.uint64).reshape(-1, 3).T
    for level in range(depth):
        shift = np.uint64(2 * (depth - 1 - level))
        local = ((x >> shift) & 3) + 4 * ((y >> shift) & 3) + 16 * ((z >> shift) & 3)
        keys = (keys << np.uint64(6)) | local
    keys, first = np.unique(keys, return_index=True)
    levels, metadata = [], []
    for level in range(1, depth + 1):
        prefix, start = np.unique(keys >> np.uint64(6 * (depth - level)), return_index=True)
        block, at = np.unique(prefix >> np.uint64(6), return_index=True)
        bits = np.uint64(1) << (prefix & np.uint64(63))
        levels.append(np.add.reduceat(bits, at) if len(at) else np.zeros(1, np.uint64))
        words = np.full(max(len(block), 1), 1 << 56, np.uint64)
        if rgb is not None:
            for band in range(3):
                words |= rgb[first[start[at]], band].astype(np.uint64) << np.uint64(8 * band)
        metadata.append(words)
    channels = [{"byte": b, "name": n} for b, n in enumerate(("red", "green", "blue"))]
    info = VolumeInfo(
        crs=CrsInfo(unit_xy="metre", unit_z="metre", horizontal="EPSG:25832"),
        channels=() if rgb is None else tuple(channels),
        source_name="made up.laz",
    )
    cube = Cube((0.0, 0.0, 0.0), float(4**depth))
    return Volume(tuple(levels), None if rgb is None else tuple(metadata), cube, info)


def hill(depth: int = 4) -> np.ndarray:
    """Cells of a slope that rises to the north, one per column."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(4**depth), np.arange(4**depth)))
    return np.column_stack([x, y, y // 4])


def slope_dem() -> FakeDem:
    z = np.tile(np.linspace(60, 0, 120, dtype=np.float32)[:, None], (1, 150))
    flag = np.ones(z.shape, np.uint8)
    flag[40:80, 30:70] = 2
    flag[100:, 100:] = 0
    z[100:, 100:] = np.nan
    return FakeDem(z, flag)


def pixels(png: bytes) -> np.ndarray:
    image = Image.open(io.BytesIO(png))
    assert image.format == "PNG"
    return np.asarray(image.convert("RGB")).astype(int)


def test_picture_is_a_png_of_the_width_asked_for_and_always_the_same() -> None:
    """PNG, width as asked, same bytes for a second run."""
    volume, dem = volume_of(hill(), 4), slope_dem()
    first = render(dem, volume, width=900)
    assert pixels(first).shape[1] == 900
    assert render(dem, volume, width=900) == first


def test_dem_stands_left_and_voxels_right() -> None:
    """Without a DEM the voxels have the whole width; with one both halves show something."""
    volume = volume_of(hill(), 4)
    both, alone = pixels(render(slope_dem(), volume)), pixels(render(None, volume))
    middle = slice(100, both.shape[0] - 150)
    for half in (both[middle, 60:660], both[middle, 900:1500]):
        assert len(np.unique(half.reshape(-1, 3), axis=0)) > 500
    assert len(np.unique(alone[100:-150].reshape(-1, 3), axis=0)) > 500


def test_void_and_filled_cells_are_told_apart() -> None:
    """Void is the neutral grey; filled ground is paler than the same height measured."""
    dem = slope_dem()
    all_measured = FakeDem(np.nan_to_num(dem.z), np.ones(dem.z.shape, np.uint8))
    volume = volume_of(hill(3), 3)
    picture, plain = (pixels(render(d, volume, width=1200)) for d in (dem, all_measured))
    void = np.all(picture == marks.VOID, axis=2)
    assert 0.01 < void.mean() < 0.1
    assert np.all(plain == marks.VOID, axis=2).mean() < void.mean() / 20
    left = slice(30, 520)
    brighter = (picture - plain).sum(axis=2)[62:-92, left]
    assert 0.05 < (brighter[:200] > 15).mean() < 0.4


def test_voxels_take_the_colours_of_the_metadata() -> None:
    """Red points make a red picture; without colours the heights' ramp is used."""
    cells = hill(3)
    red = np.tile([[200, 20, 20]], (len(cells), 1))
    picture = pixels(render(None, volume_of(cells, 3, red), width=800))
    saturated = picture[..., 0] - picture[..., 1:].max(axis=2) > 60
    assert saturated.mean() > 0.2
    plain = pixels(render(None, volume_of(cells, 3), width=800))
    assert (plain[..., 0] - plain[..., 1:].max(axis=2) > 60).mean() < 0.02


def test_near_voxels_hide_far_ones() -> None:
    """A red wall in front of a blue one hides it, whichever comes first in the volume."""
    for front in (0, 1):
        # the slope decides from where we look: from its lower end; two equal walls stand across it
        x, y = (a.ravel() for a in np.meshgrid(np.arange(64), np.arange(64)))
        fall = (63 - y) // 8 if front else y // 8
        ground = np.column_stack([x, y, fall])
        u, h = (a.ravel() for a in np.meshgrid(np.arange(8, 56), np.arange(40)))
        red_row, blue_row = (43, 20) if front else (20, 43)
        red, blue = (np.column_stack([u, np.full_like(u, row), h]) for row in (red_row, blue_row))
        cells = np.concatenate([ground, red, blue])
        colour = np.concatenate(
            [
                np.tile(paint, (len(part), 1))
                for paint, part in zip(
                    ([90, 90, 90], [220, 30, 30], [30, 30, 220]), (ground, red, blue), strict=True
                )
            ]
        )
        picture = pixels(render(None, volume_of(cells, 3, colour), width=900))
        is_red = (picture[..., 0] - picture[..., 2] > 60).sum()
        is_blue = (picture[..., 2] - picture[..., 0] > 60).sum()
        assert is_red > 1.3 * is_blue > 0


def test_light_comes_from_the_north_west() -> None:
    """A slope that faces north-west is brighter than flat ground, one facing south-east darker."""
    ramp = np.add.outer(np.arange(30.0), np.arange(30.0)).astype(np.float32)
    flat = _light(np.zeros((30, 30), np.float32), 1.0)[15, 15]
    assert _light(ramp, 1.0)[15, 15] > flat > _light(-ramp, 1.0)[15, 15]


def test_blocks_are_means_of_the_cells_that_have_a_height() -> None:
    """Against a naive loop, with ragged edges and void cells."""
    z = np.arange(7 * 11, dtype=np.float32).reshape(7, 11)
    z[2:5, 3:9] = np.nan
    made = _blocks(z, 3)
    for row in range(3):
        for column in range(4):
            part = z[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
            part = part[np.isfinite(part)]
            expected = part.mean() if part.size else np.nan
            assert made[row, column] == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    "cells",
    [np.zeros((1, 3), int), np.array([[0, 0, 63], [5, 5, 0]]), np.tile([[3, 3, 0]], (64, 1))],
    ids=["one", "two far apart", "one many times"],
)
def test_few_voxels(cells: np.ndarray) -> None:
    """One voxel, and two, make a picture."""
    assert pixels(render(None, volume_of(cells, 3), width=500)).shape[1] == 500


@pytest.mark.parametrize("shape", [(1, 1), (1, 4000), (3000, 1), (5, 5)])
@pytest.mark.parametrize("value", [np.nan, 7.0])
def test_odd_dems(shape: tuple[int, int], value: float) -> None:
    """One cell, one row, one column, flat, and all void."""
    z = np.full(shape, value, np.float32)
    dem = FakeDem(z, np.where(np.isfinite(z), 1, 0).astype(np.uint8))
    assert pixels(render(dem, volume_of(hill(2), 2), width=600)).shape[1] == 600


def test_stray_voxels_do_not_shrink_the_rest() -> None:
    """A voxel far above is left out of the picture."""
    cells = hill(4)
    stray = np.concatenate([cells, [[10, 10, 255]]])
    cover = [
        np.ptp(np.nonzero(np.ptp(pixels(render(None, volume_of(c, 4), width=700)), axis=2) > 30)[0])
        for c in (cells, stray)
    ]
    assert cover[1] > 0.95 * cover[0]


def test_round_lengths_and_heights() -> None:
    """Scale bars have lengths of 1, 2 or 5; heights get decimals when the span is small."""
    assert [marks.round_length(v) for v in (0.7, 1, 1.9, 4.99, 5, 73)] == [0.5, 1, 1, 2, 5, 50]
    assert marks.round_length(0) == 1
    assert marks.height_text(-0.04, -0.04, 1.4) == "-0.04"
    assert marks.height_text(-0.04, -0.04, 12) == "0.0"
    assert marks.height_text(331.7, 290, 331.7) == "332"


def test_a_million_voxels_take_seconds() -> None:
    """A volume of 1.05 M voxels is drawn in bounded time (2 s when the machine is idle)."""
    volume = volume_of(hill(5), 5)
    render(None, volume_of(hill(2), 2))  # kernels compiled
    start = time.process_time()
    render(None, volume)
    assert time.process_time() - start < 10
