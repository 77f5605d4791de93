"""Which column is which: from ``--columns``, from names, or from how many there are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from volatool.errors import CodedWarning, FormatError, OptionError
from volatool.imports.model import role_of

BY_NUMBER: dict[int, tuple[str, ...]] = {
    3: (),
    4: ("intensity",),
    6: ("red", "green", "blue"),
    7: ("intensity", "red", "green", "blue"),
    8: ("intensity", "red", "green", "blue", "classification"),
}
"""What columns behind x, y, z are, if nothing names them."""

_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Columns:
    """
    Places of axes and attributes among the columns of a table.

    Parameters
    ----------
    axes : tuple of 3 int
        Columns of x, y and z, from 0.
    attributes : dict of str to int
        Columns by the names of `model.ATTRIBUTES`.
    """

    axes: tuple[int, ...]
    attributes: dict[str, int]

    @property
    def n_needed(self) -> int:
        """Columns that each row must have."""
        return 1 + max((*self.axes, *self.attributes.values()))


def columns_of(
    asked: Sequence[str] | None,
    names: Sequence[str] | None,
    n_columns: int,
    warnings: list[CodedWarning],
) -> Columns:
    """
    Return which column is which.

    Parameters
    ----------
    asked : sequence of str or None
        ``--columns``: a name for each column, ``-`` to leave one out; columns behind are left out.
    names : sequence of str or None
        As the file names its columns; unknown ones are left out.
    n_columns : int
        How many there are.
    warnings : list of CodedWarning
        Appended to: ``W_COLUMNS``.

    Raises
    ------
    OptionError
        More names than columns, an unknown one, or one that comes twice.
    FormatError
        Fewer than three columns, or no x, y, z among the names.
    """
    if asked is not None:
        if len(asked) > n_columns:
            raise OptionError(f"--columns names {len(asked)} columns; the file has {n_columns}")
        return _named(asked, is_asked=True)
    if names is not None:
        return _named(names, is_asked=False)
    if n_columns < 3:
        raise FormatError(f"{n_columns} columns; points need three", "E_NOT_IMPORT")
    more = BY_NUMBER.get(n_columns)
    if more is None:
        text = (
            f"nothing names the {n_columns} columns: only x, y, z are taken; --columns "
            "x,y,z,intensity,... takes more"
        )
        warnings.append(CodedWarning("W_COLUMNS", text))
        more = ()
    return Columns((0, 1, 2), {name: 3 + k for k, name in enumerate(more)})


def _named(names: Sequence[str], *, is_asked: bool) -> Columns:
    places: dict[str, int] = {}
    for column, name in enumerate(names):
        role = role_of(name)
        if role is None:
            if is_asked and name.strip() not in ("-", ""):
                raise OptionError(
                    f"--columns: {name!r} is not one of x, y, z, intensity, red, green, blue, "
                    "class, return_number, number_of_returns, -"
                )
        elif role not in places:
            places[role] = column
        elif is_asked:
            raise OptionError(f"--columns: {name!r} comes twice")
    missing = [axis for axis in _AXES if axis not in places]
    if missing:
        text = f"no column is called {', '.join(missing)}"
        if is_asked:
            raise OptionError(f"--columns: {text}")
        raise FormatError(
            f"{text}, only {' '.join(names)[:80]}; --columns names them", "E_NOT_IMPORT"
        )
    attributes = {role: place for role, place in places.items() if role not in _AXES}
    colours = {"red", "green", "blue"}
    if 0 < len(colours & attributes.keys()) < 3:
        attributes = {role: at for role, at in attributes.items() if role not in colours}
    return Columns(tuple(places[axis] for axis in _AXES), attributes)
