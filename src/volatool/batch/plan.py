"""Arguments to a list of inputs, inputs to output names; collisions are found before any work."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from volatool.errors import InputNotFoundError, OptionError, OutputExistsError
from volatool.naming import POINT_SUFFIXES, stem
from volatool.remote.path import RemotePath, is_url, path_of


def expand(
    arguments: Sequence[str | Path],
    stdin: Iterable[str] = (),
    suffixes: tuple[str, ...] = POINT_SUFFIXES,
) -> list[Path]:
    """
    Return the input files that arguments name, in order, each once.

    Parameters
    ----------
    arguments : sequence of str or pathlib.Path
        Files, folders (their files, not those of subfolders), shell patterns, ``@list.txt`` (one
        name a line), ``-`` (names from `stdin`), and URLs of all these. A path, not a name, is
        taken as it is.
    stdin : iterable of str
        The names for ``-``.
    suffixes : tuple of str
        What counts in a folder; case does not matter.

    Returns
    -------
    paths : list of pathlib.Path
        Files named outright need not exist: that is the tile's error, not the batch's.

    Raises
    ------
    InputNotFoundError
        A list that can't be read.
    OptionError
        A folder or a pattern without any input, or no input at all.
    """
    paths = list(dict.fromkeys(_expanded(arguments, stdin, suffixes)))
    if not paths:
        raise OptionError("no input: nothing was named")
    return paths


def _expanded(
    arguments: Sequence[str | Path], stdin: Iterable[str], suffixes: tuple[str, ...]
) -> Iterator[Path]:
    for argument in arguments:
        if isinstance(argument, Path):
            yield argument
        elif not argument:
            raise OptionError("an input is an empty name; is a shell variable unset?")
        elif argument == "-":
            for name in stdin:
                if "\0" in name:
                    raise OptionError("names on stdin hold NUL bytes; give -0 if they end names")
                yield path_of(name)
        elif argument.startswith("@"):
            yield from _listed(path_of(argument[1:]))
        elif is_url(argument):
            yield from _remote(argument, suffixes)
        elif _is_dir(argument):
            yield from _some(
                argument,
                sorted(
                    path
                    for path in Path(argument).iterdir()
                    if path.name.lower().endswith(suffixes) and path.is_file()
                ),
                f"has no file that ends in {', '.join(suffixes)}",
            )
        elif glob.has_magic(argument) and not _exists(argument):
            matches = glob.glob(argument, recursive=True)  # noqa: PTH207 (absolute patterns too)
            yield from _some(
                argument, [Path(match) for match in sorted(matches)], "matches nothing"
            )
        else:
            yield Path(argument)


def _remote(url: str, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """Yield what a URL names: a file, the files of a folder, those that match a pattern."""
    path = path_of(url)
    if not isinstance(path, RemotePath):  # file://
        yield from _expanded([str(path)], (), suffixes)
        return
    from volatool.remote import store

    store.filesystem(path)  # what is not installed stops the batch, not each of its tiles
    if path.url.endswith("/") or not (
        path.name.lower().endswith(suffixes) or store.has_magic(path) or not store.is_folder(path)
    ):
        ends = ", ".join(suffixes)
        yield from _some(
            str(path), store.listed(path, suffixes), f"has no file that ends in {ends}"
        )
    elif store.has_magic(path):
        yield from _some(str(path), store.matched(path), "matches nothing")
    else:
        yield path


def _is_dir(name: str) -> bool:
    try:
        return Path(name).is_dir()
    except (OSError, ValueError):  # too long, or with a NUL: reading it says so
        return False


def _exists(name: str) -> bool:
    try:
        return Path(name).exists()
    except (OSError, ValueError):
        return False


def _some(argument: str, paths: Sequence[Path], otherwise: str) -> Sequence[Path]:
    if not paths:
        raise OptionError(f"{argument}: {otherwise}")
    return paths


def _listed(path: Path) -> list[Path]:
    try:
        # Windows editors put a byte order mark in front
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputNotFoundError(f"{path}: the list of inputs can't be read ({reason})") from error
    return [path_of(line.strip()) for line in lines if line.strip()]


def refuse_collisions(inputs: Sequence[Path], outdir: Path | None) -> None:
    """
    Raise if two inputs would write the same output.

    Raises
    ------
    OutputExistsError
        ``E_NAME_COLLISION``, naming both inputs.
    """
    seen: dict[str, Path] = {}
    resolved: dict[Path, Path] = {}  # asks the file system for each part of a path
    for path in inputs:
        folder = path.parent if outdir is None else outdir
        if folder not in resolved:
            resolved[folder] = folder.resolve()
        target = f"{resolved[folder]}/{stem(path)}"
        first = seen.setdefault(target, path)
        if first is not path:
            raise OutputExistsError(
                f"{first} and {path} would both write {folder / stem(path)}.*; "
                "rename one, or convert them into different folders",
                "E_NAME_COLLISION",
            )
