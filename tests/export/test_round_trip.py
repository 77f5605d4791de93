"""Real tiles: what is exported says the same voxels as the volume, in feet and in metres."""

from __future__ import annotations

import numpy as np
import pytest

import volatool as vt
from volatool.cube import Quantizer
from volatool.points.reader import open_points

pytestmark = pytest.mark.shared

TILES = ["tiles/4_6_crop.las", "golden/inputs/lidR-Megaplot.laz"]


@pytest.fixture(scope="module", params=TILES)
def volume(request, shared, tmp_path_factory):
    """Volume of a real tile, five levels."""
    folder = tmp_path_factory.mktemp("tile")
    report = vt.convert(shared / request.param, folder, dem=False, dense="never", depth=5)
    return vt.open(next(path for path in report.paths if path.name.endswith(".vol.gz")))


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_points(volume, tmp_path, suffix):
    (path,) = vt.export_volume(volume, tmp_path / f"t.{suffix}").paths
    keys = []
    with open_points(path) as source:
        assert source.crs.horizontal == volume.crs.horizontal
        assert source.crs.vertical == volume.crs.vertical
        for chunk in source.chunks(()):
            quantizer = Quantizer(
                volume.cube, chunk.scale, chunk.offset, volume.depth, source.crs.z_ratio
            )
            keys.append(quantizer.keys(chunk.x, chunk.y, chunk.z))
    assert np.array_equal(np.concatenate(keys), volume.keys())


@pytest.mark.parametrize("suffix", ["xyz", "csv"])
def test_text(volume, tmp_path, suffix):
    (path,) = vt.export_volume(volume, tmp_path / f"t.{suffix}").paths
    is_csv = suffix == "csv"
    xyz = np.loadtxt(
        path, delimiter="," if is_csv else " ", skiprows=int(is_csv), usecols=(0, 1, 2)
    )
    assert np.array_equal(volume.cell_indices(xyz), volume.voxels())


def test_arrays(volume, tmp_path):
    (path,) = vt.export_volume(volume, tmp_path / "t.npy", sparse=True).paths
    assert np.array_equal(np.load(path), volume.voxels())
    arrays = np.load(vt.export_volume(volume, tmp_path / "t.npz").paths[0])
    assert np.array_equal(arrays["coords"], volume.voxels())
    assert np.array_equal(arrays["metadata"], volume.metadata())
    window = np.load(vt.export_volume(volume, tmp_path / "d.npy", level=3).paths[0])
    assert np.array_equal(np.argwhere(window), np.unique(volume.voxels(3), axis=0))
