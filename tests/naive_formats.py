"""Plain Python twins of the word kernels and the two file layouts, written from vola-format.md."""

from __future__ import annotations

import struct
from collections.abc import Iterable

Voxel = tuple[int, int, int]


def path(voxel: Voxel, depth: int) -> tuple[int, ...]:
    """Return the cell numbers from the root to a voxel."""
    digits = []
    for level in range(depth):
        x, y, z = (value // 4 ** (depth - 1 - level) % 4 for value in voxel)
        digits.append(x + 4 * y + 16 * z)
    return tuple(digits)


def cell(digits: tuple[int, ...]) -> Voxel:
    """Return the indices of the cell at the end of a path."""
    x = y = z = 0
    for digit in digits:
        x, y, z = 4 * x + digit % 4, 4 * y + digit // 4 % 4, 4 * z + digit // 16
    return x, y, z


def sparse_levels(voxels: Iterable[Voxel], depth: int) -> list[list[int]]:
    """Return the occupancy words of each level, in file order."""
    paths = {path(voxel, depth) for voxel in voxels}
    levels = []
    for level in range(depth):
        blocks: dict[tuple[int, ...], int] = {} if level else {(): 0}
        for digits in paths:
            block = digits[:level]
            blocks[block] = blocks.get(block, 0) | 1 << digits[level]
        levels.append([word for _, word in sorted(blocks.items())])
    return levels


def dense_level(voxels: Iterable[Voxel], depth: int, level: int) -> list[int]:
    """Return all words of a level (1 is the root) of a dense file."""
    side = 4**level
    words = [0] * 64 ** (level - 1)
    for voxel in voxels:
        x, y, z = (value // 4 ** (depth - level) for value in voxel)
        linear = x + y * side + z * side * side
        words[linear // 64] |= 1 << linear % 64
    return words


def contiguous_pairs(word: int) -> int:
    """Count face-sharing pairs of set cells in a block."""
    cells = {cell((bit,)) for bit in range(64) if word >> bit & 1}
    return (
        sum((x + 1, y, z) in cells for x, y, z in cells)
        + sum((x, y + 1, z) in cells for x, y, z in cells)
        + sum((x, y, z + 1) in cells for x, y, z in cells)
    )


def mean_word(words: list[int]) -> int:
    """Return the mean metadata word: halves up, byte 6 the most frequent, lowest of equals."""
    mean = 0
    for byte in range(8):
        values = [word >> 8 * byte & 255 for word in words]
        if byte == 6:
            value = min(set(values), key=lambda code: (-values.count(code), code))
        else:
            value = int(sum(values) / len(values) + 0.5)
        mean |= value << 8 * byte
    return mean


def header(mode: int, depth: int, nbits: int, box: tuple[float, ...], crs: int = 2000) -> bytes:
    """Return 80 bytes."""
    return struct.pack("<IHBBII8d", 80, 1, mode, depth, nbits, crs, 0.0, 0.0, *box)
