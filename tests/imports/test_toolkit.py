"""The original's rules for imported files that no golden file covers; the rest is in tests/vola."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from making_imports import box_triangles, stl

import volatool as vt
from volatool.errors import InputError, OptionError
from volatool.formats.octomap import encode_bt
from volatool.imports.registry import read_points
from volatool.imports.toolkit import build
from volatool.options import ConvertOptions


def content(path, depth=2, **options):
    return build(read_points(Path(path), ConvertOptions()), depth, **options)


def words_by_hand(values):
    """trunc(255 * clip((v + 0.2) / 1.2)) three times, with the rounding of float32."""
    unit = np.clip((values.astype(float) + 0.2) / 1.2, 0, 1).astype(np.float32)
    grey = [int(np.float32(255) * value) for value in unit]
    return [value | value << 8 | value << 16 for value in grey]


def test_kitti_reflectances_become_grey(tmp_path):
    values = np.array([-0.3, -0.2, 0.0, 0.37, 1.0, 7.0], np.float32)
    xyz = np.arange(18.0).reshape(6, 3) % 7
    (tmp_path / "a.bin").write_bytes(np.column_stack([xyz, values]).astype("<f4").tobytes())
    points = read_points(tmp_path / "a.bin", ConvertOptions())
    ((found, words),) = points.toolkit.batches(True)
    assert np.array_equal(found, xyz)
    assert words.tolist() == words_by_hand(values)
    volume = content(tmp_path / "a.bin", 1, with_metadata=False).volume()
    assert not volume.has_metadata
    (tmp_path / "b.bin").write_bytes(np.full((1, 4), -1, "<f4").tobytes())
    dark = content(tmp_path / "b.bin", 1)
    with pytest.raises(InputError, match="metadata word of zero"):
        dark.volume()


def test_txt_skips_its_first_line_and_scales_its_first_channel(tmp_path):
    (tmp_path / "a.txt").write_text("0 0 0 -1 9\n0 0 0 -750 9\n3 3 3 -1600 257.0\n4 4 4 9 1.9\n")
    points = read_points(tmp_path / "a.txt", ConvertOptions())
    with pytest.raises(InputError, match="line 3: 257 in column 5 is not a whole number up to 255"):
        list(points.toolkit.batches(True))
    (tmp_path / "a.txt").write_text("0 0 0 -1 9\n0 0 0 -750 9\n3 3 3 -1600 7\n4 4 4 9 1.9\n")
    ((xyz, words),) = points.toolkit.batches(True)
    assert xyz[:, 0].tolist() == [0, 3, 4]
    assert words.tolist() == [127 + (9 << 8), 7 << 8, 255 + (1 << 8)]


@pytest.mark.parametrize("row", ["0 0 0 1.5", "0 0 0 256", "0 0 0 nan"])
def test_xyz_channels_are_whole_numbers_up_to_255(tmp_path, row):
    (tmp_path / "a.xyz").write_text("1 1 1 255\n# c\n" + row + "\n")
    with pytest.raises(InputError, match="line 3: ") as caught:
        content(tmp_path / "a.xyz")
    assert caught.value.code == "E_TOOLKIT"
    assert len(content(tmp_path / "a.xyz", with_metadata=False).volume()) == 2


def test_stl_gives_the_corners(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(box_triangles((0, 0, 0), (4, 2, 1))))
    report = vt.import_points(
        tmp_path / "a.stl", compat="toolkit", depth=1, gzip=False, dense="never"
    )
    volume = vt.open(report.paths[0])
    assert len(volume) == 8
    assert volume.info.box == (0.0, 0.0, 0.0, 4.0, 2.0, 1.0)
    assert not volume.has_metadata


def test_formats_that_it_does_not_read_are_refused(tmp_path):
    (tmp_path / "a.bt").write_bytes(encode_bt(np.array([[1, 2, 3]]), 0.5))
    (tmp_path / "a.csv").write_text("x,y,z\n1,2,3\n")
    np.save(tmp_path / "a.npy", np.ones((4, 4, 4), np.uint8))
    for name in ("a.bt", "a.csv", "a.npy"):
        with pytest.raises(InputError, match="the toolkit reads no") as caught:
            vt.import_points(tmp_path / name, compat="toolkit", depth=2)
        assert caught.value.code == "E_TOOLKIT"
    with pytest.raises(OptionError, match="can't go with --columns"):
        vt.import_points(tmp_path / "a.csv", compat="toolkit", depth=2, columns="x,y,z")


def test_one_point_is_written_sparse_and_refused_dense(tmp_path):
    (tmp_path / "a.xyz").write_text("1 2 3 4\n")
    options = {"compat": "toolkit", "depth": 2, "overwrite": True}
    assert len(vt.import_points(tmp_path / "a.xyz", **options).paths) == 2
    with pytest.raises(InputError, match="all points are in one place"):
        vt.import_points(tmp_path / "a.xyz", dense="always", **options)
