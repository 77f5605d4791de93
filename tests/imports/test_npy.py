"""NumPy arrays and KITTI scans."""

from __future__ import annotations

import numpy as np
import pytest
from making_imports import opened, points_of

import volatool as vt
from volatool.errors import FormatError, TruncatedError
from volatool.imports.npy import mapped_array

RNG = np.random.default_rng(5)
XYZ = np.round(RNG.uniform(-50, 50, (50, 3)), 2)


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int16])
@pytest.mark.parametrize("order", ["C", "F"])
def test_rows_are_points(tmp_path, dtype, order):
    array = np.asarray(XYZ.astype(dtype), order=order)
    np.save(tmp_path / "a.npy", array)
    xyz, _ = points_of(tmp_path / "a.npy", 7)
    assert np.abs(xyz - array).max() < 1e-5
    if dtype != np.float32:
        assert np.array_equal(xyz, array)


def test_more_columns_are_attributes(tmp_path):
    array = np.column_stack([XYZ, np.arange(50) * 10, np.full((50, 3), 9)])
    np.save(tmp_path / "a.npy", array)
    _, attributes = points_of(tmp_path / "a.npy")
    assert attributes["intensity"].tolist() == list(range(0, 500, 10))
    assert set(attributes["blue"]) == {9}
    _, attributes = points_of(tmp_path / "a.npy", columns="x,y,z,-,class")
    assert set(attributes) == {"classification"}


def test_records_are_told_by_their_fields(tmp_path):
    records = np.zeros(50, [("t", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("i", "u2")])
    records["x"], records["y"], records["z"] = XYZ.T
    records["i"] = np.arange(50)
    np.save(tmp_path / "a.npy", records)
    xyz, attributes = points_of(tmp_path / "a.npy", 20)
    assert np.array_equal(xyz, XYZ)
    assert attributes["intensity"].tolist() == list(range(50))


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_a_3d_array_is_a_grid_of_cells(tmp_path, dtype):
    """Not 0 and not NaN is occupied; its cube has the fewest levels that hold it."""
    grid = np.zeros((5, 16, 3), dtype)
    cells = [(0, 0, 0), (4, 15, 2), (3, 7, 1)]
    for cell in cells:
        grid[cell] = 1
    if dtype == np.float32:
        grid[1, 1, 1] = np.nan
    np.save(tmp_path / "a.npy", grid)
    source = opened(tmp_path / "a.npy")
    cube, depth = source.own_grid
    assert (cube.origin, cube.side, depth) == ((0.0, 0.0, 0.0), 16.0, 2)
    xyz, _ = points_of(tmp_path / "a.npy", 2)
    assert sorted(map(tuple, (xyz - 0.5).tolist())) == sorted(cells)
    assert opened(tmp_path / "a.npy", cube="32").own_grid is None


def test_missing_points_are_left_out(tmp_path):
    array = XYZ.copy()
    array[[1, 2]] = np.nan
    np.save(tmp_path / "a.npy", array)
    source = opened(tmp_path / "a.npy")
    assert source.n_points == 48


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 2)), "neither rows of x, y, z nor a 3-D grid"),
        (np.zeros(4), "neither rows"),
        (np.zeros((4, 3), complex), "neither rows"),
        (np.zeros(4, [("a", "f8"), ("b", "f8"), ("c", "f8")]), "no column is called x"),
        (np.zeros((2, 2, 2, 2)), "neither rows"),
    ],
)
def test_other_arrays_are_refused(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(FormatError, match=message) as caught:
        opened(tmp_path / "a.npy")
    assert caught.value.code == "E_NOT_IMPORT"


def test_damaged_and_crafted_files_are_refused(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, XYZ)
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    with pytest.raises(TruncatedError, match="goes on to"):
        opened(path)
    path.write_bytes(data[:40])
    with pytest.raises(TruncatedError, match="inside the header"):
        opened(path)
    path.write_bytes(data.replace(b"(50, 3)", b"(99999999999999, 3)".ljust(7))[: len(data)])
    with pytest.raises(FormatError):
        opened(path)
    path.write_bytes(b"nothing of NumPy")
    with pytest.raises(FormatError, match="is no NumPy array"):
        opened(path)
    np.save(path, np.array([{}, []], object), allow_pickle=True)
    with pytest.raises(FormatError, match="Python objects"):
        opened(path)


def test_arrays_are_mapped_not_read(tmp_path):
    np.save(tmp_path / "a.npy", XYZ)
    assert isinstance(mapped_array(tmp_path / "a.npy"), np.memmap)


def test_a_kitti_scan_has_reflectances(tmp_path):
    records = np.column_stack([XYZ, np.linspace(0, 0.99, 50)]).astype(np.float32)
    (tmp_path / "a.bin").write_bytes(records.tobytes())
    xyz, attributes = points_of(tmp_path / "a.bin", 9)
    assert np.abs(xyz - XYZ).max() < 1e-5
    assert (
        attributes["intensity"].tolist()
        == np.floor(records[:, 3].astype(np.float64) * 65535 + 0.5).tolist()
    )
    (tmp_path / "a.bin").write_bytes(records.tobytes()[:-3])
    with pytest.raises(TruncatedError, match="the file ends inside point 49"):
        opened(tmp_path / "a.bin")
    (tmp_path / "b.dat").write_bytes(records.tobytes())
    assert opened(tmp_path / "b.dat", from_format="kitti").n_points == 50
    with pytest.raises(FormatError, match=r"no importer takes \.dat"):
        opened(tmp_path / "b.dat")


def test_a_volume_of_points_in_one_place_comes_back_from_npz(tmp_path):
    """Its cube has no extent; `npz` is said to lose nothing."""
    (tmp_path / "a.xyz").write_text("1 2 3\n" * 4)
    report = vt.import_points(tmp_path / "a.xyz", depth=3, dense="never")
    volume = vt.open(report.paths[0])
    (path,) = vt.export_volume(volume, tmp_path / "b.npz").paths
    back = vt.open(vt.import_points(path, dense="never").paths[0])
    assert (volume.cube.side, back.cube, back.depth) == (0, volume.cube, 3)
    assert np.array_equal(back.voxels(), volume.voxels())
