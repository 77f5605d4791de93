"""Re-tiling: cubes made of several files are those of one file with all points, byte for byte."""

from __future__ import annotations

import os
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from making_tiles import write_las

import volatool as vt
from volatool import outputs
from volatool.errors import CRSError, FormatError, InputError, OptionError
from volatool.options import ConvertOptions
from volatool.report import schema
from volatool.retile import plan, read_group, write_groups
from volatool.summary import Summary
from volatool.tile import convert_tile

SIDE = "20m"


def points(n=20_000, seed=3):
    """Return stored x, y, z in cm over 100 x 60 m that cross 0 in y and z, and attributes."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 10_000, n), rng.integers(-3_000, 3_000, n)
    z = (300 * np.sin(x / 900)).astype(int) + rng.integers(-20, 20, n)
    xyz = np.column_stack([x, y, z])
    xyz[:40, 0] = 4_000  # exactly on a border between cubes and between files
    more = {
        "classification": rng.choice([2, 6], n).astype(np.uint8),
        "intensity": rng.integers(0, 4000, n).astype(np.uint16),
        "return_number": np.ones(n, np.uint8),
        "number_of_returns": rng.integers(1, 4, n).astype(np.uint8),
    }
    return xyz, more


def las(path, xyz, more, part, **how):
    return write_las(
        path, xyz[part], crs="EPSG:25832", **{k: v[part] for k, v in more.items()}, **how
    )


@pytest.fixture
def files(tmp_path):
    """Three overlapping files, one stored in mm with an offset of its own; and all in one."""
    xyz, more = points()
    rng = np.random.default_rng(8)
    number = np.minimum(xyz[:, 0] // 4_000, 2)
    number = np.where(rng.random(len(xyz)) < 0.1, rng.integers(0, 3, len(xyz)), number)
    folder = tmp_path / "in"
    folder.mkdir()
    paths = [las(folder / f"f{k}.las", xyz, more, number == k) for k in (0, 1)]
    moved = (xyz - np.array((6_000, -200, 50))) * 10
    paths.append(
        las(folder / "f2.las", moved, more, number == 2, scale=0.001, offset=(60.0, -2.0, 0.5))
    )
    whole = las(tmp_path / "all.las", xyz * 10, more, slice(None), scale=0.001)
    return paths, whole


def retiled(paths, out, monkeypatch=None, **options):
    """Re-tile as the command does; return the reports and the plan's groups."""
    asked = ConvertOptions(split=SIDE, **options)
    groups, failed = plan(paths, asked, "all")
    assert not failed
    targets = write_groups(groups, out / "all.cubes")
    if not asked.depth_options:
        total = Summary()
        for target in targets:
            counting = replace(asked, all_levels=True)
            total.add(convert_tile(target, counting, kind="stats", outdir=out))
        (out / "dataset.json").write_text(total.report().to_json(), encoding="utf-8")
        asked = replace(asked, depth_from=str(out / "dataset.json"))
    reports = [convert_tile(target, asked, kind="retile", outdir=out) for target in targets]
    for report in reports:
        jsonschema.validate(report.to_dict(), schema())
    return reports, groups


def volumes(folder):
    return {path.name: path for path in sorted(folder.glob("*.vol"))}


@pytest.mark.parametrize("most", [1024, 8], ids=["one group", "many groups"])
@pytest.mark.parametrize("options", [{}, {"depth": 3}, {"classes": (2,), "resolution": "1m"}])
def test_cubes_of_three_files_are_those_of_one(files, tmp_path, monkeypatch, most, options):
    """Same names, same bytes but for the name and size of the source, which are the set's."""
    paths, whole = files
    monkeypatch.setattr("volatool.retile.MOST_CUBES", most)
    one = vt.convert(whole, tmp_path / "one", split=SIDE, dem=False, gzip=False, **options)
    out = tmp_path / "out"
    reports, groups = retiled(paths, out, gzip=False, **options)
    assert (len(groups) > 1) == (most == 8)
    wanted, found = volumes(tmp_path / "one"), volumes(out)
    assert list(found) == list(wanted)
    assert len(found) > 20
    total = sum(path.stat().st_size for path in paths)
    for name, path in wanted.items():
        mine, told = found[name].read_bytes(), path.read_bytes()
        levels = vt.open(path).levels
        n_body = 80 + sum(16 * len(words) for words in levels)
        assert mine[:n_body] == told[:n_body], name
        a, b = vt.open(found[name]), vt.open(path)
        assert replace(a.info, source_name=None, source_bytes=None) == replace(
            b.info, source_name=None, source_bytes=None
        )
        assert (a.info.source_name, a.info.source_bytes) == ("all", total)
        assert a.cube == b.cube
    summary = Summary()
    for report in reports:
        summary.add(report)
    summed = summary.report()
    assert summed.input["points_used"] == one.input["points_used"]
    assert summed.input["points_read"] == one.input["points_read"]
    assert summed.input["classes"] == one.input["classes"]
    assert summed.input["dropped"] == one.input["dropped"]
    assert summed.depth == one.depth
    assert summed.cube["cubes"] == len(found)
    assert summed.input["bytes"] == pytest.approx(sum(p.stat().st_size for p in paths), abs=9)


def test_groups_that_stay_the_same_are_not_written_again(files, tmp_path):
    paths, _ = files
    asked = ConvertOptions(split=SIDE)
    groups, _ = plan(paths, asked, "all")
    (target,) = write_groups(groups, tmp_path / "g")
    before = target.stat().st_mtime_ns
    assert read_group(target) == groups[0]
    assert write_groups(plan(paths, asked, "all")[0], tmp_path / "g") == [target]
    assert target.stat().st_mtime_ns == before
    target.write_text("{}", encoding="utf-8")
    with pytest.raises(FormatError, match="not a group"):
        read_group(target)


def test_a_group_whose_file_has_changed_since_is_refused(files, tmp_path):
    """Of the same size and as many points, but another time."""
    paths, _ = files
    groups, _ = plan(paths, ConvertOptions(split=SIDE), "all")
    (target,) = write_groups(groups, tmp_path / "g")
    kept = paths[0].stat()
    os.utime(paths[0], ns=(kept.st_atime_ns, kept.st_mtime_ns + 1_000_000_000))
    try:
        with pytest.raises(InputError, match=f"{paths[0].name}: has changed since"):
            convert_tile(target, ConvertOptions(split=SIDE), kind="retile", outdir=tmp_path / "out")
        assert not (tmp_path / "out").exists()
        write_groups(plan(paths, ConvertOptions(split=SIDE), "all")[0], tmp_path / "g")
        assert read_group(target) != groups[0]
    finally:
        os.utime(paths[0], ns=(kept.st_atime_ns, kept.st_mtime_ns))


def test_what_is_left_by_a_killed_run_beside_the_groups_goes(files, tmp_path):
    paths, _ = files
    groups, _ = plan(paths, ConvertOptions(split=SIDE), "all")
    folder = tmp_path / "g"
    (target,) = write_groups(groups, folder)
    left = folder / f".{target.name}.0.volatool-{outputs._HOST[:24]}-999999999.tmp.cubes"
    left.touch()
    other = folder / "all_x9..9_y9..9.cubes"
    other.touch()
    assert write_groups(groups, folder) == [target]
    assert list(folder.iterdir()) == [target]


def test_each_file_is_in_the_groups_that_it_touches(tmp_path, monkeypatch):
    """A row of tiles of 4 cubes: groups begin at tiles, and nearly every file is in one only."""
    monkeypatch.setattr("volatool.retile.MOST_CUBES", 64)
    xyz, more = points(4000)
    paths = []
    for k in range(6):
        moved = np.column_stack([xyz[:, 0] % 8000, xyz[:, 1] % 8000, xyz[:, 2] % 1000])
        moved = moved + np.array((8000 * k, 0, 0))
        paths.append(las(tmp_path / f"{k}.las", moved, more, slice(None)))
    groups, _ = plan(paths, ConvertOptions(split=SIDE), "all")
    assert sum(len(group.pieces) for group in groups) == 6
    for group in groups:
        x0, y0, x1, y1 = group.columns
        assert (x1 - x0) * (y1 - y0) <= 64


def test_a_header_that_hides_points_is_an_error_not_a_loss(files, tmp_path):
    """Points outside the box of the header would be in a group that does not read the file."""
    paths, _ = files
    data = bytearray(paths[0].read_bytes())
    data[179:187] = np.float64(30.0).tobytes()  # largest x
    paths[0].write_bytes(data)
    with pytest.raises(InputError, match="outside the box of its header") as error:
        retiled(paths, tmp_path / "out")
    assert error.value.code == "E_HEADER_BBOX"
    assert not volumes(tmp_path / "out")


def test_a_file_that_changed_after_the_plan_is_refused(files, tmp_path):
    paths, _ = files
    asked = ConvertOptions(split=SIDE, depth=3)
    groups, _ = plan(paths, asked, "all")
    (target,) = write_groups(groups, tmp_path / "g")
    xyz, more = points(500)
    las(paths[1], xyz, more, slice(None))
    with pytest.raises(InputError, match=r"f1\.las: has changed"):
        convert_tile(target, asked, kind="retile", outdir=tmp_path / "out")
    assert not list((tmp_path / "out").glob("*"))


def test_what_can_not_share_cubes_is_refused(files, tmp_path):
    paths, _ = files
    xyz, _ = points(500)
    other = write_las(tmp_path / "o.las", xyz, crs="EPSG:25833")
    with pytest.raises(CRSError, match=r"f0\.las and o\.las"):
        plan([*paths, other], ConvertOptions(split=SIDE), "all")
    for bad in ({"thin": 2}, {"robust_z": True}):
        with pytest.raises(OptionError, match="can't go with retile"):
            plan(paths, ConvertOptions(split=SIDE, **bad), "all")
    with pytest.raises(OptionError, match="--split"):
        plan(paths, ConvertOptions(), "all")
    groups, failed = plan([tmp_path / "none.las"], ConvertOptions(split=SIDE), "all")
    assert (groups, [error.code for error in failed.values()]) == ([], ["E_NOT_FOUND"])
