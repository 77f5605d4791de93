"""Our own files again: a part of a volume, less deep, sparse or dense, gzip or not."""

from __future__ import annotations

from volatool.encodings import Encoding, write_volume
from volatool.errors import CodedWarning
from volatool.export.model import ExportOptions, Target
from volatool.vola.volume import Volume


def export(volume: Volume, target: Target, options: ExportOptions) -> list[CodedWarning]:
    """
    Write ``.vol``, ``.vol.gz``, ``.dvol`` or ``.dvol.gz``, as the target's suffix says.

    Parameters
    ----------
    volume : Volume
        What is written, with its metadata and trailer.
    target : Target
        One file.
    options : ExportOptions
        Nothing of it.

    Returns
    -------
    warnings : list of CodedWarning

    Raises
    ------
    ResourceError
        ``E_SIZE``: a dense file nobody can want.
    """
    del options
    kind = "dense" if target.suffix.startswith(".dvol") else "sparse"
    codec = "gzip" if target.suffix.endswith(".gz") else "none"
    bits = 2 if volume.has_metadata else 1
    with target.stream() as stream:
        write_volume(stream, volume, Encoding(kind, bits, codec))
    return []
