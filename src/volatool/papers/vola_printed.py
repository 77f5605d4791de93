"""What the VOLA paper prints, as far as our documents have it; None is "not in our documents".

Numbers are kept as text, so that the digits say how exact they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

MISSING = "not in our documents"

TILE_M = 100
"""Metres a side of the paper's tiles."""

POINT_BYTES = (28, 34)
"""A point of LAS formats 1 and 3: between these the paper's data sets must lie."""


@dataclass(frozen=True, slots=True)
class PrintedLevel:
    """
    A row of Tables 2 to 5.

    Parameters
    ----------
    dense, sparse : str or None
        Decimal megabytes.
    occupancy : str or None
        Block occupancy, per cent.
    """

    dense: str | None = None
    sparse: str | None = None
    occupancy: str | None = None


@dataclass(frozen=True, slots=True)
class DataSet:
    """
    One of the paper's four data sets.

    Parameters
    ----------
    key, name : str
        For the JSON object, and for people.
    source : str
        What it is (section 4).
    table : int
        Its table of levels, 2 to 5.
    tiles : int
        Tiles of 100 m.
    levels : tuple of PrintedLevel
        From level 1.
    depth : int
        What Table 7 uses.
    vola_mb : str
        Table 7: 2 bits a voxel, decimal megabytes.
    las_gb : str or None
        Table 7: LAS, decimal gigabytes.
    vola_percent_of_las : str or None
        Table 7, if printed with it.
    zip_of_vola, zip_of_laz : str
        VOLAZip in per cent of VOLA and of LAZ, as recomputed from Table 7 when it was at hand: the
        columns themselves are not in our documents.
    density : str
        Points "per metre", section 4 and figures.
    las_density : (str, str) or None
        Points a square metre for 34 and 28 bytes a point, as recomputed from Table 7 when it was
        at hand; tells the size of the LAS files where that is not in our documents.
    """

    key: str
    name: str
    source: str
    table: int
    tiles: int
    levels: tuple[PrintedLevel, ...]
    depth: int
    vola_mb: str
    las_gb: str | None
    vola_percent_of_las: str | None
    zip_of_vola: str
    zip_of_laz: str
    density: str
    las_density: tuple[str, str] | None = None


DATA_SETS = (
    DataSet(
        key="san_francisco",
        name="San Francisco",
        source="ARRA Golden Gate, 2010",
        table=2,
        tiles=234_887,
        levels=(
            PrintedLevel("1.87", None, "46.8"),
            PrintedLevel("122.14", "40.2", "51.9"),
            PrintedLevel("7818.92", "881", "29.7"),
            PrintedLevel("500412.66", "12919"),
        ),
        depth=3,
        vola_mb="1762.6",
        las_gb="224",
        vola_percent_of_las="1.07",
        zip_of_vola="45.4",
        zip_of_laz="2.4",
        density="0.2",
    ),
    DataSet(
        key="new_york",
        name="New York",
        source="CMGP Post-Sandy, 2013-14",
        table=3,
        tiles=86_804,
        levels=(
            PrintedLevel(None, None, "39.2"),
            PrintedLevel(None, "13.2", "60.4"),
            PrintedLevel(None, "319", "31.3"),
            PrintedLevel(None, "4859"),
        ),
        depth=3,
        vola_mb="637.6",
        las_gb=None,
        vola_percent_of_las=None,
        zip_of_vola="52.7",
        zip_of_laz="1.5",
        density="1.5",
        las_density=("4.3", "5.2"),
    ),
    DataSet(
        key="montreal",
        name="Montreal",
        source="2012 (2015 in the paper's list of references)",
        table=4,
        tiles=66_299,
        levels=(
            PrintedLevel(None, None, "35.6"),
            PrintedLevel(None, "9.44", "62.5"),
            PrintedLevel(None, "233", "38.0"),
            PrintedLevel(None, "4106", "15.62"),
        ),
        depth=3,
        vola_mb="466.2",
        las_gb=None,
        vola_percent_of_las=None,
        zip_of_vola="40.6",
        zip_of_laz="0.7",
        density="8",
        las_density=("7.4", "9.0"),
    ),
    DataSet(
        key="dublin",
        name="Dublin",
        source="ALS, 2015",
        table=5,
        tiles=356,
        levels=(
            PrintedLevel(None, None, "52.5"),
            PrintedLevel(None, "0.065", "87.1"),
            PrintedLevel(None, "1.96", "48.3"),
            PrintedLevel(None, "40.8", "35.5"),
            # our two accounts of the paper have .948 and .947: exact is .947808
            PrintedLevel("48539.948", "684", "14.72"),
        ),
        depth=4,
        vola_mb="81.68",
        las_gb="36",
        vola_percent_of_las=None,
        zip_of_vola="40.4",
        zip_of_laz="0.9",
        density="190 (Figure 7), 348.43",
    ),
)


@dataclass(frozen=True, slots=True)
class PrintedContiguity:
    """
    A row of Table 6.

    Parameters
    ----------
    percent : int
        Of the block's cells, as the row is called.
    cells : tuple of int
        What that can mean.
    pairs, deviation : str or None
        Mean number of "connected components", and its standard deviation.
    connected : str or None
        Per cent of 144.
    """

    percent: int
    cells: tuple[int, ...]
    pairs: str | None
    deviation: str | None = None
    connected: str | None = None


TABLE_6 = (
    PrintedContiguity(100, (64,), "144"),
    PrintedContiguity(75, (48,), "80.44", "3.23"),
    PrintedContiguity(50, (32,), "35.31", "3.38"),
    PrintedContiguity(25, (16,), "8.58", "2.28"),
    PrintedContiguity(10, (7, 6), "1.49", "1.09", "0.75"),
)

TABLE_1 = (
    "bit sequence",
    "modular traversal",
    "variable depth",
    "dense search O(1)",
    "sparse search O(h)",
    "embedded support",
    "look-up table",
    "easily saved",
    "implicit",
    "cacheable",
    "hierarchical memory",
)
"""The eleven rows. What the table says of octrees is not in our documents."""


def interval(text: str) -> tuple[Fraction, Fraction]:
    """
    Return what a printed number may stand for, whether it was rounded or cut off.

    Examples
    --------
    >>> [float(end) for end in interval("40.2")]
    [40.15, 40.3]
    """
    unit = Fraction(1, 10 ** len(text.partition(".")[2]))
    value = Fraction(text)
    return value - unit / 2, value + unit


def agrees(exact: Fraction | float, text: str) -> bool:
    """
    Tell whether a number gives a printed one, rounded or cut off.

    Examples
    --------
    >>> agrees(1.879, "1.87"), agrees(1.879, "1.88"), agrees(1.879, "1.86")
    (True, True, False)
    """
    low, high = interval(text)
    return low <= Fraction(exact) < high


def occupancy(level: PrintedLevel) -> float | None:
    """Return the printed occupancy as a fraction."""
    return None if level.occupancy is None else float(Fraction(level.occupancy)) / 100
