"""The VOLA paper's tables and figures from end to end: numbers, report, pictures, files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from volatool.errors import CodedWarning, OptionError, ResourceError
from volatool.model import Progress, no_progress
from volatool.options import ConvertOptions
from volatool.outputs import OutputSet, refuse_existing, write_error
from volatool.papers import vola_figures
from volatool.papers.figures import MISSING, is_available
from volatool.papers.result import NUMBERS, REPORT, Reproduction, write_report
from volatool.papers.vola_contiguity import SAMPLES
from volatool.papers.vola_lookups import POINTS
from volatool.papers.vola_report import to_markdown
from volatool.papers.vola_summary import summarize
from volatool.papers.vola_tile_tables import read_tiles
from volatool.papers.vola_tiles import Tile

MOST_POINTS = 20_000_000
"""Points of the made-up surface, at most: 64 bytes each while it is made."""

MOST_SAMPLES = 100_000_000
"""Random blocks a row, at most: 16 bytes each."""


def reproduce(
    paths: Sequence[Path] = (),
    options: ConvertOptions | None = None,
    *,
    points: int = POINTS,
    samples: int = SAMPLES,
    seed: int = 1,
    timing: bool = True,
    outdir: Path | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Reproduction:
    """
    Make the VOLA paper's tables and figures again [Byrne2018]_.

    Parameters
    ----------
    paths : sequence of pathlib.Path
        Tiles to measure: LAS, LAZ, COPC or VOLA files.
    options : ConvertOptions, optional
        CRS of the tiles.
    points : int
        Points of the made-up surface of Table 1.
    samples, seed : int
        Random blocks a row of Table 6, and the seed of chance.
    timing : bool
        Time look-ups and packing too; all else is the same each time.
    outdir : pathlib.Path, optional
        Folder for report.md, report.json and the figures.
    overwrite : bool
        Replace such files.
    progress : callable, optional
        Told (bytes done, bytes of all tiles).

    Returns
    -------
    result : Reproduction
        Numbers and report. Without the extra ``octomap`` there is no octree, without ``figures``
        there are no figures; the warnings say so.

    Raises
    ------
    VolatoolError
        From the first tile that can't be used.
    OutputExistsError
        A file is there already; found before any work.
    OptionError
        ``E_OPTION``: fewer than 1 point or 2 samples.
    ResourceError
        ``E_SIZE``: more than `MOST_POINTS` or `MOST_SAMPLES`.
    """
    _check(points, samples)
    with_figures = is_available()
    planned = [REPORT, NUMBERS, *(_figure_names(paths) if with_figures else ())]
    if outdir is not None:
        refuse_existing([outdir / name for name in planned], overwrite)
    options = options or ConvertOptions(resources=False)
    tiles: list[Tile] = []
    warnings: list[CodedWarning] = []
    if paths:
        tiles, warnings = read_tiles(paths, options, progress)
    document = summarize(
        tiles, points=points, samples=samples, seed=seed, timing=timing, warnings=warnings
    )
    if outdir is None:
        return Reproduction(document, to_markdown(document))
    if not with_figures:
        missing = CodedWarning("W_NO_FIGURES", MISSING)
        document["warnings"].append(missing.to_dict())
    with OutputSet(overwrite) as outputs:
        try:
            figures = _draw(document, tiles, paths, outputs, outdir) if with_figures else []
            markdown = to_markdown(document, figures)
            write_report(outputs, outdir, document, markdown)
        except OSError as error:
            raise write_error(outdir, error) from error
        written = outputs.commit([outdir / name for name in planned])
    return Reproduction(document, markdown, tuple(written))


def _check(points: int, samples: int) -> None:
    if points < 1 or samples < 2:
        raise OptionError(f"at least 1 point and 2 samples are needed, got {points}, {samples}")
    if points > MOST_POINTS or samples > MOST_SAMPLES:
        raise ResourceError(
            f"{points} points and {samples} samples: at most {MOST_POINTS} and {MOST_SAMPLES} "
            "are made",
            "E_SIZE",
        )


def _figure_names(paths: Sequence[Path]) -> list[str]:
    """Return the names that figures may get; those of times are not drawn without times."""
    names = [name for own in vola_figures.tile_names(paths).values() for name in own.values()]
    return [vola_figures.SUBDIVISION, *names, vola_figures.LOOK_UPS, vola_figures.PACKING]


def _draw(
    document: dict[str, Any],
    tiles: Sequence[Tile],
    paths: Sequence[Path],
    outputs: OutputSet,
    outdir: Path,
) -> list[str]:
    """Draw the figures; return their names in order."""
    drawn = [vola_figures.SUBDIVISION]
    vola_figures.subdivision(outputs.add(outdir / vola_figures.SUBDIVISION))
    names = vola_figures.tile_names(paths)
    for tile in tiles:
        own = names.get(tile.path, {})
        if "levels" in own:
            vola_figures.levels(tile, outputs.add(outdir / own["levels"]))
            drawn.append(own["levels"])
        if "density" in own and tile.density is not None:
            vola_figures.density(tile, outputs.add(outdir / own["density"]))
            drawn.append(own["density"])
    if "resources" in document:
        vola_figures.look_ups(document, outputs.add(outdir / vola_figures.LOOK_UPS))
        vola_figures.packing(document, outputs.add(outdir / vola_figures.PACKING))
        drawn += [vola_figures.LOOK_UPS, vola_figures.PACKING]
    return drawn
