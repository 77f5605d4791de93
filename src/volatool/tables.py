"""Reports as text: the paper's tables for people, Markdown and CSV for documents and scripts."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from volatool.errors import OptionError
from volatool.report import Report, dumps

Cells = list[list[str]]

FORMATS = ("table", "json", "jsonl", "csv", "md")


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:,.{digits}f}"


def _percent(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{100 * value:.{digits}f} %"


def _megabytes(n_bytes: int | None) -> str:
    """Decimal megabytes with the digits that a small size needs, as the paper prints them."""
    if n_bytes is None:
        return "-"
    value = n_bytes / 1e6
    return f"{value:,.2f}" if value >= 10 else f"{value:,.4f}" if value >= 0.01 else f"{value:.6f}"


_LEVEL_COLUMNS: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("Dense(MB)", lambda row: _megabytes(row["dense_bytes"])),
    ("Sparse(MB)", lambda row: _megabytes(row["sparse_bytes"])),
    ("Mag Red", lambda row: _number(row["reduction"], 2)),
    ("Block Occup", lambda row: _percent(row["occupancy"])),
    ("Cell", lambda row: "-" if row["cell"] is None else f"{row['cell']:.6g}"),
    ("Blocks", lambda row: f"{row['blocks']:,}"),
    ("Voxels", lambda row: f"{row['voxels']:,}"),
    ("Pts/Voxel", lambda row: _number(row["points_per_voxel"], 2)),
    ("Contig", lambda row: _percent(row["contiguous_fraction"])),
    ("Random", lambda row: _percent(row["contiguous_expected"] / 144)),
)


def level_cells(report: Report) -> Cells:
    """
    Return the level table: the columns of the paper's Tables 2 to 5 first, then ours.

    Parameters
    ----------
    report : Report
        Of one input or of a summary.

    Returns
    -------
    cells : list of list of str
        Header row first. The chosen level's number carries a star.
    """
    rows = [["Lvl", *(name for name, _ in _LEVEL_COLUMNS)]]
    for level in report.levels:
        mark = "*" if level["level"] == report.depth else ""
        rows.append([f"{level['level']}{mark}", *(show(level) for _, show in _LEVEL_COLUMNS)])
    return rows


def encoding_cells(report: Report) -> Cells:
    """
    Return the size table: what the paper's Table 7 compares, for every encoding.

    Returns
    -------
    cells : list of list of str
        Header row first.
    """
    rows = [["Encoding", "Size(MB)", "% of LAS", "% of input"]]
    source = report.input or {}
    las = source.get("las_equivalent_bytes")
    size = source.get("bytes")
    if las:
        share = None if not size else 100 * las / size
        rows.append(["LAS equivalent", _megabytes(las), "100.00", _number(share, 2)])
    if size and source.get("compressed"):
        share = None if not las else 100 * size / las
        rows.append(["LAZ (input)", _megabytes(size), _number(share, 2), "100.00"])
    for encoding in report.encodings:
        name = f"VOLA {encoding['kind']}, {encoding['bits_per_voxel']} bit"
        if encoding["codec"] != "none":
            name += f", {encoding['codec']}"
        rows.append(
            [
                name,
                _megabytes(encoding["file_bytes"]),
                _number(encoding["percent_of_las"], 3),
                _number(encoding["percent_of_input"], 3),
            ]
        )
    return rows


def _caption(report: Report) -> str:
    source = report.input
    if source is None or report.error is not None:
        return f"{source['name'] if source else 'input'}: {report.status}"
    used = source["points_used"]
    points = "unknown number of points" if used is None else f"{used:,} points"
    cube = report.cube
    side = "" if not cube or cube["side"] is None else f", cube side {cube['side']:.10g}"
    if side and cube and cube["unit"]:
        side += f" {cube['unit']}"
    density = source["density"]["all_per_area_occupied"]
    per_area = "" if density is None else f", {density:.3g} points per square unit of covered area"
    return f"{source['name']}: {points}{side}{per_area}"


def _chosen(report: Report) -> str:
    choice = report.choice
    return "" if choice is None else f"Depth {choice['depth']}: {choice['reason']}"


def aligned(cells: Cells) -> str:
    """Return a table as lines of text, the first row underlined."""
    widths = [max(len(row[column]) for row in cells) for column in range(len(cells[0]))]
    first_left = [
        "  ".join(
            [
                row[0].ljust(widths[0]),
                *(text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True)),
            ]
        ).rstrip()
        for row in cells
    ]
    return "\n".join([first_left[0], "-" * max(map(len, first_left)), *first_left[1:]])


def _markdown(cells: Cells) -> str:
    header, *rows = cells
    lines = ["| " + " | ".join(header) + " |", "|---" + "|---:" * (len(header) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _document(report: Report, table: Callable[[Cells], str], heading: str) -> str:
    parts = [heading + _caption(report)]
    if report.levels:
        parts += [table(level_cells(report)), _chosen(report), table(encoding_cells(report))]
    elif report.error:
        parts.append(f"{report.error['code']}: {report.error['message']}")
    else:
        parts.append("no points: no volume")
    return "\n\n".join(part for part in parts if part)


def level_records(reports: Sequence[Report]) -> list[dict[str, Any]]:
    """
    Return one record per input and level: every column but the histogram.

    Parameters
    ----------
    reports : sequence of Report
        In order.

    Returns
    -------
    records : list of dict
        ``file``, the columns of a level, and ``chosen``.
    """
    records: list[dict[str, Any]] = []
    for report in reports:
        name = report.input["name"] if report.input else None
        for level in report.levels:
            scalars = {key: value for key, value in level.items() if not isinstance(value, list)}
            chosen = level["level"] == report.depth
            records.append({"file": name, **scalars, "chosen": chosen})
    return records


def _csv(reports: Sequence[Report]) -> str:
    records = level_records(reports)
    if not records:
        return ""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, records[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return stream.getvalue().rstrip("\n")


def render(reports: Sequence[Report], form: str) -> str:
    """
    Return reports as text.

    Parameters
    ----------
    reports : sequence of Report
        In the order to print.
    form : str
        ``"table"``, ``"md"``, ``"csv"``, ``"json"`` (an object for one report, else an array) or
        ``"jsonl"`` (one line each).

    Returns
    -------
    text : str
        Without a newline at the end.

    Raises
    ------
    OptionError
        Unknown format.
    """
    if form == "jsonl":
        return "\n".join(report.to_json() for report in reports)
    if form == "json":
        if len(reports) == 1:
            return reports[0].to_json(indent=2)
        return dumps([report.to_dict() for report in reports], indent=2)
    if form == "csv":
        return _csv(reports)
    if form == "md":
        return "\n\n".join(_document(report, _markdown, "### ") for report in reports)
    if form == "table":
        return "\n\n\n".join(_document(report, aligned, "") for report in reports)
    raise OptionError(f"unknown format {form!r}: choose one of {', '.join(FORMATS)}")
