"""Vertical accuracy of a DEM against checkpoints, in the terms of ASPRS edition 2 (2023).

The error of a checkpoint is the DEM's height at its place, bilinear between cell centres, minus the
surveyed height. ``RMSE_V1`` is the root mean square of these errors, ``RMSE_V2`` the checkpoints'
own; the DEM's is reported as ``RMSE_V = sqrt(RMSE_V1^2 + RMSE_V2^2)`` [ASPRS2023]. Non-vegetated
points (NVA) may be held against a requirement, vegetated ones (VVA) are only reported. Fewer than
30 points are shown, but not reportable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from volatool.dem.checkpoints import Checkpoints
from volatool.dem.distance import FILLED
from volatool.dem.raster import read_heights_at, read_profile, read_values_at
from volatool.errors import CRSError, FormatError, InputError
from volatool.model import F64, CrsInfo

SCHEMA = "volatool.accuracy/1"

MIN_CHECKPOINTS = 30
"""Of each kind, for the assessment of a product."""

WORST = 5
"""Points that are listed."""


@dataclass(frozen=True, slots=True)
class Errors:
    """
    Errors of a group of checkpoints and what they come to.

    Parameters
    ----------
    errors : (n,) array of float64
        DEM minus checkpoint, vertical unit.
    ids : tuple of str
        Names of the checkpoints.
    checkpoint_rmse : float or None
        Their own error, ``RMSE_V2``.
    """

    errors: F64
    ids: tuple[str, ...]
    checkpoint_rmse: float | None

    @property
    def rmse_v1(self) -> float | None:
        """Root mean square of the errors."""
        return math.sqrt(np.square(self.errors).mean()) if len(self.errors) else None

    @property
    def rmse_v(self) -> float | None:
        """The same with the checkpoints' own error; None when that is not known."""
        if self.rmse_v1 is None or self.checkpoint_rmse is None:
            return None
        return math.hypot(self.rmse_v1, self.checkpoint_rmse)

    @property
    def reasons(self) -> list[str]:
        """Why the accuracy is not reportable; nothing when it is."""
        found = []
        if len(self.errors) < MIN_CHECKPOINTS:
            found.append(f"{len(self.errors)} checkpoints, {MIN_CHECKPOINTS} are needed")
        if self.checkpoint_rmse is None:
            found.append("the checkpoints' own error is not given (--checkpoint-rmse)")
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON; null where there are too few points for one."""
        e = self.errors
        n = len(e)
        std = float(e.std(ddof=1)) if n > 1 else None
        worst = sorted(range(n), key=lambda k: (-abs(e[k]), k))[:WORST]
        spread = float(e.std()) if n else 0.0
        shape: dict[str, float | None] = {"skew": None, "kurtosis": None}
        if n > 3 and spread > 0:
            unit = (e - e.mean()) / spread
            shape = {"skew": float((unit**3).mean()), "kurtosis": float((unit**4).mean() - 3)}
        return {
            "n": n,
            "reportable": not self.reasons,
            "reasons": self.reasons,
            "rmse_v1": self.rmse_v1,
            "rmse_v": self.rmse_v,
            "bias": float(e.mean()) if n else None,
            "std": std,
            "mae": float(np.abs(e).mean()) if n else None,
            "median": float(np.median(e)) if n else None,
            "p95": float(np.quantile(np.abs(e), 0.95)) if n else None,
            "min": float(e.min()) if n else None,
            "max": float(e.max()) if n else None,
            **shape,
            "worst": [{"id": self.ids[k], "error": float(e[k])} for k in worst],
        }


@dataclass(frozen=True, slots=True)
class Accuracy:
    """
    A DEM held against checkpoints.

    Parameters
    ----------
    name : str
        Of the DEM.
    unit : str or None
        Of its heights.
    nva, vva : Errors
        Non-vegetated and vegetated points.
    filled : Errors or None
        Of both, those in cells without a point; None when no flag layer says so.
    n_outside, n_void : int
        Points off the DEM, and where it has no height.
    coverage : dict or None
        Part of the errors within 1 and 1.96 standard errors, by the sigma layer.
    required : float or None
        The largest ``RMSE_V`` that will do for the non-vegetated points.
    """

    name: str
    unit: str | None
    nva: Errors
    vva: Errors
    filled: Errors | None
    n_outside: int
    n_void: int
    coverage: dict[str, Any] | None
    required: float | None

    @property
    def holds(self) -> bool:
        """Nothing was required, or it is reportable and met."""
        if self.required is None:
            return True
        value = self.nva.rmse_v
        return not self.nva.reasons and value is not None and value <= self.required

    @property
    def status(self) -> str:
        """``"not reportable"``, ``"reported"``, ``"met"`` or ``"not met"``."""
        if self.required is not None and self.nva.rmse_v1 is not None:
            # the checkpoints' own error only adds
            least = self.nva.rmse_v if self.nva.rmse_v is not None else self.nva.rmse_v1
            if least > self.required and len(self.nva.errors) >= MIN_CHECKPOINTS:
                return "not met"
        if self.nva.reasons:
            return "not reportable"
        return "reported" if self.required is None else "met"

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON."""
        return {
            "schema": SCHEMA,
            "standard": "ASPRS Positional Accuracy Standards, edition 2 (2023)",
            "dem": self.name,
            "unit": self.unit,
            "checkpoint_rmse": self.nva.checkpoint_rmse,
            "required": self.required,
            "status": self.status,
            "nva": self.nva.to_dict(),
            "vva": self.vva.to_dict() if len(self.vva.errors) else None,
            "filled": None if self.filled is None else self.filled.to_dict(),
            "n_outside": self.n_outside,
            "n_void": self.n_void,
            "sigma": self.coverage,
        }


def crs_of(dem: Path) -> CrsInfo:
    """Return a DEM's CRS and units, as far as the file says."""
    from volatool.points.crs import crs_from_user

    wkt = read_profile(dem)["crs_wkt2"]
    return CrsInfo() if wkt is None else crs_from_user(wkt, "file")


def moved(points: Checkpoints, from_crs: str, to: CrsInfo, name: str) -> Checkpoints:
    """
    Return checkpoints at their places in the DEM's CRS; heights stay as they are.

    Parameters
    ----------
    points : Checkpoints
        In their own CRS.
    from_crs : str
        ``"EPSG:x"`` or WKT.
    to : CrsInfo
        The DEM's.
    name : str
        Of the DEM, for messages.

    Raises
    ------
    CRSError
        The DEM has no CRS, or a point has no place in it.
    """
    from volatool.points.crs import crs_from_user
    from volatool.points.crs_places import mover

    if to.wkt2 is None:
        raise CRSError(f"{name}: has no CRS that --points-crs could lead to")
    way = mover(str(crs_from_user(from_crs).wkt2), to)
    if way is None:
        return points
    x, y = way(points.x, points.y)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise CRSError(f"a checkpoint has no place in the CRS of {name}")
    return replace(points, x=np.asarray(x), y=np.asarray(y))


def assess(
    dem: Path,
    points: Checkpoints,
    *,
    checkpoint_rmse: float | None = None,
    required: float | None = None,
    flag: Path | None = None,
    sigma: Path | None = None,
) -> Accuracy:
    """
    Hold a DEM against checkpoints.

    Parameters
    ----------
    dem : pathlib.Path
        GeoTIFF of one band.
    points : Checkpoints
        In the DEM's CRS; heights in its vertical unit.
    checkpoint_rmse : float, optional
        The checkpoints' own vertical error, same unit.
    required : float, optional
        Largest ``RMSE_V`` of the non-vegetated points that will do.
    flag, sigma : pathlib.Path, optional
        Layers of the DEM; those beside it (``NAME.dem.flag.tif``) by default, if there.

    Raises
    ------
    InputNotFoundError, FormatError
        The DEM or a layer is not there or not such a file.
    InputError
        ``E_CHECKPOINTS``: no checkpoint lies where the DEM has a height.
    """
    flag = beside(dem, "flag") if flag is None else flag
    sigma = beside(dem, "sigma") if sigma is None else sigma
    heights, inside = read_heights_at(dem, points.x, points.y)
    known = np.isfinite(heights)
    if not known.any():
        raise InputError(
            f"{dem.name}: none of the {len(points)} checkpoints lies on a cell with a height "
            f"({np.count_nonzero(~inside)} lie off the model); are they in another CRS "
            "(--points-crs), or x and y swapped?",
            "E_CHECKPOINTS",
        )
    errors = heights - points.z

    def group(mask: np.ndarray[Any, np.dtype[np.bool_]]) -> Errors:
        chosen = np.flatnonzero(mask & known)
        ids = tuple(points.ids[k] for k in chosen)
        return Errors(errors[chosen], ids, checkpoint_rmse)

    filled = None
    if flag is not None:
        filled = group(read_values_at(flag, points.x, points.y) == FILLED)
    coverage = None
    if sigma is not None:
        spread, _ = read_heights_at(sigma, points.x, points.y)
        both = known & np.isfinite(spread)
        ratio = np.abs(errors[both]) / np.hypot(spread[both], checkpoint_rmse or 0.0)
        coverage = {
            "n": int(both.sum()),
            "coverage_68": float(np.mean(ratio < 1)) if len(ratio) else None,
            "coverage_95": float(np.mean(ratio < 1.96)) if len(ratio) else None,
        }
    profile = read_profile(dem)
    return Accuracy(
        dem.name,
        profile["unit"],
        group(~points.vegetated),
        group(points.vegetated),
        filled,
        int(np.count_nonzero(~inside)),
        int(np.count_nonzero(inside & ~known)),
        coverage,
        required,
    )


def beside(dem: Path, layer: str) -> Path | None:
    """Return the path of a layer beside a DEM, if it is there."""
    if not dem.name.endswith(".dem.tif"):
        return None
    path = dem.with_name(dem.name.removesuffix(".tif") + f".{layer}.tif")
    return path if path.exists() else None


def read_points(source: str) -> Checkpoints:
    """
    Return the checkpoints of a file, or of stdin for ``-``.

    Raises
    ------
    InputNotFoundError, FormatError
        Not there; not text; see `checkpoints.parse`.
    """
    import sys

    from volatool.dem.checkpoints import parse
    from volatool.errors import InputError, InputNotFoundError

    if source == "-":
        data, name = sys.stdin.buffer.read(), "stdin"
    else:
        path = Path(source)
        name = path.name
        try:
            data = path.read_bytes()
        except FileNotFoundError as error:
            raise InputNotFoundError(f"{path}: no such file") from error
        except OSError as error:
            raise InputError(f"{path}: can't be read ({error.strerror})") from error
    try:
        return parse(data.decode("utf-8-sig"), name)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"{name}: not text in UTF-8 (byte {error.start})", "E_CHECKPOINTS"
        ) from error


def metres_per_height(crs: CrsInfo, unit: str | None) -> Fraction | None:
    """Return metres per unit of a DEM's heights: of its CRS, else of its band."""
    from volatool.units import METRES_PER_UNIT

    if crs.metres_per_unit_z is not None:
        return crs.metres_per_unit_z
    words = {"metre": "m", "meter": "m", "foot": "ft", "US survey foot": "ftUS", "us-ft": "ftUS"}
    return METRES_PER_UNIT.get(words.get(unit or "", unit or ""))


def in_unit(points: Checkpoints, unit: str, metres: Fraction | None) -> Checkpoints:
    """
    Return checkpoints with heights in the DEM's unit.

    Parameters
    ----------
    points : Checkpoints
        Heights in their own unit.
    unit : str
        That unit, of `units.METRES_PER_UNIT`.
    metres : Fraction or None
        Metres per unit of the DEM's heights.

    Raises
    ------
    CRSError
        The DEM does not say its unit.
    """
    from volatool.units import METRES_PER_UNIT

    if metres is None:
        raise CRSError("the unit of the DEM's heights is not known: leave out --points-unit")
    return replace(points, z=points.z * float(METRES_PER_UNIT[unit] / metres))


def summary(result: Accuracy) -> str:
    """Return the result as lines of text."""
    unit = f" {result.unit}" if result.unit else ""
    lines = [f"{result.name}: {result.status}"]
    groups = (
        ("non-vegetated (NVA)", result.nva),
        ("vegetated (VVA)", result.vva),
        ("of all, in filled cells", result.filled),
    )
    for title, errors in groups:
        if errors is None or not (len(errors.errors) or errors is result.nva):
            continue
        values = errors.to_dict()
        lines.append(f"{title}: n = {values['n']}")
        if not values["n"]:
            continue
        if values["rmse_v"] is not None:
            lines.append(
                f"  RMSE_V {values['rmse_v']:.4f}{unit} (errors {values['rmse_v1']:.4f}, "
                f"checkpoints {errors.checkpoint_rmse:.4f})"
            )
        else:
            lines.append(f"  RMSE_V1 {values['rmse_v1']:.4f}{unit} (checkpoint error not known)")
        lines.append(
            f"  bias {values['bias']:+.4f}, std {_text(values['std'])}, mae {values['mae']:.4f}, "
            f"95th percentile {values['p95']:.4f}, range {values['min']:+.4f} to "
            f"{values['max']:+.4f}"
        )
        if values["skew"] is not None:
            lines.append(f"  skew {values['skew']:+.2f}, kurtosis {values['kurtosis']:+.2f}")
        worst = ", ".join(f"{point['id']} {point['error']:+.4f}" for point in values["worst"])
        lines.append(f"  worst: {worst}")
    if result.coverage is not None and result.coverage["n"]:
        both = (result.coverage["coverage_68"], result.coverage["coverage_95"])
        lines.append(
            "within the sigma layer's 68 % and 95 % intervals: "
            + ", ".join(f"{100 * value:.1f} %" for value in both)
        )
    lines.append(f"points off the DEM: {result.n_outside}, where it is void: {result.n_void}")
    if result.required is not None:
        lines.append(f"required: RMSE_V of NVA at most {result.required:.4f}{unit}")
    if result.nva.reasons:
        lines.append("not reportable: " + "; ".join(result.nva.reasons))
    elif result.nva.rmse_v is not None:
        lines.append(
            "Tested by the ASPRS Positional Accuracy Standards, edition 2 (2023): non-vegetated "
            f"vertical accuracy RMSE_V = {result.nva.rmse_v:.4f}{unit} from "
            f"{len(result.nva.errors)} checkpoints."
        )
    return "\n".join(lines)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
