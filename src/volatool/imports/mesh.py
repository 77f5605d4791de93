"""STL and OBJ meshes by trimesh (extra ``mesh``), and what becomes of any mesh's surface.

=========  ====================================================================================
`mesh`     points
=========  ====================================================================================
voxelize   the middle of every voxel, at the depth asked for, that the surface touches; a surface
           in the face between two voxels touches both. None is missed
sample     points on the surface in rows, edges included; no part of it is farther than the
           spacing from one (half a cell by default). Voxels that it only clips may be missed
vertices   the corners of the triangles
=========  ====================================================================================

Without a depth, the deepest level is taken on which the surface fills about `AUTO_VOXELS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from volatool.cube import Cube
from volatool.errors import (
    CodedWarning,
    FormatError,
    InputError,
    OptionError,
    ResourceError,
    TruncatedError,
)
from volatool.imports.grid import BYTES_A_CELL, voxel_points
from volatool.imports.model import Batch, ImportedPoints, plain_toolkit, sliced
from volatool.model import F64, I32, I64, U64, CrsInfo, as_fraction
from volatool.options import ConvertOptions
from volatool.reference import reference

AUTO_VOXELS = 500_000
_GROUP_CELLS = 1 << 22
_STL_HEADER, _STL_TRIANGLE = 84, 50


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a mesh; it is held whole.

    Parameters
    ----------
    path : pathlib.Path
        STL (ascii or binary) or OBJ.
    options : ConvertOptions
        ``mesh``, ``spacing``, cube and depth.

    Raises
    ------
    OptionError
        ``E_NO_EXTRA``.
    FormatError, TruncatedError
        Not such a file; it ends early.
    """
    name = options.from_format or path.suffix.lower()[1:]
    vertices, triangles = _loaded(path, name)
    points = surface_points(name, vertices, triangles, options)
    if name == "stl":
        corners = vertices[triangles.reshape(-1)]
        points.toolkit = plain_toolkit(lambda n_rows: sliced(corners, {}, n_rows))
    return points


def _loaded(path: Path, name: str) -> tuple[F64, I64]:
    """Return vertices and triangles."""
    try:
        import trimesh
    except ImportError as error:
        raise OptionError(
            f"{path.name}: meshes need trimesh: pip install 'volatool[mesh]'", "E_NO_EXTRA"
        ) from error
    if name == "stl":
        _check_stl(path)
    with path.open("rb") as file:
        try:
            loaded: Any = trimesh.load(file, file_type=name, process=False, skip_materials=True)
            parts: list[Any] = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
            vertices = [np.asarray(part.vertices, np.float64) for part in parts]
            faces = [np.asarray(getattr(part, "faces", ()), np.int64) for part in parts]
        except Exception as error:  # whatever its parsers meet
            raise FormatError(
                f"is no {name.upper()} mesh that trimesh reads ({type(error).__name__}: {error})",
                "E_NOT_IMPORT",
            ) from error
    starts = np.cumsum([0, *map(len, vertices)])
    all_faces = [f.reshape(-1, 3) + start for f, start in zip(faces, starts, strict=False)]
    return np.concatenate([np.empty((0, 3)), *vertices]), np.concatenate(
        [np.empty((0, 3), np.int64), *all_faces]
    )


def _check_stl(path: Path) -> None:
    """Refuse a file that ends before its triangles do."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(1024)
        file.seek(max(0, size - 1024))
        tail = file.read()
    if head.lstrip()[:5].lower() == b"solid" and (b"facet" in head.lower() or b"\0" not in head):
        if b"endsolid" not in tail.lower():
            raise TruncatedError(f"ends at byte {size} without its line endsolid")
        return
    if len(head) < _STL_HEADER:
        raise TruncatedError(f"ends at byte {size}, inside its header of {_STL_HEADER} bytes")
    n_claimed = int.from_bytes(head[80:84], "little")
    n_there = (size - _STL_HEADER) // _STL_TRIANGLE
    if n_there < n_claimed:
        raise TruncatedError(f"ends at triangle {n_there} of {n_claimed}, byte {size}")


def surface_points(
    name: str, vertices: F64, triangles: I64, options: ConvertOptions
) -> ImportedPoints:
    """
    Return the points of a mesh, as `mesh` of the options wants them.

    Parameters
    ----------
    name : str
        Of the format.
    vertices : (n, 3) array of float64
        Corners.
    triangles : (m, 3) array of int64
        Three vertices each.
    options : ConvertOptions
        ``mesh`` (``"auto"``: voxelize), ``spacing``, cube, depth, ``swap_yz``, ``memory``.

    Raises
    ------
    FormatError
        A triangle names a vertex that is not there; ``E_BAD_COORDINATE``.
    ResourceError
        ``E_SIZE``: more points than ``memory`` allows.
    """
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise FormatError(f"a triangle names a vertex that is not among the {len(vertices)}")
    if options.mesh == "vertices" or options.compat is not None or not len(triangles):
        points = ImportedPoints(name, lambda n_rows: sliced(vertices, {}, n_rows))
        if len(vertices) and not len(triangles):
            text = "the mesh has no triangles; its vertices are taken"
            points.warnings.append(CodedWarning("W_NO_FACES", text))
        return points
    corners = vertices[triangles]
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    if bad.any():
        raise FormatError(
            f"triangle {int(np.flatnonzero(bad)[0])} has a corner that is not finite",
            "E_BAD_COORDINATE",
        )
    if options.mesh == "sample":
        return _sampled(name, corners, options)
    return _voxelized(name, corners, options)


def _crs(options: ConvertOptions) -> CrsInfo:
    from volatool.points.crs import crs_from_user

    text = options.crs or options.crs_default
    if text is None and options.cube_from is not None:
        return reference(options.cube_from).crs
    return CrsInfo() if text is None else crs_from_user(text)


def _in_cube_unit(corners: F64, options: ConvertOptions, crs: CrsInfo) -> F64:
    """Return corners in the axes of the volume, z in the horizontal unit."""
    if options.swap_yz:
        corners = corners[:, :, [0, 2, 1]]
    turned: F64 = corners * np.array([1.0, 1.0, float(crs.z_ratio)])
    return turned


def _cube_and_depth(turned: F64, options: ConvertOptions, crs: CrsInfo) -> tuple[Cube, int]:
    from volatool.volumes import depth_in_advance

    flat = turned.reshape(-1, 3)
    box = [as_fraction(value) for value in (*flat.min(axis=0), *flat.max(axis=0))]
    side = None
    if options.cube != "auto":
        side = options.cube.in_units(crs.metres_per_unit_xy)  # type: ignore[union-attr]
    if options.cube_from is not None:
        cube = reference(options.cube_from).cube
    else:
        cube = Cube.snapped(box, side) if options.snap else Cube.around(box, side)
    depth = depth_in_advance(options, crs, cube)
    if depth is None:
        depth = _auto_depth(turned, cube, options.max_depth)
    return cube, depth


def _auto_depth(turned: F64, cube: Cube, max_depth: int) -> int:
    sides = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])
    area = float(np.linalg.norm(sides, axis=1).sum()) / 2
    depth = 2
    # a plane at any angle touches about 1.5 to 3 cells for each cell of its area
    while depth < max_depth and 2 * area <= AUTO_VOXELS * cube.cell(depth + 1) ** 2:
        depth += 1
    return depth


def _voxelized(name: str, corners: F64, options: ConvertOptions) -> ImportedPoints:
    if options.split is not None:
        raise OptionError("--split is for points: give --mesh sample, or leave it out")
    crs = _crs(options)
    turned = _in_cube_unit(corners, options, crs)
    cube, depth = _cube_and_depth(turned, options, crs)
    if not cube.side:
        return ImportedPoints(name, lambda n_rows: sliced(corners[:1, 0], {}, n_rows))
    places = (turned - np.array(cube.origin)) / cube.cell(depth)
    voxels = _touched(places, depth, options.memory // BYTES_A_CELL)
    if not len(voxels):
        raise InputError("no part of the surface lies in the cube of --cube-from", "E_GRID")

    def listed() -> Iterator[I32]:
        yield voxels

    points = voxel_points(name, listed, cube, depth)
    points.is_final = True
    return points


def _touched(places: F64, depth: int, limit: int) -> I32:
    """Return the cells that triangles touch, each once, in VOLA order."""
    from volatool.kernels.quantize import cell_keys, key_cells
    from volatool.kernels.triangles import touched_cells

    room = np.empty((_GROUP_CELLS, 3), np.int32)
    keys: list[U64] = []
    n_keys, start, step = 0, 0, 1 << 16
    while start < len(places):
        group = places[start : start + step]
        counts = touched_cells(group, depth, room, len(room))
        total = int(counts.sum())
        if total > len(room):
            fitting = int(np.searchsorted(np.cumsum(counts), len(room), "right"))
            if not fitting:  # one triangle alone
                needed = int(touched_cells(group[:1], depth, room, limit)[0])
                if needed > limit:
                    raise _too_many(limit)
                room, step = np.empty((needed, 3), np.int32), 1
                continue
            group, total = group[:fitting], int(counts[:fitting].sum())
        keys.append(_once(cell_keys(room[:total])))
        start += len(group)
        n_keys += len(keys[-1])
        if n_keys > limit:
            keys = [_once(np.concatenate(keys))]
            n_keys = len(keys[0])
            if n_keys > limit:
                raise _too_many(limit)
    cells: I32 = key_cells(_once(np.concatenate(keys)), depth)
    return cells


def _too_many(
    limit: int, what: str = "voxels", advice: str = "smaller --depth, a coarser --resolution"
) -> ResourceError:
    return ResourceError(
        f"the surface takes more than the {limit} {what} that --memory allows; give a {advice}, or "
        "more --memory",
        "E_SIZE",
    )


def _once(keys: U64) -> U64:
    keys = np.sort(keys)
    return keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys


def _sampled(name: str, corners: F64, options: ConvertOptions) -> ImportedPoints:
    from volatool.kernels.triangles import count_samples, sample

    crs = _crs(options)
    if options.spacing is not None:
        spacing = float(options.spacing.in_units(crs.metres_per_unit_xy))
    else:
        cube, depth = _cube_and_depth(_in_cube_unit(corners, options, crs), options, crs)
        # half a cell also where a vertical unit is the longer one
        spacing = cube.cell(depth) / 2 / max(1.0, float(crs.z_ratio))
    if not spacing > 0:  # a mesh in one place
        return ImportedPoints(name, lambda n_rows: sliced(corners[:1, 0], {}, n_rows))
    limit = options.memory // BYTES_A_CELL
    counts = count_samples(corners, spacing, limit)
    ends = np.cumsum(counts)

    def batches(n_rows: int) -> Iterator[Batch]:
        first = 0
        while first < len(corners):
            begin = int(ends[first - 1]) if first else 0
            stop = max(first + 1, int(np.searchsorted(ends, begin + n_rows, "right")))
            if ends[stop - 1] - begin > limit:
                raise _too_many(limit, "points", "larger --spacing")
            found = sample(corners[first:stop], spacing, int(ends[stop - 1]) - begin)
            yield from sliced(found, {}, n_rows, begin)
            first = stop

    return ImportedPoints(name, batches)
