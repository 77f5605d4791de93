"""The lines of text that voxel files begin with, up to the line ``data``."""

from __future__ import annotations

from collections.abc import Iterator

from volatool.errors import TruncatedError


def header_lines(data: bytes, longest: int) -> Iterator[tuple[int, bytes]]:
    """
    Yield lines until the caller has seen ``data``.

    Parameters
    ----------
    data : bytes
        The whole file.
    longest : int
        Bytes that a line may have.

    Yields
    ------
    offset, line : int, bytes
        Where the line begins; the line without its break.

    Raises
    ------
    TruncatedError
        ``E_TRUNCATED``: there is no such line.
    """
    at = 0
    while True:
        end = data.find(b"\n", at, at + longest)
        if end < 0:
            raise TruncatedError(
                "the file ends (or goes on without a line break) before its line 'data' "
                f"(offset {at})"
            )
        yield at, data[at:end]
        at = end + 1
