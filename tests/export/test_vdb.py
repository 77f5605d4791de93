"""Volumes as OpenVDB grids, read by a naive reader and, where it is there, by OpenVDB."""

from __future__ import annotations

import functools
import json
import shutil
import subprocess
import sys

import naive_vdb as naive
import numpy as np
import pytest
from making_exports import full_volume, toolkit_volume
from making_volumes import random_volume, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import OptionError
from volatool.formats.origin import find_origin
from volatool.vola.volume import VolumeInfo
from volatool.vola.window import half_open

LIBRARY = """
import json, sys
try:
    import pyopenvdb as vdb
except ImportError:
    import openvdb as vdb
grid = vdb.read(sys.argv[1], "density")
on = [i.min for i in grid.citerOnValues() if i.count == 1 and i.value == 1.0]
print(json.dumps({
    "n": grid.activeVoxelCount(), "on": on, "crs": grid.metadata["crs_wkt"],
    "class": grid.gridClass, "names": [g.name for g in vdb.readAllGridMetadata(sys.argv[1])],
    "first": grid.transform.indexToWorld((0, 0, 0)), "size": grid.transform.voxelSize(),
}))
"""


def run(python, code, *arguments):
    command = [python, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@functools.cache
def library_python():
    """A Python that has OpenVDB: this one, or that of the system for Debian's python3-openvdb."""
    for python in (sys.executable, shutil.which("python3", path="/usr/bin:/usr/local/bin")):
        if python is None:
            continue
        code = (
            "import importlib.util as u; assert u.find_spec('pyopenvdb') or u.find_spec('openvdb')"
        )
        if subprocess.run([python, "-c", code], capture_output=True, check=False).returncode == 0:
            return python
    return None


def exported(volume, folder, **options):
    done = vt.export_volume(volume, folder / "out.vdb", overwrite=True, **options)
    return done.paths[0], naive.read(done.paths[0].read_bytes()), done.warnings


def middles(numbers, voxels):
    return np.array(sorted(voxels)) * numbers[3:6] + numbers[:3]


def ordered(xyz):
    return xyz[np.lexsort(xyz.T[::-1])]


def test_voxels_are_where_the_crs_has_them_heights_in_their_own_unit(tmp_path):
    volume = full_volume(3, 300)
    _, (_, metadata, kind, numbers, voxels), warnings = exported(volume, tmp_path)
    assert kind == "ScaleTranslateMap"  # feet of two kinds
    assert set(voxels) == set(map(tuple, volume.voxels().tolist()))
    cells = np.array(sorted(voxels))
    np.testing.assert_array_equal(volume.cell_indices(middles(numbers, voxels)), cells)
    assert warnings == ()
    assert metadata["crs_wkt"] == volume.crs.wkt2
    origin = find_origin(["volatool " + metadata["volatool"]])
    assert origin.cube.exact == volume.cube.exact
    assert origin.info.crs == volume.crs


def test_the_voxels_of_a_real_volume_are_kept(real, tmp_path):
    part = real.truncated(4)
    _, (_, _, _, numbers, voxels), _ = exported(part, tmp_path)
    assert set(voxels) == set(map(tuple, part.voxels().tolist()))
    cells = np.array(sorted(voxels))
    np.testing.assert_array_equal(part.cell_indices(middles(numbers, voxels)), cells)


def test_local_coordinates_begin_at_the_cube(tmp_path):
    volume = random_volume(2)
    _, (_, _, _, numbers, _), (warning,) = exported(volume, tmp_path, local=True)
    np.testing.assert_allclose(numbers[:3], np.array(numbers[3:6]) / 2)
    assert warning.code == "W_SHIFTED"


def test_volumes_of_the_toolkit_are_cells_around_its_points(tmp_path):
    volume = toolkit_volume()
    _, (_, _, _, numbers, voxels), _ = exported(volume, tmp_path)
    np.testing.assert_allclose(
        ordered(middles(numbers, voxels)), ordered(half_open(volume).centers()), rtol=1e-12
    )


def test_without_a_crs_that_is_told(tmp_path):
    _, (_, metadata, *_), warnings = exported(random_volume(2, info=VolumeInfo()), tmp_path)
    assert "crs_wkt" not in metadata
    assert [warning.code for warning in warnings] == ["W_NO_CRS"]


def test_a_cube_without_extent_is_refused(tmp_path):
    volume = volume_of({(0, 0, 0)}, 1, cube=Cube((1.0, 2.0, 3.0), 0.0))
    with pytest.raises(OptionError, match="no extent"):
        exported(volume, tmp_path)


def test_the_library_reads_the_same_voxels_in_the_same_places(tmp_path):
    python = library_python()
    if python is None:
        pytest.skip("no Python here has OpenVDB (Debian: python3-openvdb)")
    block = {tuple(map(int, row)) for row in np.argwhere(np.ones((20, 17, 9))) + 250}
    spread = {tuple(map(int, row)) for row in np.random.default_rng(1).integers(0, 1024, (900, 3))}
    volume = volume_of(block | spread, 5, info=full_volume().info)
    path, (_, _, _, numbers, voxels), _ = exported(volume, tmp_path)
    done = run(python, LIBRARY, path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["n"] == len(volume)
    assert set(map(tuple, told["on"])) == set(voxels)
    assert told["crs"] == volume.crs.wkt2
    assert (told["class"], told["names"]) == ("fog volume", ["density"])
    assert told["first"] == list(numbers[:3])
    assert told["size"] == list(numbers[3:6])


def test_the_same_volume_gives_the_same_bytes(tmp_path):
    paths = [vt.export_volume(full_volume(), tmp_path / f"{k}.vdb").paths[0] for k in range(2)]
    assert paths[0].read_bytes() == paths[1].read_bytes()
