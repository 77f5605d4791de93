"""NumPy arrays: dense, sparse, and the archive that loses nothing."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from making_exports import FULL, full_volume, toolkit_volume
from making_volumes import volume_of

import volatool as vt
from volatool.errors import ResourceError
from volatool.formats import sparse, trailer
from volatool.formats.header import SPARSE, Header
from volatool.model import Bounds


def test_the_dense_window_is_the_whole_cube(tmp_path):
    volume = full_volume()
    (path,) = vt.export_volume(volume, tmp_path / "t.npy").paths
    window = np.load(path)
    assert (window.shape, window.dtype) == ((64, 64, 64), np.bool_)
    assert np.argwhere(window).tolist() == sorted(volume.voxels().tolist())


def test_the_dense_window_of_a_crop_is_that_of_the_library(tmp_path):
    volume = full_volume()
    x, y, _ = volume.cube.origin
    bounds, z = Bounds(x + 1, y + 2, x + 6, y + 9.3), (402.0, 407.0)
    (path,) = vt.export_volume(volume, tmp_path / "t.npy", bounds=bounds, z=z, level=2).paths
    window = volume.window(bounds, 2, z=z)
    assert np.array_equal(np.load(path), window.to_numpy())
    assert len(window) > 0


def test_slabs_are_the_window_in_pieces(monkeypatch):
    monkeypatch.setattr("volatool.vola.window._SLAB_BYTES", 5 * 64 * 64)
    window = full_volume().window()
    slabs = list(window.slabs())
    assert [len(slab) for slab in slabs] == [5] * 12 + [4]
    assert np.array_equal(np.concatenate(slabs), window.to_numpy())


def test_coordinates_are_those_of_the_voxels(tmp_path):
    volume = full_volume()
    (path,) = vt.export_volume(volume, tmp_path / "t.npy", sparse=True).paths
    cells = np.load(path)
    assert cells.dtype == np.int32
    assert np.array_equal(cells, volume.voxels())


def test_a_large_window_is_refused_before_it_is_made(tmp_path):
    """Depth 8 would be a quarter of a petabyte."""
    volume = volume_of([(0, 0, 0), (65535, 65535, 65535)], 8, metadata=False, info=FULL)
    with pytest.raises(
        ResourceError, match=r"65536 x 65536 x 65536 .*256\.0 TiB.*--sparse"
    ) as told:
        vt.export_volume(volume, tmp_path / "t.npy")
    assert told.value.code == "E_SIZE"
    with pytest.raises(ResourceError, match="coarser level"):
        volume.window().to_numpy()
    with pytest.raises(ResourceError):
        full_volume().window().to_numpy(limit=64**3 - 1)
    with pytest.raises(ResourceError):
        vt.export_volume(full_volume(), tmp_path / "t.npy", limit=64**3 - 1)
    assert not list(tmp_path.iterdir())
    vt.export_volume(volume, tmp_path / "t.npy", sparse=True)


@pytest.mark.parametrize("make", [full_volume, toolkit_volume])
def test_a_vol_can_be_made_again_from_the_archive(tmp_path, make):
    """From the arrays and the text alone, byte for byte: nothing is lost."""
    volume = make()
    done = vt.export_volume(volume, tmp_path / "t.npz")
    assert done.warnings == ()
    arrays = np.load(done.paths[0])
    assert np.array_equal(arrays["coords"], volume.voxels())
    assert np.array_equal(arrays["metadata"], volume.metadata())
    assert np.allclose(arrays["origin"] * [1, 1, float(volume.crs.z_ratio)], volume.cube.origin)
    assert (float(arrays["cell"]), int(arrays["depth"])) == (volume.cell(), volume.depth)
    assert str(arrays["crs"]) == (volume.crs.wkt2 or "")
    text = str(arrays["trailer"])
    header = Header.of(volume, SPARSE).to_bytes()
    body = header + b"".join(
        arrays[f"{kind}_{level}"].tobytes()
        for level in range(1, volume.depth + 1)
        for kind in ("level", "metadata")
    )
    import zlib

    expected = io.BytesIO()
    sparse.write(expected, volume)
    assert body + trailer.frame(text.encode(), zlib.crc32(body)) == expected.getvalue()
    assert json.loads(text)["voxels"] == len(volume)


def test_the_archive_is_the_same_each_time_and_plain_without_metadata(tmp_path):
    volume = full_volume(metadata=False)
    paths = [vt.export_volume(volume, tmp_path / f"{k}.npz").paths[0] for k in range(2)]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert not [name for name in np.load(paths[0]).files if name.startswith("metadata")]
