"""Parts of a grid that hang together, and whether anything holds them."""

from volatool.kernels._jit import kernel


@kernel
def root(flat, k):
    """
    First node of the part that a node belongs to, shortening the way there.

    Parameters
    ----------
    flat : (n,) array of int32
        Each node's next one on the way to its first; a first node points at itself.
    k : int
        Node.
    """
    while flat[k] != k:
        flat[k] = flat[flat[k]]
        k = flat[k]
    return k


@kernel
def join_rows(edges, held, labels, start, stop):
    """
    Join rows to the parts above them; held is true in the end for the first node of a held part.

    Parameters
    ----------
    edges : (h, k, w) array of float32
        Factors; 0 is a cut.
    held : (h, w) array of bool
        In these rows: a point holds the node. Changed: a held node holds its part's first one.
    labels : (h, w) array of int32
        Rows `start` to `stop` are set, the ones above may change.
    start, stop : int
        Rows; strips must be done in order.
    """
    w = labels.shape[1]
    flat, holds = labels.reshape(labels.size), held.reshape(held.size)
    for r in range(start, stop):
        for q in range(w):
            k = r * w + q
            flat[k] = k
            for side in range(2):
                if side == 0:
                    if q == 0 or not edges[r, 0, q - 1] > 0:
                        continue
                    other = root(flat, k - 1)
                else:
                    if r == 0 or not edges[r - 1, 1, q] > 0:
                        continue
                    other = root(flat, k - w)
                mine = root(flat, k)
                low, high = min(mine, other), max(mine, other)
                flat[high] = low
                holds[low] |= holds[high]
            if holds[k]:
                holds[root(flat, k)] = True


@kernel
def unheld(labels, held):
    """
    Set ``held`` to whether a node belongs to a part that nothing holds.

    Parameters
    ----------
    labels : (h, w) array of int32
        As `join_rows` left them; changed.
    held : (h, w) array of bool
        As `join_rows` left it; replaced.

    Notes
    -----
    Parts point at a first node that comes before: from the last node backwards a first node's own
    entry is read by all others before it is replaced.
    """
    flat, out = labels.reshape(labels.size), held.reshape(held.size)
    for k in range(flat.size - 1, -1, -1):
        out[k] = not out[root(flat, k)]
