"""Meshes: no voxel that the surface touches is missed, samples lie close enough."""

from __future__ import annotations

import itertools
import sys

import naive_triangles as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from making_imports import box_triangles, opened, points_of, stl

import volatool as vt
from volatool.errors import FormatError, InputError, OptionError, ResourceError, TruncatedError
from volatool.imports import mesh
from volatool.kernels import triangles as kernels

HALVES = st.integers(0, 32).map(lambda k: k / 2)
CORNERS = st.lists(st.tuples(HALVES, HALVES, HALVES), min_size=3, max_size=3)


def cells_of(triangles, depth):
    room = np.empty((10_000, 3), np.int32)
    counts = kernels.touched_cells(np.asarray(triangles, float), depth, room, 10**9)
    return set(map(tuple, room[: counts.sum()].tolist()))


@settings(max_examples=25, deadline=None)
@given(CORNERS)
def test_touched_cells_are_those_of_the_naive_twin(corners):
    """Corners on faces, edges and corners of cells, points and lines too."""
    assert cells_of([corners], 2) == naive.touched_cells([corners], 2)


def test_touched_cells_of_random_triangles():
    rng = np.random.default_rng(7)
    for triangle in rng.uniform(0, 16, (25, 3, 3)):
        assert cells_of([triangle], 2) == naive.touched_cells([triangle], 2)


def test_counts_are_told_without_room():
    room = np.empty((0, 3), np.int32)
    counts = kernels.touched_cells(np.full((2, 3, 3), 3.5), 2, room, 9)
    assert counts.tolist() == [1, 1]


def test_counting_ends_at_the_limit():
    """A triangle of a trillion cells or samples would be counted for hours otherwise."""
    whole = np.array([[[0, 0, 0], [4.0**10, 0, 0], [0, 4.0**10, 0]]])
    counts = kernels.touched_cells(np.repeat(whole, 2, axis=0), 10, np.empty((5, 3), np.int32), 99)
    assert 99 < counts[0] < 99 + 64
    assert counts[1] == 0
    for spacing in (1e-6, 1e-300):
        assert kernels.count_samples(whole, spacing, 99)[0] > 99


def test_no_part_of_a_triangle_is_far_from_its_samples():
    rng = np.random.default_rng(8)
    thin = np.array([[0, 0, 0], [9, 0, 0], [4, 0.01, 0]])
    for corners in [*rng.uniform(0, 4, (6, 3, 3)), thin, np.zeros((3, 3)), thin[[0, 1, 1]]]:
        n = kernels.count_samples(corners[None], 0.4, 10**9)
        points = kernels.sample(corners[None], 0.4, int(n.sum()))
        share = rng.dirichlet([1, 1, 1], 300)
        on_it = share @ corners
        nearest = np.linalg.norm(on_it[:, None] - points[None], axis=2).min(axis=1)
        assert nearest.max() <= 0.4
        assert len(points) < 3 * (np.linalg.norm(np.ptp(corners, axis=0)) / 0.4 + 2) ** 2 / 2
        assert (points >= corners.min(axis=0) - 1e-9).all()
        assert (points <= corners.max(axis=0) + 1e-9).all()


BOX = box_triangles((0, 0, 0), (16, 8, 4))


def test_a_box_becomes_its_hull(tmp_path):
    """Voxels of the cube of side 16 at depth 2, those along faces, edges and corners of the box."""
    (tmp_path / "a.stl").write_bytes(stl(BOX + 0.25))
    source = opened(tmp_path / "a.stl", depth=2)
    cube, depth = source.own_grid
    assert (cube.origin, cube.side, depth) == ((0.25, 0.25, 0.25), 16.0, 2)
    xyz, _ = points_of(tmp_path / "a.stl", 100, depth=2)
    found = {tuple(int(v) for v in row) for row in (xyz - 0.25).tolist()}
    # closed cells: the faces y = 8 and z = 4 lie between two layers
    hull = {
        cell
        for cell in itertools.product(range(16), range(9), range(5))
        if cell[0] in (0, 15) or cell[1] in (0, 7, 8) or cell[2] in (0, 3, 4)
    }
    assert found == hull
    assert len(xyz) == len(found)


@pytest.mark.parametrize("options", [{}, {"cube": "20"}, {"snap": True}, {"resolution": "0.5"}])
def test_cube_and_depth_follow_the_options(tmp_path, options):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    cube, depth = opened(tmp_path / "a.stl", max_depth=4, **options).own_grid
    expected = {"cube": 20.0, "snap": 20.0}.get(next(iter(options), ""), 16.0)
    assert cube.side == expected
    assert depth == (3 if "resolution" in options else 4)


def test_samples_fill_a_subset(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    hull = {tuple(row) for row in np.floor(points_of(tmp_path / "a.stl", depth=2)[0]).tolist()}
    xyz, _ = points_of(tmp_path / "a.stl", 77, depth=2, mesh="sample")
    cells = {tuple(row) for row in np.minimum(np.floor(xyz), 15).tolist()}
    assert cells <= hull
    coarse, _ = points_of(tmp_path / "a.stl", mesh="sample", spacing="4")
    assert len(coarse) < len(xyz) / 20
    corners, _ = points_of(tmp_path / "a.stl", mesh="vertices")
    assert len(np.unique(corners, axis=0)) == 8


def test_y_up_is_turned(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    xyz, _ = points_of(tmp_path / "a.stl", depth=2, swap_yz=True)
    assert np.ptp(xyz, axis=0).round().tolist() == [15, 4, 8]
    xyz, _ = points_of(tmp_path / "a.stl", mesh="sample", depth=2, swap_yz=True)
    assert np.ptp(xyz, axis=0).round().tolist() == [16, 4, 8]


def test_heights_in_another_unit_are_scaled(tmp_path):
    """z in feet over metres: the cube is one in metres; the points' z are feet again."""
    (tmp_path / "a.stl").write_bytes(stl(BOX * [1, 1, 8]))
    crs = "EPSG:26910+6360"  # UTM in metres, NAVD88 in US survey feet
    source = opened(tmp_path / "a.stl", depth=2, crs=crs)
    assert source.own_grid[0].side == 16.0
    z = np.concatenate([chunk.xyz()[:, 2] for chunk in source.chunks()])
    assert (z.max(), z.min()) == (pytest.approx(9.5 / 0.3048006), pytest.approx(0.5 / 0.3048006))


def test_obj_is_read_and_without_faces_its_vertices(tmp_path):
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.reshape(-1, 3)]
    faces = [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(BOX))]
    (tmp_path / "a.obj").write_text("mtllib none.mtl\n" + "\n".join(lines + faces) + "\n")
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    expected = points_of(tmp_path / "a.stl", depth=2)[0]
    assert np.array_equal(points_of(tmp_path / "a.obj", depth=2)[0], expected)
    (tmp_path / "b.obj").write_text("\n".join(lines) + "\n")
    source = opened(tmp_path / "b.obj")
    assert source.n_points == 36
    assert "W_NO_FACES" in [w.code for w in source.warnings]


@pytest.mark.parametrize("group", [1, 50, 1 << 22])
def test_groups_of_triangles_do_not_matter(tmp_path, monkeypatch, group):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    expected = points_of(tmp_path / "a.stl", depth=2)[0]
    monkeypatch.setattr(mesh, "_GROUP_CELLS", group)
    assert np.array_equal(points_of(tmp_path / "a.stl", depth=2)[0], expected)


def test_too_many_voxels_are_refused(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    for options in ({}, {"mesh": "sample"}):
        with pytest.raises(ResourceError, match=r"more than the 16384 (voxels|points)"):
            points_of(tmp_path / "a.stl", depth=5, memory="1M", **options)


@pytest.mark.parametrize(
    ("content", "message", "kind"),
    [
        (stl(BOX)[:-1], "ends at triangle 11 of 12", TruncatedError),
        (stl(BOX)[:50], "inside its header", TruncatedError),
        (stl(BOX)[:80] + b"\xff" * 4 + stl(BOX)[84:], "of 4294967295", TruncatedError),
        (stl(BOX * np.nan), "corner that is not finite", FormatError),
        (b"solid x\nfacet normal 0 0 1\nouter loop\n", "without its line endsolid", TruncatedError),
    ],
)
def test_damaged_meshes_are_refused(tmp_path, content, message, kind):
    (tmp_path / "a.stl").write_bytes(content)
    with pytest.raises(kind, match=message):
        opened(tmp_path / "a.stl", depth=2)


def test_a_face_without_its_vertex_is_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    with pytest.raises(FormatError, match=r"a\.obj: "):
        opened(tmp_path / "a.obj", depth=2)


def test_a_mesh_finer_than_memory_is_refused_at_once(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    for options, message in (
        ({"depth": 10}, "more than the .* voxels .* smaller --depth"),
        ({"mesh": "sample", "spacing": "1e-9"}, "more than the .* points .* larger --spacing"),
    ):
        with pytest.raises(ResourceError, match=message) as caught:
            vt.import_points(tmp_path / "a.stl", **options)
        assert caught.value.code == "E_SIZE"
    assert [path.name for path in tmp_path.iterdir()] == ["a.stl"]


def test_without_trimesh_the_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.stl").write_bytes(stl(BOX))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(OptionError, match=r"pip install 'volatool\[mesh\]'") as caught:
        opened(tmp_path / "a.stl")
    assert caught.value.code == "E_NO_EXTRA"
    with pytest.raises(OptionError, match="--spacing is for --mesh sample"):
        opened(tmp_path / "a.stl", spacing="1m")


def test_a_mesh_is_cut_by_the_cube_of_another_volume(tmp_path):
    """Only what lies in it; a mesh beside it is an error."""
    (tmp_path / "g.xyz").write_text("0 0 0\n8 8 8\n")
    report = vt.import_points(tmp_path / "g.xyz", depth=2, dense="never")
    (tmp_path / "a.stl").write_bytes(stl(BOX + 0.25))
    options = {"cube_from": str(report.paths[0]), "dense": "never"}
    volume = vt.open(vt.import_points(tmp_path / "a.stl", **options).paths[0])
    assert (volume.cube.side, volume.depth) == (8.0, 2)
    cells = volume.voxels()
    assert cells[:, 0].max() == 15
    assert cells.min() == 0
    (tmp_path / "b.stl").write_bytes(stl(BOX + 100))
    with pytest.raises(InputError, match="no part of the surface lies in the cube"):
        vt.import_points(tmp_path / "b.stl", **options)
