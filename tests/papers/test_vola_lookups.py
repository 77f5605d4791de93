"""Table 1: memory, look-ups, claims; what the contradictions amount to."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.papers import emap_octomap, vola_claims, vola_effects, vola_lookups, vola_scene
from volatool.papers.vola_printed import TABLE_1
from volatool.vola.volume import Volume

POINTS = 3000


@pytest.fixture(scope="module")
def volume():
    return vola_scene.surface(POINTS)


def test_the_surface_is_its_points(volume):
    """No chance in it, every level has the cells of the places, deeper levels divide by four."""
    places = vola_scene.surface_places(POINTS)
    assert places.min() >= 0
    assert places.max() < 1
    np.testing.assert_array_equal(places[:100], vola_scene.surface_places(100))
    for depth in (1, 3, 8):
        held = {tuple(cell) for cell in (places * 4**depth).astype(int).tolist()}
        assert {tuple(cell) for cell in volume.voxels(depth).tolist()} == held
    with pytest.raises(OptionError, match="at least one point"):
        vola_scene.surface(0)


def test_memory_is_exact(volume):
    """Sparse: the words; dense: every level complete; octree: a node a voxel and more."""
    found = vola_lookups.memory(POINTS, (2, 5))
    assert [row["depth"] for row in found["depths"]] == [2, 5]
    for row in found["depths"]:
        part = volume.truncated(row["depth"])
        assert row["sparse_bytes"] == sum(words.nbytes for words in part.levels)
        assert row["dense_bytes"] == 8 * sum(64**level for level in range(row["depth"]))
        assert row["voxels"] == part.n_voxels
        assert row["bits_per_voxel"] == 8 * row["sparse_bytes"] / row["voxels"]
        if emap_octomap.is_available():
            assert row["octree_nodes"] >= row["voxels"]
            assert row["octree_bytes"] > row["sparse_bytes"]


def test_memory_without_the_octree_library(monkeypatch):
    monkeypatch.setattr(emap_octomap, "is_available", lambda: False)
    found = vola_lookups.memory(POINTS, (3,))
    assert found["octree"] is None
    assert found["depths"][0]["octree_bytes"] is None


@pytest.mark.parametrize("depth", [2, 4, 8])
def test_all_ways_to_look_up_agree(volume, depth):
    """With counts, without, dense: voxels and other cells."""
    part = volume.truncated(depth)
    cells = np.random.default_rng(1).integers(0, 4**depth, (500, 3))
    cells[::2] = part.voxels()[:250]
    expected = part.contains_cells(cells)
    assert 0 < expected.sum() < len(cells) or depth == 8
    found = np.empty(len(cells), np.bool_)
    np.testing.assert_array_equal(vola_lookups.descent(part, cells)() >= 0, expected)
    vola_lookups.without_ranks(part, cells, found)()
    np.testing.assert_array_equal(found, expected)
    dense = vola_lookups.dense_found(part, cells, found)
    if depth == 8:
        assert dense is None  # 35 TB
    else:
        dense()
        np.testing.assert_array_equal(found, expected)


def test_the_octree_has_the_same_voxels(volume):
    pytest.importorskip("pyoctomap")
    for depth in (3, 8):
        part = volume.truncated(depth)
        tree = vola_lookups._octree(part)
        assert tree.getNumLeafNodes() == part.n_voxels
        labels = tree.getLabels(vola_lookups._moved(part.centers()))
        assert set(np.asarray(labels).tolist()) == {1}


def test_times_have_every_column_and_say_what_is_not_measured():
    """Shape only: nothing is compared with a clock."""
    found = vola_lookups.times(POINTS, (2, 6), queries=100, runs=1)
    assert [row["depth"] for row in found["depths"]] == [2, 6]
    assert found["depths"][0]["dense_ns"] >= 0
    assert found["depths"][1]["dense_ns"] is None
    for row in found["depths"]:
        names = {"sparse_ns", "in_order_ns", "anywhere_ns", "find_ns", "without_ranks_ns"}
        assert all(row[name] >= 0 for name in names)
    assert set(found["fits"]) == {"dense", "sparse", "in_order"}
    packing = vola_claims.packing_times(POINTS, (2, 6), runs=1)
    assert packing[0]["dense_pack_s"] >= 0
    assert packing[1]["dense_pack_s"] is None
    assert packing[1]["sparse_unpack_s"] >= 0


def test_a_line_through_points():
    fit = vola_lookups.line([(2, 5.0), (4, 9.0), (6, None)])
    assert fit == {"at_zero": 1.0, "slope": 2.0, "correlation": 1.0}
    assert vola_lookups.line([(2, 5.0)]) is None
    assert vola_lookups.line([(2, 5.0), (3, 5.0)])["correlation"] == 0


def test_the_eleven_claims_are_checked(volume):
    found = vola_claims.claims(volume.truncated(4))
    assert tuple(claim.row for claim in found) == TABLE_1
    assert {claim.verdict for claim in found} == {vola_claims.HOLDS, vola_claims.IN_PART}
    by_row = {claim.row: claim for claim in found}
    assert by_row["sparse search O(h)"].verdict == vola_claims.IN_PART


def test_a_claim_that_fails_is_not_passed_over(volume, monkeypatch):
    """If dense look-ups found other cells than sparse ones, the row could not say that it holds."""
    monkeypatch.setattr(Volume, "contains_cells", lambda self, cells: np.zeros(len(cells), bool))
    with pytest.raises(AssertionError, match="dense and sparse differ"):
        vola_claims.claims(volume.truncated(3))


def test_the_depth_follows_from_the_words(volume):
    """C11: without header one knows where levels begin, if the body is whole and nothing else."""
    for depth in range(1, 9):
        words = np.concatenate(volume.truncated(depth).levels)
        assert vola_claims.depth_of_words(words) == depth
        if depth > 1:
            assert vola_claims.depth_of_words(words[:-1]) is None
    assert vola_claims.depth_of_words(np.zeros(0, np.uint64)) == 0


def test_rounding_and_reading_back():
    """C12: half of the toolkit's points lie outside the cell shown for them; none of ours does."""
    found = vola_effects.reading_back(5000)
    assert found["ours"] == {"inside": 1.0, "farthest": pytest.approx(0.5, abs=1e-3)}
    assert found["toolkit"]["inside"] < 0.6
    assert 0.9 < found["toolkit"]["farthest"] < 1.001


def test_the_toolkits_cells_are_rounded_places():
    """C12: round half to even of (S - 1) p."""
    places = vola_scene.surface_places(200)
    expected = [[round(255 * p) for p in row] for row in places.tolist()]
    assert vola_effects.rounded(places, 4).tolist() == expected


def test_occupancy_seen_from_a_voxel_is_no_less():
    """C1a: E[n^2] / (64 E[n]) >= E[n] / 64 at each level."""
    found = vola_effects.rounding(0.2)
    pairs = zip(found["voxel_weighted"], found["floor"], strict=True)
    assert all(weighted >= plain - 1e-12 for weighted, plain in pairs)
    assert len(found["rounded"]) == 4
    # the deepest level is the same file's last one in both
    assert found["rounded_alone"][3] == found["rounded"][3]


def test_mean_and_last_point_of_a_block():
    """C7, against dictionaries."""
    n = 400
    places = vola_scene.surface_places(n)
    z = places[:, 2]
    byte = np.rint(255 * (z - z.min()) / np.ptp(z)).astype(int).tolist()
    cells = [tuple(cell) for cell in (places * 256).astype(int).tolist()]
    voxels = dict(zip(cells, byte, strict=True))  # the last point of a voxel stays
    last, groups = {}, {}
    for cell in sorted(voxels):
        last[tuple(c // 4 for c in cell)] = voxels[cell]
    for cell, value in zip(cells, byte, strict=True):
        groups.setdefault(tuple(c // 4 for c in cell), []).append(value)
    away = [abs(np.rint(np.mean(groups[block])) - last[block]) for block in last]
    found = vola_effects.block_words(n)
    assert found["differing"] == np.mean(np.array(away) != 0)
    assert found["largest"] == max(away)
    assert found["rms"] == pytest.approx(np.sqrt(np.mean(np.square(away))))


def test_edges_and_grids():
    """C5 and C8."""
    found = vola_effects.effects()
    assert 100 * found["cell_edge_m"] == pytest.approx(9.77, abs=0.01)
    assert found["dense_grid_bytes"]["side_5_m_cell_1_cm"] == 512 << 20
    assert found["leaf_share"] == pytest.approx(0.984, abs=0.001)
