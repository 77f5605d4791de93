"""What several formats have to say about a volume."""

from __future__ import annotations

from volatool.errors import CodedWarning
from volatool.vola.volume import Volume


def no_crs(volume: Volume, wkt: str | None) -> list[CodedWarning]:
    """Warn of a volume whose CRS is not known, or can't be written."""
    if wkt is not None:
        return []
    name = volume.crs.horizontal
    told = "the volume has no CRS" if name is None else f"the CRS {name} is not known"
    return [CodedWarning("W_NO_CRS", f"{told}; the output carries none")]


def unknown_channels(volume: Volume) -> list[CodedWarning]:
    """Warn of metadata that is left out because nothing says what its bytes mean."""
    if not volume.has_metadata or volume.info.channels:
        return []
    return [
        CodedWarning(
            "W_CHANNELS",
            "nothing says what the bytes of the metadata mean; it is left out (csv, npz keep it)",
        )
    ]
