"""Options that go together and those that don't."""

import pytest

from volatool.errors import OptionError
from volatool.model import Bounds
from volatool.options import ConvertOptions
from volatool.units import Length


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth": 3, "budget": 10}, "only one"),
        ({"depth": 11}, "1 to 10"),
        ({"max_depth": 1}, "2 to 10"),
        ({"min_occupancy": 0.0}, "min-occupancy"),
        ({"split": "100m", "snap": True}, "--split"),
        ({"split": "100m", "budget": 100}, "--budget"),
        ({"compat": "toolkit"}, "needs --depth"),
        ({"compat": "toolkit", "depth": 3, "to_crs": "utm"}, "--to-crs"),
        ({"compat": "other"}, "compat"),
        ({"meta": ("rgb", "smell")}, "smell"),
        ({"layers": ("sigma!",)}, "sigma!"),
        ({"returns": "second"}, "returns"),
        ({"cell": "-1m"}, "not a length"),
        ({"memory": "lots"}, "not a size"),
        ({"chunk_points": 0}, "chunk_points"),
        ({"classes": 2}, "sequence of class codes"),
        ({"bounds": (1, 0, 0, 1)}, "left, bottom, right, top"),
        ({"crs": 25832}, "EPSG:25832"),
        ({"depth": "auto"}, "whole number"),
        ({"thin": 0}, "thin"),
        ({"k_surface": 0}, "--k-surface"),
        ({"ell": "10m", "preset": "paper"}, "--ell"),
        ({"k_point": float("nan")}, "--k-point"),
        ({"compat": "toolkit", "depth": 3, "classes": (2,)}, "--class"),
    ],
)
def test_what_does_not_go_together_is_refused(options, message):
    with pytest.raises(OptionError, match=message):
        ConvertOptions(**options)


def test_text_is_parsed():
    options = ConvertOptions(cell="1m", memory="256M", budget="1K")
    assert (options.cell, options.memory, options.budget) == (Length.parse("1m"), 256 << 20, 1024)


def test_the_report_names_what_was_given_and_bears_on_the_result():
    assert ConvertOptions().given() == {}
    options = ConvertOptions(
        cell="0.5ft",
        bounds=Bounds(0, 1, 2, 3),
        classes=(2, 9),
        memory="256M",
        chunk_points=7,
        resources=False,
    )
    assert options.given() == {"cell": "0.5ft", "bounds": [0, 1, 2, 3], "classes": [2, 9]}
