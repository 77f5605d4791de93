"""Rows of coordinates or cells as callers give them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from volatool.errors import OptionError


def rows_of(
    values: ArrayLike, width: int = 3, dtype: DTypeLike = np.float64, *, what: str = "points"
) -> NDArray[Any]:
    """
    Return values as rows.

    Parameters
    ----------
    values : (..., width) array
        One row, or any number of them. An empty list is none.
    width : int
        Numbers in a row.
    dtype : dtype
        Of the result.
    what : str
        What the rows are, for the error.

    Returns
    -------
    rows : (n, width) array of dtype
        A view where it can be.

    Raises
    ------
    OptionError
        ``E_OPTION``: the last axis is not `width` long. Six rows of two numbers would fill four
        rows of three, all of them wrong.
    """
    array = np.asarray(values, dtype)
    if array.ndim == 1 and not array.size:
        return array.reshape(0, width)
    if not array.ndim or array.shape[-1] != width:
        raise OptionError(f"{what} are an (n, {width}) array, not one of shape {array.shape}")
    return array.reshape(-1, width)
