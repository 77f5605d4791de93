"""Where cells come to lie in formats with one unit for all axes, and how that is told."""

from __future__ import annotations

from volatool.cube import Cube
from volatool.errors import CodedWarning, OptionError
from volatool.export.cells import Places
from volatool.export.notes import no_crs
from volatool.vola.volume import Volume


def with_extent(volume: Volume, what: str) -> Cube:
    """Return the cube; refuse one without an edge, in which cells have none."""
    if not volume.cube.side > 0:
        raise OptionError(
            f"the cube has no extent (all points are in one place), and {what} needs cells with an "
            "edge; convert with --cube LENGTH",
            "E_CUBE",
        )
    return volume.cube


def shift_of(volume: Volume, corner: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return what is added to local coordinates for those of the CRS, z in the horizontal unit."""
    cell = volume.cube.exact[3] / 4**volume.depth
    x, y, z = (
        float(value - at * cell) for value, at in zip(volume.cube.exact[:3], corner, strict=True)
    )
    return x, y, z


def shifted(volume: Volume, corner: tuple[int, int, int]) -> CodedWarning:
    """Return the message that coordinates are local."""
    x, y, z = shift_of(volume, corner)
    return CodedWarning(
        "W_SHIFTED",
        f"coordinates are local: add {x:.12g}, {y:.12g}, {z:.12g} for those of "
        f"{volume.crs.horizontal or 'the file'}{z_told(volume)}",
    )


def placed_locally(volume: Volume) -> CodedWarning:
    """Return the message that coordinates begin at the cube, z in the vertical unit."""
    x, y, z = Places.of(volume).origin
    return CodedWarning(
        "W_SHIFTED",
        f"coordinates are local: add {x:.12g}, {y:.12g}, {z:.12g} for those of "
        f"{volume.crs.horizontal or 'the file'}",
    )


def z_told(volume: Volume) -> str:
    """Return what has to be done to z for the vertical unit, to end a sentence."""
    ratio = volume.crs.z_ratio
    if ratio == 1:
        return ""
    return f", and divide z by {float(ratio):.12g} for {volume.crs.unit_z or 'its own unit'}"


def not_kept(volume: Volume, what: str) -> list[CodedWarning]:
    """
    Return what a format without room for a CRS loses.

    Parameters
    ----------
    volume : Volume
        What is exported, in coordinates of its CRS, z in the horizontal unit.
    what : str
        The format.
    """
    if volume.crs.horizontal is None:
        return no_crs(volume, None)
    name = "+".join(part for part in (volume.crs.horizontal, volume.crs.vertical) if part)
    told = f"{what} carries no CRS; the coordinates are in {name}"
    return [CodedWarning("W_NO_CRS", told), *z_unit(volume)]


def z_unit(volume: Volume) -> list[CodedWarning]:
    """Tell of heights that are not in the unit of the volume's CRS."""
    if volume.crs.z_ratio == 1:
        return []
    unit = volume.crs.unit_xy or "the unit of x and y"
    return [CodedWarning("W_Z_UNIT", f"cells are cubes: heights are in {unit}{z_told(volume)}")]
