"""What the kinds of ``volatool query`` share: the volume, numbers from arguments or stdin, answers.

A kind is a command of the group ``query`` (``commands/query.py``) like this one::

    @query.command(short_help="...")
    @queries.numbers("X Y Z")
    @queries.common
    def kind(asked: Asked, numbers: tuple[str, ...], **arguments: Any) -> None:
        asked.begin(arguments)                      # messages, --json; reads the volume
        asked.answer(numbers, ("X", "Y", "Z"), lambda rows: ...)

The callback gets an (n, 3) array and yields one `Answer` a row.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from volatool.errors import CodedWarning, OptionError, ResourceError
from volatool_cli import options

if TYPE_CHECKING:
    from volatool.model import F64
    from volatool.vola.volume import Volume

_NEGATIVE = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)
_HELP = ("-h", "--help")
_LONGEST_LINE = 1 << 20
_FLUSH_AFTER_S = 0.2


class QueryCommand(click.Command):
    """A command whose arguments may be negative numbers."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hide the minus of a number behind a blank, so that it is not taken for an option."""
        hidden = [f" {word}" if _NEGATIVE.match(word) else word for word in args]
        return super().parse_args(ctx, hidden)


class QueryGroup(click.Group):
    """The group ``query``: a file, then a kind."""

    command_class = QueryCommand

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Let ``query KIND --help`` do without the file."""
        if len(args) > 1 and args[0] in self.commands and args[1] in _HELP:
            args = ["FILE", *args]
        return super().parse_args(ctx, args)


def numbers(metavar: str) -> Callable[[Any], Any]:
    """Return the argument that takes a query's numbers."""
    return click.argument("numbers", metavar=f"[{metavar} | -]", nargs=-1)


@dataclass(frozen=True, slots=True)
class Answer:
    """
    The answer to one query.

    Parameters
    ----------
    text : str
        One line for people and pipes.
    facts : dict
        What ``--json`` prints, beside ``query``: the numbers that were given.
    """

    text: str
    facts: dict[str, Any]


Answering: TypeAlias = "Callable[[F64], Iterable[Answer]]"


@dataclass(slots=True)
class Row:
    """One query: its numbers, and where they stand (``"line 3 of stdin"``)."""

    values: list[float]
    place: str


@dataclass
class Asked:
    """
    The file that is asked, and how the answers are printed.

    Parameters
    ----------
    name : str
        Path of the volume.
    as_json : bool
        Answers are JSON objects.
    """

    name: str
    as_json: bool = False
    _quiet: bool = False
    _printed: float = field(default=0.0, repr=False)

    def begin(self, arguments: dict[str, Any]) -> None:
        """Take ``--json`` and the message options out of the arguments, and read the volume."""
        from volatool_cli.output import configure_logging

        self.as_json = arguments.pop("as_json")
        self._quiet = arguments.pop("quiet")
        configure_logging(self._quiet, arguments.pop("verbose"), arguments.pop("log"))
        self.warn(self.volume.info.warnings)

    def warn(self, warnings: Sequence[CodedWarning]) -> None:
        """Print warnings on stderr."""
        from volatool_cli.output import say_warnings

        say_warnings(self.name, warnings, self._quiet)

    @cached_property
    def volume(self) -> Volume:
        """The volume, read when it is first needed."""
        from volatool.formats.registry import open_volume

        return open_volume(self.name)

    def answer(
        self,
        words: Sequence[str],
        names: Sequence[str],
        answering: Answering,
        *,
        short: Sequence[str] = (),
        widen: Callable[[list[float]], list[float]] | None = None,
    ) -> None:
        """
        Answer every query, in order, one line each.

        Parameters
        ----------
        words : sequence of str
            The command's numbers; none, or ``-``: lines on stdin.
        names : sequence of str
            What the numbers of a query are called.
        answering : callable
            Takes an (n, len(names)) array of float64 and yields n answers, in order.
        short : sequence of str, optional
            Names of a query of fewer numbers.
        widen : callable, optional
            Makes a full row of a short one.

        Raises
        ------
        OptionError, ResourceError
            A query is not what it should be, or takes too much: says where. All queries before it
            are answered.
        """
        shape = _Shape(names, short, widen)
        if words and list(words) != ["-"]:
            self._answer_rows(shape.rows_of_words(words), answering)
            return
        for lines in _batches_of_stdin():
            rows, fault = shape.rows_of_lines(lines)
            self._answer_rows(rows, answering)
            if fault is not None:
                raise fault

    def print(self, answer: Answer, query: Sequence[float] | None = None) -> None:
        """
        Print an answer.

        Parameters
        ----------
        answer : Answer
            To be printed as text or JSON, as was asked for.
        query : sequence of float, optional
            The numbers that it answers.
        """
        if self.as_json:
            from volatool.report import dumps

            given = {} if query is None else {"query": list(query)}
            sys.stdout.write(dumps({**given, **answer.facts}) + "\n")
        else:
            sys.stdout.write(answer.text + "\n")
        # slow answers are seen as they come, fast ones don't pay for a system call each
        if time.monotonic() - self._printed > _FLUSH_AFTER_S:
            self.flush()

    def flush(self) -> None:
        """Hand on what was printed."""
        sys.stdout.flush()
        self._printed = time.monotonic()

    def _answer_rows(self, rows: list[Row], answering: Answering) -> None:
        import numpy as np

        if not rows:
            return
        done = 0
        try:
            for answer in answering(np.array([row.values for row in rows])):
                self.print(answer, rows[done].values)
                done += 1
        except (OptionError, ResourceError) as error:
            if len(rows) == 1:
                kind = OptionError if isinstance(error, OptionError) else ResourceError
                raise kind(f"{rows[0].place}: {error}", error.code) from error
            for row in rows[done:]:  # one by one: which of them was it?
                self._answer_rows([row], answering)
        finally:
            self.flush()


@dataclass(frozen=True, slots=True)
class _Shape:
    """How many numbers make a query."""

    names: Sequence[str]
    short: Sequence[str]
    widen: Callable[[list[float]], list[float]] | None

    def rows_of_words(self, words: Sequence[str]) -> list[Row]:
        """Return the queries of the command line, one or more."""
        parts = [part for word in words for part in word.replace(",", " ").split()]
        width = len(self.names)
        step = len(self.short) if self.short and len(parts) == len(self.short) else width
        if not parts or len(parts) % step:
            raise OptionError(self._expected(len(parts)))
        starts = range(0, len(parts), step)
        return [
            self._row(parts[at : at + step], f"query {1 + at // step}" if at or len(starts) > 1
                      else "the arguments")
            for at in starts
        ]  # fmt: skip

    def rows_of_lines(
        self, lines: Iterable[tuple[int, bytes]]
    ) -> tuple[list[Row], OptionError | None]:
        """Return the queries of numbered lines, up to the first line that is none."""
        rows = []
        for number, line in lines:
            parts = line.split(b"#", 1)[0].replace(b",", b" ").split()
            if not parts:
                continue
            try:
                words = [part.decode("utf-8", "replace") for part in parts]
                rows.append(self._row(words, f"line {number} of stdin"))
            except OptionError as error:
                return rows, error
        return rows, None

    def _row(self, parts: Sequence[str], place: str) -> Row:
        if len(parts) != len(self.names) and (not self.short or len(parts) != len(self.short)):
            raise OptionError(f"{place}: {self._expected(len(parts))}")
        values = []
        for part in parts:
            try:
                if "_" in part:  # Python would read 1_0 as 10
                    raise ValueError
                values.append(float(part))
            except ValueError:
                raise OptionError(f"{place}: {part!r} is not a number") from None
        if len(values) < len(self.names) and self.widen is not None:
            values = self.widen(values)
        return Row(values, place)

    def _expected(self, found: int) -> str:
        also = f", or {len(self.short)}, {' '.join(self.short)}" if self.short else ""
        return f"expected {len(self.names)} numbers, {' '.join(self.names)}{also}; got {found}"


def _batches_of_stdin() -> Iterator[list[tuple[int, bytes]]]:
    """Yield the lines that are there, numbered from 1, again and again until the end."""
    if sys.stdin is None:
        raise OptionError("stdin is closed; give numbers as arguments, or lines on stdin")
    number, rest = 1, b""
    while True:
        data = sys.stdin.buffer.read1(1 << 20)  # type: ignore[union-attr]
        if number == 1 and not rest:
            data = data.removeprefix(b"\xef\xbb\xbf")
        lines = (rest + data).split(b"\n")
        rest = lines.pop() if data else b""
        if len(rest) > _LONGEST_LINE:
            raise OptionError(f"line {number + len(lines)} of stdin: is longer than 1 MiB")
        yield list(enumerate(lines, number))
        number += len(lines)
        if not data:
            return


def text_of(value: float) -> str:
    """
    Return a coordinate or length for people: to a millionth, without zeros at the end.

    Examples
    --------
    >>> text_of(12.5), text_of(-0.0), text_of(3e-9), text_of(float("inf"))
    ('12.5', '0', '0', 'inf')
    """
    text = f"{value:.6f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def texts_of(values: Iterable[float]) -> str:
    """Return several, with blanks between."""
    return " ".join(map(text_of, values))


common = options.group(
    click.option("--json", "as_json", is_flag=True, help="One JSON object a line."),
    options.messages,
    click.pass_obj,
)
