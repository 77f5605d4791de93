"""
The original toolkit's reader, as section 9 of vola-format.md tells of it, in plain Python.

Written from that text alone, and nothing of volatool is imported: what this reader makes of our
files is what a user of the toolkit gets, faults included (it takes every file for a sparse one,
looks at neither version nor mode, and never looks behind the last level).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

Place = tuple[float, float, float]
Cell = tuple[int, int, int]

UNKNOWN_CRS = 2000


class EndOfFileError(Exception):
    """It prints ``prematurely hit end of file`` and exits with status 0."""


@dataclass
class Reading:
    """What the toolkit's reader returns of a file."""

    depth: int
    nbits: int
    crs: int
    box: tuple[float, ...]
    voxels: list[Cell] = field(default_factory=list)
    """Depth first, by bit number."""
    words: list[int] = field(default_factory=list)
    """The metadata word of each voxel's block; empty without metadata."""
    words_per_level: list[int] = field(default_factory=list)
    metadata_words: list[int] = field(default_factory=list)
    """All of them, in the order of the file."""
    consumed: int = 0
    levels: list[list[int]] = field(default_factory=list)

    def coordinates(self) -> list[Place]:
        """Return the minimum corner of each voxel, its indices if the CRS is 2000."""
        if self.crs == UNKNOWN_CRS:
            return [(float(x), float(y), float(z)) for x, y, z in self.voxels]
        size = 4**self.depth
        side = max(self.box[3 + axis] - self.box[axis] for axis in range(3))
        return [
            (
                self.box[0] + x / size * side,
                self.box[1] + y / size * side,
                self.box[2] + z / size * side,
            )
            for x, y, z in self.voxels
        ]

    def get_voxel(self, x: int, y: int, z: int) -> list[int] | bool:
        """Return the block numbers on the way down, False if not set; indices wrap round."""
        numbers, number = [], 0
        for level, words in enumerate(self.levels):
            numbers.append(number)
            lx, ly, lz = (value // 4 ** (self.depth - 1 - level) % 4 for value in (x, y, z))
            bit = lx + 4 * ly + 16 * lz
            if not words[number] >> bit & 1:
                return False
            below = words[number] & (1 << bit) - 1
            number = sum(word.bit_count() for word in words[:number]) + below.bit_count()
        return numbers


def read(data: bytes) -> Reading:
    """
    Read a file.

    Raises
    ------
    EndOfFileError
        The file is cut at a word.
    struct.error
        It is cut inside one.
    """
    fields = struct.unpack("<IHBBII8d", data[:80])
    found = Reading(depth=fields[3], nbits=fields[4], crs=fields[5], box=fields[8:])
    at = 80

    def take(n_words: int) -> list[int]:
        nonlocal at
        words = []
        for _ in range(n_words):
            piece = data[at : at + 8]
            if not piece:
                raise EndOfFileError
            words += struct.unpack("<Q", piece)
            at += 8
        return words

    blocks: list[Cell] = [(0, 0, 0)]
    for _ in range(found.depth):
        words = take(len(blocks))
        # one word for each block, whatever the number of bits is
        metadata = take(len(blocks)) if found.nbits else []
        found.levels.append(words)
        found.words_per_level.append(len(words))
        found.metadata_words += metadata
        cells, found.words = [], []
        for number, (x, y, z) in enumerate(blocks):
            for bit in range(64):
                if words[number] >> bit & 1:
                    cells.append((4 * x + bit % 4, 4 * y + bit // 4 % 4, 4 * z + bit // 16))
                    found.words += metadata[number : number + 1]
        blocks = cells
    found.voxels = blocks
    found.consumed = at
    return found
