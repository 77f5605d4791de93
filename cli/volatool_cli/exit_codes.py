"""What the exit status says; scripts rely on it."""

from __future__ import annotations

from enum import IntEnum

from volatool.errors import OptionError, OutputError, ResourceError, VolatoolError


class ExitCode(IntEnum):
    """Exit statuses of every command."""

    OK = 0
    INTERNAL = 1
    USAGE = 2
    SOME_FAILED = 3
    ALL_FAILED = 4
    NOT_WRITTEN = 5
    CHECK_FAILED = 6
    LIMIT = 7
    INTERRUPTED = 130
    STDOUT_CLOSED = 141


def code_for(error: VolatoolError) -> ExitCode:
    """
    Return the exit status that an error stands for when nothing else was done.

    Parameters
    ----------
    error : VolatoolError
        The error.
    """
    if isinstance(error, OptionError):
        return ExitCode.USAGE
    if isinstance(error, OutputError):
        return ExitCode.NOT_WRITTEN
    if isinstance(error, ResourceError):
        return ExitCode.LIMIT
    return ExitCode.ALL_FAILED
