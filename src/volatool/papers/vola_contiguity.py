"""Table 6 of the VOLA paper: contiguous cells of a block, by a formula and by sampling."""

from __future__ import annotations

from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np

from volatool.model import U64
from volatool.occupancy.levels import CELLS, PAIRS, expected_pairs
from volatool.papers.vola_printed import TABLE_6

SAMPLES = 100_000
"""Blocks drawn for each row."""

PAPERS_DRAWS = 1000
"""
Blocks that the paper's means may be of: as many as it says are not in our documents, but its means
and deviations lie as far from the exact ones as those of about a thousand.
"""

_PIECE = 25_000

SHARING = 1056
"""
Ordered pairs of different faces that have a cell in common.

Of the 64 cells 8 have 3 neighbours inside the block, 24 have 4, 24 have 5 and 8 have 6; the sum of
``k (k - 1)``.
"""


def deviation_of_pairs(n: int) -> float:
    """
    Return the standard deviation of the face-sharing pairs of `n` cells set at random in a block.

    Parameters
    ----------
    n : int
        0 to 64.

    Notes
    -----
    With p(k) the chance that k given cells are all set, ``n (n - 1) ... / (64 * 63 ...)``, the
    mean square of the number of pairs is the sum over ordered pairs of faces of the chance that
    all their cells are set: 144 times p(2) for a face with itself, 1056 times p(3) for faces with
    a common cell, and p(4) for the rest.

    Examples
    --------
    >>> round(deviation_of_pairs(7), 3), deviation_of_pairs(64)
    (1.101, 0.0)
    """
    p2, p3, p4 = (_all_set(k, n) for k in (2, 3, 4))
    square = PAIRS * p2 + SHARING * p3 + (PAIRS**2 - PAIRS - SHARING) * p4
    return sqrt(square - (PAIRS * p2) ** 2)


def _all_set(k: int, n: int) -> Fraction:
    """Return the chance that `k` given cells are among `n` cells drawn."""
    chance = Fraction(1)
    for i in range(k):
        chance *= Fraction(max(n - i, 0), CELLS - i)
    return chance


def random_blocks(n: int, count: int, rng: np.random.Generator) -> U64:
    """
    Draw blocks with `n` of their 64 cells set, each set of cells with the same chance.

    Parameters
    ----------
    n : int
        0 to 64.
    count : int
        Blocks.
    rng : numpy.random.Generator
        Source of chance.

    Returns
    -------
    words : (count,) array of uint64
    """
    cells = rng.permuted(np.tile(np.arange(CELLS) < n, (count, 1)), axis=1)
    packed = np.packbits(cells, axis=1, bitorder="little")
    words: U64 = packed.view("<u8").reshape(count).astype(np.uint64)
    return words


def sampled(n: int, samples: int, seed: int) -> dict[str, float]:
    """
    Count what random blocks have.

    Parameters
    ----------
    n : int
        Cells set.
    samples : int
        Blocks; at least 2.
    seed : int
        Of the source of chance, together with `n`: a row does not depend on the others.

    Returns
    -------
    found : dict
        ``pairs``, ``deviation``, ``standard_error`` (of the mean) and ``components``, the mean
        number of connected components.
    """
    from volatool.kernels.contiguity import count_each

    rng = np.random.default_rng([seed, n])
    pairs = np.empty(samples, np.int64)
    parts = np.empty(samples, np.int64)
    for start in range(0, samples, _PIECE):
        piece = slice(start, min(start + _PIECE, samples))
        count_each(random_blocks(n, piece.stop - start, rng), pairs[piece], parts[piece])
    deviation = float(pairs.std(ddof=1))
    return {
        "pairs": float(pairs.mean()),
        "deviation": deviation,
        "standard_error": deviation / sqrt(samples),
        "components": float(parts.mean()),
    }


def table_6(samples: int = SAMPLES, seed: int = 1) -> list[dict[str, Any]]:
    """
    Return Table 6, two lines for its row of 10 %.

    Parameters
    ----------
    samples : int
        Random blocks a line.
    seed : int
        Of their source of chance.

    Returns
    -------
    rows : list of dict
        ``percent``, ``cells``; ``printed`` (pairs, deviation, connected per cent, as text or None);
        ``exact`` (pairs, deviation, percent of 144); ``sampled``; ``pairs_agree`` and
        ``percent_agree`` whether the printed mean and per cent are those of so many cells, give or
        take three standard errors of a mean of `PAPERS_DRAWS` blocks.
    """
    rows = []
    for printed in TABLE_6:
        for cells in printed.cells:
            pairs, deviation = expected_pairs(cells), deviation_of_pairs(cells)
            percent = 100 * pairs / PAIRS
            slack = 3 * deviation / sqrt(PAPERS_DRAWS)
            rows.append(
                {
                    "percent": printed.percent,
                    "cells": cells,
                    "occupancy": cells / CELLS,
                    "printed": {
                        "pairs": printed.pairs,
                        "deviation": printed.deviation,
                        "percent": printed.connected,
                    },
                    "exact": {"pairs": pairs, "deviation": deviation, "percent": percent},
                    "sampled": sampled(cells, samples, seed),
                    "pairs_agree": _near(printed.pairs, pairs, slack),
                    "percent_agree": _near(printed.connected, percent, 100 * slack / PAIRS),
                }
            )
    return rows


def _near(printed: str | None, exact: float, slack: float) -> bool | None:
    return None if printed is None else abs(float(printed) - exact) <= slack
