"""What the EMap paper says that can't be, what is done here instead, and what it amounts to."""

from __future__ import annotations

from typing import Any, NamedTuple

from volatool.papers.emap_experiment import BASELINE, RECOMMENDED


class Erratum(NamedTuple):
    """
    A row of the table of differences.

    Parameters
    ----------
    key : str
        C13 to C23, the project's numbering.
    paper, here, measured : str
        What the paper says; what is done here; what it amounts to, in this run of the experiment.
    """

    key: str
    paper: str
    here: str
    measured: str


def errata(document: dict[str, Any]) -> list[Erratum]:
    """
    Return the table for a result.

    Parameters
    ----------
    document : dict
        Of `volatool.papers.emap_summary.summarize`.
    """
    effects, methods = document["effects"], document["methods"]
    ours = methods[RECOMMENDED]
    along = document["along"]
    literal = along["rmse"]["literal"]["mean"]
    return [
        Erratum(
            "C13",
            "equation 3: energy set to zero, then the element-wise root. A sum of squares is zero "
            "only at rest; what is left asks for roots of negative numbers, and a root has no sign",
            "the gradient is zero (equilibrium): one linear, symmetric, positive definite system",
            f"taken at its word the RMSE is {literal[0]:.2g} m after {along['x'][0]:g} m of "
            f"driving and {literal[-1]:.2g} m after {along['x'][-1]:g} m; with the sign put back "
            f"and vertical distances {methods['literal-signed']['rmse']:.2g} m over the run: it "
            f"does not settle. Equilibrium: {ours['rmse']:.2g} m",
        ),
        Erratum(
            "C14",
            "K_s is diagonal: nodes don't feel their neighbours, so nothing could fill a gap",
            "graph Laplacian (and bending springs) with off-diagonal entries",
            f"{100 * effects['share_of_nodes_without_return']:.0f} % of the nodes have no return "
            f"of their own. Without coupling (means of a node's own returns) the RMSE is "
            f"{methods['uncoupled']['rmse']:.2g} m, coupled {ours['rmse']:.2g} m",
        ),
        Erratum(
            "C15",
            "the distance to a point is Euclidean, though nodes move up and down only; points "
            "pull on the nearest node",
            "vertical distance from the surface at the point's own place (bilinear)",
            "half a cell aside is 0.10 m RMS of horizontal distance that no move can take away. "
            f"Nearest node {methods['emap-nearest']['rmse']:.2g} m, bilinear {ours['rmse']:.2g} m",
        ),
        Erratum(
            "C16",
            "equation 6: exp(-1/2 (r + r_g)^2)",
            "minus: the peak is 1 at r_g = 6 m",
            f"printed: largest weight {effects['gaussian_as_printed']['largest_weight']:.1e}, "
            f"MSE {_pair(effects['gaussian_as_printed']['mse'])}",
        ),
        Erratum(
            "C17",
            "equation 7: the root of 2 stands outside erf",
            "inside: weights from 1 to 0 with 1/2 at r_s = 4 m",
            f"printed: weights {effects['cdf_as_printed']['largest_weight']:.3f} to "
            f"{effects['cdf_as_printed']['least_weight']:.3f}, "
            f"MSE {_pair(effects['cdf_as_printed']['mse'])}",
        ),
        Erratum(
            "C18",
            "Table 1 has Nearest (88.8, 50.0) above Raw (74.6, 45.8), which no weights up to 1 "
            "allow; Gaussian + CDF make 2.9 and 3.2 % of Raw, but F_g^2 + F_c^2 is at least "
            f"{effects['least_gaussian_plus_cdf_squared']:.2f} everywhere: the rows are not of "
            "one grid and these formulas",
            "all four rows from the same errors; beside equation 4 also normalized, "
            "sum F^2 e^2 / sum F^2",
            "Gaussian + CDF make "
            + _each(effects["gaussian_plus_cdf_over_raw"], lambda v: f"{100 * v:.0f} %")
            + " of Raw",
        ),
        Erratum(
            "C19",
            'the "MSE" is a sum over time without a unit, and 45.8 is read as 45 cm',
            "means over time in m^2; RMSE, MAE and bias in metres",
            "sum over time "
            + _each(effects["sum_over_time"], lambda v: f"{v:.2g} m^2")
            + f"; RMSE, MAE, bias of EMap {1000 * ours['rmse']:.1f}, {1000 * ours['mae']:.1f}, "
            f"{1000 * ours['bias']:+.1f} mm",
        ),
        Erratum(
            "C20",
            "range gain of 36.7 % in 5.1 and 25 % in 7; 36.7 % is the ratio of two errors",
            "r_m by definition: the largest radius inside of which the RMSE is below a threshold "
            "(in a window of 20 m)",
            "; ".join(_range(methods, t) for t in ours["wide"]["range_by_rmse"]),
        ),
        Erratum(
            "C21",
            '"10 m radius", but a surface of 10 m x 10 m (1600 nodes, 16 a square metre)',
            "10 m x 10 m is what is scored; 20 m x 20 m at the same spacing too",
            f"20 m x 20 m: MSE {ours['wide']['mse']:.2g} m^2, most of it at corners out of reach"
            + _better(ours["wide"]["improvement_percent"]),
        ),
        Erratum(
            "C22",
            '"linear in the nodes", and "twice the resolution costs 25 % more"',
            "measured: CPU time of a loop against nodes",
            _times(document),
        ),
        Erratum(
            "C23",
            "the heat maps are said to be Figure 6, which is the plot of times; Figure 4 is "
            "called a histogram; complexity is in section 3, not 4.1",
            "cited by content; our Figure 4 has the maps and the histogram",
            "",
        ),
    ]


def _each(values: dict[str, float], text: Any) -> str:
    names = {BASELINE: "OctoMap", RECOMMENDED: "EMap"}
    return ", ".join(f"{names[key]} {text(value)}" for key, value in values.items())


def _pair(values: dict[str, float]) -> str:
    return _each(values, lambda value: f"{value:.1e}") + " m^2"


def _better(value: float | None) -> str:
    return "" if value is None else f"; {value:.0f} % below OctoMap"


def _range(methods: dict[str, Any], threshold: str) -> str:
    found = {
        key: methods[key]["wide"]
        for key in (BASELINE, RECOMMENDED)
        if "wide" in methods.get(key, {})
    }
    parts = [
        _each({key: wide[name][threshold] for key, wide in found.items()}, lambda v: f"{v:.1f} m")
        for name in ("range_by_rmse", "range_by_rmse_second_half")
    ]
    return f"{threshold} m: {parts[0]} (second half of the drives: {parts[1]})"


def _times(document: dict[str, Any]) -> str:
    loops = document.get("resources", {}).get("loop")
    if not loops:
        return "not timed in this run"
    first = next((loop for loop in loops if loop["nodes"] == 1600), loops[0])
    last = loops[-1]
    return (
        f"{first['nodes']:,} nodes {1000 * first['loop_s']:.1f} ms, {last['nodes']:,} nodes "
        f"{1000 * last['loop_s']:.0f} ms: {last['nodes'] / first['nodes']:.0f} times the nodes, "
        f"{last['loop_s'] / first['loop_s']:.0f} times the time"
    )
