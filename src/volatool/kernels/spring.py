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
from volatool.kernels.cut_spring import cut_across, cut_diagonal_row, cut_row_bend, cut_row_flux


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
def row_step(x, r, out):
    """
    Differences of row r + 1 and row r, one ghost of equal value at both ends.

    Parameters
    ----------
    x : (h, w) array of float
        Heights.
    r : int
        Row; the differences are zero where a row doesn't exist.
    out : (w + 2,) array of float
        Set.
    """
    h, w = x.shape
    if 0 <= r < h - 1:
        upper = x[r]
        lower = x[r + 1]
        inner = out[1:]
        for q in range(w):
            inner[q] = lower[q] - upper[q]
        out[0] = out[1]
        out[w + 1] = out[w]
    else:
        out[:] = 0.0


@kernel
def row_bend(step_above, step_below, r, h, out):
    """
    Second differences down the columns at row r; zero at the first and last row.

    Parameters
    ----------
    step_above, step_below : (w + 2,) arrays of float
        `row_step` of rows r - 1 and r.
    r, h : int
        Row, and number of rows.
    out : (w + 2,) array of float
        Set.
    """
    if 1 <= r < h - 1:
        for q in range(out.size):
            out[q] = step_below[q] - step_above[q]
    else:
        out[:] = 0.0


@kernel
def row_flux(step, bend_above, bend_below, kb, km, out):
    """
    Force that passes from row r to row r + 1 through the surface springs.

    Parameters
    ----------
    step : (w + 2,) array of float
        `row_step` of row r, with its ghosts: they make the twist vanish past the ends.
    bend_above, bend_below : (w + 2,) arrays of float
        `row_bend` of rows r and r + 1.
    kb, km : float
        Stiffness of the bending and stretching springs, of the arrays' own type.
    out : (w,) array of float
        Set; node r gets it, node r + 1 its opposite.
    """
    middle = step[1:]
    after = step[2:]
    above = bend_above[1:]
    below = bend_below[1:]
    for q in range(out.size):
        twist = (after[q] - middle[q]) - (middle[q] - step[q])
        out[q] = kb * ((below[q] - above[q]) + (twist + twist)) - km * middle[q]


@kernel
def start_rows(x, r, kb, km, steps, bends, fluxes, edges=None):
    """
    Fill the rolling rows before row r: as `next_row` would have left them.

    Parameters
    ----------
    x : (h, w) array of float
        Heights.
    r : int
        Row that `next_row` will be called for first.
    kb, km : float
        Stiffness.
    steps, bends : (3, w + 2), (2, w + 2) arrays of float
        Set: ``steps[k]`` and ``bends[k]`` by row modulo 3 and 2.
    fluxes : (2, w) array of float
        Set: by row modulo 2.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs, see `cut_spring`.
    """
    h = x.shape[0]
    row_step(x, r - 2, steps[(r + 1) % 3])
    row_step(x, r - 1, steps[(r + 2) % 3])
    row_step(x, r, steps[r % 3])
    before, above, here = steps[(r + 1) % 3], steps[(r + 2) % 3], steps[r % 3]
    bend_above, bend, flux = bends[(r + 1) % 2], bends[r % 2], fluxes[(r + 1) % 2]
    if edges is None:
        row_bend(before, above, r - 1, h, bend_above)
        row_bend(above, here, r, h, bend)
        row_flux(above, bend_above, bend, kb, km, flux)
    else:
        cut_row_bend(before, above, edges, r - 1, bend_above)
        cut_row_bend(above, here, edges, r, bend)
        cut_row_flux(above, bend_above, bend, edges, r - 1, kb, km, flux)


@kernel
def next_row(data, x, r, kb, km, steps, bends, fluxes, across, nothing, acc, edges=None):
    """
    One row of ``H x``, advancing the rolling rows.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    x : (h, w) array of float
        Heights; rows r - 1 to r + 2 are read.
    r : int
        Row.
    kb, km : float
        Stiffness, of x's type.
    steps, bends, fluxes : arrays
        As `start_rows` or the call for row r - 1 left them.
    across : (w + 2,) array of float
        Work space; its two first and last entries must be zero.
    nothing : (w,) array of float
        Zeros.
    acc : (w,) array of float
        Set to the row of the product.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs.
    """
    h, w = x.shape
    row_step(x, r + 1, steps[(r + 1) % 3])
    bend_below, bend_here, flux = bends[(r + 1) % 2], bends[r % 2], fluxes[r % 2]
    middle = x[r]
    west = acc[1:]
    x1 = middle[1:]
    below = fluxes[r % 2]
    above = fluxes[(r + 1) % 2]
    if edges is None:
        row_bend(steps[r % 3], steps[(r + 1) % 3], r + 1, h, bend_below)
        row_flux(steps[r % 3], bend_here, bend_below, kb, km, flux)
        inner = across[2:]
        x2 = middle[2:]
        for q in range(w - 2):
            inner[q] = (x2[q] - x1[q]) - (x1[q] - middle[q])
        c1 = across[1:]
        for q in range(w):
            bend = (inner[q] - c1[q]) - (c1[q] - across[q])
            acc[q] = (below[q] - above[q]) + kb * bend - km * c1[q]
        if w > 1:
            acc[0] -= km * (middle[1] - middle[0])
            acc[w - 1] -= km * (middle[w - 2] - middle[w - 1])
    else:
        cut_row_bend(steps[r % 3], steps[(r + 1) % 3], edges, r + 1, bend_below)
        cut_row_flux(steps[r % 3], bend_here, bend_below, edges, r, kb, km, flux)
        for q in range(w):
            acc[q] = below[q] - above[q]
        cut_across(x, edges, r, kb, km, across, acc)
    # data springs: three shifts, few arrays a loop, so that the compiler vectorizes
    here = data[r]
    up = data[max(r - 1, 0)]
    x_up = x[r - 1] if r > 0 else nothing
    x_down = x[r + 1] if r + 1 < h else nothing
    d0, d2, u2 = here[0], here[2], up[2]
    for q in range(w):
        acc[q] += d0[q] * middle[q] + d2[q] * x_down[q] + u2[q] * x_up[q]
    d1, d3, u4 = here[1], here[3], up[4][1:]
    down1, up1 = x_down[1:], x_up[1:]
    for q in range(w - 1):
        acc[q] += d1[q] * x1[q] + d3[q] * down1[q] + u4[q] * up1[q]
    d4, u3 = here[4][1:], up[3]
    for q in range(w - 1):
        west[q] += d1[q] * middle[q] + d4[q] * x_down[q] + u3[q] * x_up[q]


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
    w = x.shape[1]
    steps = np.empty((3, w + 2), x.dtype)
    bends = np.empty((2, w + 2), x.dtype)
    fluxes = np.empty((2, w), x.dtype)
    across = np.zeros(w + 2, x.dtype)
    nothing = np.zeros(w, x.dtype)
    start_rows(x, start, kb, km, steps, bends, fluxes, edges)
    for r in range(start, stop):
        acc = out[r]
        next_row(data, x, r, kb, km, steps, bends, fluxes, across, nothing, acc, edges)
        dots[r] = dot_row(x[r], acc)


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
    parts = np.zeros(8)
    whole = a.size // 8 * 8
    for q in range(0, whole, 8):
        for k in range(8):
            parts[k] += a[q + k] * b[q + k]
    for q in range(whole, a.size):
        parts[q - whole] += a[q] * b[q]
    total = 0.0
    for k in range(8):
        total += parts[k]
    return total


@kernel
def diagonal_row(data, r, h, kb, km, out, edges=None):
    """
    One row of the diagonal of H.

    Parameters
    ----------
    data : (h, 5, w) array of float
        Data stencil.
    r, h : int
        Row, number of rows.
    kb, km : float
        Stiffness, of the array's type.
    out : (w,) array of float
        Set; 1 where nothing holds a node (a grid of a single node without data).
    edges : (h, 3, w) array of float32, optional
        Factors of cut springs and their diagonal.
    """
    if edges is None:
        whole_diagonal_row(data, r, h, kb, km, out)
    else:
        cut_diagonal_row(data, edges, r, out)


@kernel
def whole_diagonal_row(data, r, h, kb, km, out):
    """
    One row of the diagonal of H without cuts.

    Parameters
    ----------
    data, r, h, kb, km, out
        As in `diagonal_row`.
    """
    w = out.size
    own = data[r, 0]
    # second differences that hold the node: weight 4 as their middle, 1 as an end
    vertical = 4 * (0 < r < h - 1) + (r > 1) + (r < h - 2)
    rows = (r > 0) + (r < h - 1)
    k_inner = kb * out.dtype.type(6 + vertical + 4 * rows) + km * out.dtype.type(2 + rows)
    for q in range(w):
        out[q] = own[q] + k_inner
    for k in range(4):
        q = k if k < 2 else w - 1 - (k - 2)
        if 0 <= q < w:
            horizontal = 4 * (0 < q < w - 1) + (q > 1) + (q < w - 2)
            cols = (q > 0) + (q < w - 1)
            k_edge = kb * out.dtype.type(horizontal + vertical + 2 * cols * rows)
            out[q] = own[q] + (k_edge + km * out.dtype.type(cols + rows))
            if not out[q] > 0:
                out[q] = 1.0
