"""
OctoMap's binary tree (``.bt``) [Hornung2013]_, objects <-> bytes, without OctoMap.

============ =================================================================================
line         meaning
============ =================================================================================
``# Octomap OcTree binary file``, the first line as it is
``#`` ...    comments, any number, anywhere before the data
``id``       ``OcTree``
``size``     nodes of the tree, root and leaves too; 0: no tree, no data
``res``      edge of a voxel
``data``     the end of the text; after its line break the nodes with children, 2 bytes each
============ =================================================================================

The nodes follow each other in pre-order from the root, little-endian, two bits a child, child 0 in
the lowest: 0 unknown, 1 free, 2 occupied, 3 a node with children of its own. Child
``x + 2 y + 4 z`` lies to the east for x = 1, and so on. A leaf above the sixteenth level stands for
all voxels in it. Voxel keys are 0 to 65535 an axis; key 32768 begins at coordinate 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from volatool.errors import FormatError, OptionError, ResourceError, TruncatedError
from volatool.formats.text_header import header_lines
from volatool.model import F64, I32

DEPTH = 16
"""Levels of a tree."""

HALF = 1 << (DEPTH - 1)
"""Voxels on each side of coordinate 0."""

MAX_CELLS = 1 << 28
"""Voxels that leaves are expanded to unless the caller says otherwise: 3 GiB of indices."""

FIRST_LINE = "# Octomap OcTree binary file"

_MAX_TEXT = 1 << 21
_NO_LEAVES = np.empty((0, 4), np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class BtTree:
    """
    The leaves of a tree.

    Parameters
    ----------
    resolution : float
        Edge of a voxel, in the unit of the map (OctoMap takes it for metres).
    occupied, free : (n, 4) arrays of int32
        Lowest voxel x, y, z of each leaf, counted from coordinate 0 (so -32768 to 32767), and its
        edge in voxels. In the order of the file. What is in neither is unknown.
    comments : tuple of str
        Comment lines without the sign, after the first one.
    """

    resolution: float
    occupied: I32
    free: I32 = field(default_factory=lambda: _NO_LEAVES)
    comments: tuple[str, ...] = ()

    @property
    def n_cells(self) -> int:
        """Occupied voxels, those of pruned leaves counted one by one."""
        edges, counts = np.unique(self.occupied[:, 3], return_counts=True)
        return sum(int(edge) ** 3 * int(n) for edge, n in zip(edges, counts, strict=True))

    def cells(self, limit: int = MAX_CELLS) -> I32:
        """
        Return the occupied voxels, pruned leaves expanded.

        Parameters
        ----------
        limit : int
            Voxels that may be returned.

        Returns
        -------
        cells : (n, 3) array of int32
            x, y, z, counted from coordinate 0; the voxel's corner is ``cells * resolution``.

        Raises
        ------
        ResourceError
            ``E_SIZE``: there are more.
        """
        from volatool.kernels import octree_binary

        n_cells = self.n_cells
        if n_cells > limit:
            raise ResourceError(
                f"the occupied leaves hold {n_cells} voxels of {self.resolution:g}, more than "
                f"{limit} are not expanded",
                "E_SIZE",
            )
        cells: I32 = octree_binary.expanded(self.occupied, n_cells, 0)
        return cells

    def centers(self, limit: int = MAX_CELLS) -> F64:
        """
        Return the middles of the occupied voxels.

        Parameters
        ----------
        limit : int
            As for `cells`.

        Returns
        -------
        centers : (n, 3) array of float64
            In the unit of the map.
        """
        centers: F64 = (self.cells(limit) + np.float64(0.5)) * self.resolution
        return centers


def encode_bt(
    cells: ArrayLike,
    resolution: float,
    *,
    comments: Sequence[str] = (),
    free_cube: tuple[tuple[int, int, int], int] | None = None,
) -> bytes:
    """
    Return the file of a set of occupied voxels.

    Parameters
    ----------
    cells : (n, 3) array of int
        x, y, z, counted from coordinate 0: -32768 to 32767. Repeats are fine.
    resolution : float
        Edge of a voxel, greater than zero.
    comments : sequence of str
        Lines for the reader of the text; OctoMap skips them.
    free_cube : tuple of (x, y, z) and edge, optional
        Cube of voxels, aligned to its own edge (a power of 2), that holds all `cells`: what is not
        occupied in it is free. By default it stays unknown.

    Returns
    -------
    data : bytes
        As OctoMap itself writes it: eight occupied leaves of one node are pruned to one.

    Raises
    ------
    ResourceError
        ``E_SIZE``: a voxel is outside the 65536 of an axis.
    OptionError
        ``E_OPTION``: a resolution that is not a positive number, a cube that does not fit.
    """
    from volatool.kernels import octree_binary as kernels

    if not (math.isfinite(resolution) and resolution > 0):
        raise OptionError(f"an OctoMap needs voxels with an edge, got {resolution!r}")
    places = np.asarray(cells, np.int64).reshape(-1, 3)
    if len(places) and (places.min() < -HALF or places.max() >= HALF):
        raise ResourceError(
            f"OctoMap has {2 * HALF} voxels an axis, {-HALF} to {HALF - 1}; there are voxels from "
            f"{places.min()} to {places.max()}",
            "E_SIZE",
        )
    keys = np.unique(kernels.morton_keys(places.astype(np.int32), HALF))
    leaves, heights = kernels.pruned_leaves(keys)
    value, free_level = kernels.OCCUPIED, DEPTH + 1
    if free_cube is not None:
        cube, height = _aligned_cube(free_cube)
        inside = keys >> np.uint64(3 * height) == cube >> np.uint64(3 * height)
        if not inside.all():
            raise OptionError("voxels lie outside the cube whose rest is to be free")
        free_level = DEPTH - height
        if not len(leaves):
            value = kernels.FREE
            leaves, heights = np.array([cube], np.uint64), np.array([height], np.uint8)
    n_inner = kernels.count_inner(leaves, heights)
    nodes, n_free = kernels.inner_nodes(leaves, heights, value, n_inner, free_level)
    size = len(nodes) + len(leaves) + n_free
    if len(leaves) and not len(nodes):  # all there is, as one leaf: a root without children
        nodes = np.zeros(1, np.uint16)
    lines = [FIRST_LINE, *(f"# {_one_line(comment)}" for comment in comments)]
    lines += ["id OcTree", f"size {size}", f"res {float(resolution)!r}", "data", ""]
    stored: bytes = nodes.astype("<u2").tobytes()
    return "\n".join(lines).encode() + stored


def _aligned_cube(free_cube: tuple[tuple[int, int, int], int]) -> tuple[np.uint64, int]:
    """Return the first Morton key of a cube and its levels above a voxel's."""
    from volatool.kernels import octree_binary as kernels

    corner, edge = free_cube
    height = edge.bit_length() - 1
    if edge != 1 << height or height > DEPTH or any((c + HALF) % edge for c in corner):
        raise OptionError(
            f"a cube of {edge} voxels at {corner} is not a node of an OctoMap: the edge must be "
            "a power of 2 and the corner aligned to it"
        )
    if min(corner) < -HALF or max(corner) + edge > HALF:
        raise OptionError(f"a cube of {edge} voxels at {corner} does not fit an OctoMap")
    key: np.uint64 = kernels.morton_keys(np.array([corner], np.int32), HALF)[0]
    return key, height


def _one_line(comment: str) -> str:
    if "\n" in comment or "\r" in comment:
        raise OptionError(f"a comment must be one line, got {comment!r}")
    return comment


def parse_bt(data: bytes) -> BtTree:
    """
    Read a binary tree.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    tree : BtTree
        Its leaves as they are stored; `BtTree.cells` expands them.

    Raises
    ------
    FormatError
        ``E_NOT_OCTOMAP``: another file, or a tree of another kind (``.ot``, ColorOcTree);
        ``E_CORRUPT``: text or nodes that make no sense, with their offset.
    TruncatedError
        ``E_TRUNCATED``: the file ends inside the text or the nodes.
    """
    from volatool.kernels import octree_binary as kernels

    size, resolution, comments, start = _header(data)
    if size == 0:
        _refuse_rest(data, start)
        return BtTree(resolution, _NO_LEAVES, _NO_LEAVES, comments)
    if len(data) - start < 2:
        raise TruncatedError(
            f"the file ends where its tree of {size} nodes should begin (offset {len(data)})"
        )
    nodes = np.frombuffer(data, "<u2", (len(data) - start) // 2, start).astype(np.uint16)
    used, place, n_occupied, n_free = map(int, kernels.count_leaves(nodes))
    offset = start + 2 * place
    if used == kernels.CUT:
        raise TruncatedError(f"the file ends inside its tree of {size} nodes (offset {len(data)})")
    if used == kernels.TOO_DEEP:
        raise FormatError(f"a node has children below level {DEPTH} (offset {offset})")
    if used == kernels.NO_CHILDREN:
        raise FormatError(f"a node that should have children has none (offset {offset})")
    found = used + n_occupied + n_free
    if found != size:
        raise FormatError(f"the header says {size} nodes, the tree has {found} (offset {start})")
    _refuse_rest(data, start + 2 * used)
    if nodes[0] == 0:  # a root without children is occupied, all of it
        occupied, free = np.array([[0, 0, 0, 2 * HALF]], np.int32), _NO_LEAVES.copy()
    else:
        occupied, free = kernels.find_leaves(nodes, n_occupied, n_free)
    occupied[:, :3] -= HALF
    free[:, :3] -= HALF
    return BtTree(resolution, occupied, free, comments)


def _refuse_rest(data: bytes, end: int) -> None:
    if data[end:].strip():
        raise FormatError(f"{len(data) - end} bytes follow the tree (offset {end})")


def _header(data: bytes) -> tuple[int, float, tuple[str, ...], int]:
    """Return size, resolution, comments and where the nodes begin."""
    if not data.startswith(FIRST_LINE.encode()):
        raise FormatError(_what_else(data), "E_NOT_OCTOMAP")
    fields: dict[str, str] = {}
    comments: list[str] = []
    for offset, text in header_lines(data, _MAX_TEXT):
        line = text.decode("utf-8", "replace").strip()
        if line.startswith("#"):
            if offset:
                comments.append(line[1:].removeprefix(" "))
            continue
        name, _, value = line.partition(" ")
        if name == "data":
            break
        if name in ("id", "size", "res"):
            fields[name] = value.strip()
        elif name:
            raise FormatError(
                f"expected id, size, res or data, found {line[:40]!r} (offset {offset})"
            )
    return _whole(fields), _edge(fields), tuple(comments), offset + len(text) + 1


def _what_else(data: bytes) -> str:
    start = f"expected {FIRST_LINE!r}"
    if data.startswith(b"# Octomap OcTree file"):
        return (
            "is an OctoMap tree with probabilities (.ot): write it as a binary tree first, e.g. "
            "with OctoMap's convert_octree (offset 0)"
        )
    if not data:
        return f"{start}, the file is empty (offset 0)"
    return f"not an OctoMap binary tree: {start}, found {data[:32]!r} (offset 0)"


def _whole(fields: dict[str, str]) -> int:
    kind = fields.get("id")
    if kind != "OcTree":
        raise FormatError(
            f"holds a tree of the kind {str(kind)[:40]!r}, expected 'OcTree'", "E_NOT_OCTOMAP"
        )
    text = fields.get("size", "")
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise FormatError(f"the number of nodes is {text[:40]!r}, expected 'size' and digits")
    return int(text)


def _edge(fields: dict[str, str]) -> float:
    text = fields.get("res", "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise FormatError(f"the resolution is {text[:40]!r}, expected a number greater than 0")
    return value
