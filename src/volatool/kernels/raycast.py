"""Rays onto the surface ``sin(x / pi) sin(y / pi)``: exact first intersections."""

import math

import numpy as np

from volatool.kernels._jit import kernel


@kernel
def cast(origin, directions, max_range, ranges):
    """
    Distance along each ray to the surface's first intersection.

    Parameters
    ----------
    origin : (3,) array of float64
        Where all rays start, in metres, above the surface.
    directions : (n, 3) array of float64
        Unit vectors.
    max_range : float
        Rays are followed so far.
    ranges : (n,) array of float64
        Set; infinity for rays that meet nothing in range. An origin on or below the surface
        gives 0.

    Notes
    -----
    With ``f(t)`` the height of the ray above the surface, ``f''(t) >= -m`` for
    ``m = (horizontal speed / pi)^2``: no second derivative of the surface exceeds ``1 / pi^2`` in
    any direction. So the smallest root of the parabola ``f + f' s - m s^2 / 2`` is never behind
    the surface: no peak is jumped over, however thin, and steps shrink like Newton's near a root.
    """
    scale = 1.0 / math.pi
    x0, y0, z0 = origin
    for i in range(ranges.size):
        dx, dy, dz = directions[i]
        m = (dx * dx + dy * dy) * scale * scale
        # nothing rises above 1
        t = 0.0
        if z0 > 1.0:
            t = (1.0 - z0) / dz if dz < 0.0 else np.inf
        while t <= max_range:
            a = (x0 + t * dx) * scale
            b = (y0 + t * dy) * scale
            sin_a, sin_b = math.sin(a), math.sin(b)
            f = z0 + t * dz - sin_a * sin_b
            slope = dz - scale * (math.cos(a) * sin_b * dx + sin_a * math.cos(b) * dy)
            if f <= 1e-12:
                break
            if z0 + t * dz > 1.0 and dz >= 0.0:
                t = np.inf
                break
            root = math.sqrt(slope * slope + 2.0 * m * f)
            # two forms of the same root: each where it doesn't cancel; m is 0 for vertical rays
            t += (slope + root) / m if slope > 0.0 else 2.0 * f / (root - slope)
        ranges[i] = t if t <= max_range else np.inf
