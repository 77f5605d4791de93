"""What a conversion is asked to do: one frozen, checked value."""

from __future__ import annotations

import operator
import os
from dataclasses import asdict, dataclass, fields
from typing import Any

from volatool.channels import CHANNELS
from volatool.cube import MAX_DEPTH
from volatool.errors import OptionError
from volatool.model import Bounds
from volatool.naming import LAYERS
from volatool.resources import DEFAULT_MEMORY_BYTES
from volatool.units import Length, parse_size

_LENGTHS = (
    "cube", "split", "resolution", "cell", "max_gap", "ell", "tol", "buffer", "sigma", "spacing",
)  # fmt: skip

MAX_HOLDOUT = 50.0
"""Per cent of the points."""

_TOLERANCE = Length.parse("0.1mm")

_NOT_OF_THE_TOOLKIT = (
    "classes",
    "exclude_classes",
    "returns",
    "keep_withheld",
    "keep_noise",
    "bounds",
    "thin",
    "robust_z",
    "to_crs",
    "cube",
    "snap",
    "split",
    "cube_from",
    "columns",
    "mesh",
    "spacing",
)
_FLAGS = {"classes": "class", "exclude_classes": "exclude-class"}

# these change how a result is made, not what it is: the report must not depend on them
_RUN_ONLY = ("chunk_points", "memory", "resources", "strict", "all_levels")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertOptions:
    """
    Options of `volatool.convert` and of the commands; names and defaults as in ``--help``.

    Parameters
    ----------
    classes, exclude_classes : tuple of int, optional
        Class codes to use or to leave out.
    returns : str
        ``"all"``, ``"first"`` or ``"last"``.
    keep_withheld, keep_noise : bool
        Use withheld points; use classes 7 and 18.
    bounds : Bounds, optional
        Use only points inside, in units of the (target) CRS.
    thin : int, optional
        Use every n-th point.
    robust_z : bool
        Leave isolated points far above or below out of everything.
    chunk_points : int
        Points read at a time.
    from_format : str, optional
        Of an imported file: a name of `volatool.imports.registry`; by default the suffix tells.
    columns : tuple of str, optional
        What the columns of an imported table are, ``"-"`` for one that is left out.
    mesh : str
        What of an imported mesh becomes points: ``"voxelize"`` (every voxel that the surface
        touches), ``"sample"``, ``"vertices"``; ``"auto"``: vertices of PLY, else voxelize.
    spacing : Length, optional
        Of ``mesh="sample"``: no part of the surface is farther from a point.
    swap_yz : bool
        Swap y and z of an imported file.
    salvage, strict : bool
        Use what is readable of a damaged file; refuse faulty headers.
    crs, crs_default, to_crs : str, optional
        ``"EPSG:x[+y]"``; `to_crs` also takes ``"utm"``.
    cube : Length or str
        Side of the cube, or ``"auto"``.
    snap : bool
        Cube corner on multiples of the side.
    cube_from : str, optional
        A VOLA file whose cube is used and, if no other option gives one, whose depth.
    split : Length, optional
        One volume per snapped cube of this side.
    depth : int, optional
        Number of levels; None chooses.
    resolution, budget, depth_from : optional
        Other ways to a depth: cell edge, bytes of the gzip file, a summary's JSON file.
    min_occupancy : float
        Threshold of the choice.
    max_depth : int
        Deepest level looked at.
    meta : tuple of str
        Of `volatool.channels.CHANNELS`.
    dense : str
        ``"auto"``, ``"always"`` or ``"never"``.
    gzip : bool
        Compress the volume files.
    compat : str, optional
        ``"toolkit"``: bytes of the original toolkit.
    dem : bool
        Make the elevation model.
    cell, max_gap, tol : Length or str, optional
        Of the elevation model.
    surface, preset : str
        Which points; which springs.
    fill : bool
        Fill cells without points.
    k_surface, k_point : float, optional
        Spring stiffness. `k_surface` makes the surface of a single net.
    ell : Length, optional
        Length beyond which tension rules over bending, in a single net.
    layers : tuple of str
        ``"count"``, ``"flag"``, ``"distance"``, ``"sigma"``.
    sigma : Length, optional
        Noise of the points' heights, when it is known better than the points tell.
    holdout : float, optional
        Per cent of the points to judge the elevation model by, made once more without them.
    neighbours : tuple of str
        Files, folders, patterns or ``@list`` of the tiles around, for seams of the elevation model.
    buffer : Length, optional
        How far beyond the tile their points are used; follows from the data by default.
    like : str, optional
        A GeoTIFF whose cells and extent the elevation model gets.
    params_from : str, optional
        A file of reports, for the cell and stiffness of a whole set.
    robust : bool
        Points that lie far off the surface of the others hardly count.
    breaklines, water : str, optional
        Vector files: lines that no spring crosses; lakes and rivers.
    preview : bool
        Write a picture.
    memory : int
        Ceiling in bytes for the whole process.
    resources : bool
        Put time and memory into the report.
    all_levels : bool
        List every level down to `max_depth` in the report, so that sums over tiles are exact.

    Raises
    ------
    OptionError
        Values that don't go together.
    """

    classes: tuple[int, ...] | None = None
    exclude_classes: tuple[int, ...] | None = None
    returns: str = "all"
    keep_withheld: bool = False
    keep_noise: bool = False
    bounds: Bounds | None = None
    thin: int | None = None
    robust_z: bool = False
    chunk_points: int = 400_000
    from_format: str | None = None
    columns: tuple[str, ...] | None = None
    mesh: str = "auto"
    spacing: Length | None = None
    swap_yz: bool = False
    salvage: bool = False
    strict: bool = False
    crs: str | None = None
    crs_default: str | None = None
    to_crs: str | None = None
    cube: Length | str = "auto"
    snap: bool = False
    cube_from: str | None = None
    split: Length | None = None
    depth: int | None = None
    resolution: Length | None = None
    min_occupancy: float = 0.15
    max_depth: int = 8
    budget: int | None = None
    depth_from: str | None = None
    meta: tuple[str, ...] = CHANNELS
    dense: str = "auto"
    gzip: bool = True
    compat: str | None = None
    dem: bool = True
    cell: Length | str = "auto"
    surface: str = "auto"
    max_gap: Length | None = None
    fill: bool = True
    preset: str = "emap"
    k_surface: float | None = None
    k_point: float | None = None
    ell: Length | None = None
    tol: Length = _TOLERANCE
    layers: tuple[str, ...] = ()
    sigma: Length | None = None
    holdout: float | None = None
    neighbours: tuple[str, ...] = ()
    buffer: Length | None = None
    like: str | None = None
    params_from: str | None = None
    robust: bool = False
    breaklines: str | None = None
    water: str | None = None
    preview: bool = False
    memory: int = DEFAULT_MEMORY_BYTES
    resources: bool = True
    all_levels: bool = False

    def __post_init__(self) -> None:
        for name in _LENGTHS:  # Python callers may write "1m"
            value = getattr(self, name)
            if value is not None and value != "auto":
                object.__setattr__(self, name, Length.parse(value))
        for name in ("memory", "budget"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, parse_size(value))
        self._check_points()
        self._check_depth()
        self._check_words()
        for name in ("k_surface", "k_point"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                flag = "--" + name.replace("_", "-")
                raise OptionError(f"{flag} must be a number greater than 0, got {value}")
        if self.holdout is not None and not 0 < self.holdout <= MAX_HOLDOUT:
            raise OptionError(f"--holdout must be above 0 and at most 50, got {self.holdout}")
        if "sigma" in self.layers and self.surface not in ("auto", "dtm", "dsm"):
            raise OptionError(
                "--layers sigma is for surfaces made by springs: leave out "
                f"--surface {self.surface}"
            )
        if self.chunk_points < 1:
            raise OptionError(f"chunk_points must be at least 1, got {self.chunk_points}")
        if self.ell is not None and self.preset == "paper":
            raise OptionError("--ell is for bending springs: --preset paper has none")
        if self.split is not None and (self.cube != "auto" or self.snap):
            raise OptionError("--split cuts into snapped cubes: leave out --cube and --snap")
        if self.cube_from is not None:
            self._check_cube_from()
        if self.split is not None and self.budget is not None:
            raise OptionError("--budget is for one volume: leave out --split")
        if self.compat == "toolkit":
            self._check_toolkit()
        self._check_seams()
        for name in ("breaklines", "water", "robust"):
            if getattr(self, name) and self.surface not in ("auto", "dtm", "dsm"):
                raise OptionError(f"--{name} is for EMap surfaces, not --surface {self.surface}")

    def _check_cube_from(self) -> None:
        if not isinstance(self.cube_from, str | os.PathLike):
            raise OptionError(f"cube_from must be the name of a VOLA file, got {self.cube_from!r}")
        object.__setattr__(self, "cube_from", os.fspath(self.cube_from))
        if self.cube != "auto" or self.snap or self.split is not None:
            raise OptionError("--cube-from gives the cube: leave out --cube, --snap and --split")

    @property
    def depth_options(self) -> tuple[str, ...]:
        """Names of the options given that say the depth."""
        names = ("depth", "resolution", "budget", "depth_from")
        return tuple(name for name in names if getattr(self, name) is not None)

    @property
    def takes_depth_from_volume(self) -> bool:
        """Whether the depth is that of the volume of ``cube_from``."""
        return self.cube_from is not None and not self.depth_options

    def _check_seams(self) -> None:
        """Refuse what can't be the same for all tiles of a set."""
        if isinstance(self.neighbours, str):
            object.__setattr__(self, "neighbours", (self.neighbours,))
        if self.like is not None and self.cell != "auto":
            raise OptionError("--like gives the cells: leave out --cell")
        if not self.neighbours:
            if self.buffer is not None:
                raise OptionError("--buffer is for --neighbours: give both or none")
            return
        if self.cell == "auto" and self.like is None and self.params_from is None:
            raise OptionError(
                "--neighbours needs --cell, --like or --params-from: tiles that choose their own "
                "cells don't mesh"
            )
        for name in ("bounds", "robust_z"):
            if getattr(self, name):
                raise OptionError(
                    f"--{name.replace('_', '-')} is about one tile's points: it can't go with "
                    "--neighbours"
                )

    def _check_points(self) -> None:
        """Check what Python callers may get wrong; the command line has parsed it."""
        if self.bounds is not None and not isinstance(self.bounds, Bounds):
            try:
                left, bottom, right, top = map(float, self.bounds)
                object.__setattr__(self, "bounds", Bounds(left, bottom, right, top))
            except (TypeError, ValueError) as error:
                raise OptionError(f"bounds must be left, bottom, right, top: {error}") from error
        for name in ("classes", "exclude_classes"):
            codes = getattr(self, name)
            if codes is not None:
                try:
                    object.__setattr__(self, name, tuple(map(operator.index, codes)))
                except TypeError as error:
                    raise OptionError(f"{name} must be a sequence of class codes") from error
        if isinstance(self.columns, str):
            object.__setattr__(self, "columns", tuple(self.columns.split(",")))
        if self.spacing is not None and self.mesh != "sample":
            raise OptionError("--spacing is for --mesh sample")
        if self.thin is not None and self.thin < 1:
            raise OptionError(f"thin must be at least 1, got {self.thin}")
        for name in ("crs", "crs_default", "to_crs"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise OptionError(f'{name} must be text such as "EPSG:25832", got {value!r}')
        for name in ("depth", "max_depth", "chunk_points"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, int):
                raise OptionError(f"{name} must be a whole number, got {value!r}")

    def _check_depth(self) -> None:
        given = self.depth_options
        if len(given) > 1:
            flags = ", ".join("--" + name.replace("_", "-") for name in given)
            raise OptionError(f"{flags}: give only one of them")
        if self.depth is not None and not 1 <= self.depth <= MAX_DEPTH:
            raise OptionError(f"--depth must be 1 to {MAX_DEPTH}, got {self.depth}")
        if not 2 <= self.max_depth <= MAX_DEPTH:
            raise OptionError(f"--max-depth must be 2 to {MAX_DEPTH}, got {self.max_depth}")
        if not 0 < self.min_occupancy <= 1:
            raise OptionError(f"--min-occupancy must be in (0, 1], got {self.min_occupancy}")

    def _check_words(self) -> None:
        allowed: dict[str, tuple[str | None, ...]] = {
            "returns": ("all", "first", "last"),
            "dense": ("auto", "always", "never"),
            "surface": ("auto", "dtm", "dsm", "min", "max", "mean", "idw", "tin"),
            "preset": ("emap", "paper"),
            "compat": (None, "toolkit"),
            "mesh": ("auto", "voxelize", "sample", "vertices"),
        }
        for name, words in allowed.items():
            if getattr(self, name) not in words:
                raise OptionError(f"{name} must be one of {words}, got {getattr(self, name)!r}")
        for name, known in (("meta", CHANNELS), ("layers", LAYERS)):
            unknown = [word for word in getattr(self, name) if word not in known]
            if unknown:
                raise OptionError(f"{name}: {unknown[0]!r} is not one of {known}")

    def _check_toolkit(self) -> None:
        if self.depth is None:
            raise OptionError("--compat toolkit needs --depth N: the toolkit does not choose one")
        for field in fields(self):
            if field.name in _NOT_OF_THE_TOOLKIT and getattr(self, field.name) != field.default:
                flag = "--" + _FLAGS.get(field.name, field.name).replace("_", "-")
                raise OptionError(
                    f"--compat toolkit can't go with {flag}: the toolkit takes all points of a "
                    "file, as they are, into one cube"
                )

    def given(self) -> dict[str, Any]:
        """Return the options that differ from their defaults and bear on the results, as JSON."""
        document: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _RUN_ONLY or value == field.default:
                continue
            if isinstance(value, Length):
                value = str(value)
            elif isinstance(value, Bounds):
                value = list(asdict(value).values())
            elif isinstance(value, tuple):
                value = list(value)
            document[field.name] = value
        return document
