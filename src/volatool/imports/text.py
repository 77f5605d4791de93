"""Columns of numbers: xyz, txt, csv, pts. Read in blocks of lines, never as a whole.

Lines that are blank or begin with ``#``, ``//`` or ``%`` are left out; one of them, or the first
line, may name the columns. A first line of one number is the count that PTS files have. Columns are
separated by commas, semicolons or white space.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from volatool.errors import CodedWarning, FormatError, InputError, TruncatedError
from volatool.imports.columns import Columns, columns_of
from volatool.imports.model import Batch, ImportedPoints, ToolkitPoints, role_of
from volatool.imports.toolkit import words_of
from volatool.model import F64, U64
from volatool.options import ConvertOptions

BLOCK_BYTES = 1 << 22
"""Text held at a time; a longer line is refused."""

_HEAD_BYTES = 1 << 16
_COMMENTS = (b"#", b"//", b"%")
_BOM = b"\xef\xbb\xbf"
_TOOLKIT_CHANNELS = 8


@dataclass(frozen=True, slots=True)
class Layout:
    """
    Where the rows of a table begin and how they are cut.

    Parameters
    ----------
    data_start, first_line : int
        Byte and line (from 1) of the first row.
    delimiter : bytes or None
        Between columns; None for white space.
    n_columns : int
        Of the first row.
    names : tuple of str or None
        Of the columns.
    """

    data_start: int
    first_line: int
    delimiter: bytes | None
    n_columns: int
    names: tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class Block:
    """
    Whole lines of a file.

    Parameters
    ----------
    data : bytes
        The lines.
    first_line : int
        Number of the first, from 1.
    """

    data: bytes
    first_line: int


def read(path: Path, options: ConvertOptions) -> ImportedPoints:
    """
    Open a table of numbers.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    options : ConvertOptions
        ``columns``.

    Raises
    ------
    FormatError
        ``E_NOT_IMPORT``: not such text; ``E_CORRUPT``, with the line.
    """
    told: list[CodedWarning] = []
    layout = _layout(path)
    columns = columns_of(options.columns, layout.names, layout.n_columns, told)

    def batches(n_rows: int) -> Iterator[Batch]:
        return table_batches(path, layout, columns, n_rows)

    kind = "txt" if (options.from_format or path.suffix.lower()[1:]) == "txt" else "xyz"
    is_csv = "csv" in (options.from_format, path.suffix.lower()[1:])
    return ImportedPoints(
        kind if not is_csv else "csv",
        batches,
        frozenset(columns.attributes),
        warnings=told,
        toolkit=None if is_csv else _toolkit(path, layout, kind),
    )


def _layout(path: Path) -> Layout:
    """Look at the first lines."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        is_all = not file.read(1)
    if b"\0" in head:
        raise FormatError(
            "is not text of one byte a character: it has NUL bytes (UTF-16, or binary data)",
            "E_NOT_IMPORT",
        )
    at = len(_BOM) if head.startswith(_BOM) else 0
    names: tuple[str, ...] | None = None
    is_header = False
    number, text_lines = 0, head[at:].splitlines(keepends=True)
    if not is_all and len(text_lines) > 1:
        text_lines.pop()  # may be cut
    for line in text_lines:
        number += 1
        words, delimiter = _words(line)
        is_comment = line.lstrip().startswith(_COMMENTS)
        if is_comment and names is None:
            names = _names(_words(line.lstrip().lstrip(b"#/%"))[0])
        elif words and not is_comment:
            if _are_numbers(words):
                if len(words) == 1 and number == 1:
                    at += len(line)  # the count of a PTS file
                    continue
                if is_header and names is not None and len(words) < len(names):
                    raise FormatError(
                        f"line {number}: {len(words)} values, the header names {len(names)}"
                    )
                return Layout(at, number, delimiter, len(words), _fitting(names, len(words)))
            if names is not None or _names(words) is None:
                raise FormatError(
                    f"line {number}: {line[:60].decode('latin-1').rstrip()!r} is neither numbers "
                    f"nor a header that names x, y and z{_advice(line)}",
                    "E_NOT_IMPORT",
                )
            names, is_header = _names(words), True
        at += len(line)
    raise FormatError(
        "has no line of numbers" + ("" if is_all else " near its start"), "E_NOT_IMPORT"
    )


def _words(line: bytes) -> tuple[list[str], bytes | None]:
    """Return the fields of a line and what separates them."""
    text = line.strip()
    for delimiter in (b",", b";"):
        if delimiter in text:
            fields = text.split(delimiter)
            while len(fields) > 1 and not fields[-1].strip():
                fields.pop()  # a separator at the end of the line
            return [f.decode("latin-1").strip().strip("\"'") for f in fields], delimiter
    return [field.decode("latin-1").strip("\"'") for field in text.split()], None


def _advice(line: bytes) -> str:
    """Return what to do about a line that is no table, to end a sentence."""
    for delimiter in (b";", None):  # 1,5;2,5;3,5 or 1,5 2,5 3,5
        fields = line.strip().split(delimiter)
        points = [field.decode("latin-1").strip().replace(",", ".") for field in fields]
        if len(points) >= 3 and b"," in line and _are_numbers(points):
            return "; decimal commas are not read: write points"
    if len(line.split()) > 1 or b"," in line or b";" in line:
        return ""
    return "; columns are separated by commas, semicolons or white space"


def _names(words: list[str]) -> tuple[str, ...] | None:
    """Return words as column names if x, y and z are among them."""
    roles = {role_of(word) for word in words}
    return tuple(words) if roles >= {"x", "y", "z"} else None


def _fitting(names: tuple[str, ...] | None, n_columns: int) -> tuple[str, ...] | None:
    """Return the names, unless a comment has more than there are columns."""
    return names if names is not None and len(names) <= n_columns else None


def _are_numbers(words: list[str]) -> bool:
    try:
        for word in words:
            _number(word)
    except ValueError:
        return False
    return True


def _number(word: str) -> float:
    if "_" in word:  # Python takes 1_000
        raise ValueError(f"{word!r} is not a number")
    return float(word)


def blocks(path: Path, start: int, first_line: int) -> Iterator[Block]:
    """
    Yield a file in blocks of whole lines.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    start, first_line : int
        Byte and line to begin with.

    Raises
    ------
    FormatError
        A line is longer than `BLOCK_BYTES`.
    """
    with path.open("rb") as file:
        file.seek(start)
        rest, line = b"", first_line
        while True:
            data = file.read(BLOCK_BYTES)
            block = rest + data
            if not block:
                return
            if data:
                cut = block.rfind(b"\n") + 1
                if not cut:
                    if len(block) >= 2 * BLOCK_BYTES:
                        raise FormatError(f"line {line} is longer than {BLOCK_BYTES} bytes")
                    rest = block
                    continue
                block, rest = block[:cut], block[cut:]
            else:
                rest = b""
            if b"\r" in block and b"\n" not in block:
                block = block.replace(b"\r", b"\n")
            yield Block(block, line)
            line += block.count(b"\n")


def table_batches(
    path: Path, layout: Layout, columns: Columns, n_rows: int, limit: int | None = None
) -> Iterator[Batch]:
    """
    Yield the rows of a table.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    layout : Layout
        Where its rows begin.
    columns : Columns
        Which are wanted.
    n_rows : int
        Most rows of a batch.
    limit : int, optional
        Rows behind so many are something else.
    """
    places = [*columns.axes, *columns.attributes.values()]
    start = 0
    for block in blocks(path, layout.data_start, layout.first_line):
        if limit is not None:
            block = _first_rows(block, limit - start)
        table = _table(block, layout.delimiter, places, columns.n_needed)
        where = _lines_of(block, start)
        for at in range(0, len(table), n_rows):
            part = table[at : at + n_rows]
            attributes = {name: part[:, 3 + k] for k, name in enumerate(columns.attributes)}
            yield Batch(start + at, np.ascontiguousarray(part[:, :3]), attributes, where)
        start += len(table)
        if start == limit:
            return


def _first_rows(block: Block, n_rows: int) -> Block:
    """Return a block without the lines behind its first rows."""
    if block.data.count(b"\n") < n_rows:
        return block
    at = 0
    lines = block.data.split(b"\n")
    for line in lines:
        if not n_rows:
            break
        at += len(line) + 1
        text = line.strip()
        n_rows -= bool(text) and not text.startswith(_COMMENTS)
    return Block(block.data[:at], block.first_line)


def _table(block: Block, delimiter: bytes | None, places: list[int], n_needed: int) -> F64:
    """Return the columns asked for, in their order, of all rows of a block."""
    is_plain = not any(mark in block.data for mark in _COMMENTS) and b"_" not in block.data
    if is_plain:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a block of blank lines
                table: F64 = np.loadtxt(
                    io.TextIOWrapper(io.BytesIO(block.data), "latin-1"),
                    delimiter=None if delimiter is None else delimiter.decode(),
                    comments=None,
                    usecols=places,
                    ndmin=2,
                )
            return table.reshape(-1, len(places))
        except ValueError:
            pass  # line by line, which finds the fault or gets over it
    rows = []
    for number, words in _rows(block, delimiter):
        if len(words) < n_needed:
            is_last = block.data.count(b"\n") == number - block.first_line
            kind = TruncatedError if is_last else FormatError  # no line break: the file is cut
            raise kind(f"line {number}: {len(words)} values, expected {n_needed}")
        try:
            rows.append([_number(words[place]) for place in places])
        except ValueError as error:
            shown = " ".join(words)[:60]
            raise FormatError(f"line {number}: {shown!r} ({error})") from error
    return np.array(rows, np.float64).reshape(-1, len(places))


def _rows(block: Block, delimiter: bytes | None) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each line with numbers."""
    for number, line in enumerate(block.data.split(b"\n"), block.first_line):
        text = line.strip()
        if not text or text.startswith(_COMMENTS):
            continue
        fields = text.split() if delimiter is None else text.split(delimiter)
        yield number, [field.decode("latin-1").strip().strip("\"'") for field in fields]


def _lines_of(block: Block, start: int) -> Callable[[int], str]:
    """Return what names the line of a row of a block whose first row has this number."""

    def where(row: int) -> str:
        for k, (number, _) in enumerate(_rows(block, None)):
            if k == row - start:
                return f"line {number}"
        return f"point {row}"

    return where


def _toolkit(path: Path, layout: Layout, kind: str) -> ToolkitPoints:
    """Return what the toolkit makes of the columns: as they stand, but for the first of txt."""
    # its txt converter takes the first line for a header, whatever it says
    start, first = (layout.data_start, layout.first_line) if kind == "xyz" else _second_line(path)
    n_channels = layout.n_columns - 3

    def batches(with_metadata: bool) -> Iterator[tuple[F64, U64 | None]]:
        if with_metadata and n_channels > _TOOLKIT_CHANNELS:
            raise InputError(
                f"{n_channels} columns behind x, y, z; the toolkit stops above "
                f"{_TOOLKIT_CHANNELS}: convert without metadata (--meta none)",
                "E_TOOLKIT",
            )
        places = list(range(3 + (n_channels if with_metadata else 0)))
        row = 0
        for block in blocks(path, start, first):
            block = Block(block.data.replace(b",", b" "), block.first_line)
            table = _table(block, None, places, len(places))
            words = None
            if with_metadata:
                words = _toolkit_words(table[:, 3:], kind, row, _lines_of(block, row))
            yield table[:, :3], words
            row += len(table)

    return ToolkitPoints(max(n_channels, 0), batches)


def _second_line(path: Path) -> tuple[int, int]:
    with path.open("rb") as file:
        return len(file.readline(BLOCK_BYTES)), 2


def _toolkit_words(values: F64, kind: str, start: int, where: Callable[[int], str]) -> U64:
    bad = ~np.isfinite(values) | (np.abs(values) > 2**31)
    if kind == "xyz":
        bad |= values != np.trunc(values)
    channels = np.trunc(np.where(bad, 0.0, values)).astype(np.int64)
    if kind == "txt":  # intensities of -1500 .. 0
        unit = np.clip((channels[:, 0] + 1500) / 1500, 0.0, 1.0)
        channels[:, 0] = np.trunc(unit * 255).astype(np.int64)
    bad |= channels > 255
    if bad.any():
        row, column = (int(place[0]) for place in np.nonzero(bad))
        raise InputError(
            f"{where(start + row)}: {values[row, column]:g} in column {4 + column} is not a whole "
            "number up to 255, at which the toolkit stops; convert without metadata (--meta none)",
            "E_TOOLKIT",
        )
    return words_of(channels)
