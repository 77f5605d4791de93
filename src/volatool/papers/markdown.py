"""What the papers' reports share: tables as Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def table(head: str | Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    r"""
    Return a Markdown table.

    Parameters
    ----------
    head : str or sequence of str
        Names of the columns; one text is cut at each ``|``.
    rows : sequence of sequences of str
        Cells; none may hold a line break, ``|`` is escaped.

    Examples
    --------
    >>> print(table("a | b", [("1", "2|3")]))
    | a | b |
    | --- | --- |
    | 1 | 2\|3 |
    """
    if isinstance(head, str):
        head = [name.strip() for name in head.split("|")]
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )
