"""Channel names, the attributes they need, and what the trailer says of the bytes."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.errors import OptionError
from volatool.vola.metadata import (
    CHANNELS,
    Ranges,
    Scaling,
    attributes_for,
    channels_of,
    check_channels,
)


def test_channels_are_put_in_the_order_of_the_word():
    """Asked for in any order, also twice."""
    assert check_channels(["class", "rgb", "class"]) == ("rgb", "class")
    assert check_channels([]) == ()
    with pytest.raises(OptionError, match=r"no metadata channel is called 'x'; there are rgb, "):
        check_channels(["x"])


def test_a_file_fills_the_channels_that_it_has_the_attributes_for():
    """Two colours are no rgb; height is always there."""
    assert channels_of({"red", "green", "classification"}) == ("height", "class")
    assert channels_of(attributes_for(CHANNELS)) == CHANNELS


def test_ranges_are_those_of_all_points():
    """In any pieces; without a point there is none."""
    ranges = Ranges()
    ranges.add(np.empty(0, np.int32), {})
    assert ranges.z_min is None
    for z in ([5, -7], [100]):
        colour = np.array([3] * len(z), np.uint16)
        ranges.add(np.array(z, np.int32), dict.fromkeys(("red", "green", "blue"), colour))
    assert (ranges.z_min, ranges.z_max, ranges.colour_max, ranges.intensity_max) == (-7, 100, 3, 0)


def test_the_description_turns_bytes_back_into_values():
    """value = byte x scale + offset at both ends of every channel, and byte 7 is named."""
    ranges = Ranges(z_min=-100, z_max=25_400, colour_max=65_535, intensity_max=1020)
    scaling = Scaling.of(CHANNELS, ranges, 0.01, 50.0, "foot")
    by_name = {c["name"]: c for c in scaling.channels}
    assert [c["byte"] for c in scaling.channels] == list(range(8))

    def value(name, byte):
        return byte * by_name[name]["scale"] + by_name[name]["offset"]

    assert value("red", 255) == 65_280
    assert (value("height", 0), value("height", 255)) == pytest.approx((49.0, 304.0))
    assert (value("returns", 0), value("returns", 255)) == pytest.approx((1, 7))
    assert value("intensity", 255) == pytest.approx(1020)
    assert (value("class", 6), by_name["class"]["reduction"]) == (6, "mode")
    assert (by_name["height"]["unit"], by_name["present"]["reduction"]) == ("foot", "constant")


def test_flat_and_dark_files_scale_to_zero():
    """No division by a range of 0."""
    scaling = Scaling.of(("height", "intensity"), Ranges(z_min=4, z_max=4), 0.01, 0.0)
    assert scaling.table[3].tolist() == [4, 0, 1]
    assert scaling.table[5].tolist() == [0, 0, 1]
    assert not scaling.has_class
    assert Scaling.of((), Ranges(), 1.0, 0.0).channels == ()
