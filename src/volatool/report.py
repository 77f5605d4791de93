"""What a run says: one object, printed by the commands, written as JSON, checked by a schema."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from volatool._version import __version__
from volatool.errors import CodedWarning, FormatError

SCHEMA_ID = "volatool.stats/1"


@dataclass(frozen=True, slots=True)
class Report:
    """
    The report of one input, or the sum over several (with ``tiles``).

    Parameters
    ----------
    status : str
        ``"ok"``, ``"partial"``, ``"empty"`` or ``"failed"``.
    input, cube : dict or None
        What was read, and where the volume lies; see the schema.
    levels : sequence of dict
        One per level, from 1.
    choice : dict or None
        The depth and why.
    encodings : sequence of dict
        Sizes of the volume in each encoding.
    dem : dict or None
        The elevation model, if one was made.
    classification : dict or None
        What `classify` wrote; left out of the JSON when None.
    warnings : sequence of CodedWarning
        In the order in which they came up.
    options : mapping
        The options that were given and differ from their defaults.
    resources : mapping or None
        Time and memory; left out of the JSON when None.
    error : mapping or None
        ``{"code", "message"}`` of a failed input.
    tiles : int or None
        Number of inputs of a summary.
    paths : sequence of str
        Files that were written, in order. Not part of the JSON.
    """

    status: str
    input: Mapping[str, Any] | None
    cube: Mapping[str, Any] | None = None
    levels: Sequence[Mapping[str, Any]] = ()
    choice: Mapping[str, Any] | None = None
    encodings: Sequence[Mapping[str, Any]] = ()
    dem: Mapping[str, Any] | None = None
    warnings: Sequence[CodedWarning] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    resources: Mapping[str, Any] | None = None
    error: Mapping[str, str] | None = None
    tiles: int | None = None
    paths: Sequence[Path] = ()
    classification: Mapping[str, Any] | None = None

    @property
    def depth(self) -> int | None:
        """The chosen depth; None for an empty or failed input."""
        return None if self.choice is None else int(self.choice["depth"])

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of the schema ``volatool.stats/1``."""
        document: dict[str, Any] = {
            "schema": SCHEMA_ID,
            "tool": {"name": "volatool", "version": __version__, "options": dict(self.options)},
            "status": self.status,
            "error": None if self.error is None else dict(self.error),
            "input": None if self.input is None else dict(self.input),
            "cube": None if self.cube is None else dict(self.cube),
            "levels": [dict(level) for level in self.levels],
            "choice": None if self.choice is None else dict(self.choice),
            "encodings": [dict(encoding) for encoding in self.encodings],
            "dem": None if self.dem is None else dict(self.dem),
            "warnings": [warning.to_dict() for warning in self.warnings],
        }
        if self.resources is not None:
            document["resources"] = dict(self.resources)
        if self.classification is not None:
            document["classification"] = dict(self.classification)
        if self.tiles is not None:
            document["tiles"] = self.tiles
        return document

    def to_json(self, indent: int | None = None) -> str:
        """
        Return the report as JSON with sorted keys; numbers that are not finite become null.

        Parameters
        ----------
        indent : int, optional
            Spaces a level; one line by default.
        """
        return dumps(self.to_dict(), indent)

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Report:
        """
        Return the report that a JSON object holds.

        Raises
        ------
        FormatError
            ``E_NOT_REPORT``: it is not a report of this schema.
        """
        if not isinstance(document, Mapping) or document.get("schema") != SCHEMA_ID:
            found = document.get("schema") if isinstance(document, Mapping) else type(document)
            raise FormatError(
                f"not a report: schema is {found!r}, not {SCHEMA_ID!r}", "E_NOT_REPORT"
            )
        try:
            return cls(
                status=document["status"],
                input=document["input"],
                cube=document["cube"],
                levels=document["levels"],
                choice=document["choice"],
                encodings=document["encodings"],
                dem=document["dem"],
                warnings=[CodedWarning(**warning) for warning in document["warnings"]],
                options=document["tool"]["options"],
                resources=document.get("resources"),
                error=document.get("error"),
                tiles=document.get("tiles"),
                classification=document.get("classification"),
            )
        except (KeyError, TypeError) as error:
            raise FormatError(f"not a whole report: {error}", "E_NOT_REPORT") from error

    def _repr_html_(self) -> str:
        """Return the level table for a notebook."""
        from volatool.tables import level_cells

        header, *rows = level_cells(self)
        cells = [
            "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in row)
            for tag, row in [("th", header), *(("td", row) for row in rows)]
        ]
        return "<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"


def dumps(document: Any, indent: int | None = None) -> str:
    """
    Return JSON as all of volatool writes it: sorted keys, null for numbers that are not finite.

    Parameters
    ----------
    document : object
        Dicts, lists and scalars.
    indent : int, optional
        Spaces a level; one line by default.

    Examples
    --------
    >>> dumps({"b": 1, "a": float("inf")})
    '{"a": null, "b": 1}'
    """
    text = json.dumps(
        finite(document), indent=indent, sort_keys=True, allow_nan=False, ensure_ascii=False
    )
    return readable(text)


def readable(text: str) -> str:
    """
    Return text with what file names hold beside Unicode replaced, so that it can be encoded.

    Parameters
    ----------
    text : str
        May hold lone surrogates, as `os.fsdecode` makes them.
    """
    return text.encode("utf-8", "replace").decode("utf-8")


def finite(value: Any) -> Any:
    """
    Return a JSON value with every number that is not finite replaced by None.

    Examples
    --------
    >>> finite({"a": [1.0, float("nan")]})
    {'a': [1.0, None]}
    """
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def schema() -> dict[str, Any]:
    """Return the JSON Schema of the report, as it is shipped with the package."""
    from importlib.resources import files

    text = (files("volatool") / "report.schema.json").read_text(encoding="utf-8")
    document: dict[str, Any] = json.loads(text)
    return document
