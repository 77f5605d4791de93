"""Index a folder: the ``.vola`` file, STAC, and mosaics of the elevation models in it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from volatool.catalog import stac
from volatool.catalog.attribution import attribution_of
from volatool.catalog.tiles import Tile, tiles_of
from volatool.encodings import output_stream
from volatool.errors import CodedWarning, FormatError, OptionError
from volatool.formats import vola_index
from volatool.naming import LAYERS
from volatool.outputs import OutputSet, refuse_existing
from volatool.report import dumps


@dataclass(frozen=True, slots=True)
class Indexed:
    """
    What came of indexing a folder.

    Parameters
    ----------
    paths : tuple of pathlib.Path
        Files written: the index, mosaics, STAC items, the STAC collection.
    warnings : tuple of CodedWarning
        What a user of the index may stumble over.
    """

    paths: tuple[Path, ...]
    warnings: tuple[CodedWarning, ...]


def index_folder(
    folder: Path,
    *,
    name: str | None = None,
    info_file: Path | None = None,
    attribution: Mapping[str, str | None] | None = None,
    vrt: bool = True,
    period: stac.Period | None = None,
    overwrite: bool = False,
) -> Indexed:
    """
    Write the index of a folder of volumes into it.

    Parameters
    ----------
    folder : pathlib.Path
        Holds ``*.vol`` or ``*.vol.gz``; the folders in it are not searched.
    name : str, optional
        Of the index and the mosaics, without suffix; the folder's name by default.
    info_file : pathlib.Path, optional
        JSON with the texts of `Attribution`; ``info.json`` in the folder by default.
    attribution : mapping of str to str or None, optional
        Texts that go before those of the file.
    vrt : bool
        Write ``NAME.dem.vrt`` over the elevation models of the tiles, and one over each of their
        layers.
    period : Period, optional
        When the points were measured; with it STAC items and a collection are written.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    indexed : Indexed

    Raises
    ------
    InputNotFoundError, InputError, FormatError
        No such folder, no volume in it, a volume that can't be read.
    OptionError
        ``E_ATTRIBUTION``: author or licence are not named; ``E_OUTPUT_EXISTS``.
    FormatError
        ``E_GRID``: the models don't mesh.
    """
    tiles = tiles_of(folder)
    texts = attribution_of(folder, info_file, attribution)
    base = folder / (name or folder.resolve().name or "dataset")
    if base.parent != folder:
        raise OptionError(f"{name!r}: give a name without folders; it is written into {folder}")
    contents: dict[Path, bytes] = {}
    entries = [vola_index.entry(t.path.name, t.header, t.facts.info.box) for t in tiles]
    document = vola_index.document(texts.to_dict(), entries)
    contents[base.with_name(base.name + vola_index.SUFFIX)] = _json(document)
    warnings = _warnings(tiles, document)
    if vrt:
        contents |= _mosaics(tiles, base)
    if period is not None:
        pages, more = _stac(tiles, folder, texts, period)
        contents |= pages
        warnings += more
    refuse_existing(list(contents), overwrite)
    with OutputSet(overwrite) as outputs:
        for target, data in contents.items():
            with output_stream(outputs.add(target)) as stream:
                stream.write(data)
        paths = outputs.commit()
    return Indexed(tuple(paths), tuple(warnings))


def _json(document: Any) -> bytes:
    return (dumps(document, 2) + "\n").encode()


def _warnings(tiles: list[Tile], document: Mapping[str, Any]) -> list[CodedWarning]:
    warnings = []
    n_packed = sum(tile.facts.is_gzip for tile in tiles)
    if n_packed:
        warnings.append(
            CodedWarning(
                "W_INDEX_GZIP",
                f"{n_packed} of {len(tiles)} volumes are gzip, which the original viewer can't "
                "open; volatool can (export --to vol1 writes plain ones)",
                n_packed,
            )
        )
    if "crs" not in document:
        codes = sorted({tile.header.crs for tile in tiles})
        warnings.append(
            CodedWarning(
                "W_INDEX_CRS",
                f"the volumes are in several CRS ({', '.join(map(str, codes))}); the index has no "
                "box of all of them",
                len(codes),
            )
        )
    return warnings


def _mosaics(tiles: list[Tile], base: Path) -> dict[Path, bytes]:
    """Return the mosaic of the models and of each of their layers, as far as there are any."""
    from volatool.dem.vrt import mosaic

    models = [tile.beside["dem"] for tile in tiles if "dem" in tile.beside]
    found = {}
    for layer in ("", *(f".{name}" for name in LAYERS)):
        suffix = f".dem{layer}.tif"
        paths = [path.with_name(path.name.removesuffix(".dem.tif") + suffix) for path in models]
        paths = [path for path in paths if path.is_file()]
        if paths:
            try:
                found[base.with_name(f"{base.name}.dem{layer}.vrt")] = mosaic(paths)
            except FormatError as error:
                raise FormatError(f"{error}; --no-vrt leaves mosaics out", error.code) from error
    return found


def _stac(
    tiles: list[Tile], folder: Path, texts: Any, period: stac.Period
) -> tuple[dict[Path, bytes], list[CodedWarning]]:
    pages: dict[Path, bytes] = {}
    items, warnings = [], []
    for tile in tiles:
        item, more = stac.item(tile, period, texts.dataset, _density(tile))
        pages[folder / (tile.name + stac.ITEM_SUFFIX)] = _json(item)
        items.append(item)
        warnings += more
    pages[folder / stac.COLLECTION] = _json(stac.collection(texts, items, period))
    return pages, warnings


def _density(tile: Tile) -> float | None:
    """Return points per square unit of the tile's box, from its report if there is one."""
    path = tile.beside.get("report")
    if path is None:
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        value = document["input"]["density"]["all_per_area_bbox"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None  # `validate` says what is wrong with a report
    return float(value) if isinstance(value, int | float) else None
