"""``dem --mosaic``: seamless models of a set of tiles, and what is told when some can't be used."""

from __future__ import annotations

import json

import numpy as np
import pytest
from making_tiles import write_las


@pytest.fixture
def tiles(volatool):
    """Three tiles in a row, 60 m each, in a folder of their own."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1, (2, 9000)) * [[180], [60]]
    z = 50 + np.sin(x / 9) + rng.normal(0, 0.02, 9000)
    xyz = np.floor(np.column_stack([x, y, z]) * 100).astype(np.int64)
    folder = volatool.folder / "tiles"
    folder.mkdir()
    for number in range(3):
        part = xyz[xyz[:, 0] // 6000 == number]
        codes = np.full(len(part), 2, np.uint8)
        write_las(folder / f"t{number}.las", part, crs="EPSG:25832", classification=codes)
    return folder


def test_a_mosaic_is_made_and_told(volatool, tiles):
    out = volatool.folder / "out"
    asked = ("dem", "tiles", "-o", "out", "--mosaic", "row", "--cell", "1m", "--layers", "flag")
    planned = volatool(*asked, "--cog", "--dry-run")
    assert planned.returncode == 0, planned.stderr
    assert not out.exists()
    done = volatool(*asked, "--cog")
    assert done.returncode == 0, done.stderr
    written = done.stdout.splitlines()
    assert sorted(written) == sorted(planned.stdout.splitlines())
    said = json.loads((out / "row.mosaic.json").read_text(encoding="utf-8"))
    assert (said["tiles"], said["width"], said["height"]) == (3, 180, 60)
    n_cells = sum(said[f"cells_{kind}"] for kind in ("measured", "filled", "void"))
    assert n_cells == 180 * 60
    assert "mosaic of 3 models: 180 x 60 cells of 1, " in done.stderr
    assert "W_SEAM_SPRINGS" not in done.stderr
    again = volatool(*asked)
    assert again.returncode == 2
    assert again.stderr.startswith("E_OUTPUT_EXISTS")


def test_a_bad_tile_does_not_stop_the_mosaic_of_the_others(volatool, tiles):
    """A header that can't be read: the others meet without it, and the status says so."""
    (tiles / "t2.las").write_bytes(b"<html>")
    done = volatool("dem", "tiles", "-o", "out", "--mosaic", "row", "--cell", "1m")
    assert done.returncode == 3
    assert "E_NOT_LAS: t2.las" in done.stderr
    assert "mosaic of 2 models" in done.stderr
    assert (volatool.folder / "out" / "row.dem.vrt").exists()
    assert not (volatool.folder / "out" / "row.dem.tif").exists()


def test_a_model_of_an_earlier_run_does_not_stand_in_for_a_tile_that_fails(volatool, tiles):
    asked = ("dem", "tiles", "-o", "out", "--mosaic", "row", "--cell", "1m", "--overwrite")
    assert "mosaic of 3 models" in volatool(*asked).stderr
    (tiles / "t2.las").write_bytes(b"<html>")
    done = volatool(*asked)
    assert done.returncode == 3
    assert "mosaic of 2 models: 120 x 60 cells" in done.stderr
    assert (volatool.folder / "out" / "t2.dem.tif").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--cog",), "--cog is for --mosaic"),
        (("--mosaic", "a/b"), "without folders"),
        (("--mosaic", "x", "--neighbours", "tiles"), "leave out --neighbours"),
        (("--mosaic", "x", "--like", "x.tif"), "leave out --like"),
        (("--mosaic", "x", "--robust-z"), "--robust-z is about one tile"),
        (("--mosaic", "t0"), "is a tile's"),
    ],
)
def test_what_does_not_go_together_is_refused_before_any_work(volatool, tiles, options, message):
    done = (
        volatool("dem", "tiles", "-o", "out", "--cog", *options)
        if "--mosaic" in options
        else (volatool("dem", "tiles", "-o", "out", *options))
    )
    assert done.returncode == 2
    assert message in done.stderr
    assert not (volatool.folder / "out").exists()
