"""Conditions on reports: what is read, what is refused, what is found."""

from __future__ import annotations

import pytest

from volatool.conditions import condition_names, failures, parse_condition
from volatool.errors import CodedWarning, OptionError
from volatool.report import Report

TILE = Report(
    status="ok",
    input={
        "name": "a.laz",
        "points_used": 1000,
        "compressed": True,
        "dropped": {"withheld": 7},
        "classes": {"1": 400, "2": 600},
        "returns": {"1": 1000},
        "density": {"first_per_area_occupied": 7.5},
        "crs": {"horizontal": "EPSG:25832", "unit_xy": "metre"},
    },
    cube={"side": 100.0, "snapped": False},
    levels=({"level": 1, "occupancy": 0.4}, {"level": 2, "occupancy": 0.2}),
    choice={"depth": 2, "rule": "occupancy", "cell": 6.25},
    warnings=(CodedWarning("W_Z_UNIT", "no unit"),),
)
EMPTY = Report(status="empty", input={**TILE.input, "crs": None, "density": {}, "classes": {}})


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("density.first_per_area_occupied < 8", "7.5"),
        ("input.density.first_per_area_occupied < 7.5", None),
        ("density.first_per_area_occupied<=7.5", "7.5"),
        ("depth < 5", "2"),
        ("choice.depth >= 3", None),
        ("crs == none", None),
        ("crs != EPSG:28992", "EPSG:25832"),
        ("crs == 'EPSG:25832'", "EPSG:25832"),
        ("crs.unit_xy != metre", None),
        ("dropped.withheld > 0", "7"),
        ("dropped.noise > 0", None),
        ("classes.9 == 0", "0"),
        ("classes lacks 9", "1, 2"),
        ("classes lacks 2", None),
        ("classes has 2", "1, 2"),
        ("warnings has W_NO_CRS", None),
        ("warnings has W_Z_UNIT", "W_Z_UNIT"),
        ("levels.2.occupancy < 0.25", "0.2"),
        ("levels.3.occupancy < 0.25", "none"),
        ("snapped == false", "false"),
        ("compressed == none", None),
        ("status != ok", None),
        ("cell > 1e1", None),
    ],
)
def test_a_condition_tells_what_it_found(text, found):
    assert parse_condition(text).met_by(TILE) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("depth < 5", "none"),
        ("depth > 5", "none"),  # a value that is not there passes no gate, whichever way it asks
        ("density.first_per_area_occupied < 8", "none"),
        ("crs == none", "none"),
        ("crs.horizontal != EPSG:25832", "none"),
        ("classes lacks 2", "nothing"),
        ("classes has 2", None),
        ("classes.2 < 1", "0"),
        ("status == empty", "empty"),
    ],
)
def test_a_tile_without_points_passes_no_comparison(text, found):
    assert parse_condition(text).met_by(EMPTY) == found


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is not NAME OPERATOR VALUE"),
        ("depth", "is not NAME OPERATOR VALUE"),
        ("depth <", "is not NAME OPERATOR VALUE"),
        ("depth = 5", "operators are <, <=, >, >=, ==, !=, has, lacks"),
        ("depth == 5; import os", "is a number or none"),
        ("__import__('os') == 1", "is not NAME OPERATOR VALUE"),
        ("dpth < 5", "'dpth' is not in a report; there are bytes, cell, classes"),
        ("density < 8", "is not in a report"),
        ("bbox == none", "is not in a report"),
        ("levels.0.occupancy < 1", "is not in a report"),
        ("levels.2.colour < 1", "is not in a report"),
        ("classes.CODE == 1", "is not in a report"),
        ("depth < five", "is a number or none, not 'five'"),
        ("depth < nan", "is a number or none"),
        ("depth < none", "only numbers are less or greater"),
        ("crs < 5", "only numbers are less or greater"),
        ("snapped == yes", "is true, false or none"),
        ("classes == 2", "has or lacks something"),
        ("classes.ground > 0", "is not in a report"),
        ("classes has none", "has and lacks are for"),
        ("depth has 2", "has and lacks are for"),
    ],
)
def test_what_is_no_condition_is_refused(text, complaint):
    with pytest.raises(OptionError, match=complaint.replace("(", r"\(")):
        parse_condition(text)


def test_every_name_that_is_listed_can_be_asked_for():
    for name in condition_names():
        name = name.replace("CODE", "7").replace(".N.", ".3.")
        is_set = name in ("classes", "returns", "dropped", "warnings")
        parse_condition(f"{name} lacks x" if is_set else f"{name} == none").met_by(TILE)


def test_failures_are_in_the_order_of_tiles_then_conditions():
    conditions = [parse_condition("depth < 3"), parse_condition("points_used == 1000")]
    assert failures([TILE, EMPTY], conditions) == [
        "E_CHECK: a.laz: depth < 3 (found 2)",
        "E_CHECK: a.laz: points_used == 1000 (found 1000)",
        "E_CHECK: a.laz: depth < 3 (found none)",
        "E_CHECK: a.laz: points_used == 1000 (found 1000)",
    ]
