"""Maps for map_server, read by a reader that was written from map_server's rules alone."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from making_exports import FEET, FULL
from making_volumes import random_volume, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.dem.grid import Grid
from volatool.errors import CRSError, InputError, OptionError, OutputExistsError, ResourceError
from volatool.export.nav2 import Columns, occupancy, resampled
from volatool.model import CrsInfo
from volatool.points.crs import crs_from_user
from volatool.vola.info import VolumeInfo

METRES = crs_from_user("EPSG:25832+7837")
CUBE = Cube((500000.0, 5000000.0, 100.0), 16.0)
FREE, OCCUPIED, UNKNOWN = 0, 100, -1


def load(yaml_path):
    """
    Read a map as map_server does.

    The picture's first row is the top; a pixel is ``p = (255 - v) / 255`` occupied (negate 0);
    trinary: above occupied_thresh 100, below free_thresh 0, else -1. Row 0 of the grid that is
    returned is the lowest y, at the origin.
    """
    fields = {}
    for line in yaml_path.read_text().splitlines():
        if not line.startswith("#"):
            key, value = line.split(": ", 1)
            fields[key] = json.loads(value) if value[0] in '["' else value
    assert set(fields) == {
        "image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh",
    }  # fmt: skip
    assert (fields["mode"], fields["negate"]) == ("trinary", "0")
    data = (yaml_path.parent / fields["image"]).read_bytes()
    head = re.match(rb"P5\s+(\d+)\s+(\d+)\s+255\s", data)
    width, height = int(head[1]), int(head[2])
    pixels = np.frombuffer(data[head.end() :], np.uint8).reshape(height, width)
    p = (255 - pixels.astype(float)) / 255
    grid = np.full(pixels.shape, UNKNOWN)
    grid[p > float(fields["occupied_thresh"])] = OCCUPIED
    grid[p < float(fields["free_thresh"])] = FREE
    return grid[::-1], float(fields["resolution"]), fields["origin"]


def scene(cube=CUBE, crs=METRES):
    """
    Return 16 x 16 columns of 1 m: ground at layer 2, and things on it.

    A wall (5, y < 8), a roof without walls 8 m above (10 to 12, 10 to 12) and no ground there,
    nothing at all at (2, 2) and from y = 14 on.
    """
    voxels = {(x, y, 2) for x in range(16) for y in range(14)} - {(2, 2, 2)}
    voxels |= {(5, y, z) for y in range(8) for z in (3, 4)}
    roof = {(x, y) for x in range(10, 13) for y in range(10, 13)}
    voxels -= {(x, y, 2) for x, y in roof}
    voxels |= {(x, y, 10) for x, y in roof}
    voxels |= {(15, 15, 12)}  # so that the map has all columns
    info = VolumeInfo(crs=crs)
    return volume_of(voxels, 2, cube=cube, metadata=False, info=info)


def expected():
    grid = np.full((16, 16), UNKNOWN)  # [y, x]
    grid[:14] = FREE
    grid[2, 2] = UNKNOWN
    grid[:8, 5] = OCCUPIED
    grid[10:13, 10:13] = UNKNOWN
    return grid


def flat(path, z, cube=CUBE, crs="EPSG:25832", cell=4.0):
    """Write a level elevation model over a cube."""
    x, y, _ = cube.origin
    size = int(cube.side / cell)
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="float32", nodata=-9999,
        crs=crs, transform=rasterio.Affine(cell, 0, x, 0, -cell, y + cube.side),
    ) as file:  # fmt: skip
        file.write(np.full((size, size), z, "float32"), 1)
    return str(path)


BAND = ("0.5m", "3m")


@pytest.mark.parametrize("is_given", [True, False])
def test_map_server_sees_the_scene(tmp_path, is_given):
    """With an elevation model, and with the ground that the voxels tell."""
    ground = flat(tmp_path / "dem.tif", 102.5) if is_given else None
    done = vt.export_volume(
        scene(), tmp_path / "map.yaml", "nav2", ground=ground, above=BAND, near=0
    )
    assert [path.name for path in done.paths] == ["map.yaml", "map.pgm"]
    assert [one.code for one in done.warnings] == ["W_VOXEL_SIZE"]
    grid, resolution, origin = load(done.paths[0])
    assert np.array_equal(grid, expected())
    assert (resolution, origin) == (1.0, [500000.0, 5000000.0, 0.0])


def test_the_heights_are_above_the_ground(tmp_path):
    """The roof is 8 m above it: in the band it is an obstacle, below the band it is nothing."""
    ground = flat(tmp_path / "dem.tif", 102.5)
    limits = {(7.9, 8.1): OCCUPIED, (8, 8): OCCUPIED, (1, 7.9): UNKNOWN, (8.1, 9): FREE}
    for (low, high), state in limits.items():
        above = (low, high)
        done = vt.export_volume(
            scene(), tmp_path / "m.yaml", ground=ground, above=above, near=0, overwrite=True
        )
        grid, *_ = load(done.paths[0])
        assert (grid[10:13, 10:13] == state).all(), (low, high)


def test_empty_columns_near_the_ground_are_free_unless_an_obstacle_is_as_near(tmp_path):
    ground = flat(tmp_path / "dem.tif", 102.5)
    volume = scene()
    voxels = {tuple(map(int, row)) for row in volume.voxels()}
    voxels -= {(5, 4, 2), (5, 4, 3), (5, 4, 4)}  # a gap in the wall
    volume = volume_of(voxels, 2, cube=CUBE, metadata=False, info=volume.info)
    near = "1m"
    done = vt.export_volume(volume, tmp_path / "m.yaml", ground=ground, above=BAND, near=near)
    grid, *_ = load(done.paths[0])
    wanted = expected()
    wanted[4, 5] = UNKNOWN  # the gap
    wanted[2, 2] = FREE
    wanted[14] = FREE  # one metre beyond the ground seen
    assert np.array_equal(grid, wanted)


def test_feet_become_metres_and_local_counts_from_the_cube(tmp_path):
    """Feet across, survey feet up; the map's corner is not the cube's."""
    cube = Cube((2000000.0, 300000.0, 400.0), 16.0)
    volume = scene(cube, FEET)
    voxels = {tuple(map(int, row)) for row in volume.voxels() if row[0] >= 3}
    volume = volume_of(voxels, 2, cube=cube, metadata=False, info=volume.info)
    ground = flat(tmp_path / "dem.tif", 402.5 / float(FEET.z_ratio), cube, "EPSG:2994")
    above = ("0.5ft", "3ft")
    for local, corner in ((None, (2000003.0, 300000.0)), (True, (3.0, 0.0))):
        done = vt.export_volume(
            volume, tmp_path / "m.yaml", ground=ground, above=above, near=0, local=local,
            overwrite=True,
        )  # fmt: skip
        grid, resolution, origin = load(done.paths[0])
        assert resolution == pytest.approx(0.3048, abs=1e-12)
        assert origin == pytest.approx([*(0.3048 * value for value in corner), 0.0], abs=1e-6)
        assert np.array_equal(grid, expected()[:, 3:])
        comment = done.paths[0].read_text().splitlines()[0]
        assert comment.startswith("# map frame:")
        assert "EPSG:2994" in comment
        assert ("[609600.0, 91440.0]" in comment) == bool(local)


@pytest.mark.parametrize("side", [32.0, 10.0])
def test_a_slope_is_no_obstacle(tmp_path, side):
    """30 % up: the ground of the voxels themselves follows it, on larger cells of fine voxels."""
    voxels = [(x, y, 5 + int(0.3 * x)) for x in range(64) for y in range(64)]
    voxels += [(30, 30, 5 + 9 + k) for k in (1, 2)]
    cube = Cube((500000.0, 5000000.0, 100.0), side)
    volume = volume_of(voxels, 3, cube=cube, metadata=False, info=VolumeInfo(crs=METRES))
    grid, *_ = load(vt.export_volume(volume, tmp_path / "m.yaml", above=("0.1m", "2m")).paths[0])
    assert np.argwhere(grid == OCCUPIED).tolist() == [[30, 30]]
    assert (grid == UNKNOWN).sum() == 0


def test_ground_in_two_layers_of_voxels_is_no_obstacle(tmp_path):
    """Level ground at the border of two layers: every tenth column has a voxel above its own."""
    rng = np.random.default_rng(4)
    voxels = {(x, y, 5) for x in range(64) for y in range(64)}
    voxels |= {(int(x), int(y), 6) for x, y in rng.integers(0, 64, (400, 2))}
    voxels |= {(20, 30, 7)}
    info = VolumeInfo(crs=METRES)
    volume = volume_of(voxels, 3, cube=CUBE, metadata=False, info=info)
    grid, *_ = load(vt.export_volume(volume, tmp_path / "m.yaml").paths[0])
    assert np.argwhere(grid == OCCUPIED).tolist() == [[30, 20]]


def test_warnings_tell_an_unknown_unit_and_a_map_full_of_holes(tmp_path):
    rng = np.random.default_rng(3)
    voxels = {(int(x), int(y), 1) for x, y in rng.integers(0, 64, (300, 2))}
    volume = volume_of(voxels, 3, cube=CUBE, metadata=False, info=VolumeInfo())
    done = vt.export_volume(volume, tmp_path / "m.yaml", near=0)
    codes = [one.code for one in done.warnings]
    assert codes == ["W_NO_CRS", "W_VOXEL_SIZE", "W_UNKNOWN"]
    grid, *_ = load(done.paths[0])
    assert done.warnings[2].count == (grid == UNKNOWN).sum() > grid.size / 2


def test_what_makes_no_map_is_refused(tmp_path, monkeypatch):
    degrees = replace(scene().info, crs=CrsInfo(is_geographic=True, horizontal="EPSG:4326"))
    with pytest.raises(CRSError, match="degrees") as caught:
        vt.export_volume(random_volume(info=degrees), tmp_path / "m.yaml")
    assert caught.value.code == "E_GEOGRAPHIC"
    other = flat(tmp_path / "dem.tif", 102.5, crs="EPSG:28992")
    with pytest.raises(CRSError, match=r"--ground .*dem\.tif: is in Amersfoort"):
        vt.export_volume(scene(), tmp_path / "m.yaml", ground=other)
    low = ("0.1m", "0.5m")
    with pytest.raises(InputError, match="voxels of 1 m can't tell"):
        vt.export_volume(scene(), tmp_path / "m.yaml", above=low)
    point = volume_of([(0, 0, 0)], 1, cube=Cube((0.0, 0.0, 0.0), 0.0), info=FULL)
    with pytest.raises(OptionError, match=r"--cube LENGTH") as caught:
        vt.export_volume(point, tmp_path / "m.yaml")
    assert caught.value.code == "E_CUBE"
    with pytest.raises(OptionError, match=r"m\.pgm: is the picture's name; .*, m\.yaml"):
        vt.export_volume(scene(), tmp_path / "m.pgm", "nav2")
    monkeypatch.setattr("volatool.export.nav2.MAX_CELLS", 255)
    with pytest.raises(ResourceError, match="16 x 16 cells"):
        vt.export_volume(scene(), tmp_path / "m.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["dem.tif"]


def test_a_picture_that_exists_is_refused_before_the_ground_is_looked_for(tmp_path):
    (tmp_path / "m.pgm").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"m\.pgm: exists"):
        vt.export_volume(scene(), tmp_path / "m.yaml", ground="nowhere.tif")
    vt.export_volume(scene(), tmp_path / "m.yaml", above=BAND, overwrite=True)
    assert (tmp_path / "m.pgm").read_bytes().startswith(b"P5")


@pytest.mark.parametrize("near", [0.5, 1.0, 2**0.5, 2.0, 5**0.5, 3.5])
def test_free_columns_are_those_of_plain_distances(near):
    """Of each empty column to all others, at the limit and at ties; whatever the cell."""
    rng = np.random.default_rng(3)
    voxels = {(int(x), int(y), int(z)) for x, y, z in rng.integers(0, (16, 16, 2), (40, 3))}
    cell = 0.3
    volume = volume_of(voxels, 2, cube=Cube((5.0, 7.0, 0.0), 16 * cell), metadata=False)
    columns = Columns.of(volume)
    ground = np.full((columns.grid.height, columns.grid.width), 0.5 * cell)
    image = occupancy(volume, columns, ground, 0.9 * cell, 9.0, near * cell)
    plain = occupancy(volume, columns, ground, 0.9 * cell, 9.0)
    for place in np.argwhere(plain == 205):
        away = {
            state: np.sqrt(((np.argwhere(plain == state) - place) ** 2).sum(axis=1)).min()
            for state in (0, 254)
        }
        is_free = away[254] <= near + 1e-9 and away[254] < away[0]
        assert image[tuple(place)] == (254 if is_free else 205)
    assert (image[plain != 205] == plain[plain != 205]).all()


def test_a_raster_between_its_centres_and_beyond():
    """Bilinear on a plane is the plane; NaN spreads to the cells that weigh it."""
    source = Grid(10.0, 50.0, 2.0, 6, 5)
    x = source.left + (np.arange(6) + 0.5) * 2
    y = source.top - (np.arange(5) + 0.5) * 2
    plane = 3 * x[None, :] - y[:, None] / 2
    grid = Grid(11.25, 48.5, 0.5, 17, 13)
    found = resampled(plane, source, grid)
    at_x = grid.left + (np.arange(17) + 0.5) * 0.5
    at_y = grid.top - (np.arange(13) + 0.5) * 0.5
    assert np.allclose(found, 3 * at_x[None, :] - at_y[:, None] / 2)
    assert np.array_equal(resampled(plane, source, source), plane)
    holed = plane.copy()
    holed[2, 3] = np.nan
    assert np.isnan(resampled(holed, source, source)).sum() == 1
    off = resampled(plane, source, source.padded(1))
    assert np.isnan(off).sum() == off.size - plane.size
