"""How stiff: the nets whose heights add up to a surface, from the spacing of the points."""

from __future__ import annotations

import math
from dataclasses import dataclass

from volatool.emap.system import Springs
from volatool.errors import OptionError

LAYERS = ((2.0, 20.0, 0.0), (0.02, 1.5, 1.1))
"""The nets of the default: bending stiffness in squared spacings, length of tension and of tether
in spacings (0: no tether).

The first is the lie of the land. It is stiff enough not to follow what single points say, so that
it crosses gaps on the slope of the wider surroundings. The second follows what the points say
beside it, and its tether takes it back to the first within a spacing or two: roughness, noise and
walls at the rim of a gap don't run into it. See ``docs/explanation/emap.md`` for what else was
tried.
"""

MAX_SPACING_CELLS = 1000.0
"""Points farther apart than so many cells count as no farther: keeps the solver's digits."""


@dataclass(frozen=True, slots=True)
class Net:
    """
    One net of springs, fitted to what the nets before it leave of the points' heights.

    Parameters
    ----------
    springs : Springs
        Its own springs and those of the points.
    tether : float
        Stiffness of a spring at each node that pulls it to the nets before; 0 for none.
    """

    springs: Springs
    tether: float = 0.0


@dataclass(frozen=True, slots=True)
class Tuned:
    """
    The nets of a surface and why they are so.

    Parameters
    ----------
    nets : tuple of Net
        Solved one after the other; the surface is their sum.
    springs : Springs
        The single net that does nearly the same: for what needs one system.
    rule : str
        ``"spacing"``: the default, stiffness by the points' spacing; ``"given"``: one net of given
        stiffness; ``"paper"``: the paper's net.
    """

    nets: tuple[Net, ...]
    springs: Springs
    rule: str


def choose_springs(
    cell: float,
    spacing: float,
    *,
    preset: str = "emap",
    k_surface: float | None = None,
    k_point: float | None = None,
    ell: float | None = None,
) -> Tuned:
    """
    Return the nets that a surface is made of.

    Parameters
    ----------
    cell, spacing : float
        Edge of a cell and mean spacing of the points, in the horizontal unit.
    preset : str
        ``"emap"`` or ``"paper"``.
    k_surface, k_point, ell : float, optional
        As `Springs.emap` takes them. `k_surface` or `ell` asks for a single net.

    Raises
    ------
    OptionError
        A length that is not greater than zero, a stiffness out of proportion, or `ell` with the
        paper's net, which has no bending to set it against.
    """
    if preset == "paper":
        if ell is not None:
            raise OptionError("--ell is for --preset emap: the paper's net has no bending springs")
        paper = Springs.paper(k_surface=k_surface, k_point=k_point)
        return Tuned((Net(paper),), paper, "paper")
    s = min(spacing, MAX_SPACING_CELLS * cell)
    single = Springs.emap(cell, s, k_surface=k_surface, k_point=k_point, ell=ell)
    if k_surface is not None or ell is not None:
        return Tuned((Net(single),), single, "given")
    nets = []
    for rho, length, tether in LAYERS:
        stiffness = rho * s**2 * single.weight
        springs = Springs(stiffness / cell**2, stiffness / (length * s) ** 2, single.weight)
        nets.append(Net(springs, stiffness * cell**2 / (tether * s) ** 4 if tether else 0.0))
    return Tuned(tuple(nets), single, "spacing")


MAX_FREEDOM = 0.95
"""Above this part of the points the surface follows them all, and residuals say nothing."""

FREQUENCIES = 4096
"""Steps of the sum over wave numbers."""


def degrees_of_freedom(nets: tuple[Net, ...], cell: float, spacing: float) -> float:
    """
    Return how many degrees of freedom the surface spends per point.

    The trace of the smoother for evenly spread points, over the wave numbers k up to the grid's
    own limit, ``k^2 = 4 pi / cell^2``. A net leaves the part ``f = r / (1 + r)`` of a wave, with
    ``r = s^2 (rho k^4 + tau k^2 + tether / cell^2)``, and nets after each other the product.

    Parameters
    ----------
    nets : tuple of Net
        ``rho = kb cell^2 / w``, ``tau = km / w``.
    cell, spacing : float
        Edge of a cell and mean spacing s of the points, same unit.
    """
    import numpy as np

    # k^2 in steps that grow in proportion: from waves far longer than any net's reach
    limit = 4 * math.pi / cell**2
    edges = np.concatenate([[0.0], np.geomspace(1e-9 * limit, limit, FREQUENCIES + 1)])
    k2 = (edges[1:] + edges[:-1]) / 2
    left = np.ones(len(k2))
    for net in nets:
        kb, km, weight = net.springs.kb, net.springs.km, net.springs.weight
        force = kb * cell**2 * k2**2 + km * k2 + net.tether / cell**2
        ratio = spacing**2 * force / weight
        left *= ratio / (1 + ratio)
    return float(np.sum((1 - left) * np.diff(edges)) * spacing**2 / (4 * math.pi))
