"""Every shared file ends in the points that laspy reads, or in one error of ours."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from volatool.errors import InputError
from volatool.points.reader import open_points

LIMITED = """
import resource, sys, warnings
warnings.simplefilter("error")
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from volatool.errors import InputError
from volatool.points.reader import open_points
for path in sys.argv[1:]:
    for salvage in (False, True):
        try:
            with open_points(path, salvage=salvage) as source:
                n = sum(map(len, source.chunks(source.header.dimensions)))
                assert n == source.n_points
                print(path.rsplit("/", 1)[-1], n, *sorted({w.code for w in source.warnings}))
        except InputError as error:
            print(path.rsplit("/", 1)[-1], error.code)
from volatool.resources import peak_rss_bytes
peak = peak_rss_bytes() // 1024
assert peak < 400_000, peak
"""


def test_odd_files_end_in_points_or_one_error(shared: Path) -> None:
    """In a process of 3 GiB address space: no crash, no hang, no traceback, little memory."""
    paths = sorted(map(str, (shared / "odd").iterdir()))
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *paths],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stderr == ""
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert len(lines) == 2 * len(paths)
    told = {}
    for line in lines[::2]:
        name, rest = line.split(" ", 1)
        told[name] = rest
    assert told["las_1.2-with-color-clipped.las"] == "E_TRUNCATED"
    assert told["las_garbage_nVariableLength.las"] == "E_TRUNCATED"
    assert told["README.md"] == "E_NOT_LAS"
    assert told["laz_simple-laszip-compressor-version-1.2r0.laz"] == "1065 W_NO_CRS"
    assert told["las_no-points.las"] == "0"
    assert told["example.copc.laz"] == "30"
    refused = [name for name, rest in told.items() if rest.startswith("E_")]
    assert len(refused) == 3
    salvaged = dict(line.split(" ", 1) for line in lines[1::2])
    assert salvaged["las_1.2-with-color-clipped.las"] == "1064 W_NO_CRS W_SALVAGED"


def test_the_oldest_laz_equals_the_same_points_by_a_newer_one(shared: Path) -> None:
    """LASzip 1.2, one stream without chunks, of which laspy's parallel reader makes a panic."""
    with (
        open_points(shared / "odd/laz_simple-laszip-compressor-version-1.2r0.laz") as old,
        open_points(shared / "odd/laszip_liblas-generated.laz") as new,
    ):
        (one,), (other,) = (list(source.chunks(source.header.dimensions)) for source in (old, new))
    for axis in "xyz":
        assert np.array_equal(getattr(one, axis), getattr(other, axis))
    for name, values in one.attributes.items():
        assert np.array_equal(values, other.attributes[name]), name


SAME_AS_LASPY = [
    "tiles/ahn3_cropped_2.laz",
    "tiles/autzen_trim.las",
    "tiles/las_with_several_extra_byte_bloc.laz",
    "tiles/lone-star.copc.laz",
    "tiles/laserchicken-AHN3.laz",
    "tiles/pyfor-osbs-test.laz",
    "odd/1_4_w_evlr.laz",
    "odd/fullwave.laz",
    "odd/simple_with_page.copc.laz",
    "odd/vegetation_1_3.las",
    "odd/las_extrabytes.las",
    "golden/inputs/lidR-Topography.laz",
]


@pytest.mark.parametrize("name", SAME_AS_LASPY)
def test_real_files_equal_laspy(shared: Path, name: str) -> None:
    """Points and attributes of real files, by an independent reader."""
    las = laspy.read(shared / name)
    with open_points(shared / name) as source:
        chunks = list(source.chunks(source.header.dimensions, 100_000))
        names = source.header.dimensions
    for axis in "xyz":
        got = np.concatenate([getattr(c, axis) for c in chunks])
        assert np.array_equal(got, las[axis.upper()])
    for attribute in names:
        got = np.concatenate([c.attributes[attribute] for c in chunks])
        assert np.array_equal(got, np.asarray(las[attribute])), attribute


@pytest.mark.parametrize(
    ("name", "horizontal", "vertical", "unit_xy", "unit_z", "codes"),
    [
        ("tiles/autzen-2010-oregon-10.6M.laz", "EPSG:2994", None, "foot", None, ["W_Z_UNIT"]),
        ("tiles/autzen_trim.las", "EPSG:2994", None, "foot", None, ["W_Z_UNIT"]),
        ("tiles/4_6_crop.las", "EPSG:2903", "EPSG:6360", "US survey foot", "US survey foot", []),
        ("tiles/ahn3_cropped_1.laz", None, None, None, None, ["W_NO_CRS"]),
        ("tiles/lone-star.copc.laz", None, None, None, None, ["W_CRS_BROKEN", "W_NO_CRS"]),
        ("tiles/pyfor-osbs-test.laz", "EPSG:32617", None, "metre", "metre", []),
        ("odd/simple_with_page.copc.laz", "EPSG:2991", "EPSG:6360", "metre", "US survey foot", []),
        ("odd/las_mvk-thin.las", "EPSG:2255", "EPSG:6360", "US survey foot", "US survey foot", []),
        ("odd/extra_byte.las", "EPSG:32622", None, "metre", "metre", []),
        ("odd/autzen_autzen-dd.las", "EPSG:4326", None, "degree", None, []),
        ("odd/las_1.2-empty-geotiff-vlrs.las", None, None, "metre", "metre", ["W_NO_CRS"]),
    ],
)
def test_real_crs(
    shared: Path,
    name: str,
    horizontal: str | None,
    vertical: str | None,
    unit_xy: str | None,
    unit_z: str | None,
    codes: list[str],
) -> None:
    """CRS and units per axis of real files, wrong labels among them."""
    with open_points(shared / name) as source:
        crs = source.crs
        assert (crs.horizontal, crs.vertical) == (horizontal, vertical)
        assert (crs.unit_xy, crs.unit_z) == (unit_xy, unit_z)
        assert [w.code for w in source.warnings] == codes


def test_every_tile_opens(shared: Path) -> None:
    """Headers, chunk tables and CRS of all tiles and golden inputs, without an error."""
    paths = [*(shared / "tiles").rglob("*.la?"), *(shared / "golden/inputs").glob("*.la?")]
    assert len(paths) > 20
    for path in paths:
        with open_points(path) as source:
            assert source.n_points > 0
            assert "W_HEADER_COUNT" not in [w.code for w in source.warnings]
            next(iter(source.chunks(chunk_points=1000)))


def test_text_inputs_are_not_las(shared: Path) -> None:
    """The golden inputs of other formats."""
    for path in (shared / "golden/inputs").glob("*.xyz"):
        with pytest.raises(InputError, match="not a LAS or LAZ file"):
            open_points(path)
