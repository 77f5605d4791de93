"""``--compat toolkit``: the volume part of a tile as the original toolkit makes it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from volatool.encodings import DENSE_LIMIT_BYTES, Encoding, encoding_row, output_stream
from volatool.errors import CodedWarning
from volatool.formats import gz, toolkit
from volatool.model import CrsInfo
from volatool.occupancy.depth import fixed_depth
from volatool.occupancy.levels import level_rows
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet
from volatool.vola.toolkit import ToolkitVolume, build
from volatool.volumes import VolumePart, cube_document, place_of

if TYPE_CHECKING:
    from volatool.points.source import Source


def make_toolkit_volume(
    source: Source,
    options: ConvertOptions,
    outputs: OutputSet,
    base: Path | None,
    corners: list[float],
) -> VolumePart:
    """
    Build and write what the toolkit would.

    It takes every point of the file, whatever its class or flags, and knows a CRS only from its
    command line; so does this. The file is read twice more.

    Parameters
    ----------
    source, options, outputs, base, corners
        As for `volatool.volumes.make_volumes`.
    """
    assert options.depth is not None
    crs = source.crs if options.crs is not None else CrsInfo()
    lat, lon = place_of(crs, corners)
    content = _content(source, options, crs.epsg, lat or 0.0, lon or 0.0)
    volume = content.volume()
    bits = 2 if content.has_metadata else 1
    codec = "gzip" if options.gzip else "none"
    warnings = [
        CodedWarning(
            "W_TOOLKIT",
            "written as the original toolkit does, with all points of the file: voxels are "
            "rounded, not cells, and the last point of a block gives its metadata",
        )
    ]
    rows = []
    for kind in _kinds(content, options, bits):
        encoding = Encoding(kind, bits, codec)
        if base is not None:
            name = base.name + encoding.suffix
            path = outputs.add(base.with_name(name))
            with output_stream(path) as stream:
                _write(stream, content, encoding)
            rows.append(
                encoding_row(
                    volume,
                    encoding,
                    path,
                    name,
                    source.header.las_equivalent_bytes,
                    source.header.size_bytes,
                )
            )
    counts = volume.counts()
    return VolumePart(
        cube=cube_document(volume.cube, crs, options, 1),
        choice=fixed_depth(options.depth, volume.cube, counts).to_dict(),
        levels=tuple(
            row.to_dict() for row in level_rows(counts, volume.cube.exact[3], source.n_points)
        ),
        encodings=partial(tuple, rows),
        volume=volume,
        warnings=tuple(warnings),
    )


def _content(
    source: Source, options: ConvertOptions, epsg: int | None, lat: float, lon: float
) -> ToolkitVolume:
    assert options.depth is not None
    with_metadata = bool(options.meta)
    from volatool.imports.source import ImportSource

    if isinstance(source, ImportSource):
        from volatool.imports.toolkit import build as build_import

        return build_import(
            source.points,
            options.depth,
            with_metadata=with_metadata,
            swap_yz=options.swap_yz,
            epsg=epsg,
            lat=lat,
            lon=lon,
        )
    return build(
        lambda attributes: source.chunks(attributes, options.chunk_points),
        options.depth,
        with_metadata=with_metadata,
        header_zmax=source.header.box[5],
        epsg=epsg,
        lat=lat,
        lon=lon,
    )


def _kinds(content: ToolkitVolume, options: ConvertOptions, bits: int) -> list[str]:
    """Return which files to write; the toolkit makes no dense one of points in one place."""
    size = Encoding("dense", bits, "none").payload_bytes(content.volume())
    wants_dense = options.dense == "always" or (
        options.dense == "auto" and content.has_extent and size <= DENSE_LIMIT_BYTES
    )
    return ["sparse", "dense"] if wants_dense else ["sparse"]


def _write(stream: BinaryIO, content: ToolkitVolume, encoding: Encoding) -> None:
    write = toolkit.write_sparse if encoding.kind == "sparse" else toolkit.write_dense
    if encoding.codec == "gzip":
        with gz.writer(stream) as packed:
            write(packed, content)  # type: ignore[arg-type]
    else:
        write(stream, content)
