"""Vectors of the conjugate gradients: one walk down the rows for all that can be done together."""

import numpy as np

from volatool.kernels._jit import kernel
from volatool.kernels.product import product_row, start_carry
from volatool.kernels.spring import dot_row


@kernel
def advance(z, p, x, moved, beta, data, kb, km, product, dots, start, stop, edges=None):
    """
    Move along the last direction, turn to the next one, and find the force along it.

    That is ``z += moved p; p = x + beta p; product = H p``.

    Parameters
    ----------
    z, p : (h, w) arrays of float64
        Heights and direction, changed in place.
    x : (h, w) array of float32
        Preconditioned residual.
    moved, beta : float64
        Step along the last direction, and its weight in the new one.
    data : (h, 5, w) array of float32
        Data stencil.
    kb, km : float64
        Stiffness.
    product : (h, w) array of float64
        Set; the direction is two rows ahead.
    dots : (h,) array of float64
        ``p[r] . product[r]``, set.
    start, stop : int
        Rows of the product; strips must be done in order.
    edges : (h, k, w) array of float32, optional
        Factors of cut springs.
    """
    h, w = p.shape
    carry = np.empty((2, w), p.dtype)
    nothing = np.zeros((1, 5, w), data.dtype)
    start_carry(data, p, -1, start, h, kb, km, carry, 0, nothing, product, start, edges)
    for t in range(start + 2 if start > 0 else 0, stop + 2):
        if t < h:
            turn_row(z[t], p[t], x[t], moved, beta)
        r = t - 2
        if r >= start:
            product_row(data, p, -1, r, h, kb, km, carry, 0, nothing, product, r, edges)
            dots[r] = dot_row(p[r], product[r])


@kernel
def turn(z, p, x, moved, beta, start, stop):
    """
    Do what `advance` does to heights and direction alone: for threads, since it reads ahead.

    Parameters
    ----------
    z, p, x, moved, beta
        As for `advance`.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        turn_row(z[r], p[r], x[r], moved, beta)


@kernel
def turn_row(z, p, x, moved, beta):
    """
    One row of `turn`.

    Parameters
    ----------
    z, p, x : (w,) arrays of float
        Rows.
    moved, beta : float64
        As for `advance`.
    """
    for q in range(z.size):
        z[q] += moved * p[q]
        p[q] = x[q] + beta * p[q]


@kernel
def descend(residual, product, step, right, start, stop):
    """
    Residual after a step: ``residual -= step product; right = residual``.

    Parameters
    ----------
    residual, product : (h, w) arrays of float64
        Residual, changed in place; ``H p``.
    step : float64
        Step length.
    right : (h, w) array of float32
        Set to the residual for the preconditioner.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        rest, force, change = residual[r], right[r], product[r]
        for q in range(rest.size):
            rest[q] -= step * change[q]
            force[q] = rest[q]


@kernel
def measure(residual, x, start, stop, dots, largest):
    """
    Products that conjugate gradients need of the preconditioned residual, by row.

    Parameters
    ----------
    residual : (h, w) array of float64
        Residual.
    x : (h, w) array of float32
        Preconditioned residual.
    start, stop : int
        Rows.
    dots : (h,) array of float64
        ``residual . x``, set.
    largest : (h,) array of uint32
        Set to the bits of the largest ``|x|``, which are in the order of the numbers, NaN last:
        unlike that of floats, their maximum is vector code.
    """
    bits = x.view(np.uint32)
    without_sign = np.uint32(0x7FFFFFFF)
    for r in range(start, stop):
        dots[r] = dot_row(residual[r], x[r])
        top = np.uint32(0)
        for q in range(x.shape[1]):
            top = max(top, bits[r, q] & without_sign)
        largest[r] = top


@kernel
def begin(right, product, residual, force, norms, start, stop):
    """
    Residual of the heights to start from: ``residual = right - product``.

    Parameters
    ----------
    right, product : (h, w) arrays of float64
        Right side, ``H z``.
    residual : (h, w) array of float64
        Set; may be the right side itself.
    force : (h, w) array of float32
        Set to the residual for the preconditioner.
    norms : (h,) array of float64
        ``right . right``, set.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        norms[r] = dot_row(right[r], right[r])
        own, held, rest, short = right[r], product[r], residual[r], force[r]
        for q in range(own.size):
            value = own[q] - held[q]
            rest[q] = value
            short[q] = value


@kernel
def finish(z, p, x, moved, residual, norms, start, stop):
    """
    Move along the last direction and by the last estimate of the error.

    Parameters
    ----------
    z, p : (h, w) arrays of float64
        Heights, changed in place; last direction.
    x : (h, w) array of float32
        Preconditioned residual.
    moved : float64
        Step along the last direction.
    residual : (h, w) array of float64
        Residual.
    norms : (h,) array of float64
        ``residual . residual``, set.
    start, stop : int
        Rows.
    """
    for r in range(start, stop):
        norms[r] = dot_row(residual[r], residual[r])
        heights, along, new = z[r], p[r], x[r]
        for q in range(heights.size):
            heights[q] = (heights[q] + moved * along[q]) + new[q]
