"""What the kinds of ``volatool query`` say: from the library's values to lines and JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from volatool_cli.queries import Answer, text_of, texts_of

if TYPE_CHECKING:
    from volatool.model import F64
    from volatool.units import Length
    from volatool.vola.census import Census
    from volatool.vola.rays import Hits
    from volatool.vola.regions import BoxCount
    from volatool.vola.volume import Volume

OUTSIDE = Answer("outside", {"answer": "outside"})


def points(volume: Volume, rows: F64) -> Iterator[Answer]:
    """Answer ``point`` for (n, 3) coordinates."""
    cells = volume.cell_indices(rows)
    found = volume.find(cells)
    blocks = volume.find(cells >> 2, volume.depth - 1) if volume.depth > 1 else found * 0
    for cell, index, block in zip(cells.tolist(), found.tolist(), blocks.tolist(), strict=True):
        if cell[0] < 0:
            yield OUTSIDE
            continue
        facts: dict[str, Any] = {"answer": "free", "cell": cell}
        if index >= 0:
            facts["answer"] = "occupied"
            facts["metadata"] = metadata_of(volume, block)
        yield Answer(facts["answer"], facts)


def metadata_of(volume: Volume, block: int) -> dict[str, float]:
    """Return what the metadata of a block of the deepest level says, by channel."""
    if not volume.has_metadata:
        return {}
    word = int(volume.metadata_words()[block])
    return {
        str(channel["name"]): (word >> 8 * int(channel["byte"]) & 255) * float(channel["scale"])
        + float(channel["offset"])
        for channel in volume.info.channels
        if channel["name"] != "present"
    }


def boxes(volume: Volume, rows: F64) -> Iterator[Answer]:
    """Answer ``box`` for (n, 6) corners."""
    for row in rows:
        found = volume.box(row[:3], row[3:])
        facts: dict[str, Any] = {
            "answer": "some" if found else "none" if found.cells else "outside",
            "voxels": found.voxels,
            "blocks": found.blocks,
            "cells": found.cells,
            "fill": found.fill,
            "tight": None,
        }
        text = facts["answer"]
        if found.low is not None and found.high is not None:
            low, high = found.low.tolist(), found.high.tolist()
            facts["tight"] = [*low, *high]
            text = (
                f"{_voxels(found)}, fill {found.fill:.6g}, from {texts_of(low)} to {texts_of(high)}"
            )
        yield Answer(text, facts)


def columns(volume: Volume, rows: F64) -> Iterator[Answer]:
    """Answer ``column`` for (n, 2) places."""
    for column in volume.columns(rows):
        if column.is_outside:
            yield OUTSIDE
            continue
        runs = [f"{text_of(low)}..{text_of(high)}" for low, high in column]
        word = "occupied" if runs else "empty"
        facts = {"answer": word, "runs": [list(run) for run in column]}
        count = f"{len(runs)} run{'s' if len(runs) > 1 else ''}"
        yield Answer(f"{count}: {' '.join(runs)}" if runs else word, facts)


def rays(volume: Volume, rows: F64, max_distance: Length | None) -> Iterator[Answer]:
    """Answer ``ray`` for (n, 6) origins and directions."""
    limit = None
    if max_distance is not None:
        limit = float(max_distance.in_units(volume.crs.metres_per_unit_xy))
    hits = volume.ray(rows[:, :3], rows[:, 3:], limit)
    for i, row in enumerate(rows.tolist()):
        if not all(map(math.isfinite, row)):
            yield OUTSIDE
        elif hits.index[i] < 0:
            yield Answer("none", {"answer": "none", "blocks": int(hits.blocks[i])})
        else:
            yield _met(hits, i, "hit", {"blocks": int(hits.blocks[i])})


def sights(volume: Volume, rows: F64, ignore_ends: bool) -> Iterator[Answer]:
    """Answer ``sight`` for (n, 6) pairs of points."""
    found = volume.sight(rows[:, :3], rows[:, 3:], ignore_ends=ignore_ends)
    for i in range(len(rows)):
        length = float(found.length[i])
        if not found.is_clear[i] and found.blockers.index[i] < 0:  # not finite
            yield OUTSIDE
        elif found.is_clear[i]:
            yield Answer(f"clear {text_of(length)}", {"answer": "clear", "length": length})
        else:
            yield _met(found.blockers, i, "blocked", {"length": length})


def _met(hits: Hits, i: int, word: str, more: dict[str, Any]) -> Answer:
    distance, point = float(hits.distance[i]), hits.points[i].tolist()
    facts = {
        "answer": word,
        "distance": distance,
        "point": point,
        "voxel": hits.voxels[i].tolist(),
        **more,
    }
    return Answer(f"{word} {text_of(distance)} at {texts_of(point)}", facts)


def neighbours(
    volume: Volume, rows: F64, connectivities: Sequence[int], radius: float | None, exact: bool
) -> Iterator[Answer]:
    """Answer ``neighbours`` for (n, 3) coordinates."""
    if radius is None:
        names = [str(connectivity) for connectivity in connectivities]
        counts = [
            volume.neighbours(rows, connectivity=connectivity, exact=exact).tolist()
            for connectivity in connectivities
        ]
    else:
        names = ["count"]
        counts = [volume.neighbours(rows, radius=radius, exact=exact).tolist()]
    for row in zip(*counts, strict=True):
        if row[0] < 0:
            yield OUTSIDE
            continue
        facts: dict[str, Any] = dict(zip(names, row, strict=True))
        text = ", ".join(f"{n} of {name}" for name, n in facts.items())
        if radius is not None:
            text = f"{row[0]} within {text_of(radius)} cells"
            facts["radius"] = radius
        yield Answer(text, {"answer": "counted", "exact": exact, **facts})


def neighbour_errors(volume: Volume, connectivities: Sequence[int]) -> Iterator[Answer]:
    """Answer ``neighbours --error``."""
    for connectivity in connectivities:
        error = volume.neighbour_error(connectivity)
        yield Answer(
            f"of {connectivity}: mean {error.mean_exact:.4g}, inside blocks "
            f"{error.mean_by_block:.4g} ({error.share:.1%}; {error.share_if_full:.1%} in a full "
            f"volume), right for {error.right:.1%} of {error.voxels} voxels, rmse {error.rmse:.4g}",
            error.to_dict(),
        )


def census(found: Census, more: dict[str, Any] | None = None) -> Answer:
    """Return the answer that a census is."""
    facts = {"answer": "some" if found.voxels else "none", **found.to_dict(), **(more or {})}
    if not found.voxels:
        return Answer("none", facts)
    parts = [f"{_voxels(found)}, {_volume_text(found.volume)} cubic {found.unit or 'units'}"]
    if found.classes:
        parts.append("classes " + _counts(found.classes))
    for band in found.bands:
        counts = f" ({_counts(band.classes)})" if band.classes else ""
        parts.append(f"{text_of(band.low)}..{text_of(band.high)}: {band.voxels}{counts}")
    for name, one in found.channels.items():
        parts.append(f"{name} {text_of(one.mean)} ({text_of(one.minimum)}..{text_of(one.maximum)})")
    return Answer("; ".join(parts), facts)


def _voxels(found: BoxCount | Census) -> str:
    voxels, blocks = found.voxels, found.blocks
    return f"{voxels} voxel{'s' * (voxels != 1)} in {blocks} block{'s' * (blocks != 1)}"


def _volume_text(volume: float) -> str:
    """To a millionth as lengths are; what is far below one, as of deep volumes, is not 0."""
    return text_of(volume) if volume >= 1e-3 else f"{volume:.6g}"


def _counts(classes: dict[int, int]) -> str:
    return " ".join(f"{code}:{n}" for code, n in classes.items())
