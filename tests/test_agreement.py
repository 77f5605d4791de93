"""`validate_files`: the files of one tile, held against each other."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import zlib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import making_volumes as making
import numpy as np
import pytest

import volatool
from volatool.cube import Cube
from volatool.formats import trailer
from volatool.formats.registry import read_info
from volatool.validate import validate_files
from volatool.vola.volume import Volume

SAMPLES = Path(__file__).resolve().parents[1] / "data_samples"


@pytest.fixture(scope="module")
def delivered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one converted tile with all that belongs to it (coarse: it is fast)."""
    folder = tmp_path_factory.mktemp("delivered")
    volatool.convert(SAMPLES / "forest.laz", outdir=folder, depth=3, layers=("flag", "count"))
    return folder


@pytest.fixture
def tile(delivered: Path, tmp_path: Path) -> Path:
    """Return a copy of it that may be broken."""
    return Path(shutil.copytree(delivered, tmp_path / "out"))


def faults(*paths: Path, whole_set: bool = False) -> list[tuple[str, str, int | None]]:
    """Return name, message and offset of each problem, all of which must be mismatches."""
    problems = [
        (Path(report.path).name, problem)
        for report in validate_files(paths, whole_set=whole_set)
        for problem in report.problems
    ]
    assert {problem.code for _, problem in problems} <= {"E_MISMATCH"}
    assert all("\n" not in problem.message for _, problem in problems)
    return [(name, problem.message, problem.offset) for name, problem in problems]


def rewrite(path: Path, volume: Volume, mode: int) -> None:
    """Write a volume in place of a file."""
    path.write_bytes(gzip.compress(making.written(volume, mode), mtime=0))


def edit(tile: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Change the report."""
    path = tile / "forest.stats.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def test_what_we_write_agrees(tile: Path) -> None:
    """Given one by one, together, and by one of them."""
    paths = sorted(tile.iterdir())
    assert len(paths) == 6
    assert faults(*paths) == []
    for path in paths:
        assert faults(path) == []
        reports = validate_files([path], whole_set=True)
        assert Path(reports[0].path) == path
        assert {Path(report.path) for report in reports} == set(paths)
        assert all(report.ok for report in reports)


@pytest.mark.parametrize(
    "options",
    [
        {"compat": "toolkit"},
        {"meta": ()},
        {"gzip": False},
        {"dense": "never", "snap": True},
        {"thin": 9},
    ],
    ids=str,
)
def test_all_kinds_of_output_agree(tmp_path: Path, options: dict[str, Any]) -> None:
    """Without metadata, without gzip, as the toolkit's, snapped, thinned."""
    given = {"depth": 3, "dem": False, **options}
    volatool.convert(SAMPLES / "forest.laz", outdir=tmp_path, **given)
    assert faults(tmp_path / "forest.stats.json", whole_set=True) == []


def test_volumes_of_a_split_tile_are_not_held_against_the_sum(tmp_path: Path) -> None:
    """The report tells of all of them together."""
    volume = making.random_volume(2, 30)
    rewrite(tmp_path / "a.vol.gz", volume, 0)
    volatool.convert(SAMPLES / "forest.laz", outdir=tmp_path, depth=2, dem=False)
    path = edit(tmp_path, lambda report: report["cube"].update(cubes=4))
    moved = path.rename(tmp_path / "a.stats.json")
    assert faults(moved, tmp_path / "a.vol.gz") == []


# ------------------------------------------------------------------------------ dense, sparse


def test_a_dense_file_with_another_voxel_is_found(tile: Path) -> None:
    """With the offset of the word."""
    dense = tile / "forest.dvol.gz"
    volume = volatool.open(tile / "forest.vol.gz")
    last = volume.levels[-1].copy()
    block = int(np.flatnonzero(np.bitwise_count(last) > 1)[5])
    last[block] &= last[block] - np.uint64(1)  # its lowest bit
    changed = Volume((*volume.levels[:-1], last), volume.metadata_levels, volume.cube, volume.info)
    gone = {tuple(v) for v in volume.voxels().tolist()} - {
        tuple(v) for v in changed.voxels().tolist()
    }
    ((x, y, z),) = gone
    rewrite(dense, changed, 1)
    ((name, message, offset),) = faults(tile / "forest.vol.gz", dense)
    assert name == "forest.dvol.gz"
    assert "occupancy word" in message
    assert "of level 3" in message
    # levels 1 and 2 with their metadata come before
    assert offset == 80 + 16 * (1 + 64) + 8 * ((x + 64 * y + 4096 * z) // 64)


def test_a_dense_file_with_another_metadata_word_is_found(tile: Path) -> None:
    """Its checksum is right: only the sparse file can tell."""
    dense = tile / "forest.dvol.gz"
    data = bytearray(gzip.decompress(dense.read_bytes()))
    at = data.index(trailer.MAGIC)
    text = bytes(data[at + 12 : -20])
    place = 80 + 16 + 8 * 64  # level 2's metadata
    while not any(data[place : place + 8]):
        place += 8
    data[place + 3] ^= 1
    body = bytes(data[:at])
    dense.write_bytes(gzip.compress(body + trailer.frame(text, zlib.crc32(body))))
    assert faults(dense) == []
    ((name, message, offset),) = faults(dense, tile / "forest.vol.gz")
    assert (name, offset) == ("forest.dvol.gz", place)
    assert "metadata word" in message


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda v: v.truncated(2), "depth is 2"),
        (lambda v: Volume(v.levels, None, v.cube, v.info), "nbits is 0"),
        (lambda v: replace(v, info=replace(v.info, epsg=4978)), "crs is 4978"),
        (lambda v: replace(v, cube=Cube(v.cube.origin, v.cube.side + 1)), "box is"),
        (lambda v: replace(v, info=replace(v.info, n_points=5)), "trailer differs.*: points "),
        (lambda v: replace(v, info=replace(v.info, crs=making.CRS)), "trailer differs.*: crs "),
    ],
)
def test_other_facts_of_the_two_are_compared(
    tile: Path, change: Callable[[Volume], Volume], match: str
) -> None:
    """Depth, metadata, CRS, cube, and all that the trailers tell."""
    rewrite(tile / "forest.dvol.gz", change(volatool.open(tile / "forest.vol.gz")), 1)
    ((_, message, offset),) = faults(tile / "forest.vol.gz", tile / "forest.dvol.gz")
    assert re.search(match, message)
    assert offset is not None


def test_files_of_other_tiles_are_not_compared(tile: Path, tmp_path: Path) -> None:
    """Neither another name nor another folder."""
    other = making.random_volume(2, 9)
    rewrite(tmp_path / "forest.dvol.gz", other, 1)
    rewrite(tile / "other.dvol.gz", other, 1)
    paths = (tile / "forest.vol.gz", tmp_path / "forest.dvol.gz", tile / "other.dvol.gz")
    assert faults(*paths) == []


def test_a_faulty_file_is_not_compared(tile: Path) -> None:
    """Its own fault is enough."""
    dense = tile / "forest.dvol.gz"
    dense.write_bytes(dense.read_bytes()[:-9])
    reports = validate_files([tile / "forest.vol.gz"], whole_set=True)
    codes = [(Path(r.path).name, p.code) for r in reports for p in r.problems]
    assert codes == [("forest.dvol.gz", "E_TRUNCATED")]


# ------------------------------------------------------------------------------------- report


def row(report: dict[str, Any], kind: str, codec: str = "gzip") -> dict[str, Any]:
    (found,) = (
        r
        for r in report["encodings"]
        if (r["kind"], r["codec"], r["bits_per_voxel"]) == (kind, codec, 2)
    )
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda r: row(r, "sparse").update(file_bytes=5), "file_bytes of forest.vol.gz is 5"),
        (lambda r: row(r, "dense").update(file_bytes=5), "file_bytes of forest.dvol.gz is 5"),
        (lambda r: row(r, "sparse").update(payload_bytes=8), r"payload_bytes \(sparse, 2 bit"),
        (lambda r: row(r, "dense").update(payload_bytes=8), "payload_bytes of forest.dvol.gz"),
        (lambda r: row(r, "sparse", "none").update(file_bytes=7), r"file_bytes \(sparse, 2 bit, n"),
        (lambda r: row(r, "sparse").update(path=None), "does not name forest.vol.gz"),
        (lambda r: r["choice"].update(depth=2), "choice.depth is 2"),
        (lambda r: r["levels"][1].update(blocks=1), "level 2: blocks is 1"),
        (lambda r: r["levels"][2].update(voxels=1), "level 3: voxels is 1"),
        (lambda r: r["levels"][0].update(occupancy=0.5), "level 1: occupancy is 0.5"),
        (lambda r: r["levels"][0]["occupancy_histogram"].reverse(), "level 1: occupancy_histogram"),
        (lambda r: r["levels"].pop(), None),
        (lambda r: r.update(levels=r["levels"][:2]), "level 3 of forest.vol.gz is not in"),
        (lambda r: r["cube"].update(side=1.0), "cube.side is 1.0"),
        (lambda r: r["cube"].update(origin=[0.0, 0.0, 0.0]), r"cube.origin is \[0.0"),
        (lambda r: r["input"].update(points_used=3), "input.points_used is 3"),
        (
            lambda r: r["input"]["crs"].update(horizontal="EPSG:1"),
            "input.crs is not that of.*horiz",
        ),
        (lambda r: r["dem"].update(width=3), "dem.width is 3"),
        (lambda r: r["dem"].update(cell=9.0), "dem.cell is 9.0"),
        (lambda r: r["dem"].update(nodata=-1.0), "dem.nodata is -1.0"),
        (lambda r: r["dem"].update(z_min=3.5), "dem.z_min is 3.5"),
        (lambda r: r["dem"].update(z_min=10**400), "dem.z_min is 1000"),
        (
            lambda r: r["dem"].update(layers={"flag": "forest.dem.count.tif"}),
            "a flag layer has bytes",
        ),
        (lambda r: r["dem"].update(z_max=None), "dem.z_max is None"),
        (lambda r: r["dem"].update(cells_void=7), "dem.cells_void is 7"),
        (lambda r: r["dem"].update(cells_measured=7), "cells_measured . cells_filled"),
        (
            lambda r: r["dem"].update(
                cells_measured=r["dem"]["cells_measured"] - 2,
                cells_filled=r["dem"]["cells_filled"] + 2,
            ),
            "that of forest.dem.flag.tif",
        ),
        (lambda r: r.update(dem=None), "tells of no elevation model"),
        (lambda r: r["dem"].update(layers={}), "does not name forest.dem.flag.tif"),
    ],
)
def test_what_the_report_says_is_held_against_the_files(
    tile: Path, change: Callable[[dict[str, Any]], None], match: str | None
) -> None:
    """Sizes, levels, cube, points, CRS, the model's cells; levels below the depth may be there."""
    path = edit(tile, change)
    found = faults(path, *tile.iterdir())
    if match is None:
        assert found == []
        return
    assert found
    assert {name for name, *_ in found} == {"forest.stats.json"}
    assert any(re.search(match, message) for _, message, _ in found), found
    assert faults(path) == []  # by itself it is sound


def test_a_file_that_the_report_names_must_be_there(tile: Path) -> None:
    """With the whole set only; a name with a folder is looked for beside the report."""
    for name in ("forest.dvol.gz", "forest.dem.count.tif"):
        (tile / name).unlink()
    assert faults(*tile.iterdir()) == []
    found = faults(tile / "forest.vol.gz", whole_set=True)
    assert [message.split("names ")[1].split(",")[0] for _, message, _ in found] == [
        "forest.dvol.gz",
        "forest.dem.count.tif",
    ]
    path = edit(tile, lambda r: row(r, "sparse").update(path="/etc/../forest.vol.gz"))
    assert len([m for _, m, _ in faults(path, whole_set=True) if "not beside it" in m]) == 2


def test_a_sparse_file_of_another_tile_is_found(tile: Path) -> None:
    """A mix-up of names: nothing agrees, each thing is said once."""
    volume = making.random_volume(3, 100)
    with (tile / "forest.vol.gz").open("wb") as file:
        file.write(gzip.compress(making.written(volume, 0)))
    found = faults(*tile.iterdir())
    assert {name for name, *_ in found} == {"forest.dvol.gz", "forest.stats.json"}
    assert len(found) == len({message for _, message, _ in found}) > 5


def test_only_a_dense_file_is_held_against_the_report(tile: Path) -> None:
    """Its levels are those of the table."""
    (tile / "forest.vol.gz").unlink()
    path = edit(tile, lambda r: r["levels"][1].update(voxels=1))
    ((_, message, _),) = faults(path, tile / "forest.dvol.gz")
    assert "level 2: voxels is 1, that of forest.dvol.gz is" in message


def test_sizes_of_another_version_are_not_worked_out_again(tile: Path) -> None:
    """The trailer's length depends on it; the files that are there are still measured."""
    sparse_file = tile / "forest.vol.gz"
    info = read_info(sparse_file)
    assert info.trailer is not None
    text = json.dumps({**info.trailer, "generator": "volatool 0.0.9"}).encode()
    body = gzip.decompress(sparse_file.read_bytes())
    body = body[: body.index(trailer.MAGIC)]
    sparse_file.write_bytes(gzip.compress(body + trailer.frame(text, zlib.crc32(body))))
    size = sparse_file.stat().st_size

    def change(report: dict[str, Any]) -> None:
        row(report, "sparse").update(file_bytes=size)
        row(report, "sparse", "none").update(file_bytes=7)

    assert faults(edit(tile, change), sparse_file) == []


def test_odd_volumes_agree_with_themselves(tmp_path: Path) -> None:
    """A cube in thirds, empty levels, no metadata: nothing to complain of."""
    cube = Cube.from_exact([Fraction(1, 3)] * 3, Fraction(10, 3))
    for n, volume in enumerate(
        [
            making.random_volume(3, 60, metadata=False, cube=cube),
            making.volume_of([], 3, cube=cube),
            making.volume_of([(0, 0, 0)], 1),
        ]
    ):
        for mode, suffix in enumerate((".vol", ".dvol")):
            (tmp_path / f"{n}{suffix}").write_bytes(making.written(volume, mode))
        assert faults(tmp_path / f"{n}.vol", whole_set=True) == []
