"""Files cut anew along a grid of cubes: neighbouring files' points in one cube become one volume.

The cubes are worked on in groups of columns, each a unit of work of its own: a small file names the
group's cubes and the files that may have points there, found by their headers. A group needs
nothing from another, so that groups can run anywhere, in any order, and again.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from volatool._version import __version__
from volatool.batch.identity import Identity, identify
from volatool.catalog.headers import crs_document, crs_from_document, headers_of, shared_name
from volatool.census import box_corners, header_box
from volatool.channels import CHANNELS
from volatool.errors import CRSError, FormatError, InputError, OptionError, VolatoolError
from volatool.model import CrsInfo, as_fraction
from volatool.options import ConvertOptions
from volatool.points.header import LasHeader
from volatool.report import dumps

GROUP_SUFFIX = ".cubes"
"""What the file of a group ends in."""

SCHEMA = "volatool.cubes/1"

MOST_CUBES = 1024
"""Cubes of a group, as planned; half of what one unit of work may have."""

MOST_LAYERS = 8
"""Layers that are planned for: a stray point far above makes the headers tell of more."""

Columns = tuple[int, int, int, int]
"""Columns of cubes: first x, first y, and the ones behind the last."""


@dataclass(frozen=True, slots=True)
class Piece:
    """
    A file that may have points in a group.

    Parameters
    ----------
    path : str
        Absolute, or a URL.
    identity : dict or None
        Of the file, as it was when the groups were planned: a group changes when a file does.
    size_bytes, n_points, record_bytes : int
        Of the file.
    columns : tuple of 4 int
        Columns of cubes that its header's box touches.
    """

    path: str
    identity: Identity | None
    size_bytes: int
    n_points: int
    record_bytes: int
    columns: Columns


@dataclass(frozen=True, slots=True)
class Frame:
    """
    What all groups of a set have in common.

    Parameters
    ----------
    name : str
        Outputs begin with it.
    side : Fraction
        Of the cubes, in the horizontal unit.
    crs : CrsInfo
        Of all files.
    scale, offset : tuple of 3 Fraction
        Integers in which the coordinates of every file can be stored exactly.
    channels : tuple of str
        Metadata that all files have.
    total_bytes, las_bytes : int
        Sizes of all files, and as LAS.
    """

    name: str
    side: Fraction
    crs: CrsInfo
    scale: tuple[Fraction, Fraction, Fraction]
    offset: tuple[Fraction, Fraction, Fraction]
    channels: tuple[str, ...]
    total_bytes: int
    las_bytes: int


@dataclass(frozen=True, slots=True)
class Group:
    """A unit of work: columns of cubes, and the files that may have points there."""

    frame: Frame
    columns: Columns
    pieces: tuple[Piece, ...]

    @property
    def name(self) -> str:
        """Of its file and its report."""
        x0, y0, x1, y1 = self.columns
        return f"{self.frame.name}_x{x0}..{x1 - 1}_y{y0}..{y1 - 1}"

    def to_json(self) -> str:
        """Return the content of its file."""
        frame = asdict(self.frame)
        frame["crs"] = crs_document(self.frame.crs)
        frame["side"] = str(self.frame.side)
        for key in ("scale", "offset"):
            frame[key] = [str(value) for value in frame[key]]
        return dumps(
            {
                "schema": SCHEMA,
                "frame": frame,
                "columns": self.columns,
                "pieces": [asdict(piece) for piece in self.pieces],
            },
            1,
        )


def read_group(path: Path) -> Group:
    """
    Return the group that a file names.

    Raises
    ------
    FormatError
        ``E_NOT_REPORT``: the file is none.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema {document['schema']!r}")
        frame = document["frame"]
        frame["crs"] = crs_from_document(frame["crs"])
        frame["side"] = Fraction(frame["side"])
        for key in ("scale", "offset"):
            frame[key] = tuple(Fraction(value) for value in frame[key])
        frame["channels"] = tuple(frame["channels"])
        pieces = [
            Piece(**{**piece, "columns": tuple(piece["columns"])}) for piece in document["pieces"]
        ]
        return Group(Frame(**frame), tuple(document["columns"]), tuple(pieces))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FormatError(f"{path}: not a group of cubes ({error})", "E_NOT_REPORT") from error


def is_group(path: Path) -> bool:
    """Whether a file names a group of cubes, by its name."""
    return path.name.endswith(GROUP_SUFFIX)


def plan(
    paths: Iterable[Path], options: ConvertOptions, name: str
) -> tuple[list[Group], dict[Path, VolatoolError]]:
    """
    Read the headers of files and part the cubes that they touch into groups.

    Parameters
    ----------
    paths : iterable of pathlib.Path
        LAS, LAZ or COPC.
    options : ConvertOptions
        ``split``, ``meta`` and how files are opened.
    name : str
        What outputs begin with.

    Returns
    -------
    groups : list of Group
        By x, then y; together they touch every place that a header's box does.
    failed : dict of pathlib.Path to VolatoolError
        Files whose headers can't be read; they are in no group.

    Raises
    ------
    OptionError
        A URL holds a secret: see `volatool.catalog.headers.shared_name`.
    CRSError
        ``E_CRS``: files are in different CRS.
    FormatError
        ``E_BAD_SCALE``: no integers store the coordinates of all files exactly.
    """
    if options.split is None:
        raise OptionError("re-tiling needs the side of the cubes: --split LENGTH")
    for flag in ("thin", "robust_z"):
        if getattr(options, flag):
            raise OptionError(
                f"--{flag.replace('_', '-')} is about one file's points: it can't go with retile"
            )
    failed: dict[Path, VolatoolError] = {}
    headers = deque(_slim(headers_of(paths, options, failed)))
    if not headers:
        return [], failed
    crs = _common_crs(headers)
    side = options.split.in_units(crs.metres_per_unit_xy)
    scale, offset = _exact_integers([header for _, header, _, _ in headers])
    channels = _common_channels([header.dimensions for _, header, _, _ in headers], options)
    pieces, layers = [], set[int]()
    while headers:  # each goes as its piece comes
        path, header, _, n_points = headers.popleft()
        box = header_box(header.box, header.scale, header.offset)
        if box is None:
            failed[path] = InputError(
                f"{path.name}: its header has no usable box, so where its points lie is not known; "
                "have it repaired (lasinfo -repair, pdal translate)",
                "E_NO_BOX",
            )
            continue
        low = [math.floor(value / side) for value in _corners(box, header, crs)]
        pieces.append(
            Piece(
                shared_name(path),
                identify(path),
                header.size_bytes,
                n_points,
                header.record_bytes,
                (low[0], low[1], low[3] + 1, low[4] + 1),
            )
        )
        layers.update((low[2], low[5]))
    if not pieces:
        return [], failed
    frame = Frame(
        name,
        side,
        crs,
        scale,
        offset,
        channels,
        sum(piece.size_bytes for piece in pieces),
        sum(piece.n_points * piece.record_bytes for piece in pieces),
    )
    return _groups(frame, pieces, max(layers) - min(layers) + 1), failed


def _slim(
    found: Iterable[tuple[Path, LasHeader, CrsInfo, int]],
) -> Iterator[tuple[Path, LasHeader, CrsInfo, int]]:
    """Yield headers without what is not needed, and once what is equal: files may be very many."""
    crs_known: dict[CrsInfo, CrsInfo] = {}
    known: dict[Any, Any] = {}
    for path, header, crs, n_points in found:
        small = replace(
            header,
            vlrs=(),
            warnings=(),
            dimensions=known.setdefault(header.dimensions, header.dimensions),
            scale=known.setdefault(header.scale, header.scale),
            offset=known.setdefault(header.offset, header.offset),
        )
        yield path, small, crs_known.setdefault(crs, crs), n_points


def _corners(box: Any, header: Any, crs: CrsInfo) -> list[Fraction]:
    return box_corners(box, header.scale, header.offset, crs.z_ratio)


def _common_crs(headers: Sequence[tuple[Path, Any, CrsInfo, int]]) -> CrsInfo:
    """Return the CRS of the first file that has one; refuse files in others."""
    from volatool.points.crs import difference

    first = next((item for item in headers if item[2].wkt2 is not None), headers[0])
    for path, _, crs, _ in headers:
        found = difference(first[2], crs)
        if found is not None:
            raise CRSError(
                f"{first[0].name} and {path.name} can't share cubes: {found}; give --to-crs, or "
                "--crs if one of them is wrong"
            )
    return first[2]


def _common_channels(
    dimensions: Sequence[frozenset[str]], options: ConvertOptions
) -> tuple[str, ...]:
    from volatool.vola.metadata import channels_of

    have = set(channels_of(frozenset.intersection(*dimensions)))
    return tuple(channel for channel in CHANNELS if channel in have and channel in options.meta)


def _exact_integers(headers: Sequence[Any]) -> tuple[Any, Any]:
    """Return scale and offset in which each file's coordinates are whole numbers."""
    scale, offset = [], []
    for axis in range(3):
        start = as_fraction(headers[0].offset[axis])
        step = Fraction(0)
        for one in {(header.scale[axis], header.offset[axis]) for header in headers}:
            step = _gcd(step, as_fraction(one[0]))
            step = _gcd(step, abs(as_fraction(one[1]) - start))
        if as_fraction(float(step)) != step:
            raise FormatError(
                f"the files' scales and offsets of {'xyz'[axis]} have no common step that a LAS "
                "header could hold",
                "E_BAD_SCALE",
            )
        scale.append(step)
        offset.append(start)
    return tuple(scale), tuple(offset)


def _gcd(one: Fraction, other: Fraction) -> Fraction:
    denominator = math.lcm(one.denominator, other.denominator)
    return Fraction(math.gcd(int(one * denominator), int(other * denominator)), denominator)


def _groups(frame: Frame, pieces: Sequence[Piece], n_layers: int) -> list[Group]:
    """Part columns into squares that begin at the set's corner and are whole files wide."""
    left = min(piece.columns[0] for piece in pieces)
    bottom = min(piece.columns[1] for piece in pieces)
    widths = sorted(
        max(piece.columns[2] - piece.columns[0], piece.columns[3] - piece.columns[1])
        for piece in pieces
    )
    width = widths[len(widths) // 2]
    most = max(1, math.isqrt(MOST_CUBES // min(n_layers, MOST_LAYERS)))
    step = most // width * width if most >= width else most
    members: dict[tuple[int, int], list[Piece]] = defaultdict(list)
    for piece in pieces:
        x0, y0, x1, y1 = piece.columns
        for col in range((x0 - left) // step, (x1 - 1 - left) // step + 1):
            for row in range((y0 - bottom) // step, (y1 - 1 - bottom) // step + 1):
                members[col, row].append(piece)
    groups = []
    for col, row in sorted(members):
        x, y = left + col * step, bottom + row * step
        groups.append(Group(frame, (x, y, x + step, y + step), tuple(members[col, row])))
    return groups


def write_groups(groups: Sequence[Group], folder: Path) -> list[Path]:
    """
    Write the files of groups; those that are there with the same content stay as they are.

    Parameters
    ----------
    groups : sequence of Group
        What is planned.
    folder : pathlib.Path
        For them alone: files of groups that are not planned any more are removed.

    Returns
    -------
    paths : list of pathlib.Path
        In the order of the groups.
    """
    from volatool.outputs import OutputSet, sweep

    sweep(folder)
    paths = [folder / (group.name + GROUP_SUFFIX) for group in groups]
    with OutputSet(overwrite=True) as outputs:
        for path, group in zip(paths, groups, strict=True):
            content = group.to_json()
            if not (path.is_file() and path.read_text(encoding="utf-8") == content):
                outputs.add(path).write_text(content, encoding="utf-8")
        outputs.commit()
    for path in set(folder.glob(f"*{GROUP_SUFFIX}")).difference(paths):
        path.unlink()
    return paths


COUNT_NAME = "dataset.json"
"""File beside those of the groups: the sum over all of them, which their depth follows from."""

_PROOF_NAME = "dataset.proof.json"


def count_proof(groups: Iterable[Group], options: str) -> str:
    """
    Return what changes when the sum over groups might.

    Parameters
    ----------
    groups : iterable of Group
        All of them; they tell the identities of their files.
    options : str
        Digest of the options for counting.
    """
    digest = hashlib.sha256(f"{__version__} {options}".encode())
    for group in groups:
        digest.update(group.to_json().encode())
    return digest.hexdigest()


def is_counted(folder: Path, proof: str) -> bool:
    """Whether the sum in a folder of groups is proven to be the same as a new one would be."""
    try:
        document = json.loads((folder / _PROOF_NAME).read_text(encoding="utf-8"))
        count = (folder / COUNT_NAME).read_bytes()
        return bool(document == _proven(count, proof))
    except (OSError, ValueError):
        return False


def keep_proof(folder: Path, proof: str) -> None:
    """Write down that the sum in a folder of groups is whole, and of what it is."""
    from volatool.outputs import OutputSet

    with OutputSet(overwrite=True) as outputs:
        text = dumps(_proven((folder / COUNT_NAME).read_bytes(), proof)) + "\n"
        outputs.add(folder / _PROOF_NAME).write_text(text, encoding="utf-8")
        outputs.commit()


def _proven(count: bytes, proof: str) -> dict[str, str]:
    return {"of": proof, "sha256": hashlib.sha256(count).hexdigest()}
