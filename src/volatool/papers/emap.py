"""The EMap paper's experiment from end to end: drives, numbers, figures, files."""

from __future__ import annotations

from pathlib import Path

from volatool.errors import CodedWarning
from volatool.model import Progress, no_progress
from volatool.outputs import OutputSet, refuse_existing, write_error
from volatool.papers import emap_figures
from volatool.papers.emap_experiment import run_drives
from volatool.papers.emap_report import to_markdown
from volatool.papers.emap_scene import Drive
from volatool.papers.emap_summary import summarize
from volatool.papers.emap_timing import loop_times
from volatool.papers.figures import MISSING as MISSING_FIGURES
from volatool.papers.figures import is_available as figures_available
from volatool.papers.result import NUMBERS, REPORT, Reproduction, write_report


def reproduce(
    drive: Drive | None = None,
    *,
    runs: int = 10,
    jobs: int = 1,
    timing: bool = True,
    outdir: Path | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Reproduction:
    """
    Make the EMap paper's experiment again [Lock2022]_.

    Parameters
    ----------
    drive : Drive, optional
        The set-up; the paper's by default.
    runs : int
        Drives at y = 0, 1, ... metres.
    jobs : int
        Drives at a time. The numbers don't depend on it.
    timing : bool
        Time loops too (Figure 6); all else is the same each time.
    outdir : pathlib.Path, optional
        Folder for report.md, report.json and the figures.
    overwrite : bool
        Replace such files.
    progress : callable, optional
        Told (scans done, scans of all runs).

    Returns
    -------
    result : Reproduction
        Numbers and report. Without the extra ``octomap`` there is no baseline, without
        ``figures`` there are no figures; the warnings say so.

    Raises
    ------
    OutputExistsError
        A file is there already; found before any work.
    OutputError
        A file can't be written.
    """
    drive = drive or Drive()
    wanted = [REPORT, NUMBERS]
    figures: list[str] = []
    if outdir is not None and figures_available():
        names = emap_figures.NAMES
        figures = [names[key] for key in names if timing or key != "figure-6"]
    if outdir is not None:
        refuse_existing([outdir / name for name in (*wanted, *figures)], overwrite)
    driven = run_drives(drive, runs, jobs=jobs, progress=progress)
    times = loop_times(drive) if timing else None
    document = summarize(drive, driven, times)
    if outdir is None:
        return Reproduction(document, to_markdown(document))
    if not figures:
        document["warnings"].append(CodedWarning("W_NO_FIGURES", MISSING_FIGURES).to_dict())
    markdown = to_markdown(document, figures)
    with OutputSet(overwrite) as outputs:
        try:
            write_report(outputs, outdir, document, markdown)
            if figures:
                names = emap_figures.NAMES
                emap_figures.error_map(driven, outputs.add(outdir / names["figure-4"]))
                emap_figures.along_the_drive(document, outputs.add(outdir / names["figure-5"]))
            if figures and timing:
                emap_figures.time_against_nodes(document, outputs.add(outdir / names["figure-6"]))
        except OSError as error:
            raise write_error(outdir, error) from error
        paths = outputs.commit()
    return Reproduction(document, markdown, tuple(paths))
