"""Selection masks are pure and exact, and count what they leave out."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from naive_points import las_bytes, naive_outside, random_las, written

from volatool.errors import OptionError
from volatool.model import Bounds, PointChunk
from volatool.points.header import read_header
from volatool.points.reader import open_points
from volatool.points.select import Selection, stored_range


def chunk_of(n: int = 1000, start: int = 0, **attributes: object) -> PointChunk:
    x = np.arange(n, dtype=np.int32)
    values = {name: np.asarray(v) for name, v in attributes.items()}
    return PointChunk(start, x, x.copy(), x.copy(), (0.01,) * 3, (0.0,) * 3, values)


def kept(selection: Selection, chunk: PointChunk) -> tuple[list[int], dict[str, int]]:
    dropped: dict[str, int] = {}
    mask = selection.mask(chunk, dropped)
    return (chunk.x if mask is None else chunk.x[mask]).tolist(), dropped


def test_default_drops_withheld_and_noise() -> None:
    """Classes 7 and 18 and withheld points; a point counts once, for the first reason."""
    chunk = chunk_of(
        5,
        classification=np.array([2, 7, 18, 7, 0], np.uint8),
        withheld=np.array([False, True, False, False, True]),
    )
    assert kept(Selection(), chunk) == ([0], {"withheld": 2, "noise": 2})
    assert kept(Selection(keep_withheld=True), chunk) == ([0, 4], {"noise": 3})
    assert kept(Selection(keep_noise=True), chunk) == ([0, 2, 3], {"withheld": 2})
    assert kept(Selection(keep_noise=True, keep_withheld=True), chunk)[1] == {}


def test_nothing_dropped_is_none() -> None:
    """No mask is made when all points pass."""
    chunk = chunk_of(3, classification=np.full(3, 2, np.uint8), withheld=np.zeros(3, bool))
    dropped: dict[str, int] = {}
    assert Selection().mask(chunk, dropped) is None
    assert dropped == {}


def test_classes() -> None:
    """Naming a noise class keeps it; excluding wins."""
    chunk = chunk_of(4, classification=np.array([2, 7, 9, 18], np.uint8))
    assert kept(Selection(frozenset({2, 7})), chunk) == ([0, 1], {"noise": 1, "class": 1})
    assert kept(Selection(exclude_classes=frozenset({9})), chunk) == ([0], {"noise": 2, "class": 1})
    both = Selection(frozenset({2, 9}), exclude_classes=frozenset({9}))
    assert kept(both, chunk) == ([0], {"noise": 2, "class": 1})


def test_returns() -> None:
    """First, last, and points that record neither."""
    chunk = chunk_of(
        5,
        return_number=np.array([1, 2, 3, 0, 1], np.uint8),
        number_of_returns=np.array([3, 3, 3, 0, 1], np.uint8),
    )
    assert kept(Selection(returns="first"), chunk) == ([0, 3, 4], {"return": 2})
    assert kept(Selection(returns="last"), chunk) == ([2, 3, 4], {"return": 2})


@pytest.mark.parametrize("size", [1, 7, 100, 1000])
@pytest.mark.parametrize("thin", [2, 3, 10, 5000])
def test_thinning_goes_by_the_number_in_the_file(size: int, thin: int) -> None:
    """Whatever the chunks."""
    out = []
    for start in range(0, 1000, size):
        n = min(size, 1000 - start)
        mask = Selection(thin=thin).mask(chunk_of(n, start), {})
        numbers = np.arange(start, start + n)
        out += (numbers if mask is None else numbers[mask]).tolist()
    assert out == list(range(0, 1000, thin))


def test_bounds_are_closed_and_exact() -> None:
    """0.1 / 0.01 is 10.000000000000002 in floating point, 0.29 / 0.01 is 28.999999999999996."""
    got, dropped = kept(Selection(bounds=Bounds(0.1, 0.0, 0.29, 100.0)), chunk_of(1000))
    assert got == list(range(10, 30))
    assert dropped == {"bounds": 980}
    assert kept(Selection(bounds=Bounds(1e9, 0, 2e9, 1)), chunk_of(3))[1] == {"bounds": 3}
    assert kept(Selection(bounds=Bounds(-1e300, -1e300, 1e300, 1e300)), chunk_of(3))[1] == {}


decimals = st.integers(-(10**9), 10**9).map(lambda n: f"{n / 1000:.3f}")


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.sampled_from(["0.01", "0.001", "0.00025", "0.1"]),
    decimals,
    decimals,
    decimals,
)
def test_bounds_equal_decimal_arithmetic(
    stored: int, scale: str, offset: str, one: str, other: str
) -> None:
    """The stored range is what decimal numbers say."""
    low, high = sorted((one, other), key=float)
    first, last = stored_range(float(scale), float(offset), float(low), float(high))
    assert (not first <= stored <= last) == naive_outside(stored, scale, offset, low, high)


def test_attributes_are_only_those_looked_at() -> None:
    """So that the decoder can leave out the others."""
    data = las_bytes()
    header = read_header(io.BytesIO(data), len(data))
    assert Selection().attributes(header) == {"withheld", "classification"}
    assert Selection(keep_withheld=True, keep_noise=True).attributes(header) == set()
    assert "return_number" in Selection(returns="last").attributes(header)


def test_counts_do_not_depend_on_chunks() -> None:
    """Sum of dropped and kept is the file, for any chunk size."""
    selection = Selection(returns="first", bounds=Bounds(-1e7, -1e6, 1e7, 1e6), thin=3)
    data = written(random_las(6, n=4000), False)
    seen = []
    for size in (10, 333, 10_000):
        dropped: dict[str, int] = {}
        n = 0
        with open_points(io.BytesIO(data)) as source:
            for chunk in source.chunks(selection.attributes(source.header), size):
                mask = selection.mask(chunk, dropped)
                n += len(chunk) if mask is None else int(mask.sum())
        assert n + sum(dropped.values()) == 4000
        seen.append((n, dropped))
    assert seen[0] == seen[1] == seen[2]


@pytest.mark.parametrize(
    "bad",
    [
        {"returns": "second"},
        {"thin": 0},
        {"classes": frozenset({256})},
        {"bounds": Bounds(0, 0, float("inf"), 1)},
    ],
)
def test_senseless_rules_are_refused(bad: dict[str, object]) -> None:
    """With an error of options."""
    with pytest.raises(OptionError):
        Selection(**bad)  # type: ignore[arg-type]
