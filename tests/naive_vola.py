"""Plain Python twins of the voxel kernels: exact rationals, dictionaries, one thing at a time."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

OUTSIDE = 2**64 - 1


def decimal(value: float) -> Fraction:
    return Fraction(repr(float(value)))


def cell_index(
    stored: int, scale: float, offset: float, origin: Fraction, side: Fraction, depth: int,
    ratio: Fraction = Fraction(1),
) -> int | None:  # fmt: skip
    """vola-format.md 3.2 for one axis; None outside the closed cube."""
    place = (int(stored) * decimal(scale) + decimal(offset)) * ratio - origin
    if place < 0 or place > side:
        return None
    if side == 0:
        return 0
    cells = 4**depth
    return min(cells - 1, math.floor(place * cells / side))


def interleave(cell: Sequence[int], depth: int) -> int:
    """Path key: 6 bits a level, root first, lx + 4 ly + 16 lz."""
    key = 0
    for level in range(depth - 1, -1, -1):
        lx, ly, lz = ((c >> (2 * level)) & 3 for c in cell)
        key = key * 64 + lx + 4 * ly + 16 * lz
    return key


def path_keys(
    points: Iterable[Sequence[int]], scale: Sequence[float], offset: Sequence[float],
    exact_cube: Sequence[Fraction], depth: int, z_ratio: Fraction = Fraction(1),
) -> list[int]:  # fmt: skip
    keys = []
    for point in points:
        ratios = (Fraction(1), Fraction(1), z_ratio)
        cell = [
            cell_index(
                point[a], scale[a], offset[a], exact_cube[a], exact_cube[3], depth, ratios[a]
            )
            for a in range(3)
        ]
        keys.append(OUTSIDE if None in cell else interleave(cell, depth))
    return keys


def level_words(keys: Iterable[int], depth: int) -> list[list[int]]:
    """Words of levels 1 to depth of a set of path keys, in VOLA order."""
    levels = []
    for level in range(1, depth + 1):
        words: dict[int, int] = defaultdict(int)
        for key in keys:
            cell = key >> (6 * (depth - level))
            words[cell >> 6] |= 1 << (cell & 63)
        levels.append([words[block] for block in sorted(words)] or ([0] if level == 1 else []))
    return levels


def pairs(word: int) -> int:
    """Face-sharing pairs of set cells, cell by cell."""
    n = 0
    for x in range(4):
        for y in range(4):
            for z in range(4):
                here = word >> (x + 4 * y + 16 * z) & 1
                if x < 3:
                    n += here & (word >> (x + 1 + 4 * y + 16 * z) & 1)
                if y < 3:
                    n += here & (word >> (x + 4 * (y + 1) + 16 * z) & 1)
                if z < 3:
                    n += here & (word >> (x + 4 * y + 16 * (z + 1)) & 1)
    return n


def half_up(value: Fraction) -> int:
    return min(max(math.floor(value + Fraction(1, 2)), 0), 255)


def metadata_words(
    keys: Sequence[int], depth: int, z: Sequence[int], attributes: Mapping[str, Sequence[Any]],
    channels: Iterable[str],
) -> list[list[int]]:  # fmt: skip
    """Metadata words of levels 1 to depth: means half up, most frequent class, byte 7 = 1."""
    channels = set(channels)
    levels = []
    for level in range(1, depth + 1):
        members: dict[int, list[int]] = defaultdict(list)
        for i, key in enumerate(keys):
            members[key >> (6 * (depth - level + 1))].append(i)
        levels.append([_word(members[block], z, attributes, channels) for block in sorted(members)])
    return levels


def _word(
    members: list[int], z: Sequence[int], attributes: Mapping[str, Sequence[Any]],
    channels: set[str],
) -> int:  # fmt: skip
    def mean(values: Sequence[Any]) -> Fraction:
        return Fraction(sum(int(values[i]) for i in members), len(members))

    word = 1 << 56
    if "rgb" in channels:
        colours = [attributes[name] for name in ("red", "green", "blue")]
        divisor = 256 if max(int(max(c)) for c in colours) > 255 else 1
        for byte, colour in enumerate(colours):
            word |= half_up(mean(colour) / divisor) << (8 * byte)
    if "height" in channels:
        low, high = int(min(z)), int(max(z))
        if high > low:
            word |= half_up((mean(z) - low) * 255 / (high - low)) << 24
    if "returns" in channels:
        word |= half_up((mean(attributes["number_of_returns"]) - 1) * 255 / 6) << 32
    if "intensity" in channels:
        most = int(max(attributes["intensity"]))
        if most:
            word |= half_up(mean(attributes["intensity"]) * 255 / most) << 40
    if "class" in channels:
        codes = Counter(int(attributes["classification"][i]) for i in members)
        word |= min(codes, key=lambda code: (-codes[code], code)) << 48
    return word
