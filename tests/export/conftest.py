"""Volumes of two real tiles, for the tests of the exporters."""

from __future__ import annotations

import pytest

import volatool as vt

TILES = ("ahn3_cropped_1.laz", "4_6_crop.las")


@pytest.fixture(scope="session", params=TILES)
def real(request, shared, tmp_path_factory):
    """Return the volume of a real tile at depth 5."""
    folder = tmp_path_factory.mktemp("real")
    report = vt.convert(shared / "tiles" / request.param, folder, dem=False, depth=5)
    return vt.open(next(path for path in report.paths if ".vol" in path.name))
