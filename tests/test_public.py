"""The public names, and what importing them costs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import volatool as vt


def test_every_public_name_is_there_and_an_unknown_one_is_not():
    for name in vt.__all__:
        assert getattr(vt, name) is not None
    assert set(vt.__all__) <= set(dir(vt))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        vt.nonsense  # noqa: B018


def test_import_loads_nothing_heavy():
    code = (
        "import sys, volatool\n"
        "heavy = {'numpy', 'numba', 'rasterio', 'pyproj', 'lazrs', 'click'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_only_the_modules_that_contributing_names_know_the_libraries_for_files_and_crs():
    """laspy, lazrs and pyproj in points/; rasterio in dem/gdal.py and dem/geotiff.py."""
    top = Path(vt.__file__).parent
    knowing = {}
    for path in top.rglob("*.py"):
        for name in re.findall(r"^\s*(?:import|from) (\w+)", path.read_text("utf-8"), re.MULTILINE):
            knowing.setdefault(name, set()).add(path.relative_to(top).as_posix())
    assert knowing["rasterio"] == {"dem/gdal.py", "dem/geotiff.py"}
    for name in ("laspy", "lazrs", "pyproj"):
        assert {path.split("/")[0] for path in knowing[name]} == {"points"}


def test_an_unknown_option_is_told():
    with pytest.raises(vt.VolatoolError, match="frobnicate"):
        vt.convert("tile.laz", frobnicate=1)


def test_points_of_ones_own_make_a_volume():
    import numpy as np
    from making_tiles import hills

    from volatool.model import PointChunk

    xyz = hills(5000)
    builder = vt.VolaBuilder(vt.Cube((0.0, 0.0, 0.0), 64.0), max_depth=5)
    for start in range(0, 5000, 700):
        part = xyz[start : start + 700].astype(np.int32)
        columns = (np.ascontiguousarray(part[:, axis]) for axis in range(3))
        assert builder.add(PointChunk(start, *columns, (0.01,) * 3, (0.0,) * 3)) == 0
    volume = builder.finish(depth="auto", min_occupancy=0.05)
    assert volume.depth >= 2
    assert volume.contains(xyz / 100).all()
    expected = np.unique((xyz * 4**volume.depth) // 6400, axis=0)
    found = volume.voxels()
    assert np.array_equal(found[np.lexsort(found.T[::-1])], expected)
