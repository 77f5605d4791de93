"""Reading the nodes of an OctoMap tree, as OctoMap serializes them."""

import numpy as np

from volatool.kernels._jit import kernel


@kernel
def topmost(nodes, threshold, depth, col, row, top):
    """
    Layer of the topmost occupied voxel in each column of a window.

    Parameters
    ----------
    nodes : (n,) array of uint8
        Nodes in pre-order, 5 bytes each: float32 log-odds, little endian, then one bit a child;
        child 1 lies to the east, 2 to the north, 4 above, and their sums.
    threshold : float
        Log-odds from which a leaf is occupied.
    depth : int
        Of the tree: the smallest voxels have an edge of 1, the root one of ``2 ** depth``.
    col, row : int
        Voxel key of the window's south-west corner.
    top : (h, w) array of int64
        Set: key of the topmost occupied voxel, row 0 in the south; -1 where there is none.

    Returns
    -------
    n_bytes : int64
        Bytes used; less than all, or -1, when `nodes` is no whole tree.

    Notes
    -----
    A leaf above the last level stands for all voxels in it: OctoMap prunes equal children.
    """
    h, w = top.shape
    top[:] = -1
    # children still to come, the next one on top: x, y, z and edge of each
    stack = np.empty((8 * depth + 8, 4), np.int64)
    stack[0, :3] = 0
    stack[0, 3] = 1 << depth
    n = 1
    at = 0
    while n > 0:
        n -= 1
        x, y, z, edge = stack[n]
        if at + 5 > nodes.size:
            return -1
        value = nodes[at : at + 4].view(np.float32)[0]
        children = nodes[at + 4]
        at += 5
        if children:
            half = edge >> 1
            if half == 0:
                return -1
            for k in range(7, -1, -1):
                if children >> k & 1:
                    stack[n, 0] = x + half * (k & 1)
                    stack[n, 1] = y + half * (k >> 1 & 1)
                    stack[n, 2] = z + half * (k >> 2)
                    stack[n, 3] = half
                    n += 1
        elif value >= threshold:
            for r in range(max(y - row, 0), min(y - row + edge, h)):
                for q in range(max(x - col, 0), min(x - col + edge, w)):
                    top[r, q] = max(top[r, q], z + edge - 1)
    return at
