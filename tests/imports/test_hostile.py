"""Damaged files of every format: read, or refused with a coded error; never anything else."""

from __future__ import annotations

import io
import random

import numpy as np
import pytest
import rasterio
from making_imports import box_triangles, opened, pcd, ply, points_of, stl
from rasterio.transform import Affine

import volatool as vt
from volatool.errors import FormatError, ResourceError, VolatoolError
from volatool.formats.binvox import encode_binvox
from volatool.formats.octomap import encode_bt
from volatool.imports.registry import FORMATS
from volatool.naming import IMPORT_SUFFIXES

N_MUTANTS = 20
RNG = np.random.default_rng(1)
XYZ = np.round(RNG.uniform(0, 50, (30, 3)), 2)
BOX = box_triangles((0, 0, 0), (4, 2, 1))
COLOURS = {name: np.arange(30, dtype=np.uint8) for name in ("red", "green", "blue")}
GRID = np.argwhere(RNG.random((16, 16, 16)) < 0.02)


def saved(save, *arrays, **named):
    stream = io.BytesIO()
    save(stream, *arrays, **named)
    return stream.getvalue()


SEEDS = {
    "a.xyz": "".join(f"{x} {y} {z} 7\n" for x, y, z in XYZ).encode(),
    "a.csv": b"x,y,z,class\n" + b"".join(b"%d,%d,%d,2\n" % tuple(row) for row in XYZ.astype(int)),
    "a.asc": b"ncols 3\nnrows 2\nxllcorner 1\nyllcorner 2\ncellsize 1\n1.5 2 -9999\n4 5 6\n",
    "b.pcd": pcd(XYZ, "binary", [("rgb", np.arange(30, dtype=np.uint32))]),
    "c.pcd": pcd(XYZ, "binary_compressed"),
    "t.pcd": pcd(XYZ, "ascii"),
    "b.ply": ply(dict(zip("xyz", XYZ.T, strict=True)) | COLOURS, faces=[(0, 1, 2), (3, 4, 5, 6)]),
    "t.ply": ply(dict(zip("xyz", XYZ.T, strict=True)), "ascii", [(0, 1, 2)]),
    "a.npy": saved(np.save, XYZ),
    "g.npy": saved(np.save, RNG.random((8, 8, 8)) < 0.1),
    "a.npz": saved(np.savez_compressed, xyz=XYZ),
    "a.bin": np.column_stack([XYZ, RNG.random(30)]).astype("<f4").tobytes(),
    "a.stl": stl(BOX),
    "a.binvox": encode_binvox(GRID, 16, (0.0, 0.0, 0.0), 1.0),
    "a.bt": encode_bt(GRID, 0.1),
}


def mutant(data, chance):
    """Return bytes with some changed, cut out, put in, or cut off."""
    changed = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 4])):
        if not changed:
            break
        at = chance.randrange(min(len(changed), chance.choice([60, 300, len(changed)])))
        what = chance.random()
        if what < 0.5:
            changed[at] = chance.choice([0, 255, chance.randrange(256), chance.randrange(48, 58)])
        elif what < 0.7:
            del changed[at : at + chance.choice([1, 4, 50])]
        elif what < 0.85:
            changed[at:at] = chance.randbytes(chance.choice([1, 4]))
        else:
            del changed[at:]
    return bytes(changed)


def refusal(call, *arguments, **options):
    """Return the coded error of a call, None if it works; other exceptions come through."""
    try:
        call(*arguments, **options)
    except VolatoolError as error:
        return error
    return None


@pytest.mark.parametrize("name", SEEDS)
def test_mutants_are_read_or_refused(tmp_path, name):
    chance = random.Random(name)
    points_of(tmp_path_with(tmp_path, name, SEEDS[name]), depth=2)
    for _ in range(N_MUTANTS):
        path = tmp_path_with(tmp_path, name, mutant(SEEDS[name], chance))
        mesh = "voxelize" if name.endswith("ply") and chance.random() < 0.5 else "auto"
        error = refusal(points_of, path, depth=2, mesh=mesh, memory="64M")
        assert error is None or error.code != "E_INTERNAL"
        assert error is None or name in str(error)


def tmp_path_with(folder, name, data):
    (folder / name).write_bytes(data)
    return folder / name


def test_mutants_of_our_own_exports_are_read_or_refused(tmp_path):
    """With the comments and trailers from which cube and CRS come back."""
    np.savetxt(tmp_path / "s.xyz", XYZ)
    report = vt.import_points(tmp_path / "s.xyz", depth=2, crs="EPSG:28992", dense="never")
    volume = vt.open(report.paths[0])
    chance = random.Random(5)
    for suffix in ("npz", "bt", "ply"):
        (path,) = vt.export_volume(volume, tmp_path / f"t.{suffix}").paths
        data = path.read_bytes()
        for _ in range(N_MUTANTS):
            path.write_bytes(mutant(data, chance))
            out = {"outdir": tmp_path / "o", "overwrite": True, "dense": "never"}
            error = refusal(vt.import_points, path, memory="64M", **out)
            assert error is None or error.code != "E_INTERNAL"


def test_mutants_of_a_geotiff_are_read_or_refused(tmp_path):
    path = tmp_path / "a.tif"
    place = {"transform": Affine(1.0, 0, 10.0, 0, -1.0, 22.0), "crs": "EPSG:28992"}
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="float32", width=9, height=9, **place
    ) as file:
        file.write(RNG.random((9, 9)).astype("f4"), 1)
    data, chance = path.read_bytes(), random.Random(6)
    for _ in range(N_MUTANTS):
        path.write_bytes(mutant(data, chance))
        error = refusal(points_of, path)
        assert error is None or error.code != "E_INTERNAL"


def test_a_cube_that_the_points_have_left_is_not_used(tmp_path):
    """Points moved by a program that kept the comment."""
    np.savetxt(tmp_path / "s.xyz", XYZ)
    volume = vt.open(vt.import_points(tmp_path / "s.xyz", depth=2, dense="never").paths[0])
    (path,) = vt.export_volume(volume, tmp_path / "t.ply").paths
    source = opened(path)
    assert source.own_grid == (volume.cube, 2)
    head, _, body = path.read_bytes().partition(b"end_header\n")
    records = np.frombuffer(body, [("xyz", "<f8", 3)]) if len(body) % 24 == 0 else None
    assert records is not None
    moved = records["xyz"] + 1000.0
    path.write_bytes(head + b"end_header\n" + moved.tobytes())
    source = opened(path)
    assert source.own_grid is None
    assert "W_CUBE" in [warning.code for warning in source.warnings]


def test_an_archive_that_swells_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((1_000_000, 3)))
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    with pytest.raises(ResourceError, match="more than --memory allows") as caught:
        opened(tmp_path / "a.npz", memory="4M")
    assert caught.value.code == "E_SIZE"


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"a": XYZ, "b": XYZ}, "has 2 arrays, none called points"),
        ({"coords": XYZ, "depth": 2, "trailer": "{}"}, "coords are"),
        ({"coords": GRID, "depth": 1, "trailer": "{}"}, "coords are not 0 to 3"),
        ({"coords": GRID, "depth": 99, "trailer": "{}"}, "depth 99 is not 1 to 10"),
        ({"coords": GRID, "depth": 2, "trailer": "{}"}, "makes no sense"),
        ({"coords": GRID, "depth": 2, "trailer": "}"}, "its trailer makes no sense"),
        ({"coords": GRID, "depth": 2, "trailer": 7}, "are not text and a number"),
    ],
)
def test_archives_that_make_no_sense_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(FormatError, match=message):
        opened(tmp_path / "a.npz")


def test_an_archive_may_be_anyones(tmp_path):
    np.savez(tmp_path / "a.npz", XYZ)
    assert opened(tmp_path / "a.npz").n_points == 30
    np.savez(tmp_path / "b.npz", xyz=XYZ, other=np.zeros(3))
    assert opened(tmp_path / "b.npz").n_points == 30
    np.savez(tmp_path / "c.npz", np.array([{}], object))
    with pytest.raises(FormatError, match="is not the"):
        opened(tmp_path / "c.npz")


def test_all_suffixes_are_known():
    assert sorted(s for one in FORMATS.values() for s in one.suffixes) == sorted(IMPORT_SUFFIXES)
