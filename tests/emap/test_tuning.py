"""The nets of a surface: their stiffness, and what they leave of the points."""

from __future__ import annotations

import numpy as np
import pytest

from volatool.emap.solve import solve
from volatool.emap.system import Evidence, Springs
from volatool.emap.tuning import LAYERS, Net, choose_springs, degrees_of_freedom
from volatool.errors import OptionError


def test_nets_scale_with_the_spacing_and_not_with_the_cell():
    """Stiffness, tension and tether are those of `LAYERS` whatever cell and spacing."""
    for cell, s in ((0.5, 3.0), (2.0, 3.0), (1.0, 0.4)):
        tuned = choose_springs(cell, s)
        assert tuned.rule == "spacing"
        for net, (rho, ell, tether) in zip(tuned.nets, LAYERS, strict=True):
            stiffness = net.springs.kb * cell**2
            assert stiffness == pytest.approx(rho * s**2)
            assert net.springs.km == pytest.approx(stiffness / (ell * s) ** 2)
            # per area it is stiffness / length^4
            area = stiffness / (tether * s) ** 4 if tether else 0.0
            assert net.tether / cell**2 == pytest.approx(area)


def test_what_is_given_makes_one_net():
    """A stiffness or a length asks for a single net, k_point alone changes no ratio."""
    tuned = choose_springs(1.0, 3.0, k_surface=2.0, k_point=4.0, ell=10.0)
    assert (tuned.rule, tuned.nets) == ("given", (Net(Springs(2.0, 0.02, 4.0)),))
    assert choose_springs(1.0, 3.0, ell=6.0).nets[0].springs.km == pytest.approx(0.02 * 9 / 36)
    stiff, plain = choose_springs(1.0, 3.0, k_point=4.0), choose_springs(1.0, 3.0)
    for a, b in zip(stiff.nets, plain.nets, strict=True):
        assert a.springs.kb / a.springs.weight == pytest.approx(b.springs.kb)
        assert a.tether / a.springs.weight == pytest.approx(b.tether)
    assert choose_springs(1.0, 3.0, preset="paper").nets == (Net(Springs.paper()),)
    with pytest.raises(OptionError, match="--ell"):
        choose_springs(1.0, 3.0, preset="paper", ell=1.0)


def test_points_far_apart_keep_the_stiffness_in_proportion():
    """Two points on a grid of many thousand cells are no error."""
    for net in choose_springs(0.1, 1e5).nets:
        assert net.springs.kb < 1e9


def test_a_tether_holds_a_net_to_what_was_before():
    """Far from the points the tethered net is level at 0, near them it is at their height."""
    springs = choose_springs(1.0, 2.0).nets[1].springs
    evidence = Evidence(41, 41)
    evidence.add(np.array([20.5]), np.array([20.5]), np.ones(1), springs)
    evidence.tether(choose_springs(1.0, 2.0).nets[1].tether)
    z, info = solve(evidence, springs, tol=1e-8)
    assert info.converged
    assert z[20, 20] > 0.8
    assert abs(z[:, :5]).max() < 1e-2


def test_degrees_of_freedom_follow_the_closed_form():
    """0.559 at rho = 0.05 s^2 and fine cells, cells per point for coarse ones; nets multiply."""
    fine, coarse, stretched = (
        (Net(springs),)
        for springs in (Springs(0.05 / 1e-4, 0.0), Springs(0.05 / 1e4, 0.0), Springs(0.0, 0.1))
    )
    assert degrees_of_freedom(fine, 0.01, 1.0) == pytest.approx(0.559, abs=1e-3)
    assert degrees_of_freedom(coarse, 100.0, 1.0) == pytest.approx(1e-4, rel=0.01)
    assert degrees_of_freedom(stretched, 100.0, 1.0) == pytest.approx(1e-4, rel=0.01)
    held = (*fine, Net(Springs(0.05 / 1e-4, 0.0), tether=1e30))
    assert degrees_of_freedom(held, 0.01, 1.0) == pytest.approx(0.559, abs=1e-3)
    assert degrees_of_freedom(fine * 2, 0.01, 1.0) > 0.6
