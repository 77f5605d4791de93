"""Voxel centres as text, read by the csv module and by NumPy."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from making_exports import FULL, full_volume, quantized, toolkit_volume
from making_volumes import volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.export.text import decimals_for


def test_xyz_has_centres_and_colours(tmp_path):
    volume = full_volume()
    done = vt.export_volume(volume, tmp_path / "t.xyz")
    assert [one.code for one in done.warnings] == ["W_NO_CRS"]
    assert "EPSG:2994+EPSG:6360" in done.warnings[0].message
    table = np.loadtxt(done.paths[0])
    assert table.shape == (len(volume), 6)
    assert np.allclose(table[:, :3], volume.centers(), rtol=0, atol=volume.cell() / 1000)
    assert np.array_equal(table[:, 3] * 256, volume.channel("red"))
    assert np.array_equal(table[:, 5] * 256, volume.channel("blue"))


def test_csv_has_a_header_row_and_all_channels(tmp_path):
    volume = full_volume()
    (path,) = vt.export_volume(volume, tmp_path / "t.csv").paths
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = ["red", "green", "blue", "height", "returns", "intensity", "class"]
    assert list(rows[0]) == ["x", "y", "z", *names]
    for name in names:
        values = np.array([float(row[name]) for row in rows])
        assert np.allclose(values, volume.channel(name), rtol=1e-9)


def test_csv_without_metadata_and_with_unknown_channels(tmp_path):
    (path,) = vt.export_volume(full_volume(metadata=False), tmp_path / "a.csv").paths
    assert path.read_text().splitlines()[0] == "x,y,z"
    volume = toolkit_volume()
    (path,) = vt.export_volume(volume, tmp_path / "b.csv").paths
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert path.read_text().splitlines()[0] == "x,y,z," + ",".join(f"byte{k}" for k in range(8))
    words = volume.metadata().view(np.uint8).reshape(-1, 8)
    assert np.array_equal(table[:, 3:], words)
    assert np.array_equal(table[:, :3], volume.centers())
    done = vt.export_volume(volume, tmp_path / "b.xyz")
    assert [one.code for one in done.warnings] == ["W_NO_CRS", "W_CHANNELS"]


@pytest.mark.parametrize("side", [1e-2, 1 / 3, 10.01, 239.0625, 1e5])
def test_the_voxels_come_back_from_the_text(tmp_path, side):
    rng = np.random.default_rng(2)
    voxels = {tuple(map(int, row)) for row in rng.integers(0, 4**4, (80, 3))}
    voxels |= {(0, 0, 0), (255, 255, 255)}
    cube = Cube((523456.123456, 4850000.5, -3.25), side)
    volume = volume_of(voxels, 4, cube=cube, info=FULL)
    (path,) = vt.export_volume(volume, tmp_path / "t.xyz").paths
    xyz = np.loadtxt(path)[:, :3]
    assert np.array_equal(quantized(xyz, volume), volume.voxels())


def test_decimals_keep_a_thousandth_of_a_step():
    for step in (1e-6, 0.0003, 0.002, 0.5, 1.0, 7.7, 499.0, 1e6):
        error = 10.0 ** -decimals_for(step) / 2
        assert error <= step / 1000 * (1 + 1e-12) or decimals_for(step) == 0
    assert decimals_for(1e6) == 0
    assert decimals_for(1e-30) == 17
