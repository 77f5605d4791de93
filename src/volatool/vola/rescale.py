"""Metadata channels of several volumes in one scaling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Channels = Sequence[Mapping[str, Any]]
Table = NDArray[np.uint8]

_COLOURS = ("red", "green", "blue")
_PRESENT = 7


def common_channels(
    described: Sequence[Channels],
) -> tuple[tuple[Mapping[str, Any], ...], list[Table]]:
    """
    Return the channels that all volumes have, and how the bytes of each become theirs.

    Parameters
    ----------
    described : sequence of sequences of mappings
        `VolumeInfo.channels` of each volume.

    Returns
    -------
    channels : tuple of mappings
        Those of the same name, byte and unit in all. Where scale and offset differ the common
        ones span the values of all, and bytes are rounded to them, halves up. Colours keep their
        bytes, which are parts of the full scale in any file; their scale is the largest.
    tables : list of (8, 256) arrays of uint8
        What each byte of each volume's words becomes. Bytes of other channels become 0, byte 7
        is 1.

    Notes
    -----
    When none of the volumes says what its bytes are (files of the original toolkit) all are kept
    as they are.
    """
    tables: list[Table] = [np.zeros((8, 256), np.uint8) for _ in described]
    if not any(described):
        for table in tables:
            table[:] = np.arange(256)
        return (), tables
    for table in tables:
        table[_PRESENT] = 1
    channels = []
    for first in described[0]:
        found = [_like(first, channels_of_one) for channels_of_one in described]
        if None in found:
            continue
        alike: list[Mapping[str, Any]] = [channel for channel in found if channel is not None]
        byte = int(first["byte"])
        channels.append(_common(alike))
        if byte == _PRESENT:
            continue
        for table, own in zip(tables, alike, strict=True):
            table[byte] = _mapped(own, channels[-1])
    return tuple(channels) if {c["byte"] for c in channels} - {_PRESENT} else (), tables


def _like(wanted: Mapping[str, Any], channels: Channels) -> Mapping[str, Any] | None:
    for channel in channels:
        if all(channel.get(key) == wanted.get(key) for key in ("name", "byte", "unit")):
            return channel
    return None


def _common(alike: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return one channel for several of the same meaning."""
    first = alike[0]
    if all(_scaling(channel) == _scaling(first) for channel in alike):
        return first
    if first["name"] in _COLOURS:
        return {**first, "scale": max(float(channel["scale"]) for channel in alike)}
    ends = [end for channel in alike for end in _span(channel)]
    low, high = min(ends), max(ends)
    return {**first, "scale": (high - low) / 255, "offset": low}


def _scaling(channel: Mapping[str, Any]) -> tuple[float, float]:
    return float(channel["scale"]), float(channel["offset"])


def _span(channel: Mapping[str, Any]) -> tuple[float, float]:
    scale, offset = _scaling(channel)
    return offset, offset + 255 * scale


def _mapped(own: Mapping[str, Any], common: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return what each byte of one volume's channel is in the common scaling."""
    raw = np.arange(256)
    if _scaling(own) == _scaling(common) or own["name"] in _COLOURS:
        return raw.astype(np.uint8)
    (scale, offset), (step, low) = _scaling(own), _scaling(common)
    if not step:
        return np.zeros(256, np.uint8)
    places = (raw * scale + (offset - low)) / step
    mapped: NDArray[np.uint8] = np.clip(np.floor(places + 0.5), 0, 255).astype(np.uint8)
    return mapped


def apply_table(words: NDArray[np.uint64], table: Table) -> NDArray[np.uint64]:
    """Return metadata words with each byte replaced by what the table says."""
    result = np.zeros(len(words), np.uint64)
    for byte in range(8):
        shift = np.uint64(8 * byte)
        place = ((words >> shift) & np.uint64(255)).astype(np.intp)
        result |= table[byte][place].astype(np.uint64) << shift
    return result
