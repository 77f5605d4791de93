"""Random signs that hang on identity alone, and the random forces of springs made from them.

A sign belongs to a point (its stored integers) or to a surface spring (its kind and the absolute
index of its node) and to the number of a sample; not to loops, chunks, strips or threads. One
64-bit hash holds the signs of 64 samples. Signs have mean 0 and variance 1, which is all that a
covariance asks for, need no logarithms and vary less than normal numbers do.
"""

import numpy as np

from volatool.kernels._jit import kernel

KINDS = 5
"""Springs that a node answers for: east, south, bending across, bending down, twist."""


@kernel
def mix(value):
    """
    Scramble 64 bits: the finaliser of splitmix64.

    Parameters
    ----------
    value : uint64
        Any number.

    Returns
    -------
    bits : uint64
        Each bit hangs on every bit of `value`.
    """
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@kernel
def hash_three(a, b, c, salt):
    """
    Hash of three whole numbers.

    Parameters
    ----------
    a, b, c, salt : int64
        Numbers.

    Returns
    -------
    bits : uint64
        The hash.
    """
    step = np.uint64(0x9E3779B97F4A7C15)
    bits = mix(np.uint64(salt) + step)
    bits = mix((bits ^ np.uint64(a)) + step)
    bits = mix((bits ^ np.uint64(b)) + step)
    return mix((bits ^ np.uint64(c)) + step)


@kernel
def hash_rows(rows, salt, out):
    """
    Hash of each point's stored integers: equal points have equal hashes.

    Parameters
    ----------
    rows : (n, 3) array of int32
        Stored x, y, z.
    salt : int
        Another salt, another hash.
    out : (n,) array of uint64
        Set.
    """
    for i in range(rows.shape[0]):
        out[i] = hash_three(rows[i, 0], rows[i, 1], rows[i, 2], salt)


@kernel
def point_forces(col, row, bits, weight, is_nearest, sample, first, last, forces):
    """
    Add random forces ``sqrt(weight) e phi`` of points.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells, as for `spring.accumulate`.
    bits : (n,) array of uint64
        Signs of each point; bit k belongs to sample k.
    weight : float
        Stiffness of a point's spring.
    is_nearest : bool
        Attach to the nearest node alone.
    sample : int
        The first sample's number.
    first, last : int
        Only rows ``first <= r < last`` are touched.
    forces : (h, w, m) array of float32
        Of samples ``sample .. sample + m``, added to.
    """
    h, w, m = forces.shape
    root = np.sqrt(weight)
    signs = np.empty(m, np.float32)
    for i in range(col.size):
        x = col[i]
        y = row[i]
        if not (x >= 0.0 and x <= w and y >= 0.0 and y <= h):
            continue
        if is_nearest:
            r = min(np.int64(y), h - 1)
            q = min(np.int64(x), w - 1)
            u = 0.0
            v = 0.0
        else:
            x = max(x - 0.5, 0.0)
            y = max(y - 0.5, 0.0)
            q = min(np.int64(x), w - 2)
            r = min(np.int64(y), h - 2)
            u = min(x - q, 1.0)
            v = min(y - r, 1.0)
        if r + 1 < first or r >= last:
            continue
        for k in range(m):
            bit = (bits[i] >> np.uint64(sample + k)) & np.uint64(1)
            signs[k] = root if bit else -root
        for down in range(2):
            if not first <= r + down < last:
                continue
            part_y = v if down else 1.0 - v
            for right in range(2):
                part = np.float32(part_y * (u if right else 1.0 - u))
                if part > 0.0:
                    target = forces[r + down, q + right]
                    for k in range(m):
                        target[k] += part * signs[k]


@kernel
def pull(forces, r, q, factor, bits, sample, first, last):
    """
    Add a signed force to one node in all samples, if its row is to be touched.

    Parameters
    ----------
    forces : (h, w, m) array of float32
        Added to.
    r, q : int
        Node.
    factor : float32
        Force.
    bits : uint64
        Signs.
    sample, first, last : int
        As for `point_forces`.
    """
    if first <= r < last:
        target = forces[r, q]
        for k in range(target.size):
            bit = (bits >> np.uint64(sample + k)) & np.uint64(1)
            target[k] += factor if bit else -factor


@kernel
def surface_forces(kb, km, top, left, sample, first, last, forces):
    """
    Add random forces ``sqrt(k) e`` of every surface spring, on all nodes that it holds.

    Parameters
    ----------
    kb, km : float
        Stiffness of the bending and stretching springs.
    top, left : int
        Absolute index of node (0, 0): neighbouring grids agree on their springs' signs.
    sample : int
        The first sample's number.
    first, last : int
        Only rows ``first <= r < last`` are touched.
    forces : (h, w, m) array of float32
        Of samples ``sample .. sample + m``, added to.
    """
    h, w, _ = forces.shape
    stretch = np.float32(np.sqrt(km))
    bend = np.float32(np.sqrt(kb))
    twist = np.float32(np.sqrt(2.0 * kb))
    for r in range(max(0, first - 1), min(h, last + 1)):
        for q in range(w):
            a, b = top + r, left + q
            if km > 0.0:
                if q + 1 < w and first <= r < last:
                    bits = hash_three(a, b, 0, 1)
                    pull(forces, r, q, stretch, bits, sample, first, last)
                    pull(forces, r, q + 1, -stretch, bits, sample, first, last)
                if r + 1 < h:
                    bits = hash_three(a, b, 1, 1)
                    pull(forces, r, q, stretch, bits, sample, first, last)
                    pull(forces, r + 1, q, -stretch, bits, sample, first, last)
            if kb > 0.0:
                if 0 < q < w - 1 and first <= r < last:
                    bits = hash_three(a, b, 2, 1)
                    pull(forces, r, q - 1, bend, bits, sample, first, last)
                    pull(forces, r, q, -2 * bend, bits, sample, first, last)
                    pull(forces, r, q + 1, bend, bits, sample, first, last)
                if 0 < r < h - 1:
                    bits = hash_three(a, b, 3, 1)
                    pull(forces, r - 1, q, bend, bits, sample, first, last)
                    pull(forces, r, q, -2 * bend, bits, sample, first, last)
                    pull(forces, r + 1, q, bend, bits, sample, first, last)
                if r + 1 < h and q + 1 < w:
                    bits = hash_three(a, b, 4, 1)
                    pull(forces, r, q, twist, bits, sample, first, last)
                    pull(forces, r, q + 1, -twist, bits, sample, first, last)
                    pull(forces, r + 1, q, -twist, bits, sample, first, last)
                    pull(forces, r + 1, q + 1, twist, bits, sample, first, last)


@kernel
def add_squares(z, step, top, left, start, stop, out):
    """
    Add the squares of a coarse grid's heights, read at the centres of a fine grid's cells.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the coarse nodes.
    step : int
        Fine cells a side of a coarse one.
    top, left : int
        Fine cells from the coarse grid's corner to the fine grid's.
    start, stop : int
        Fine rows.
    out : (m, n) array of float32
        Added to.
    """
    h, w = z.shape
    line = np.empty(w)
    for r in range(start, stop):
        y = min(max((top + r + 0.5) / step - 0.5, 0.0), h - 1.0)
        i = min(np.int64(y), h - 2)
        v = y - i
        for q in range(w):
            line[q] = (1.0 - v) * z[i, q] + v * z[i + 1, q]
        for q in range(out.shape[1]):
            x = min(max((left + q + 0.5) / step - 0.5, 0.0), w - 1.0)
            j = min(np.int64(x), w - 2)
            value = line[j] + (x - j) * (line[j + 1] - line[j])
            out[r, q] += value * value


@kernel
def add_to_blocks(col, row, residuals, freedoms, cells, sums):
    """
    Sum by square block what the noise estimate needs.

    Parameters
    ----------
    col, row : (n,) arrays of float64
        Places in cells; points outside the blocks, or whose residual is NaN, are ignored.
    residuals : (n,) array of float64
        Point minus surface.
    freedoms : (n,) array of float64
        ``v_i (S v)_i``: random signs times the surface's answer to them.
    cells : int
        Cells a side of a block.
    sums : (h, w, 3) array of float64
        Number of points, squared residuals, ``v . S v``; added to.
    """
    h, w, _ = sums.shape
    for i in range(col.size):
        if not (col[i] >= 0.0 and row[i] >= 0.0) or np.isnan(residuals[i]):
            continue
        q = min(np.int64(col[i]) // cells, w - 1)
        r = min(np.int64(row[i]) // cells, h - 1)
        own = sums[r, q]
        own[0] += 1.0
        own[1] += residuals[i] * residuals[i]
        own[2] += freedoms[i]
