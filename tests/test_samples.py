"""The sample tiles: what README says is in them, and that the generator still makes them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import laspy
import numpy as np
import pyproj
import pytest

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"
LIMIT_BYTES = 3_000_000


@pytest.fixture(scope="module")
def generator() -> Iterator[ModuleType]:
    """The generator, imported as it is run: with its own folder on the path."""
    modules = set(sys.modules)
    sys.path.insert(0, str(SAMPLES))
    try:
        yield importlib.import_module("generate")
    finally:
        sys.path.remove(str(SAMPLES))
        for name in set(sys.modules) - modules:
            if str(SAMPLES) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]


@pytest.fixture(scope="module")
def town() -> laspy.LasData:
    return laspy.read(SAMPLES / "town.laz")


@pytest.fixture(scope="module")
def forest() -> laspy.LasData:
    return laspy.read(SAMPLES / "forest.laz")


def share(mask: np.ndarray) -> float:
    return float(np.count_nonzero(mask)) / len(mask)


def test_all_samples_together_are_small() -> None:
    """All files of data_samples, code included, fit the limit of 3 MB."""
    files = [path for path in SAMPLES.iterdir() if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= LIMIT_BYTES


@pytest.mark.parametrize("kind", ["town", "forest"])
def test_generator_makes_the_file_again(kind: str, generator: ModuleType, tmp_path: Path) -> None:
    """A new run gives the same header and points (the compressed bytes are lazrs' affair)."""
    path = tmp_path / f"{kind}.laz"
    n_points = generator.generate(kind, path)
    made, kept = laspy.read(path), laspy.read(SAMPLES / f"{kind}.laz")
    assert n_points == len(kept.points) == len(made.points)
    assert made.points.array.tobytes() == kept.points.array.tobytes()
    for name in ("scales", "offsets", "mins", "maxs", "creation_date", "system_identifier"):
        assert np.all(getattr(made.header, name) == getattr(kept.header, name)), name
    records = [[vlr.record_data_bytes() for vlr in las.header.vlrs] for las in (made, kept)]
    assert records[0] == records[1]


def test_pieces_do_not_matter(generator: ModuleType) -> None:
    """The points do not depend on how many scan lines are worked out at a time."""
    scanner = importlib.import_module("scanner")
    sample = generator.SAMPLES["town"]
    flight = scanner.Flight(60, 40, 300, 180, 20, 95, 0.9, 0.9)
    scene = sample.scene(flight.width, flight.height)
    runs = [list(scanner.scan(scene, flight, lines)) for lines in (7, 10_000)]
    for name in ("u", "v", "z", "code", "time"):
        one, other = (np.concatenate([getattr(piece, name) for piece in run]) for run in runs)
        assert np.array_equal(one, other), name


@pytest.mark.parametrize(("kind", "suffix"), [("town", "laz"), ("forest", "las")])
def test_any_size(kind: str, suffix: str, generator: ModuleType, tmp_path: Path) -> None:
    """A tile has exactly the points asked for, at the sample's density."""
    path = tmp_path / f"tile.{suffix}"
    assert generator.generate(kind, path, 30_000) == 30_000
    with laspy.open(path) as reader:
        header = reader.header
    with laspy.open(SAMPLES / f"{kind}.laz") as reader:
        sample = reader.header
    area, area_of_sample = (np.prod((h.maxs - h.mins)[:2]) for h in (header, sample))
    assert header.point_count == 30_000
    density = header.point_count / area / (sample.point_count / area_of_sample)
    assert 0.7 < density < 1.4


def test_town_is_las_1_4_with_a_compound_crs(town: laspy.LasData) -> None:
    """LAS 1.4, point format 7, WKT flag set, EPSG:25832+7837."""
    assert (str(town.header.version), town.header.point_format.id) == ("1.4", 7)
    assert town.header.global_encoding.wkt
    crs = pyproj.CRS(town.header.parse_crs())
    assert [part.to_epsg() for part in crs.sub_crs_list] == [25832, 7837]


def test_town_has_what_the_readme_says(town: laspy.LasData) -> None:
    """Classes, returns, noise, flags, colours and strips are there in sensible shares."""
    code = np.asarray(town.classification)
    assert set(np.unique(code)) == {1, 2, 3, 4, 5, 6, 7, 9, 18}
    assert 10 <= np.count_nonzero(code == 7) < 100
    assert 10 <= np.count_nonzero(code == 18) < 100
    assert 0.4 < share(code == 2) < 0.6
    assert 0.1 < share(code == 6) < 0.25
    number, count = np.asarray(town.return_number), np.asarray(town.number_of_returns)
    assert np.all((number >= 1) & (number <= count))
    assert np.asarray(count[code == 5]).max() == 5
    assert share(count > 1) > 0.25
    assert 0 < share(np.asarray(town.withheld) == 1) < 0.01
    assert 0.1 < share(np.asarray(town.overlap) == 1) < 0.4
    assert set(np.unique(np.asarray(town.point_source_id))) == {101, 102, 103}
    red = np.asarray(town.red)
    assert red.max() > 255
    assert np.all(red % 256 == 0)
    intensity = np.asarray(town.intensity)
    assert 0 < intensity.min() < intensity.max() < 4096
    time = np.asarray(town.gps_time)
    assert np.all(np.diff(time) >= 0)


def test_town_heights(town: laspy.LasData) -> None:
    """Noise lies below and above all else; the cube is set by the width, not by the noise."""
    code, z = np.asarray(town.classification), np.asarray(town.z)
    kept = (code != 7) & (code != 18)
    assert z[code == 7].min() < z[kept].min()
    assert z[code == 18].max() > z[kept].max() + 50
    extent = town.header.maxs - town.header.mins
    assert extent[2] < max(extent[:2])


def test_town_roofs_are_denser_than_streets_and_the_lake_is_a_void(town: laspy.LasData) -> None:
    """Cells of 1 m: more first returns on roofs than elsewhere, hardly any on the lake."""
    first = np.asarray(town.return_number) == 1
    column = np.floor(np.asarray(town.x) - 523400).astype(int).clip(0, 239)
    row = np.floor(np.asarray(town.y) - 5398200).astype(int).clip(0, 199)
    counts = np.zeros((200, 240), int)
    np.add.at(counts, (row[first], column[first]), 1)
    roof = np.zeros((200, 240), bool)
    code = np.asarray(town.classification)
    roof[row[code == 6], column[code == 6]] = True
    assert 0.03 < share((counts == 0).ravel()) < 0.15
    lake = counts[20:50, 210:]
    assert share((lake == 0).ravel()) > 0.98
    rgb = np.column_stack([np.asarray(town[name]) // 256 for name in ("red", "green", "blue")])
    asphalt = (code == 2) & (np.ptp(rgb.astype(int), axis=1) <= 12) & (rgb.max(axis=1) < 125)
    street = np.zeros((200, 240), bool)
    street[row[asphalt], column[asphalt]] = True
    single_strip = slice(95, 110)  # rows that only one strip sees
    on_roofs = counts[single_strip][(roof & ~street)[single_strip]].mean()
    on_streets = counts[single_strip][(street & ~roof)[single_strip]].mean()
    assert on_roofs > 1.15 * on_streets


def test_forest_is_old_feet_and_unclassified(forest: laspy.LasData) -> None:
    """LAS 1.2, point format 1, GeoTIFF keys of a state plane in US survey feet, class 1 only."""
    assert (str(forest.header.version), forest.header.point_format.id) == ("1.2", 1)
    assert not any(vlr.record_id == 2112 for vlr in forest.header.vlrs)
    crs = pyproj.CRS(forest.header.parse_crs())
    assert crs.to_epsg() == 2225
    assert crs.axis_info[0].unit_name == "US survey foot"
    keys = next(vlr for vlr in forest.header.vlrs if vlr.record_id == 34735).geo_keys
    assert {key.id: key.value_offset for key in keys}[4099] == 9003
    assert np.all(np.asarray(forest.classification) == 1)
    count = np.asarray(forest.number_of_returns)
    assert 0.5 < share(count > 1) < 0.8
    assert count.max() == 5
    height = forest.header.maxs[2] - forest.header.mins[2]
    assert 300 < height < 600  # feet


def test_the_lake_is_what_the_generator_draws(generator: ModuleType, tmp_path: Path) -> None:
    """The same bytes again."""
    generator.write_lake(tmp_path / "lake.geojson")
    assert (tmp_path / "lake.geojson").read_bytes() == (SAMPLES / "town-lake.geojson").read_bytes()
