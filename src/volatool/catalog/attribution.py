"""Who made a data set and what may be done with it: `info.json`, and what a caller adds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

from volatool.errors import InputNotFoundError, OptionError

INFO_FILE = "info.json"
"""What the original toolkit's ``datasetparser`` reads in the folder."""

_LONGEST = 100_000


@dataclass(frozen=True, slots=True)
class Attribution:
    """
    The seven texts of a ``.vola`` index, by its names.

    Parameters
    ----------
    dataset : str
        Name of the data set.
    info : str
        A description.
    url : str
        Where it is told about or can be had.
    author, authorurl : str
        Whom to name, and where to find them.
    license, licenseurl : str
        What may be done with the data (an SPDX identifier or a name), and its text.
    """

    dataset: str = ""
    info: str = ""
    url: str = ""
    author: str = ""
    authorurl: str = ""
    license: str = ""
    licenseurl: str = ""

    def to_dict(self) -> dict[str, str]:
        """Return the texts by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def attribution_of(
    folder: Path, info_file: Path | None = None, given: Mapping[str, str | None] | None = None
) -> Attribution:
    """
    Return a folder's attribution; who made the data and under which licence must be said.

    Parameters
    ----------
    folder : pathlib.Path
        Its name is the data set's, if no other is given; its ``info.json`` is read if there.
    info_file : pathlib.Path, optional
        Read instead.
    given : mapping of str to str or None, optional
        Fields of `Attribution`; they go before those of the file.

    Raises
    ------
    InputNotFoundError
        `info_file` is not there.
    OptionError
        ``E_ATTRIBUTION``: neither names the author or the licence, or the file is not what it
        should be.
    """
    path = folder / INFO_FILE if info_file is None else info_file
    found = Attribution()
    if path.exists():
        found = _read(path)
    elif info_file is not None:
        raise InputNotFoundError(f"{info_file}: no such file")
    texts = {key: value for key, value in (given or {}).items() if value is not None}
    found = replace(found, **texts)
    if not found.dataset:
        found = replace(found, dataset=folder.resolve().name or "dataset")
    missing = [name for name in ("author", "license") if not getattr(found, name).strip()]
    if missing:
        flags = " and ".join(f"--{name}" for name in missing)
        raise OptionError(
            f"{folder}: an index names who made the data and its licence; give {flags}, or "
            f"{' and '.join(map(repr, missing))} in {path.name}",
            "E_ATTRIBUTION",
        )
    return found


def _read(path: Path) -> Attribution:
    def refuse(why: str) -> OptionError:
        return OptionError(f"{path}: {why}", "E_ATTRIBUTION")

    try:
        with path.open("rb") as stream:
            text = stream.read(_LONGEST + 1)
        document = json.loads(text.decode("utf-8-sig")) if len(text) <= _LONGEST else None
    except OSError as error:
        raise refuse(f"can't be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise refuse(f"is not JSON: {error}") from error
    if document is None:
        raise refuse(f"is longer than {_LONGEST} bytes")
    if not isinstance(document, dict):
        raise refuse('is not a JSON object such as {"author": "...", "license": "..."}')
    names = [field.name for field in fields(Attribution)]
    for name in names:
        if not isinstance(document.get(name, ""), str):
            raise refuse(f"{name!r} is not text")
    return Attribution(**{name: document[name] for name in names if name in document})
