"""Volumes as OpenVDB grids."""

from __future__ import annotations

from volatool.errors import CodedWarning
from volatool.export.cells import Places
from volatool.export.model import ExportOptions, Target
from volatool.export.notes import no_crs
from volatool.export.placing import placed_locally, with_extent
from volatool.formats.origin import origin_lines
from volatool.formats.vdb import encode_vdb
from volatool.vola.volume import Volume
from volatool.vola.window import half_open


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write a ``.vdb``: a float grid ``density``, 1 in the voxels.

    Parameters
    ----------
    volume : Volume
        What is written.
    target : Target
        One file.
    options : ExportOptions
        ``local``: the cube's corner is at 0; by default it is where the CRS has it. The transform
        is of doubles, but programs that render often have single precision.

    Returns
    -------
    warnings : list of CodedWarning
        ``W_SHIFTED``, ``W_NO_CRS``.

    Notes
    -----
    z is in the vertical unit: where that is not the horizontal one, voxels are no cubes. A voxel is
    around its place in OpenVDB, so the transform has the middle of the first one. The grid's
    metadata has the CRS as ``crs_wkt`` and, as ``volatool``, what a comment of ours has.
    """
    with_extent(volume, "OpenVDB")
    volume = half_open(volume)
    places = Places.of(volume)
    corner = (0.0, 0.0, 0.0) if options.local else places.origin
    (line,) = origin_lines(volume)
    texts = {"volatool": line.removeprefix("volatool ")}
    if volume.crs.wkt2 is not None:
        texts["crs_wkt"] = volume.crs.wkt2
    data = encode_vdb(
        volume.voxels(),
        places.step,
        [low + step / 2 for low, step in zip(corner, places.step, strict=True)],
        metadata=texts,
    )
    with target.stream() as stream:
        stream.write(data)
    warnings = no_crs(volume, volume.crs.wkt2 or volume.crs.horizontal)
    return [placed_locally(volume), *warnings] if options.local else warnings
