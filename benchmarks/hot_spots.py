"""Which functions a job spends its time in, by py-spy's samples.

    python benchmarks/hot_spots.py samples.txt

The samples are py-spy's ``--format raw``: a stack a line, root first, ``;`` between frames, then
how often it was seen. A stack's leaf is where the time goes; compiled kernels and libraries have
no frames of their own, so the leaf is the Python line that called them. Threads count each by
itself: a sample with the decoder and a kernel at work is two.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path


def shares(lines: Iterable[str]) -> list[tuple[str, float, float]]:
    """
    Return (function, own share, share with what it calls), the largest own share first.

    Parameters
    ----------
    lines : iterable of str
        Of py-spy's raw format.

    Examples
    --------
    >>> shares(["main (a.py:1);read (b.py:7) 3", "main (a.py:2) 1"])
    [('b.py read', 0.75, 0.75), ('a.py main', 0.25, 1.0)]
    """
    own: Counter[str] = Counter()
    within: Counter[str] = Counter()
    for line in lines:
        stack, _, count = line.strip().rpartition(" ")
        if not stack:
            continue
        frames = [_named(frame) for frame in stack.split(";")]
        own[frames[-1]] += int(count)
        for name in set(frames):  # a function that calls itself counts once
            within[name] += int(count)
    total = sum(own.values())
    return [(name, n / total, within[name] / total) for name, n in own.most_common()]


def _named(frame: str) -> str:
    """Return "file function" of a frame "function (folder/file.py:12)"."""
    function, _, place = frame.rpartition(" (")
    path = place.rstrip(")").rpartition(":")[0] or place.rstrip(")")
    parts = Path(path).parts
    start = next((k for k, part in enumerate(parts) if part in ("volatool", "volatool_cli")), -1)
    return f"{'/'.join(parts[start:])} {function}".strip()


def table(lines: Iterable[str], n_rows: int = 15) -> str:
    """Return the functions with the largest own shares as a Markdown table."""
    rows = ["| function | own | with what it calls |", "|---|---:|---:|"]
    for name, own, within in shares(lines)[:n_rows]:
        rows.append(f"| `{name}` | {own:.1%} | {within:.1%} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table(Path(sys.argv[1]).read_text().splitlines()))
