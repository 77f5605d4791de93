"""Errors and warnings with stable codes; nothing here knows of the command line.

A class says what the caller can do about it, its ``code`` says exactly what was wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


class VolatoolError(Exception):
    """
    Root of all errors that volatool raises on purpose.

    Parameters
    ----------
    message : str
        Which file, what was expected, what was found, what to do.
    code : str, optional
        Stable code, ``E_...``; the class's default if not given.
    """

    code = "E_INTERNAL"

    def __init__(self, message: str, code: str | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        # exceptions with keyword state don't survive pickling between processes by themselves
        return (type(self), (str(self), self.code))


class OptionError(VolatoolError, ValueError):
    """An option or argument that can't be used as given (usage, exit code 2)."""

    code = "E_OPTION"


class OutputExistsError(OptionError, FileExistsError):
    """An output exists and was not to be overwritten, or two inputs would write the same one."""

    code = "E_OUTPUT_EXISTS"


class InputError(VolatoolError, ValueError):
    """An input that can't be read or used: the tile fails, other tiles go on."""

    code = "E_INPUT"


class InputNotFoundError(InputError, FileNotFoundError):
    """An input that is not there."""

    code = "E_NOT_FOUND"


class FormatError(InputError):
    """Bytes that are not what they say they are (`E_NOT_LAS`, `E_NOT_VOLA`, `E_CORRUPT`)."""

    code = "E_CORRUPT"


class TruncatedError(FormatError):
    """A file that ends before its header says."""

    code = "E_TRUNCATED"


class CRSError(InputError):
    """A coordinate reference system that can't be used (`E_CRS`, `E_GEOGRAPHIC`)."""

    code = "E_CRS"


class OutputError(VolatoolError, OSError):
    """An output that could not be written or did not verify."""

    code = "E_WRITE"


class ResourceError(VolatoolError, MemoryError):
    """A memory or size ceiling that can't be kept (`E_MEMORY`, `E_SIZE`)."""

    code = "E_MEMORY"


@dataclass(frozen=True, slots=True)
class CodedWarning:
    """
    Something suspicious that did not stop the work.

    Parameters
    ----------
    code : str
        Stable code, ``W_...``.
    message : str
        What was found and what was done about it.
    count : int
        How often (points, cells, files); 1 if it can't be counted.
    """

    code: str
    message: str
    count: int = 1

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of the report."""
        return {"code": self.code, "message": self.message, "count": self.count}
