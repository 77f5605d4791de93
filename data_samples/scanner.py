"""An airborne laser scanner: parallel strips of scan lines, slanting pulses, several returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from chance import between, normal, uniform
from numpy.typing import NDArray
from scene import Floats, Scene

CROWN = 8.0
"""Height above ground, in metres, at which a slanting pulse is taken to meet a crown."""

TICK = 2.0**-18
"""Seconds between pulses: a power of two, so that the times are exact numbers."""


@dataclass(frozen=True)
class Flight:
    """
    How a tile is flown: strips along u, side by side in v.

    Parameters
    ----------
    width, height : float
        Of the tile in metres; returns outside are cut off.
    datum : float
        Mean height of the scene, metres.
    above : float
        Flying height over it.
    angle : float
        Largest scan angle, degrees.
    strip : float
        Distance between the strips' axes, metres; less than the swath, so that they overlap.
    line, pulse : float
        Spacing of scan lines and of the pulses in a line, metres at the datum.
    """

    width: float
    height: float
    datum: float
    above: float
    angle: float
    strip: float
    line: float
    pulse: float

    @property
    def pulses_per_line(self) -> int:
        """Pulses in one scan line."""
        return int(2 * self.above * np.tan(np.radians(self.angle)) / self.pulse)

    @property
    def lines(self) -> int:
        """Scan lines in one strip."""
        return int(self.width / self.line) + 4

    @property
    def strips(self) -> int:
        """Strips over the tile."""
        return int(np.ceil((self.height - 0.05 * self.strip) / self.strip)) + 1


@dataclass(frozen=True)
class Returns:
    """Points in the order of their times; all arrays are of the same length."""

    u: Floats
    v: Floats
    z: Floats
    code: NDArray[np.uint8]
    colour: NDArray[np.uint8]
    intensity: NDArray[np.uint16]
    number: NDArray[np.uint8]
    count: NDArray[np.uint8]
    time: Floats
    strip: NDArray[np.uint16]
    angle: Floats
    direction: NDArray[np.uint8]
    is_edge: NDArray[np.bool_]
    is_overlap: NDArray[np.bool_]
    is_withheld: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.u)


def scan(scene: Scene, flight: Flight, lines_per_piece: int = 400) -> Iterator[Returns]:
    """
    Fly the tile.

    Parameters
    ----------
    scene : Scene
        What is scanned.
    flight : Flight
        How.
    lines_per_piece : int
        Scan lines worked out at a time; the result does not depend on it.

    Yields
    ------
    returns : Returns
        Inside the tile, in the order of their times.
    """
    for strip in range(flight.strips):
        for first in range(0, flight.lines, lines_per_piece):
            lines = np.arange(first, min(flight.lines, first + lines_per_piece))
            yield _fire(scene, flight, strip, lines)


def estimate(scene: Scene, flight: Flight, every: int = 37) -> float:
    """
    Return about how many points `scan` will give, from one scan line in `every`.

    Parameters
    ----------
    scene : Scene
        What is scanned.
    flight : Flight
        How.
    every : int
        Lines that one stands for.
    """
    lines = np.arange(0, flight.lines, every)
    found = sum(len(_fire(scene, flight, strip, lines)) for strip in range(flight.strips))
    return found * flight.lines / len(lines)


def _fire(scene: Scene, flight: Flight, strip: int, lines: NDArray[np.int64]) -> Returns:
    """Return the points of some scan lines of one strip."""
    seed, per_line = scene.seed, flight.pulses_per_line
    line, place = (part.ravel() for part in np.meshgrid(lines, np.arange(per_line), indexing="ij"))
    pulse = (np.int64(strip) * flight.lines + line) * per_line + place
    forth = 1 if strip % 2 == 0 else -1
    axis = 0.05 * flight.strip + strip * flight.strip
    # the aircraft sways a little; a scan line is aslant because it flies on meanwhile
    phase = line * flight.line / 37.0 + strip
    roll = 0.35 * np.sin(phase) + 0.15 * np.sin(2.7 * phase)
    angle = flight.angle * (2 * (place + 0.5) / per_line - 1) + roll
    tangent = np.tan(np.radians(angle)) * forth
    along = (line - 1 + place / per_line) * flight.line + 0.12 * normal(seed + 1, pulse)
    u = along if forth > 0 else flight.width - along
    v = axis + flight.above * tangent + 0.06 * normal(seed + 2, pulse)
    ground = scene.terrain(u, v)
    v = axis + (flight.datum + flight.above - ground) * tangent + 0.06 * normal(seed + 2, pulse)

    keep = np.flatnonzero(
        (u > -30) & (u < flight.width + 30) & (v > -30) & (v < flight.height + 30)
    )
    u, v, pulse, angle, tangent = u[keep], v[keep], pulse[keep], angle[keep], tangent[keep]
    line, place = line[keep], place[keep]
    ground = scene.terrain(u, v)
    hit_z, hit_v, is_roof, is_wall = _solid(scene, u, v, ground, tangent, pulse)
    lit = scene.surface(u, hit_v, is_roof)
    hit_z = np.where(is_roof | is_wall, hit_z, lit.height)
    code = np.where(is_wall, np.uint8(1), lit.code)
    colour = np.where(is_wall[:, None], 0.35 * lit.colour + 110.0, lit.colour)
    reflectance = np.where(is_wall, 0.25, lit.reflectance)
    chance = np.where(is_wall, 0.35, lit.detection)  # walls are hardly hit
    # still water answers only a beam that comes straight down
    chance = np.where(lit.code == 9, 0.5 * np.exp(-((angle / 1.6) ** 2)), chance)

    # trees: a slanting beam meets the crown about half way up
    top, bottom, tree = scene.trees.crowns(u, v + CROWN * tangent)
    in_crown = (tree >= 0) & (top > hit_z + 1.0)
    layers = np.full((len(u), 5), np.nan)
    depth = top + 0.1 - 0.35 * -np.log1p(-uniform(seed + 3, pulse))
    goes_on = in_crown.copy()
    for layer in range(4):
        leaf = goes_on & (depth > np.maximum(bottom, hit_z + 0.6))
        layers[leaf, layer] = depth[leaf]
        goes_on = leaf & (uniform(seed + 4, pulse, layer) < 0.62 - 0.1 * layer)
        depth = depth - 1.2 - 1.6 * -np.log1p(-uniform(seed + 5, pulse, layer))
    seen = ~np.isnan(layers[:, :4])
    blocked = seen.any(axis=1) & (uniform(seed + 6, pulse) < scene.canopy)
    answers = (uniform(seed + 7, pulse) < chance) & ~blocked
    layers[answers, 4] = hit_z[answers]
    seen = ~np.isnan(layers)
    count = seen.sum(axis=1)

    shade = 1.0 + np.where(in_crown, 0.09, 0.03) * normal(seed + 8, pulse)
    leafy = scene.trees.colour.reshape(-1, 3)[np.maximum(tree, 0)]
    # colours come from a photograph taken from above: what is under a crown has the crown's
    pixel = np.where((in_crown & seen[:, :4].any(axis=1))[:, None], leafy, colour) * shade[:, None]
    pixel = np.clip(pixel, 4, 252).astype(np.uint8) & np.uint8(0xFC)

    who, layer = np.nonzero(seen)
    number = (np.cumsum(seen, axis=1)[who, layer]).astype(np.uint8)
    is_leaf = layer < 4
    z = layers[who, layer]
    z = z + 0.018 * normal(seed + 9, pulse[who], layer) + 0.02 * ((strip * 7) % 3 - 1)
    # what a beam meets above the ground lies nearer to the aircraft's axis
    slant = CROWN + 0.5 * (z - ground[who] - CROWN)
    place_v = np.where(is_leaf, v[who] + slant * tangent[who], hit_v[who])
    above = z - ground[who]
    leaf_code = np.where(above > 5, 5, np.where(above > 2, 4, 3)).astype(np.uint8)
    strength = np.where(is_leaf, 0.42, reflectance[who]) / np.sqrt(count[who])
    intensity = 1600 * strength * np.cos(np.radians(angle[who]))
    intensity = intensity * (1 + 0.05 * normal(seed + 10, pulse[who], layer))
    distance = np.abs(v[who] - axis)
    outer = flight.above * np.tan(np.radians(flight.angle))
    edge = (place[who] == 0) | (place[who] == per_line - 1)
    inside = (u[who] >= 0) & (u[who] < flight.width) & (place_v >= 0) & (place_v < flight.height)
    found = Returns(
        u=u[who],
        v=place_v,
        z=z,
        code=np.where(is_leaf, leaf_code, code[who]),
        colour=pixel[who],
        intensity=np.clip(intensity, 1, 4095).astype(np.uint16),
        number=number,
        count=count[who].astype(np.uint8),
        time=(strip * 2.0**25 + line[who] * 2.0**11 + place[who]) * TICK,
        strip=np.full(len(who), 101 + strip, np.uint16),
        angle=angle[who],
        direction=np.full(len(who), strip % 2, np.uint8),
        is_edge=edge,
        is_overlap=distance > flight.strip / 2,
        is_withheld=distance > 0.985 * outer,
    )
    return _with_noise(scene, found, pulse[who], ground[who], inside)


def _solid(
    scene: Scene, u: Floats, v: Floats, ground: Floats, tangent: Floats, pulse: NDArray[np.int64]
) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """Follow slanting pulses down to the first roof or wall: (z, v, is_roof, is_wall)."""
    hit_z, hit_v = ground.copy(), v.copy()
    is_roof, is_wall = np.zeros(len(u), bool), np.zeros(len(u), bool)
    on_the_way = np.arange(len(u))
    before = float(np.max(scene.steps, initial=0.0)) + 3.0
    for step in scene.steps:
        part = v[on_the_way] + step * tangent[on_the_way]
        top = scene.roof(u[on_the_way], part) - ground[on_the_way]
        met = top >= step
        struck, high, place = on_the_way[met], top[met], part[met]
        wall = high - step > 1.2 * (before - step) + 0.4
        level = step + (before - step) * uniform(scene.seed + 11, pulse[struck])
        hit_z[struck] = ground[struck] + np.where(wall, level, high)
        hit_v[struck] = place
        is_roof[struck], is_wall[struck] = ~wall, wall
        on_the_way = on_the_way[~met]
        before = step
    return hit_z, hit_v, is_roof, is_wall


def _with_noise(
    scene: Scene,
    found: Returns,
    pulse: NDArray[np.int64],
    ground: Floats,
    inside: NDArray[np.bool_],
) -> Returns:
    """Turn a few single returns into noise (7 below, 18 far above) and cut to the tile."""
    lot = uniform(scene.seed + 12, pulse)
    single = found.count == 1
    low, high = single & (lot < 1.6e-4), single & (lot > 1 - 1.2e-4)
    found.z[low] = ground[low] - between(1.5, 14.0, scene.seed + 13, pulse[low])
    found.z[high] = ground[high] + between(*scene.clouds, scene.seed + 13, pulse[high])
    found.code[low], found.code[high] = 7, 18
    found.intensity[low | high] = 6
    return Returns(*(getattr(found, name)[inside] for name in found.__dataclass_fields__))
