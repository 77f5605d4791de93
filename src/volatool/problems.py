"""What is wrong with a file, as `validate` tells it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from volatool.errors import VolatoolError

MISMATCH = "E_MISMATCH"
"""Code of files that are sound each, but don't tell the same."""

_OFFSET = re.compile(r"offset (\d+)")


@dataclass(frozen=True, slots=True)
class Problem:
    """
    One thing that is wrong.

    Parameters
    ----------
    code : str
        Stable code, ``E_...``.
    message : str
        What was expected and what was found.
    offset : int or None
        Byte of the (unpacked) file.
    """

    code: str
    message: str
    offset: int | None = None

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"

    @classmethod
    def of(cls, error: VolatoolError) -> Problem:
        """Return the problem that an error tells of."""
        found = _OFFSET.findall(str(error))
        return cls(error.code, str(error), int(found[-1]) if found else None)
