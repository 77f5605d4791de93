"""A comment by which a file of another format remembers the cube and CRS that it came from."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass

from volatool.cube import MAX_DEPTH, Cube
from volatool.errors import FormatError
from volatool.formats import trailer
from volatool.vola.info import VolumeInfo
from volatool.vola.volume import Volume

_SIGN, _MORE = "volatool ", "volatool+"
_LIMIT = 1 << 40
"""Voxels that a file's corner may be away from its zero."""


@dataclass(frozen=True, slots=True)
class Origin:
    """
    Where the voxels of a file belong.

    Parameters
    ----------
    cube : Cube
        Their cube.
    depth : int
        Their level in it.
    corner : tuple of 3 int
        The file's voxel x, y, z that is cell 0, 0, 0 of the cube.
    info : VolumeInfo
        CRS, box, channels, as the volume had them.
    """

    cube: Cube
    depth: int
    corner: tuple[int, int, int]
    info: VolumeInfo


def origin_lines(
    volume: Volume, corner: Sequence[int] = (0, 0, 0), width: int | None = None
) -> list[str]:
    """
    Return the comment.

    Parameters
    ----------
    volume : Volume
        What the file holds, half-open cells.
    corner : sequence of 3 int
        As `Origin.corner`.
    width : int, optional
        Longest line; some readers have a limit.

    Returns
    -------
    lines : list of str
        ``volatool`` and a JSON object in ASCII: the trailer's, with ``depth`` and ``corner``. What
        does not fit a line goes on in the next ones, after ``volatool+``.
    """
    content = json.loads(trailer.describe(volume, [len(words) for words in volume.levels]))
    content |= {"depth": volume.depth, "corner": [int(value) for value in corner]}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    step = len(text) if width is None else width - len(_MORE)
    pieces = [text[start : start + step] for start in range(0, len(text), step)]
    return [_SIGN + pieces[0], *(_MORE + piece for piece in pieces[1:])]


def find_origin(comments: Sequence[str]) -> Origin | None:
    """
    Return what a file's comments say of where it came from.

    Parameters
    ----------
    comments : sequence of str
        Without their signs.

    Returns
    -------
    origin : Origin or None
        None when no line is ours.

    Raises
    ------
    FormatError
        ``E_CORRUPT``: there is a line of ours that makes no sense.
    """
    for i, comment in enumerate(comments):
        if comment.startswith(_SIGN + "{"):
            more = itertools.takewhile(lambda line: line.startswith(_MORE), comments[i + 1 :])
            return _origin("".join(line[len(_SIGN) :] for line in (comment, *more)))
    return None


def _origin(text: str) -> Origin:
    try:
        content = json.loads(text)
        depth, corner = content["depth"], content["corner"]
        whole = all(type(value) is int and abs(value) < _LIMIT for value in (depth, *corner))
        if not (whole and 1 <= depth <= MAX_DEPTH and len(corner) == 3):
            raise ValueError(f"depth {trailer.short(depth)}, corner {trailer.short(corner)}")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise FormatError(f"the line of volatool makes no sense: {trailer.short(error)}") from error
    cube, info = trailer.recall(content)
    if not cube.side:
        raise FormatError("the line of volatool makes no sense: a cube without extent has no cells")
    return Origin(cube, depth, (corner[0], corner[1], corner[2]), info)
