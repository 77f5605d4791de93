"""Plain Python twins of the algebra: voxels as sets of tuples, one thing at a time."""

from __future__ import annotations

import itertools
import math

import naive_formats as naive


def voxel_set(volume):
    return {tuple(row) for row in volume.voxels().tolist()}


def block_words(volume):
    """Metadata word of each block of each level, by path."""
    found = {}
    for level in range(1, volume.depth + 1):
        blocks = volume.voxels(level - 1) if level > 1 else [(0, 0, 0)]
        for block, word in zip(blocks, volume.metadata_words(level), strict=True):
            found[naive.path(tuple(map(int, block)), level - 1)] = int(word)
    return found


def pruned_words(volume, voxels):
    """Metadata words of what is left of a volume when only some voxels stay."""
    return _pruned(volume.depth, voxel_set(volume), block_words(volume), voxels)


def _pruned(depth, before, old, after):
    """Words of deepest blocks stay; above one that went they are means of the children left."""
    before = {naive.path(voxel, depth)[: depth - 1] for voxel in before}
    after = {naive.path(voxel, depth)[: depth - 1] for voxel in after}
    if not after:
        return {(): 1 << 56}
    words = {block: old[block] for block in after}
    for level in range(depth - 2, -1, -1):
        for block in {path[:level] for path in after}:
            lost = any(path[:level] == block for path in before - after)
            left = sorted({path[: level + 1] for path in after if path[:level] == block})
            words[block] = naive.mean_word([words[c] for c in left]) if lost else old[block]
    return words


def united_words(volumes):
    """Mean word of each block over the volumes that have it."""
    members = {}
    for volume in filter(len, volumes):  # an empty root says nothing
        for block, word in block_words(volume).items():
            members.setdefault(block, []).append(word)
    if not any(map(len, volumes)):
        return {(): 1 << 56}
    return {block: naive.mean_word(words) for block, words in members.items()}


def combined_words(a, b, op, voxels):
    """Metadata words of the result of an operation whose voxels are known."""
    start = united_words([a, b]) if op in ("or", "xor") else block_words(a)
    depth = a.depth
    blocks = (voxel_set(a) | voxel_set(b)) if op in ("or", "xor") else voxel_set(a)
    if op == "and":  # blocks that only one of both has are no candidates from the start
        other = block_words(b)
        blocks = {v for v in blocks if naive.path(v, depth)[: depth - 1] in other}
    return _pruned(depth, blocks, start, voxels)


def regridded(volume, cube, depth):
    """Cells of another grid that voxels set, one by one, and how many voxels set none."""
    n_source, n_target = 4**volume.depth, 4**depth
    edge = cube.exact[3] / n_target
    rounded = volume.info.quantizer != "floor"
    step = volume.cube.exact[3] / (n_source - rounded)
    found, lost = set(), 0
    for voxel in voxel_set(volume):
        ranges = []
        for axis in range(3):
            start = volume.cube.exact[axis] - cube.exact[axis] + step * voxel[axis]
            if rounded or edge >= step:
                place = start if rounded else start + step / 2
                cell = math.floor(place / edge)
                if place == cube.exact[3]:
                    cell = n_target - 1
                cells = [cell]
            else:
                first, last = math.floor(start / edge), math.ceil((start + step) / edge)
                cells = list(range(first, last))
            ranges.append([cell for cell in cells if 0 <= cell < n_target])
        cells = set(itertools.product(*ranges))
        lost += not cells
        found |= cells
    return found, lost


def far(changed, other, reach):
    """Voxels with none of another set within `reach` on every axis."""
    steps = list(itertools.product(range(-reach, reach + 1), repeat=3))
    return {
        voxel
        for voxel in changed
        if not any(tuple(map(sum, zip(voxel, step, strict=True))) in other for step in steps)
    }


def places(voxels, depth, level, by):
    """How many voxels there are at each place."""
    edge = 4 ** (depth - level + 1)
    found = {}
    for x, y, z in voxels:
        place = (x // edge, y // edge, z // edge if by == "block" else 0)
        found[place] = found.get(place, 0) + 1
    return found
