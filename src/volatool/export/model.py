"""What all exporters share: how one is described, its options, and where its output goes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from volatool.errors import OptionError
from volatool.outputs import OutputSet, refuse_existing
from volatool.units import Length, parse_size

if TYPE_CHECKING:
    from volatool.errors import CodedWarning
    from volatool.model import Bounds

SHAPES = ("points", "cubes")
COLOURS = ("auto", "rgb", "height", "intensity", "class", "none")
SLICES = ("all", "top")


@dataclass(frozen=True, slots=True)
class Exporter:
    """
    One format that a volume can be exported to.

    Parameters
    ----------
    name : str
        As ``--to`` has it.
    suffix : str
        Of the output, with its dot; for several files that of the one they begin with.
    title : str
        A few words for ``--help``: who reads it.
    module : str
        Has ``export(volume, target, options)``, which returns a list of `CodedWarning`. It is
        imported when it is used. The volume is the selection: level and crop are done.
    options : tuple of str
        Fields of `ExportOptions` beyond level, bounds and z that mean something.
    extra : str or None
        Optional extra that holds its packages, for ``E_NO_EXTRA``.
    suffixes : tuple of str
        Others of the same format, by which ``-o`` tells it.
    has_main : bool
        There is a file of the output's very name; False if all have endings of their own.
    """

    name: str
    suffix: str
    title: str
    module: str
    options: tuple[str, ...] = ()
    extra: str | None = None
    suffixes: tuple[str, ...] = ()
    has_main: bool = True


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """
    What is exported and how; None is the format's own default.

    Lengths and sizes may be given as text (``"0.2m"``, ``"64M"``), bounds as four numbers.

    Parameters
    ----------
    level : int, optional
        A coarser level, 1 to the depth; exact.
    bounds : Bounds, optional
        Cells whose box meets this closed rectangle.
    z : tuple of 2 float, optional
        Lowest and highest height, in the vertical unit; cells that meet it.
    shape : str, optional
        ``"points"`` or ``"cubes"`` (ply).
    colour : str, optional
        One of `COLOURS` (ply, glb).
    local : bool, optional
        Coordinates from the cube's corner (True) or those of the CRS (False).
    free : bool, optional
        What of the cube is not occupied is marked as free (bt).
    sparse : bool, optional
        Coordinates instead of a dense window (npy).
    slices : str, optional
        ``"all"`` layers or ``"top"``, one view from above (png).
    above : tuple of 2 Length, optional
        Lowest and highest obstacle above the ground (nav2).
    ground : str, optional
        Elevation model that is the ground (nav2).
    near : Length, optional
        How far from ground that was seen empty columns count as free (nav2).
    name : str, optional
        Identifier of the array (c-array).
    dense : bool, optional
        The dense form (vol1).
    limit : int, optional
        Largest output, bytes.
    """

    level: int | None = None
    bounds: Bounds | None = None
    z: tuple[float, float] | None = None
    shape: str | None = None
    colour: str | None = None
    local: bool | None = None
    free: bool | None = None
    sparse: bool | None = None
    slices: str | None = None
    above: tuple[Length, Length] | None = None
    ground: str | None = None
    near: Length | None = None
    name: str | None = None
    dense: bool | None = None
    limit: int | None = None

    def __post_init__(self) -> None:
        self._parse()
        for field, words in (("shape", SHAPES), ("colour", COLOURS), ("slices", SLICES)):
            value = getattr(self, field)
            if value is not None and value not in words:
                raise OptionError(f"{field} is {value!r}, expected one of {', '.join(words)}")
        if self.level is not None and not isinstance(self.level, int):
            raise OptionError(f"level must be a whole number, got {self.level!r}")
        if self.z is not None:
            from volatool.vola.frame import sides_of

            sides_of(None, self.z)
        if self.above is not None:
            low, high = self.above
            if low.unit == high.unit and low.value > high.value:
                raise OptionError(f"above must be LOW,HIGH with LOW <= HIGH, got {low},{high}")

    def _parse(self) -> None:
        """Make values of what was given as text or as plain numbers."""
        if self.bounds is not None:
            object.__setattr__(self, "bounds", _bounds(self.bounds))
        if self.above is not None:
            low, high = self.above
            pair = (Length.parse(low, or_zero=True), Length.parse(high))
            object.__setattr__(self, "above", pair)
        if self.near is not None:
            object.__setattr__(self, "near", Length.parse(self.near, or_zero=True))
        if self.limit is not None:
            object.__setattr__(self, "limit", parse_size(self.limit))

    @property
    def has_selection(self) -> bool:
        """Whether not all of the volume is exported."""
        return (self.level, self.bounds, self.z) != (None, None, None)

    def check(self, exporter: Exporter) -> None:
        """
        Refuse options that mean nothing for a format.

        Raises
        ------
        OptionError
            Naming the first.
        """
        for field in fields(self):
            if field.name in ("level", "bounds", "z", *exporter.options):
                continue
            if getattr(self, field.name) is not None:
                raise OptionError(f"--{field.name} means nothing for --to {exporter.name}")


def _bounds(value: Any) -> Bounds:
    """Return bounds that are given as such, as four numbers or as text."""
    from volatool.model import Bounds

    if isinstance(value, Bounds):
        return value
    numbers = value.split(",") if isinstance(value, str) else value
    try:
        left, bottom, right, top = map(float, numbers)
        return Bounds(left, bottom, right, top)
    except (TypeError, ValueError) as error:
        raise OptionError(f"bounds must be X0,Y0,X1,Y1 with X0 <= X1, got {value!r}") from error


class Target:
    """
    Where an exporter's output goes: one file, or several that begin alike.

    Parameters
    ----------
    outputs : OutputSet
        Gives the files their names when all are written.
    path : pathlib.Path
        The output; of several the one that the others are named after.
    suffix : str
        The format's.
    source : pathlib.Path, optional
        The input, which is never written over.

    Attributes
    ----------
    path, suffix, source
        As given.
    stem : str
        Name of the output without the suffix.
    """

    def __init__(
        self, outputs: OutputSet, path: Path, suffix: str, source: Path | None = None
    ) -> None:
        self.path, self.suffix = path, suffix
        self.source = source
        self._outputs = outputs
        has_suffix = path.name.lower().endswith(suffix) and len(path.name) > len(suffix)
        self.stem = path.name[: -len(suffix)] if has_suffix else path.name

    def name(self, ending: str | None = None) -> Path:
        """Return the name of the output, or of one beside it: `stem` and an ending."""
        return self.path if ending is None else self.path.with_name(self.stem + ending)

    def file(self, ending: str | None = None) -> Path:
        """
        Return the temporary path of a file to write.

        Parameters
        ----------
        ending : str, optional
            For one of several files: what follows `stem`, such as ``".z0012.png"``.

        Raises
        ------
        OutputExistsError
            It exists and must not be overwritten, or it is the input.
        """
        path = self.name(ending)
        if self.source is not None and is_same(path, self.source):
            raise OptionError(f"{path}: is the input; give the output another name with --output")
        return self._outputs.add(path)

    def refuse_existing(self, ending: str) -> None:
        """
        Refuse now a file that `file` would refuse after the work.

        Raises
        ------
        OutputExistsError
            It exists and must not be overwritten.
        """
        refuse_existing([self.name(ending)], self._outputs.overwrite)

    @contextmanager
    def stream(self, ending: str | None = None) -> Iterator[BinaryIO]:
        """
        Open a file for writing; failures are `OutputError` with its name.

        Parameters
        ----------
        ending : str, optional
            As for `file`.
        """
        from volatool.encodings import output_stream

        with output_stream(self.file(ending)) as stream:
            yield stream


def is_same(a: Path, b: Path) -> bool:
    """Tell whether two names are one file, by whatever links."""
    try:
        return a.samefile(b)
    except (OSError, ValueError):  # one is not there
        return False


@dataclass(frozen=True, slots=True)
class Exported:
    """
    What an export wrote.

    Parameters
    ----------
    paths : tuple of pathlib.Path
        The files, the main one first.
    format : str
        Name of the format.
    n_voxels : int
        Cells exported.
    warnings : tuple of CodedWarning
        What the format could not keep.
    """

    paths: tuple[Path, ...]
    format: str
    n_voxels: int
    warnings: tuple[CodedWarning, ...] = ()
