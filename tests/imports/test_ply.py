"""PLY files: vertices of all kinds, surfaces, and headers that claim too much."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from making_imports import opened, ply, points_of

from volatool.errors import FormatError, OptionError, TruncatedError

RNG = np.random.default_rng(4)
XYZ = np.round(RNG.uniform(-500, 500, (40, 3)), 3)
COLUMNS = {
    "x": XYZ[:, 0],
    "nx": np.zeros(40, np.float32),
    "y": XYZ[:, 1],
    "z": XYZ[:, 2],
    "red": np.arange(40, dtype=np.uint8),
    "green": np.arange(40, 80, dtype=np.uint8),
    "blue": np.arange(80, 120, dtype=np.uint8),
    "scalar_Intensity": np.arange(40, dtype=np.float32) * 100,
    "class": np.full(40, 6, np.int32),
}
ORDERS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("faces", [(), [(0, 1, 2), (3, 4, 5, 6)]])
def test_vertices_are_points(tmp_path, order, faces):
    """With float64 coordinates exact; faces behind them are passed by."""
    (tmp_path / "a.ply").write_bytes(ply(COLUMNS, order, faces))
    xyz, attributes = points_of(tmp_path / "a.ply", 7)
    assert np.array_equal(xyz, XYZ)
    for name in ("red", "green", "blue"):
        assert attributes[name].tolist() == COLUMNS[name].tolist()
    assert attributes["intensity"].tolist() == [100 * k for k in range(40)]
    assert set(attributes["classification"]) == {6}


def test_colours_of_0_to_1_are_scaled_and_told(tmp_path):
    columns = {**COLUMNS, "red": np.linspace(0, 1, 40, dtype=np.float32)}
    columns |= {name: np.ones(40, np.float32) for name in ("green", "blue")}
    (tmp_path / "a.ply").write_bytes(ply(columns))
    _, attributes = points_of(tmp_path / "a.ply")
    assert attributes["red"].max() == attributes["green"].min() == 255
    assert attributes["red"][1] == round(255 / 39)
    assert any("red x 255" in w.message for w in opened(tmp_path / "a.ply").warnings)


@pytest.mark.parametrize("order", ORDERS)
def test_lists_before_the_vertices_need_plyfile(tmp_path, order, monkeypatch):
    columns = {axis: COLUMNS[axis] for axis in "xyz"}
    data = ply(columns, order)
    strips = b"element strip 1\nproperty list uchar int ids\nelement vertex"
    data = data.replace(b"element vertex", strips)
    head, rest = data.split(b"end_header\n")
    sign = {"a": "", "b": "<"}[order[0]] if "big" not in order else ">"
    first = b"2 7 8\n" if not sign else b"\x02" + np.array([7, 8], f"{sign}i4").tobytes()
    (tmp_path / "a.ply").write_bytes(head + b"end_header\n" + first + rest)
    assert np.array_equal(points_of(tmp_path / "a.ply")[0], XYZ)
    monkeypatch.setitem(sys.modules, "plyfile", None)
    with pytest.raises(OptionError, match=r"pip install 'volatool\[mesh\]'") as caught:
        opened(tmp_path / "a.ply")
    assert caught.value.code == "E_NO_EXTRA"


@pytest.mark.parametrize("order", ORDERS)
def test_the_surface_of_faces_is_filled_on_request(tmp_path, order):
    """A square of 4 x 4: one layer of 16 voxels at depth 1, also where a face has four corners."""
    corners = np.array([[0, 0, 0.1], [4, 0, 0.1], [4, 4, 0.1], [0, 4, 0.1]])
    columns = {axis: corners[:, k] for k, axis in enumerate("xyz")}
    (tmp_path / "a.ply").write_bytes(ply(columns, order, [(0, 1, 2, 3)]))
    xyz, _ = points_of(tmp_path / "a.ply", mesh="voxelize", depth=1)
    assert sorted({(x, y) for x, y, _ in xyz.tolist()}) == [
        (x + 0.5, y + 0.5) for x in range(4) for y in range(4)
    ]
    assert len(xyz) == 16
    (tmp_path / "b.ply").write_bytes(ply(columns, order))
    with pytest.raises(OptionError, match="has no faces for --mesh voxelize"):
        opened(tmp_path / "b.ply", mesh="voxelize", depth=1)


@pytest.mark.parametrize("order", ORDERS)
def test_missing_vertices_are_nan(tmp_path, order):
    columns = {**COLUMNS, "y": np.where(np.arange(40) == 3, np.nan, COLUMNS["y"])}
    (tmp_path / "a.ply").write_bytes(ply(columns, order))
    source = opened(tmp_path / "a.ply")
    assert source.n_points == 39
    assert "W_NO_COORDINATES" in [w.code for w in source.warnings]


@pytest.mark.parametrize("order", ORDERS)
def test_a_cut_file_is_told(tmp_path, order):
    (tmp_path / "a.ply").write_bytes(ply(COLUMNS, order)[:-30])
    with pytest.raises(FormatError, match=r"a.ply: ") as caught:
        opened(tmp_path / "a.ply")
    assert caught.value.code in ("E_TRUNCATED", "E_CORRUPT")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"element vertex 40", b"element vertex 4000000000000", "more than its"),
        (b"element vertex 40", b"element vertex -1", "claims -1"),
        (b"element vertex 40", b"element vertex many", "header line 4"),
        (b"property double x", b"property double w", "no x"),
        (b"property double x", b"property quad x", "header line 5"),
        (b"element vertex", b"element corner", "has no vertices"),
        (b"ply\n", b"pli\n", "is no PLY file"),
        (b"format binary_little_endian", b"format binary_odd", "header line 2"),
        (b"end_header", b"end_head__", "before end_header"),
        (b"comment", b"remark!", "is no word of a PLY header"),
    ],
)
def test_a_crafted_header_is_refused(tmp_path, old, new, message):
    (tmp_path / "a.ply").write_bytes(ply(COLUMNS).replace(old, new, 1))
    with pytest.raises(FormatError, match=message):
        opened(tmp_path / "a.ply")


def test_a_crafted_list_is_refused(tmp_path):
    """A face that claims four billion vertices."""
    columns = {axis: COLUMNS[axis] for axis in "xyz"}
    data = ply(columns, faces=[(0, 1, 2)]).replace(b"list uchar int", b"list uint int")
    (tmp_path / "a.ply").write_bytes(data[:-13] + b"\xff\xff\xff\xff" + data[-12:])
    with pytest.raises((TruncatedError, FormatError), match=r"a\.ply"):
        opened(tmp_path / "a.ply", mesh="voxelize", depth=2)


@pytest.mark.parametrize("text", [False, True])
def test_what_plyfile_writes_is_read(tmp_path, text):
    """An independent writer."""
    import plyfile

    table = np.empty(40, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "u2")])
    table["x"], table["y"], table["z"] = XYZ.T
    table["intensity"] = np.arange(40)
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], text=text).write(tmp_path / "a.ply")
    xyz, attributes = points_of(tmp_path / "a.ply")
    assert np.array_equal(xyz, XYZ)
    assert attributes["intensity"].tolist() == list(range(40))
