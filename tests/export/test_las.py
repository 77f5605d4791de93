"""Voxel centres as LAS and LAZ, read by laspy and by our own reader."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from making_exports import FULL, full_volume, quantized, toolkit_volume
from making_volumes import volume_of

import volatool as vt
from volatool.cube import Cube, Quantizer
from volatool.errors import OutputError
from volatool.kernels import quantize
from volatool.points.crs import las_wkt
from volatool.points.las_writer import LasWriter
from volatool.points.reader import open_points


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_laspy_reads_the_centres_and_what_the_metadata_says(tmp_path, suffix):
    volume = full_volume()
    done = vt.export_volume(volume, tmp_path / f"t.{suffix}")
    assert done.warnings == ()
    las = laspy.read(done.paths[0])
    assert (str(las.header.version), las.header.point_format.id) == ("1.4", 7)
    assert las.header.are_points_compressed == (suffix == "laz")
    assert np.allclose(las.xyz, volume.centers(), rtol=1e-15, atol=volume.cell() / 1e5)
    assert np.allclose(las.header.mins, las.xyz.min(axis=0), atol=1e-9)
    assert np.allclose(las.header.maxs, las.xyz.max(axis=0), atol=1e-9)
    assert las.header.number_of_points_by_return.tolist() == [len(volume)] + [0] * 14
    for name, ours in (("intensity", "intensity"), ("classification", "class"), ("red", "red")):
        assert np.array_equal(np.asarray(las[name]), np.rint(volume.channel(ours)))
    n_returns = np.clip(np.rint(volume.channel("returns")), 1, 15)
    assert np.array_equal(np.asarray(las.number_of_returns), n_returns)
    assert np.all(np.asarray(las.return_number) == 1)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_the_voxels_and_the_crs_come_back(tmp_path, suffix):
    """By our reader and the exact quantizer, with heights in another unit than x and y."""
    volume = full_volume(depth=4, n=3000)
    (path,) = vt.export_volume(volume, tmp_path / f"t.{suffix}").paths
    with open_points(path) as source:
        crs = source.crs
        (chunk,) = source.chunks(())
        assert not source.header.warnings
    for field in ("horizontal", "vertical", "unit_xy", "unit_z", "metres_per_unit_z"):
        assert getattr(crs, field) == getattr(volume.crs, field)
    quantizer = Quantizer(volume.cube, chunk.scale, chunk.offset, volume.depth, crs.z_ratio)
    assert np.array_equal(quantizer.keys(chunk.x, chunk.y, chunk.z), volume.keys())


def test_voxels_of_the_deepest_level_and_of_odd_cubes_come_back(tmp_path):
    """Corners without a short decimal form; the naive quantizer is exact."""
    rng = np.random.default_rng(1)
    for side in (1e-3, 1 / 3, 1000 / 7):
        cube = Cube((523456.123456, 5398000.7, -12.000001), side)
        voxels = {tuple(map(int, row)) for row in rng.integers(0, 4**7, (50, 3))}
        voxels |= {(0, 0, 0), (4**7 - 1,) * 3}
        volume = volume_of(voxels, 7, cube=cube, metadata=False, info=FULL)
        (path,) = vt.export_volume(volume, tmp_path / "t.laz", overwrite=True).paths
        las = laspy.read(path)
        assert las.header.point_format.id == 6
        if side > 0.01:  # else float64 coordinates of this size can't tell the cells
            assert np.array_equal(quantized(las.xyz, volume), volume.voxels())
        with open_points(path) as source:
            (chunk,) = source.chunks(())
        assert np.array_equal(chunk.x, 2 * volume.voxels()[:, 0] + 1)


def test_a_file_of_the_original_toolkit_has_its_points_where_it_rounded_to(tmp_path):
    volume = toolkit_volume()
    done = vt.export_volume(volume, tmp_path / "t.laz")
    assert [one.code for one in done.warnings] == ["W_CHANNELS"]
    las = laspy.read(done.paths[0])
    assert np.allclose(las.xyz, volume.centers(), rtol=1e-15, atol=1e-9)
    assert las.header.parse_crs().to_epsg() == 28992


def test_the_same_volume_is_the_same_bytes(tmp_path):
    paths = [vt.export_volume(full_volume(), tmp_path / f"{k}.laz").paths[0] for k in range(2)]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_one_place_and_no_crs(tmp_path):
    info = FULL.__class__()
    volume = volume_of([(0, 0, 0)], 2, cube=Cube((1.5, 2.5, 3.5), 0.0), metadata=False, info=info)
    done = vt.export_volume(volume, tmp_path / "t.las")
    assert [one.code for one in done.warnings] == ["W_NO_CRS"]
    las = laspy.read(done.paths[0])
    assert las.xyz.tolist() == [[1.5, 2.5, 3.5]]
    assert las.header.parse_crs() is None
    assert np.all(np.asarray(las.header.scales) > 0)


def test_pieces_do_not_change_the_file(tmp_path, monkeypatch):
    volume = full_volume(depth=4, n=3000)
    whole = vt.export_volume(volume, tmp_path / "a.laz").paths[0].read_bytes()
    monkeypatch.setattr("volatool.export.cells.cell_chunks.__defaults__", (64,))
    assert vt.export_volume(volume, tmp_path / "b.laz").paths[0].read_bytes() == whole


def test_what_does_not_fit_is_refused(tmp_path):
    with (tmp_path / "t.las").open("wb") as out:
        writer = LasWriter(out, (1, 1, 1), (0, 0, 0), has_colours=False, is_compressed=False)
        with pytest.raises(OutputError, match="32 bits"):
            writer.write(np.array([[2**31, 0, 0]]))
        with pytest.raises(OutputError, match="too long"):
            LasWriter(
                out, (1, 1, 1), (0, 0, 0), has_colours=False, is_compressed=False, wkt="x" * 70000
            )


def test_wkt_is_the_old_one_unless_it_would_lose_something():
    from dataclasses import replace

    from volatool.points.crs import crs_from_user

    assert las_wkt(crs_from_user("EPSG:2994+6360")).startswith("COMPD_CS[")
    assert las_wkt(crs_from_user("EPSG:28992")).startswith("PROJCS[")
    assert las_wkt(replace(FULL.crs, wkt2=None, horizontal=None)) is None
    assert las_wkt(replace(FULL.crs, wkt2=None, horizontal="EPSG:1")) is None
    assert las_wkt(replace(FULL.crs, wkt2="nonsense")) is None
    three = crs_from_user("EPSG:4979")  # WKT 1 has no ellipsoidal heights of its own
    again = crs_from_user(las_wkt(three))
    assert (again.vertical, again.is_geographic) == (three.vertical, True)


def test_cell_keys_agree_with_the_naive_quantizer():
    """The helper that other round trips use is itself checked against the kernel's keys."""
    volume = full_volume()
    cells = quantized(volume.centers(), volume)
    assert np.array_equal(quantize.cell_keys(cells.astype(np.int32)), volume.keys())
