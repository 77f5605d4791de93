"""Springs of the EMap surface: evidence of points, the operator's product, residuals at points.

The energy and its symbols are those of ``docs/explanation/emap.md``. Nothing is assembled: the
surface springs act through differences of neighbouring rows and columns, each taken only where
all its nodes exist, and the data springs through a symmetric 9-point stencil of which each
coupling is stored once::

    data[r, 0, q]  diagonal        data[r, 1, q]  (r, q) - (r, q + 1)
    data[r, 2, q]  (r, q) - (r + 1, q)            data[r, 3, q]  (r, q) - (r + 1, q + 1)
    data[r, 4, q]  (r, q) - (r + 1, q - 1)

Couplings that would leave the grid are zero. All loops run along rows in a fixed order, so a
caller may walk a grid in strips of any height and get the same bytes.
"""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.product import product_row, start_carry


@kernel
def accumulate(data, right, col, row, height, weights, nearest, first, last):
    """
    Add the data springs of points to a grid's evidence, in the order of the points.

    Parameters
    ----------
    data : (h, 5, w) array of float64
        Data stencil, added to.
    right : (h, w) array of float64
        Right side, added to.
    col, row : (n,) arrays of float64
        Places in cells from the grid's top left corner; node (r, q) is at (r + 0.5, q + 0.5).
        Points outside the grid are ignored; within half a cell of its rim they pull on the rim.
    height : (n,) array of float64
        Height of each point, in the unit of the surface.
    weights : (n,) or (1,) array of float64
        Stiffness of each point's spring, or one for all of them.
    nearest : bool
        Attach to the nearest node alone instead of bilinearly to four.
    first, last : int
        Only rows ``first <= r < last`` of the grid are touched.

    Notes
    -----
    An entry gets its terms in the order of the points whatever the split into calls and row
    windows: sums don't depend on the chunk size.
    """
    h, w = right.shape
    last_weight = weights.size - 1
    for i in range(col.size):
        x = col[i]
        y = row[i]
        if not (x >= 0.0 and x <= w and y >= 0.0 and y <= h):
            continue
        weight = weights[min(i, last_weight)]
        if nearest:
            r = min(np.int64(y), h - 1)
            q = min(np.int64(x), w - 1)
            if first <= r < last:
                data[r, 0, q] += weight
                right[r, q] += weight * height[i]
            continue
        x = max(x - 0.5, 0.0)
        y = max(y - 0.5, 0.0)
        q = min(np.int64(x), w - 2)
        r = min(np.int64(y), h - 2)
        if r + 1 < first or r >= last:
            continue
        u = min(x - q, 1.0)
        v = min(y - r, 1.0)
        upper_left = (1.0 - u) * (1.0 - v)
        upper_right = u * (1.0 - v)
        lower_left = (1.0 - u) * v
        lower_right = u * v
        pull = weight * height[i]
        if r >= first:
            data[r, 0, q] += weight * upper_left * upper_left
            data[r, 0, q + 1] += weight * upper_right * upper_right
            data[r, 1, q] += weight * upper_left * upper_right
            data[r, 2, q] += weight * upper_left * lower_left
            data[r, 2, q + 1] += weight * upper_right * lower_right
            data[r, 3, q] += weight * upper_left * lower_right
            data[r, 4, q + 1] += weight * upper_right * lower_left
            right[r, q] += pull * upper_left
            right[r, q + 1] += pull * upper_right
        if r + 1 < last:
            data[r + 1, 0, q] += weight * lower_left * lower_left
            data[r + 1, 0, q + 1] += weight * lower_right * lower_right
            data[r + 1, 1, q] += weight * lower_left * lower_right
            right[r + 1, q] += pull * lower_left
            right[r + 1, q + 1] += pull * lower_right


@kernel
def interpolate(z, col, row, nearest, first, last, out):
    """
    Height of a surface at points, read as the data springs see it.

    Parameters
    ----------
    z : (h, w) array of float64
        Heights of the nodes.
    col, row : (n,) arrays of float64
        Places in cells from the top left corner.
    nearest : bool
        The nearest node's height instead of the bilinear one.
    first, last : int
        Only points whose upper node row is in ``first <= r < last`` are read.
    out : (n,) array of float64
        Set for the points read, untouched for others; NaN for points outside the grid.
    """
    h, w = z.shape
    for i in range(col.size):
        x = col[i]
        y = row[i]
        if not (x >= 0.0 and x <= w and y >= 0.0 and y <= h):
            out[i] = np.nan
            continue
        if nearest:
            r = min(np.int64(y), h - 1)
            if first <= r < last:
                out[i] = z[r, min(np.int64(x), w - 1)]
            continue
        x = max(x - 0.5, 0.0)
        y = max(y - 0.5, 0.0)
        q = min(np.int64(x), w - 2)
        r = min(np.int64(y), h - 2)
        if r < first or r >= last:
            continue
        u = min(x - q, 1.0)
        v = min(y - r, 1.0)
        out[i] = (1.0 - v) * ((1.0 - u) * z[r, q] + u * z[r, q + 1]) + v * (
            (1.0 - u) * z[r + 1, q] + u * z[r + 1, q + 1]
        )


@kernel
def apply_rows(data, x, kb, km, start, stop, out, dots, edges=None):
    """
    Rows of the product ``H x``, and their dot products with x.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    x : (h, w) array of float64
        Heights.
    kb, km : float
        Stiffness of the bending and stretching springs.
    start, stop : int
        Rows.
    out : (h, w) array of float64
        Rows `start` to `stop` are set.
    dots : (h,) array of float64
        ``x[r] . out[r]`` of these rows is set.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs.
    """
    h, w = x.shape
    carry = np.empty((2, w), x.dtype)
    nothing = np.zeros((1, 5, w), data.dtype)
    start_carry(data, x, -1, start, h, kb, km, carry, 0, nothing, out, start, edges)
    for r in range(start, stop):
        product_row(data, x, -1, r, h, kb, km, carry, 0, nothing, out, r, edges)
        dots[r] = dot_row(x[r], out[r])


@kernel
def dot_row(a, b):
    """
    Dot product of two rows in a fixed order.

    Parameters
    ----------
    a, b : (w,) arrays of float
        Rows; may differ in type.

    Returns
    -------
    dot : float64
        Eight interleaved partial sums, added in order: fixed, and fast without reordering.
    """
    n = a.size // 8
    x, y = a[: 8 * n].reshape(n, 8), b[: 8 * n].reshape(n, 8)
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    for i in range(n):
        s0 += x[i, 0] * y[i, 0]
        s1 += x[i, 1] * y[i, 1]
        s2 += x[i, 2] * y[i, 2]
        s3 += x[i, 3] * y[i, 3]
        s4 += x[i, 4] * y[i, 4]
        s5 += x[i, 5] * y[i, 5]
        s6 += x[i, 6] * y[i, 6]
        s7 += x[i, 7] * y[i, 7]
    parts = np.array((s0, s1, s2, s3, s4, s5, s6, s7))
    for q in range(8 * n, a.size):
        parts[q - 8 * n] += a[q] * b[q]
    total = 0.0
    for k in range(8):
        total += parts[k]
    return total
