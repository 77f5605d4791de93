"""The paper's equations taken at their word."""

from __future__ import annotations

import numpy as np

from volatool.papers.emap_literal import K, Literal, Uncoupled
from volatool.papers.emap_scene import Drive, Nodes, Scan, scans, terrain


def scan_of(points, x=0.0, number=0):
    return Scan(number, np.array([x, 0.0, 2.0]), np.array(points, float), evaluated=True)


def test_a_step_is_the_root_of_the_springs_work():
    literal = Literal(side=4, cell=1.0)
    # two points over the node at (0.5, 0.5), which has four neighbours
    literal.update(scan_of([[0.5, 0.5, 2.0], [0.5, 0.7, -1.0]]))
    z = literal.heights(Nodes.around(np.zeros(3), 4, 1.0))
    assert z[1, 2] == np.sqrt(K * (4 + 1 + 0.2**2) / (4 * K))
    assert np.count_nonzero(z) == 1


def test_the_sign_put_back_and_vertical_distances():
    literal = Literal(signed=True, vertical=True, side=4, cell=1.0)
    literal.update(scan_of([[0.7, 0.7, -2.0]]))
    assert literal.heights(Nodes.around(np.zeros(3), 4, 1.0))[1, 2] == -1.0


def test_taken_at_its_word_it_diverges():
    """emap.md, section 1: the error grows beyond all bounds; equation 3 can't have been run."""
    literal, mse = Literal(), []
    for scan in scans(Drive(duration_s=6), 0):
        literal.update(scan)
        nodes = Nodes.around(scan.sensor)
        mse.append(np.mean((literal.heights(nodes) - terrain(*nodes.places())) ** 2))
    assert mse[0] < 1
    assert mse[9] > 1e3
    assert mse[29] > 1e15


def test_an_uncoupled_node_is_the_mean_of_its_points():
    net = Uncoupled(side=4, cell=1.0)
    net.update(scan_of([[0.2, 0.2, 1.0], [0.9, 0.9, 2.0], [9.0, 9.0, 7.0]]))
    z = net.heights(Nodes.around(np.zeros(3), 4, 1.0))
    assert z[1, 2] == 1.5
    assert np.count_nonzero(z) == 1
    assert net.empty == 15 / 16


def test_values_stay_in_the_world_when_the_window_rolls():
    net = Uncoupled(side=4, cell=1.0)
    net.update(scan_of([[0.5, 0.5, 1.0], [-1.5, 0.5, 2.0]]))
    net.update(scan_of(np.empty((0, 3)), x=1.0))
    z = net.heights(Nodes.around(np.array([1.0, 0, 0]), 4, 1.0))
    assert z[1, 1] == 1.0
    assert np.count_nonzero(z) == 1  # the other one has left
    net.update(scan_of(np.empty((0, 3)), x=30.0))
    assert net.empty == 1
