"""Conditions on a report, as a delivery gate has them: ``depth < 5``, ``warnings has W_NO_CRS``.

A condition is ``NAME OPERATOR VALUE``. Names, and what can be asked of each, are the report's
JSON Schema's; nothing is evaluated as code.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from volatool.errors import OptionError
from volatool.report import Report, dumps, schema

FAILED = "E_CHECK"
"""Code of a line that says which condition was met."""

_SECTIONS = ("input", "choice", "cube")
"""Parts of the report whose names may stand without the part's."""

_ALIASES = {"crs": "input.crs.horizontal"}

_ORDER: Mapping[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_SET = ("has", "lacks")

_CONDITION = re.compile(
    r"\s*([\w.-]+?)\s*(<=|>=|==|!=|<|>|\b(?:has|lacks)\b)\s*(.*?)\s*", re.DOTALL
)
_LEVEL = re.compile(r"levels\.([1-9]\d*)\.(\w+)")

_NO_KEY = re.compile(r"\.CODE$|\b(?:classes|returns)\.(?!\d+$)")  # a count of which is always 0

_Value = float | bool | str | None


@dataclass(frozen=True, slots=True)
class Condition:
    """
    One question to a report; `parse_condition` makes it.

    Parameters
    ----------
    text : str
        As it was written.
    name : str
        Path of the value in the report, without shortening.
    operator : str
        ``<``, ``<=``, ``>``, ``>=``, ``==``, ``!=``, ``has`` or ``lacks``.
    value : float, bool, str or None
        What is compared with; None stands for ``none``.
    """

    text: str
    name: str
    operator: str
    value: _Value

    def met_by(self, report: Report) -> str | None:
        """
        Return what was found if the condition is true of a report, None if it is not.

        A value that the report does not have is neither less nor greater than anything, and a
        gate must not let it pass: such a comparison counts as true.

        Parameters
        ----------
        report : Report
            Of a tile, or of the sum of several.
        """
        found = _look_up(report.to_dict(), self.name)
        if self.operator in _SET:
            members = sorted(found or ())
            is_true = (self.value in members) == (self.operator == "has")
            return (", ".join(members) or "nothing") if is_true else None
        if self.operator == "==":
            is_true = found == self.value
        elif self.operator == "!=":
            is_true = found != self.value
        else:
            is_true = found is None or _ORDER[self.operator](found, self.value)
        return ("none" if found is None else dumps(found).strip('"')) if is_true else None


def parse_condition(text: str) -> Condition:
    """
    Read a condition.

    Parameters
    ----------
    text : str
        ``NAME OPERATOR VALUE``; VALUE is a number, ``true``, ``false``, ``none`` or text, which
        may stand in quotes.

    Raises
    ------
    OptionError
        It is no condition, no report has such a name, or the value is of another kind.

    Examples
    --------
    >>> parse_condition("depth < 5")
    Condition(text='depth < 5', name='choice.depth', operator='<', value=5.0)
    """
    match = _CONDITION.fullmatch(text)
    if match is None or not match[3]:
        raise OptionError(
            f"{text!r} is not NAME OPERATOR VALUE, such as 'depth < 5'; operators are "
            f"{', '.join([*_ORDER, '==', '!=', *_SET])}"
        )
    name, symbol, written = match.groups()
    full, kind = _resolve(name)
    value = _parse_value(written, kind, name)
    if symbol in _SET and (kind != "set" or value is None):
        raise OptionError(f"{text!r}: has and lacks are for classes, returns, dropped, warnings")
    if symbol not in _SET and kind == "set":
        raise OptionError(f"{text!r}: {name} has or lacks something; it is not a value")
    if symbol in _ORDER and (kind != "number" or value is None):
        raise OptionError(f"{text!r}: only numbers are less or greater; use == or !=")
    return Condition(text.strip(), full, symbol, value)


def condition_names() -> list[str]:
    """Return the names that a condition may ask for; ``N`` is a level, ``CODE`` a key."""
    return sorted({_short(name) for name in _kinds()} | set(_ALIASES))


def _short(name: str) -> str:
    section, _, rest = name.partition(".")
    return rest if section in _SECTIONS else name


@cache
def _kinds() -> dict[str, str]:
    """Return what stands at each path of a report: number, flag, text or set."""
    properties = schema()["properties"]
    kinds = {"status": "text", "tiles": "number", "warnings": "set"}
    for section in _SECTIONS:
        kinds.update(_walk(properties[section], section))
    kinds.update(_walk(properties["levels"]["items"], "levels.N"))
    return kinds


def _walk(node: Mapping[str, Any], path: str) -> Iterator[tuple[str, str]]:
    """Yield the paths below a node of the schema with their kinds; lists have none."""
    types = node.get("type", "string")  # an enum is of strings
    types = {types} if isinstance(types, str) else set(types)
    if "object" in types:
        if isinstance(node.get("additionalProperties"), Mapping):
            yield path, "set"
            yield f"{path}.CODE", "number"
        for key, below in node.get("properties", {}).items():
            yield from _walk(below, f"{path}.{key}")
    elif types & {"number", "integer"}:
        yield path, "number"
    elif "boolean" in types:
        yield path, "flag"
    elif "string" in types:
        yield path, "text"


def _resolve(name: str) -> tuple[str, str]:
    """Return the whole path for a name, and its kind."""
    name = _ALIASES.get(name, name)
    level = _LEVEL.fullmatch(name)
    pattern = f"levels.N.{level[2]}" if level else name
    for prefix in ("", *(f"{section}." for section in _SECTIONS)):
        for known in (pattern, f"{pattern.rpartition('.')[0]}.CODE"):
            if prefix + known in _kinds() and not _NO_KEY.search(name):
                return prefix + name, _kinds()[prefix + known]
    raise OptionError(f"{name!r} is not in a report; there are {', '.join(condition_names())}")


def _parse_value(written: str, kind: str, name: str) -> _Value:
    if written == "none":
        return None
    if kind == "flag":
        if written not in ("true", "false"):
            raise OptionError(f"{name} is true, false or none, not {written!r}")
        return written == "true"
    if kind == "number":
        try:
            number = float(written)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise OptionError(f"{name} is a number or none, not {written!r}")
        return number
    is_quoted = len(written) > 1 and written[0] == written[-1] and written[0] in "'\""
    return written[1:-1] if is_quoted else written


def _look_up(document: Mapping[str, Any], name: str) -> Any:
    """Return a value of a report; None where it has none, 0 for a count that is not there."""
    if name == "warnings":
        return [warning["code"] for warning in document["warnings"]]
    level = _LEVEL.fullmatch(name)
    if level:
        rows = {row["level"]: row for row in document["levels"]}
        return rows.get(int(level[1]), {}).get(level[2])
    value: Any = document
    *path, last = name.split(".")
    for key in path:
        value = (value or {}).get(key)
    is_count = _kinds().get(name) is None
    return None if value is None else value.get(last, 0 if is_count else None)


def failures(reports: Sequence[Report], conditions: Sequence[Condition]) -> list[str]:
    """
    Return a line for each report that meets a condition which none should.

    Parameters
    ----------
    reports : sequence of Report
        Of inputs that could be used.
    conditions : sequence of Condition
        Asked of each report, in this order.
    """
    return [
        f"{FAILED}: {(report.input or {}).get('name')}: {condition.text} (found {found})"
        for report in reports
        for condition in conditions
        if (found := condition.met_by(report)) is not None
    ]
