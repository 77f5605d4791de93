"""The binvox grid: order of the cells, runs against a naive reader, files that are bad."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError
from volatool.formats.binvox import encode_binvox, parse_binvox

HEADER = b"#binvox 1\ndim %d %d %d\ntranslate 10 20 30\nscale 8\ndata\n"


def naive_cells(data):
    """Cells of a file, one after the other: y fastest, then z, then x."""
    head, _, body = data.partition(b"data\n")
    lines = head.decode().splitlines()
    nx, nz, ny = next(map(int, line.split()[1:]) for line in lines if line.startswith("dim"))
    flat = itertools.chain.from_iterable(
        [value] * count for value, count in zip(body[::2], body[1::2], strict=True)
    )
    grid = itertools.product(range(nx), range(nz), range(ny))
    return [(x, y, z) for (x, z, y), value in zip(grid, flat, strict=True) if value]


def test_y_is_fastest_then_z_then_x():
    """By hand: the cells of 2 x 2 x 2 one after the other are (0,0,0), (0,1,0), (0,0,1), ..."""
    places = [(0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 0, 0), (1, 1, 0), (1, 0, 1)]
    for number, cell in enumerate(places):
        runs = [(0, number)] * (number > 0) + [(1, 1), (0, 7 - number)]
        expected = HEADER % (2, 2, 2) + b"".join(map(bytes, runs))
        assert parse_binvox(expected).cells().tolist() == [list(cell)]
        ours = encode_binvox([cell], 2, (10, 20, 30), 8)
        assert ours.partition(b"data\n")[2] == expected.partition(b"data\n")[2]


def test_the_text_is_as_binvox_writes_it_with_all_digits():
    data = encode_binvox([[0, 0, 0]], 4, (637000.01, 4850000.5, 0.1 + 0.2), 10.01)
    assert data.startswith(
        b"#binvox 1\ndim 4 4 4\ntranslate 637000.01 4850000.5 0.30000000000000004\n"
        b"scale 10.01\ndata\n"
    )
    grid = parse_binvox(data)
    assert grid.translate == (637000.01, 4850000.5, 0.1 + 0.2)
    assert grid.scale == 10.01
    assert grid.cell == 10.01 / 4
    np.testing.assert_allclose(grid.centers()[0] - grid.translate, 10.01 / 8)


def test_sides_that_differ_are_x_z_y_in_the_file():
    """dim 1 2 3: one cell in x, two in z, three in y; the cell's edge is that of the longest."""
    grid = parse_binvox(HEADER % (1, 2, 3) + bytes([0, 4, 7, 1, 0, 1]))
    assert grid.shape == (1, 3, 2)
    assert grid.cells().tolist() == [[0, 1, 1]]
    assert grid.centers().tolist() == [[10 + 4 / 3, 20 + 4, 30 + 4]]


@given(
    st.integers(1, 9).flatmap(
        lambda side: st.tuples(
            st.just(side), st.lists(st.tuples(*[st.integers(0, side - 1)] * 3), max_size=50)
        )
    )
)
@settings(max_examples=60, deadline=None)
def test_runs_are_those_of_the_naive_reader(case):
    side, cells = case
    data = encode_binvox(np.array(cells).reshape(-1, 3), side, (0, 0, 0), 1.0)
    grid = parse_binvox(data)
    assert naive_cells(data) == list(map(tuple, grid.cells().tolist()))
    assert set(naive_cells(data)) == set(cells)
    assert grid.n_cells == len(set(cells))


@pytest.mark.parametrize("length", [254, 255, 256, 510, 511])
def test_long_runs_are_cut_at_255(length):
    side = 8
    order = np.arange(1, 1 + length)
    x, z, y = np.unravel_index(order, (side,) * 3)
    data = encode_binvox(np.column_stack([x, y, z]), side, (0, 0, 0), 1.0)
    body = data.partition(b"data\n")[2]
    pairs = list(zip(body[::2], body[1::2], strict=True))
    assert all(count for _, count in pairs)
    assert sum(count for value, count in pairs if value) == length
    assert len([1 for value, _ in pairs if value]) == -(-length // 255)
    assert len(parse_binvox(data).cells()) == length


def test_trimesh_reads_the_same_cells():
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 16, (300, 3))
    data = encode_binvox(cells, 16, (1.5, 2.5, -3.0), 32.0)
    grid = trimesh.exchange.binvox.load_binvox(io.BytesIO(data))
    np.testing.assert_array_equal(np.argwhere(grid.matrix), np.unique(cells, axis=0))


GOOD = encode_binvox(np.random.default_rng(5).integers(0, 9, (50, 3)), 9, (1, 2, 3), 0.5)


@pytest.mark.parametrize("length", range(0, len(GOOD), 7))
def test_every_cut_is_noticed(length):
    with pytest.raises(FormatError, match="offset") as caught:
        parse_binvox(GOOD[:length])
    if length > 9:
        assert isinstance(caught.value, TruncatedError)


@pytest.mark.parametrize(
    ("data", "code", "message"),
    [
        (b"", "E_NOT_BINVOX", "empty"),
        (b"ply\nformat", "E_NOT_BINVOX", "found b'ply"),
        (GOOD.replace(b"binvox 1", b"binvox 2"), "E_NOT_BINVOX", "version 1"),
        (GOOD.replace(b"binvox 1", b"binvox 11"), "E_NOT_BINVOX", "version 1"),
        (GOOD.replace(b"dim 9 9 9", b"dim 9 9"), "E_CORRUPT", "3 numbers after 'dim'.*offset 10"),
        (GOOD.replace(b"dim 9 9 9", b"dim 9 -9 9"), "E_CORRUPT", "1 to 99999 cells"),
        (GOOD.replace(b"dim 9 9 9", b"dim 9 0 9"), "E_CORRUPT", "1 to 99999 cells"),
        (GOOD.replace(b"dim", b"mid"), "E_CORRUPT", "no line 'dim'"),
        (GOOD.replace(b"scale 0.5", b"scale nan"), "E_CORRUPT", "numbers after 'scale'"),
        (GOOD.replace(b"scale 0.5", b"scale 0"), "E_CORRUPT", "greater than 0"),
        (GOOD.replace(b"translate 1", b"translate x"), "E_CORRUPT", "after 'translate'.*x"),
        (GOOD.replace(b"dim 9 9 9", b"dim 9 9 8"), "E_CORRUPT", "goes on after the last"),
        (GOOD.replace(b"dim 9 9 9", b"dim 9 9 10"), "E_TRUNCATED", "810 cells"),
        (GOOD + b"\0\1", "E_CORRUPT", "2 bytes follow"),
        (HEADER % (99999, 99999, 99999) + b"\1\xff", "E_TRUNCATED", "999970000299999 cells"),
        (b"#binvox 1\n" + b"x" * 9999, "E_TRUNCATED", "line 'data'"),
    ],
    ids=range(16),
)
def test_bad_files_are_refused_with_a_reason(data, code, message):
    with pytest.raises(FormatError, match=message) as caught:
        parse_binvox(data)
    assert caught.value.code == code


@given(st.binary(max_size=60))
@settings(max_examples=100, deadline=None)
def test_any_runs_are_read_or_refused(noise):
    try:
        grid = parse_binvox(HEADER % (3, 2, 4) + noise)
    except FormatError:
        return
    assert (grid.shape, int(grid.counts.sum())) == ((3, 4, 2), 24)


def test_more_cells_than_wanted_are_not_expanded():
    grid = parse_binvox(HEADER % (100, 10, 51) + b"\1\xff" * 200)
    assert grid.n_cells == 51000
    for call in (grid.cells, grid.centers):
        with pytest.raises(ResourceError, match="51000") as caught:
            call(50999)
        assert caught.value.code == "E_SIZE"


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (([[0, 0, 4]], 4, (0, 0, 0), 1.0), OptionError),
        (([[0, -1, 0]], 4, (0, 0, 0), 1.0), OptionError),
        (([[0, 0, 0]], 4, (0, 0, 0), 0.0), OptionError),
        (([[0, 0, 0]], 0, (0, 0, 0), 1.0), OptionError),
        (([[0, 0, 0]], 4, (0, float("nan"), 0), 1.0), OptionError),
        (([[0, 0, 0]], 1025, (0, 0, 0), 1.0), ResourceError),
    ],
)
def test_what_is_no_grid_is_not_written(arguments, error):
    with pytest.raises(error):
        encode_binvox(*arguments)
