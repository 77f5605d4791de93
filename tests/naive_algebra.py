"""Plain Python twins of the algebra: voxels as sets of tuples, one thing at a time."""

from __future__ import annotations

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
    depth = volume.depth
    old = block_words(volume)
    before = {naive.path(voxel, depth) for voxel in voxel_set(volume)}
    after = {naive.path(voxel, depth) for voxel in voxels}
    if not after:
        return {(): 1 << 56}
    words = {}
    for level in range(depth, 0, -1):
        for block in {path[: level - 1] for path in after}:
            children = {path[:level] for path in before if path[: level - 1] == block}
            left = sorted({path[:level] for path in after if path[: level - 1] == block})
            same = level == depth or (
                children == set(left) and all(words[child] == old[child] for child in left)
            )
            # a block below that got a new mean may have got the old number again
            touched = level < depth and any(
                {path for path in before if path[: depth - 1] == deepest}
                and not any(path[: depth - 1] == deepest for path in after)
                for deepest in {path[: depth - 1] for path in before if path[: level - 1] == block}
            )
            words[block] = (
                old[block] if same and not touched else naive.mean_word([words[c] for c in left])
            )
    return words
