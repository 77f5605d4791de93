"""Option values that are parsed: lengths, sizes, bounds, lists."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from volatool.errors import OptionError
from volatool.units import Length, parse_size

if TYPE_CHECKING:
    Base = click.ParamType[Any]
else:  # not subscriptable in every click that we support
    Base = click.ParamType


def complete_files(ctx: Any, param: Any, incomplete: str) -> list[CompletionItem]:
    """Let the shell complete file names, for values that are more than a path."""
    del ctx, param
    return [CompletionItem(incomplete, type="file")]


class FloatRange(click.FloatRange):
    """A number in a range; NaN, which no comparison refuses, is in none."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a float."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{number} is not in the range {self._describe_range()}.", param, ctx)
        return number


class LengthType(Base):
    """A length with an optional unit; one of `words` is passed on as it is."""

    name = "LENGTH"

    def __init__(self, *words: str) -> None:
        self.words = words

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a `Length`, or the word."""
        if value in self.words:
            return value
        try:
            return Length.parse(value)
        except OptionError as error:
            self.fail(str(error), param, ctx)


class SizeType(Base):
    """Bytes, with an optional unit."""

    name = "SIZE"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return bytes as an integer."""
        try:
            return parse_size(value)
        except OptionError as error:
            self.fail(str(error), param, ctx)


class BoundsType(Base):
    """``X0,Y0,X1,Y1``."""

    name = "X0,Y0,X1,Y1"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return `Bounds`."""
        from volatool.model import Bounds  # loads numpy

        if isinstance(value, Bounds):
            return value
        try:
            left, bottom, right, top = (float(part) for part in value.split(","))
            return Bounds(left, bottom, right, top)
        except ValueError:
            self.fail(f"{value!r} is not X0,Y0,X1,Y1 with X0 <= X1 and Y0 <= Y1", param, ctx)


class RangeType(Base):
    """``LOW,HIGH``, two numbers."""

    name = "LOW,HIGH"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a tuple of two floats."""
        if isinstance(value, tuple):
            return value
        try:
            low, high = (float(part) for part in value.split(","))
            if low <= high:
                return low, high
        except ValueError:
            pass
        self.fail(f"{value!r} is not LOW,HIGH with LOW <= HIGH", param, ctx)


class LengthRangeType(Base):
    """``LOW,HIGH``, two lengths; the lower one may be 0."""

    name = "LOW,HIGH"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a tuple of two `Length`."""
        if isinstance(value, tuple):
            return value
        try:
            low, high = value.split(",")
            return Length.parse(low, or_zero=True), Length.parse(high)
        except (OptionError, ValueError):
            self.fail(f"{value!r} is not two lengths LOW,HIGH such as 0.2m,2m", param, ctx)


class LengthOrZeroType(Base):
    """A length that may be 0."""

    name = "LENGTH"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a `Length`."""
        try:
            return Length.parse(value, or_zero=True)
        except OptionError as error:
            self.fail(str(error), param, ctx)


class NumbersType(Base):
    """Comma-separated numbers."""

    name = "N,N,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a tuple of float."""
        if isinstance(value, tuple):
            return value
        try:
            return tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not a list of numbers, such as 0,2.5,10", param, ctx)


class CodesType(Base):
    """Comma-separated whole numbers 0 to 255."""

    name = "CODES"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a tuple of int."""
        if isinstance(value, tuple):
            return value
        try:
            codes = tuple(int(part) for part in value.split(","))
            if all(0 <= code <= 255 for code in codes):
                return codes
        except ValueError:
            pass
        self.fail(f"{value!r} is not a list of class codes 0 to 255, such as 2,9", param, ctx)


class WordsType(Base):
    """Comma-separated words out of a list; ``none`` alone is the empty list."""

    name = "WORDS"

    def __init__(self, *words: str) -> None:
        self.words = words

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a tuple of str, in the order of the list."""
        if isinstance(value, tuple):
            return value
        if value == "none":
            return ()
        given = value.split(",")
        unknown = [word for word in given if word not in self.words]
        if unknown:
            self.fail(f"{unknown[0]!r} is not one of {', '.join(self.words)} or none", param, ctx)
        return tuple(word for word in self.words if word in given)

    def shell_complete(self, ctx: Any, param: Any, incomplete: str) -> list[CompletionItem]:
        """Return the words that may follow those given so far."""
        del ctx, param
        before, comma, begun = incomplete.rpartition(",")
        left = [word for word in self.words if word not in before.split(",")]
        choices = left if comma else [*left, "none"]
        return [CompletionItem(before + comma + word) for word in choices if word.startswith(begun)]


class DepthType(Base):
    """``auto`` or a number of levels."""

    name = "auto|N"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return None for auto, else an int."""
        if value is None or value == "auto":
            return None
        try:
            depth = int(value)
            if 1 <= depth <= 10:
                return depth
        except ValueError:
            pass
        self.fail(f"{value!r} is not auto or a depth from 1 to 10", param, ctx)


class ConditionType(Base):
    """A condition on a report: ``NAME OPERATOR VALUE``."""

    name = "CONDITION"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return a `Condition`."""
        from volatool.conditions import Condition, parse_condition

        if isinstance(value, Condition):
            return value
        try:
            return parse_condition(value)
        except OptionError as error:
            self.fail(str(error), param, ctx)


class JobsType(Base):
    """``auto`` or a number of processes."""

    name = "N|auto"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return None for auto, else an int."""
        if value is None or value == "auto":
            return None
        try:
            jobs = int(value)
            if jobs >= 1:
                return jobs
        except ValueError:
            pass
        self.fail(f"{value!r} is not auto or a number of processes", param, ctx)


def joined(ctx: Any, param: Any, value: Any) -> tuple[int, ...] | None:
    """Return the codes of an option given several times, each once; None without any."""
    del ctx, param
    return tuple(dict.fromkeys(code for codes in value for code in codes)) if value else None
