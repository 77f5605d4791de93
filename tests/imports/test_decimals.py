"""Integers for coordinates: exact for decimals, as fine as can be for the rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from volatool.errors import FormatError
from volatool.imports.decimals import AxisSurvey


def axis_of(values):
    survey = AxisSurvey()
    for start in range(0, len(values), 3):
        survey.add(np.array(values[start : start + 3], np.float64))
    return survey.axis("x")


@given(
    st.integers(0, 6),
    st.integers(-9_000_000, 9_000_000),
    st.lists(st.integers(-(10**9), 10**9), min_size=1, max_size=12),
)
def test_decimals_of_text_come_back_exactly(decimals, start, stored):
    values = [float(f"{start * 10**decimals + value}e-{decimals}") for value in stored]
    axis = axis_of(values)
    assert axis.is_exact
    assert axis.decimals <= decimals
    back = axis.stored(np.array(values)).astype(np.int64)
    written = [f"{int(b) + round(axis.offset * 10**axis.decimals)}e-{axis.decimals}" for b in back]
    assert [float(text) for text in written] == values


@given(st.lists(st.floats(-1e7, 1e7), min_size=1, max_size=12))
def test_other_numbers_are_off_by_half_a_step_of_a_fine_scale(values):
    axis = axis_of(values)
    back = axis.stored(np.array(values)) * axis.scale + axis.offset
    largest = max(map(abs, values))
    assert np.abs(back - values).max() <= axis.scale * 0.5001 + 2 * np.spacing(largest)
    if not axis.is_exact:
        extent = max(values) - min(values)
        assert axis.scale <= max(extent / 2**31 * 11, 41 * np.spacing(largest), 1e-40)


def test_the_offset_is_zero_or_round():
    assert axis_of([1234.5, 9.25]).offset == 0.0
    axis = axis_of([5_000_000.001, 5_000_123.456])
    assert (axis.decimals, axis.offset) == (3, 5_000_000.0)
    assert (axis_of([0.0, 3e12]).decimals, axis_of([0.0, 3e12]).offset) == (-3, 2e12)
    assert axis_of([1e-20, 2e-20]).stored(np.array([1e-20, 2e-20])).tolist() != [0, 0]


def test_no_values_and_one_value():
    assert AxisSurvey().axis("x").is_exact
    assert axis_of([1 / 3]).scale <= 1e-9


def test_what_does_not_fit_is_refused():
    with pytest.raises(FormatError, match="too far apart") as caught:
        axis_of([-1.5e300, 1e300])
    assert caught.value.code == "E_BAD_COORDINATE"
