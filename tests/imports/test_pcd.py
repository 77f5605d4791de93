"""PCD files: the three kinds of data, colours, and files that are not what they claim."""

from __future__ import annotations

import numpy as np
import pytest
from making_imports import opened, pcd, points_of

from volatool.errors import FormatError, TruncatedError

RNG = np.random.default_rng(3)
XYZ = np.round(RNG.uniform(-50, 50, (60, 3)), 2).astype(np.float32)
RGB = RNG.integers(0, 1 << 24, 60, dtype=np.uint32)
FIELDS = [
    ("_", np.zeros(60, np.uint8)),
    ("rgb", RGB),
    ("intensity", np.arange(60, dtype=np.float32)),
    ("label", (np.arange(60) % 20).astype(np.uint32)),
]
KINDS = ["ascii", "binary", "binary_compressed"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("as_float", [False, True])
def test_points_and_attributes_are_read(tmp_path, kind, as_float):
    fields = list(FIELDS)
    if as_float:  # PCL stores the bits of the colour as a float
        fields[1] = ("rgb", (RGB & 0x7F7FFFFF).view(np.float32))
    (tmp_path / "a.pcd").write_bytes(pcd(XYZ, kind, fields))
    xyz, attributes = points_of(tmp_path / "a.pcd", 17)
    assert np.abs(xyz - XYZ).max() < 1e-5
    rgb = RGB & 0x7F7FFFFF if as_float else RGB
    if as_float and kind == "ascii":  # denormal colours are printed with few digits
        pass
    assert attributes["red"].tolist() == ((rgb >> 16) & 255).tolist()
    assert attributes["green"].tolist() == ((rgb >> 8) & 255).tolist()
    assert attributes["blue"].tolist() == (rgb & 255).tolist()
    assert attributes["intensity"].tolist() == list(range(60))
    assert attributes["classification"].tolist() == [k % 20 for k in range(60)]


@pytest.mark.parametrize("kind", KINDS)
def test_rows_without_a_return_are_left_out_and_counted(tmp_path, kind):
    """An organized cloud; the attributes stay with their points."""
    xyz = XYZ.copy()
    xyz[[0, 7, 59], 1] = np.nan
    (tmp_path / "a.pcd").write_bytes(pcd(xyz, kind, FIELDS, height=6))
    found, attributes = points_of(tmp_path / "a.pcd", 10)
    assert len(found) == 57
    assert attributes["intensity"].tolist() == [k for k in range(60) if k not in (0, 7, 59)]
    warnings = {w.code: w.count for w in opened(tmp_path / "a.pcd").warnings}
    assert warnings["W_NO_COORDINATES"] == 3


def test_no_points_are_no_error(tmp_path):
    (tmp_path / "a.pcd").write_bytes(pcd(XYZ[:0]))
    assert opened(tmp_path / "a.pcd").n_points == 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_cut_file_is_told(tmp_path, kind):
    data = pcd(XYZ, kind)
    (tmp_path / "a.pcd").write_bytes(data[:-70])
    with pytest.raises(TruncatedError, match=r"a.pcd: .*(of 60|go on to|1 values)"):
        opened(tmp_path / "a.pcd")
    (tmp_path / "a.pcd").write_bytes(data[:60])
    with pytest.raises(TruncatedError, match="ends in its header"):
        opened(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"POINTS 60", b"POINTS 999999999999", "ends at point 60 of 999999999999"),
        (b"POINTS 60", b"POINTS 9999999999999999", "claims 9999999999999999 points"),
        (b"DATA binary", b"DATA bananas", "DATA bananas is not"),
        (b"FIELDS x", b"FIELDS w", "has no field x"),
        (b"VERSION", b"WERSION", "not of a PCD file"),
    ],
)
def test_a_crafted_header_is_refused(tmp_path, old, new, message):
    (tmp_path / "a.pcd").write_bytes(pcd(XYZ).replace(old, new))
    with pytest.raises(Exception, match=message) as caught:
        opened(tmp_path / "a.pcd")
    assert caught.value.code in ("E_CORRUPT", "E_TRUNCATED", "E_SIZE")


def test_infinite_coordinates_are_refused(tmp_path):
    xyz = XYZ.copy()
    xyz[5, 2] = np.inf
    (tmp_path / "a.pcd").write_bytes(pcd(xyz))
    with pytest.raises(FormatError, match="point 5: coordinates"):
        opened(tmp_path / "a.pcd")
