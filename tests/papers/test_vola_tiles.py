"""The tables on tiles at hand: sizes, identity, densities, summing up."""

from __future__ import annotations

import gzip
import io
from pathlib import Path

import laspy
import naive_vola
import numpy as np
import pytest
from making_tiles import hills, write_las
from making_volumes import random_volume

import volatool
from volatool.errors import CodedWarning, OptionError
from volatool.model import PointChunk
from volatool.options import ConvertOptions
from volatool.papers import vola_density
from volatool.papers.vola_tile_tables import common_choice, read_tiles, tile_tables
from volatool.papers.vola_tiles import broken_identity, read_tile, sizes, strip_occupancy

OPTIONS = ConvertOptions(resources=False)
SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dense tile, a thin one, and the dense one as LAZ and as a VOLA file."""
    folder = tmp_path_factory.mktemp("tiles")
    xyz = hills(6000, extent=1000)
    for name in ("dense.las", "dense.laz"):
        write_las(folder / name, xyz, crs="EPSG:28992", intensity=xyz[:, 2] % 900)
    write_las(folder / "thin.las", hills(90, seed=2, extent=1000), crs="EPSG:28992")
    volatool.convert(folder / "dense.laz", folder, dem=False, dense="never", resources=False)
    return folder


def test_a_tile_is_what_stats_says(folder):
    """Same depth, levels and sizes as the report that `volatool stats` prints."""
    tile = read_tile(folder / "dense.laz", OPTIONS)
    report = volatool.stats(folder / "dense.laz", resources=False)[0]
    assert tile.volume.depth == report.depth
    assert [count.blocks for count in tile.counts] == [row["blocks"] for row in report.levels]
    rows = {(row["bits_per_voxel"], row["codec"]): row for row in report.encodings[:4]}
    measured = sizes(tile.volume)
    assert measured["vola_1_bit"] == rows[1, "none"]["payload_bytes"]
    assert measured["vola_2_bit"] == rows[2, "none"]["payload_bytes"]
    assert measured["vola_2_bit"] == 2 * measured["vola_1_bit"]  # C6
    # gzip of the levels alone is less than of the file, by header and trailer
    assert 0 < rows[2, "gzip"]["file_bytes"] - measured["vola_2_bit_gzip"] < 2500


def test_gzip_sizes_are_those_of_the_bytes():
    volume = random_volume(3, 150)
    data = b"".join(
        words.tobytes() + more.tobytes()
        for words, more in zip(volume.levels, volume.metadata_levels, strict=True)
    )
    stream = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", fileobj=stream, compresslevel=6, mtime=0) as packed:
        packed.write(data)
    assert sizes(volume)["vola_2_bit_gzip"] == len(stream.getvalue())
    bare = sizes(random_volume(3, 150, metadata=False))
    assert bare["vola_2_bit"] is None
    assert bare["vola_1_bit"] == sizes(volume)["vola_1_bit"]


def test_laz_sizes(folder):
    """A LAZ input's own size; of a LAS input the size of the LAZ that would be written."""
    packed = read_tile(folder / "dense.laz", OPTIONS)
    assert (packed.laz_bytes, packed.laz_kind) == (
        (folder / "dense.laz").stat().st_size,
        "input",
    )
    plain = read_tile(folder / "dense.las", OPTIONS)
    assert plain.laz_kind == "compressed here"
    written = io.BytesIO()
    with laspy.open(folder / "dense.las") as source:
        source.read().write(written, do_compress=True)
    assert plain.laz_bytes == pytest.approx(len(written.getvalue()), rel=0.03)
    assert plain.source["las_equivalent_bytes"] == (folder / "dense.las").stat().st_size
    moved = read_tile(folder / "dense.las", ConvertOptions(resources=False, to_crs="EPSG:32631"))
    assert moved.laz_bytes == plain.laz_bytes


def test_a_vola_file_gives_the_same_tables_without_las(folder):
    tile = read_tile(folder / "dense.vol.gz", OPTIONS)
    points = read_tile(folder / "dense.laz", OPTIONS)
    assert sizes(tile.volume) == sizes(points.volume)
    assert (tile.laz_bytes, tile.density) == (None, None)
    table = tile_tables([tile])["sum"]
    assert table["sizes"]["las"] is None
    assert table["sizes"]["vola_percent_of_las"] is None
    assert table["sizes"]["volazip_percent_of_vola"] > 0


def test_all_tiles_are_measured_at_one_depth(folder):
    """As the paper has one depth a data set: a tile whose own depth is less is read again."""
    paths = [folder / "dense.las", folder / "thin.las"]
    alone = [read_tile(path, OPTIONS).volume.depth for path in paths]
    assert alone[0] != alone[1]
    tiles, _ = read_tiles(paths, OPTIONS)
    depth = common_choice(tiles)["depth"]
    assert [tile.volume.depth for tile in tiles] == [depth, depth]
    tables = tile_tables(tiles)
    whole, parts = tables["sum"], tables["tiles"]
    assert whole["points"] == sum(part["points"] for part in parts) == 6090
    for level in range(depth):
        for name in ("blocks", "voxels", "dense_bytes", "sparse_bytes"):
            assert whole["levels"][level][name] == sum(p["levels"][level][name] for p in parts)
    for name in ("las", "laz", "vola_1_bit", "vola_2_bit", "vola_2_bit_gzip"):
        assert whole["sizes"][name] == sum(part["sizes"][name] for part in parts)
    assert [part["own_depths"] for part in parts] == [[alone[0]], [alone[1]]]
    assert whole["own_depths"] == sorted(alone)
    assert whole["own_sizes"]["vola_1_bit"] == sum(p["own_sizes"]["vola_1_bit"] for p in parts)
    assert (
        parts[0]["own_sizes"]["vola_1_bit"]
        == sizes(read_tile(paths[0], OPTIONS).volume)["vola_1_bit"]
    )
    means = [part["levels"][1]["occupancy"] for part in parts]
    assert whole["definitions"][1]["tile_mean"] == pytest.approx(np.mean(means))


def test_the_identity_holds_exactly(folder):
    """C1: blocks of a level are the voxels above; so the sizes imply the occupancies themselves."""
    tiles, _ = read_tiles([folder / "dense.las", folder / "thin.las"], OPTIONS)
    table = tile_tables(tiles)["sum"]
    assert table["identity"]["holds"]
    assert table["identity"]["blocks"] == sum(len(w) for t in tiles for w in t.volume.levels)
    for row in table["definitions"]:
        if row["implied_by_sizes"] is not None:
            assert row["implied_by_sizes"] == pytest.approx(row["block_mean"], rel=1e-12)
        assert row["voxel_weighted"] >= row["block_mean"] - 1e-12


def test_a_broken_identity_is_named():
    """The check counts for itself: it does not take the volume's word."""
    volume = random_volume(3, 60)
    assert broken_identity(volume) == []
    levels = list(volume.levels)
    levels[1] = levels[1][:-1]
    object.__setattr__(volume, "levels", tuple(levels))
    assert broken_identity(volume) == [2, 3]


def test_strips_of_the_dense_order():
    """Words of 64 cells along x that are not empty, against sets."""
    volume = random_volume(3, 200)
    for level in (1, 2, 3):
        side = 4**level
        cells = volume.voxels(level).tolist()
        strips = {(x + y * side + z * side * side) // 64 for x, y, z in cells}
        assert strip_occupancy(volume, level) == (len(cells), len(strips))


def test_contiguity_beside_the_random_one(folder):
    """Pairs of the volume's own words; a surface has more than as many random cells."""
    tiles, _ = read_tiles([folder / "dense.las"], OPTIONS)
    table = tile_tables(tiles)["sum"]
    words = tiles[0].volume.levels[1].tolist()
    mean = sum(map(naive_vola.pairs, words)) / len(words)
    assert table["definitions"][1]["contiguous_percent"] == pytest.approx(100 * mean / 144)
    assert table["definitions"][1]["contiguous_over_random"] > 1


def test_tiles_without_a_point(tmp_path, folder):
    """Left out with a warning; an error if none is left."""
    write_las(tmp_path / "empty.las", np.empty((0, 3), int), crs="EPSG:28992")
    assert isinstance(read_tile(tmp_path / "empty.las", OPTIONS), CodedWarning)
    tiles, warnings = read_tiles([tmp_path / "empty.las", folder / "thin.las"], OPTIONS)
    assert [tile.path.name for tile in tiles] == ["thin.las"]
    assert next(warning.code for warning in warnings) == "W_EMPTY"
    with pytest.raises(OptionError, match="no input has a point"):
        read_tiles([tmp_path / "empty.las"], OPTIONS)


def test_a_volume_without_a_voxel(tmp_path, folder):
    """A file of one empty root block: left out, not divided by."""
    from volatool.encodings import Encoding, write_volume
    from volatool.vola.volume import Volume

    like = random_volume(2, 5)
    empty = Volume((np.zeros(1, np.uint64), np.zeros(0, np.uint64)), None, like.cube, like.info)
    with (tmp_path / "none.vol").open("wb") as stream:
        write_volume(stream, empty, Encoding("sparse", 1, "none"))
    found = read_tile(tmp_path / "none.vol", OPTIONS)
    assert isinstance(found, CodedWarning)
    assert found.code == "W_EMPTY"


def test_progress_is_of_all_tiles(folder):
    """Bytes, never backwards, to the end."""
    told = []
    paths = [folder / "thin.las", folder / "dense.las"]
    read_tiles(paths, OPTIONS, lambda done, total: told.append((done, total)))
    total = sum(path.stat().st_size for path in paths)
    assert {of for _, of in told} == {total}
    done = [value for value, _ in told]
    assert done == sorted(done)
    assert done[-1] == total


def chunk(x, y, scale=0.01):
    x, y = (np.asarray(values, np.int32) for values in (x, y))
    return PointChunk(0, x, y, np.zeros_like(x), (scale,) * 3, (0.0, 0.0, 0.0))


def test_density_counts_points_in_cells_on_multiples_of_their_edge(monkeypatch):
    """Against a dictionary, negative coordinates too, whatever the chunks."""
    rng = np.random.default_rng(1)
    x, y = rng.integers(-5000, 5000, (2, 3000))
    monkeypatch.setattr(vola_density, "_MERGE", 1000)
    gatherer = vola_density.DensityGatherer(5.0)
    for start, stop in ((0, 100), (100, 101), (101, 1700), (1700, 3000)):
        gatherer.add(chunk(x[start:stop], y[start:stop]))
    gatherer.add(chunk([], []))
    made = gatherer.result()
    assert made.cell == 5
    assert made.counts.sum() == 3000
    left, bottom = made.bounds.left, made.bounds.bottom
    assert left % 5 == bottom % 5 == 0
    expected = {}
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        place = (b // 500 - round(bottom / 5), a // 500 - round(left / 5))
        expected[place] = expected.get(place, 0) + 1
    assert {place: made.counts[place] for place in zip(*np.nonzero(made.counts), strict=True)} == (
        expected
    )
    assert made.per_area(0.5).max() == made.counts.max() / 6.25
    assert made.per_area(None).max() == made.counts.max() / 25


def test_a_map_is_made_coarser_until_it_fits():
    gatherer = vola_density.DensityGatherer(0.01)
    gatherer.add(chunk(np.arange(3000), np.zeros(3000)))
    made = gatherer.result()
    assert max(made.counts.shape) <= vola_density.MOST_CELLS
    assert made.counts.sum() == 3000
    assert made.cell == pytest.approx(0.08)


def test_a_map_of_nothing():
    assert vola_density.DensityGatherer(1.0).result() is None


def test_cells_that_are_much_too_small_become_larger(monkeypatch):
    """Whatever the header's box led to: no point is lost, memory is bounded."""
    gatherer = vola_density.DensityGatherer(1e-9)
    gatherer.add(chunk([2_000_000_000, -7], [0, 5], scale=1.0))
    assert gatherer.result().counts.sum() == 2
    monkeypatch.setattr(vola_density, "_MERGE", 500)
    gatherer = vola_density.DensityGatherer(0.25)
    for start in range(0, 4000, 400):
        gatherer.add(chunk(np.arange(start, start + 400) - 1999, np.zeros(400), scale=0.25))
        assert gatherer._held <= 500
    made = gatherer.result()
    assert made.counts.sum() == 4000
    assert made.cell > 0.25
    # cells keep to multiples of their edge, so each but the outermost holds as many points
    assert set(made.counts[0, 1:-1].tolist()) == {made.cell / 0.25}


@pytest.mark.parametrize("extent", [0.37, 1.0, 99.0, 12345.6])
def test_cells_of_a_map_are_round_and_80_to_200_a_side(extent):
    cell = vola_density.cell_for(extent)
    assert 80 <= round(extent / cell, 6) <= 200
    assert f"{cell:e}"[0] in "125"
    assert vola_density.cell_for(float("nan")) == vola_density.cell_for(-1.0) == 1.0


def test_density_in_square_metres(tmp_path):
    """A square foot is 0.0929 of a square metre."""
    write_las(tmp_path / "feet.las", hills(500, extent=1000), crs="EPSG:2994")
    tile = read_tile(tmp_path / "feet.las", OPTIONS)
    per_foot = tile.source["density"]["all_per_area_occupied"]
    assert tile.density_m2 == pytest.approx(per_foot / 0.3048**2)
    write_las(tmp_path / "units.las", hills(500, extent=1000))
    assert read_tile(tmp_path / "units.las", OPTIONS).density_m2 is None


def test_density_of_a_tile_is_all_its_points(folder):
    tile = read_tile(folder / "dense.las", OPTIONS)
    assert tile.density.counts.sum() == tile.n_points == 6000


def test_the_papers_claims_on_two_real_tiles(shared):
    """Delft: VOLA below 1 % of LAS, VOLAZip below 5 % of LAZ and about half of VOLA (section 8)."""
    paths = [shared / "tiles" / f"ahn3_cropped_{number}.laz" for number in (1, 2)]
    tiles, _ = read_tiles(paths, ConvertOptions(resources=False, crs_default="EPSG:28992"))
    table = tile_tables(tiles)["sum"]
    assert table["points"] == 640_510 + 208_432
    assert (table["depth"], table["own_depths"]) == (4, [4])
    assert table["identity"] == {"holds": True, "levels": 8, "blocks": 11_859, "broken": {}}
    found = table["sizes"]
    assert found["vola_2_bit"] == 16 * 11_859
    assert found["vola_percent_of_las"] < 1
    assert found["volazip_percent_of_laz"] < 5
    assert 40 < found["volazip_percent_of_vola"] < 60
    assert 7 < found["laz_percent_of_las"] < 25  # V20
    for row in table["definitions"]:
        assert row["contiguous_over_random"] > 1  # surfaces hang together
