"""A town on a hillside by a lake: streets, houses, halls, a church, gardens, parks, a wood."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from chance import bits, smooth, uniform
from numpy.typing import NDArray
from scene import Floats, Surface, Trees

PITCH_S, PITCH_T = 71.0, 53.0
"""Distance between streets along and across the hill, metres."""
STREET, WALK = 3.2, 1.6
"""Half the width of a carriageway, and the width of a pavement, metres."""
LOT = 15.5
LAKE, WOOD = 299.0, 328.5
"""Level of the lake, and the height above which blocks are left to the wood, metres."""
TURN = np.radians(17.0)
ROOFS = np.array(
    [[150, 76, 56], [166, 92, 66], [124, 66, 56], [96, 96, 104], [140, 84, 60], [112, 74, 66]],
    float,
)
HOUSES, FLATS, PARK, CHURCH, HALL, FOREST = range(6)
GABLE, HIP, FLAT, SPIRE = range(4)


@dataclass(frozen=True)
class _Lots:
    """Buildings by block and slot, at most twelve to a block; arrays are (columns, rows, 12)."""

    a: Floats  # centre in the block, from the crossing's middle
    b: Floats
    half_a: Floats
    half_b: Floats
    base: Floats
    eaves: Floats
    rise: Floats
    shape: NDArray[np.int64]
    colour: NDArray[np.int64]


@dataclass
class Town:
    """
    The town's scene (see `scene.Scene`).

    Parameters
    ----------
    width, height : float
        Of the tile, metres; the town goes on as far as it is asked for.
    seed : int
        Another seed, another town.
    """

    width: float
    height: float
    seed: int = 2026
    steps: Floats = field(
        default_factory=lambda: np.array(
            [36, 30, 25, 20, 16, 13.5, 11.5, 9.5, 8, 6.8, 5.6, 4.4, 3.2, 2.2, 1.2]
        )
    )
    clouds: tuple[float, float] = (35.0, 110.0)
    canopy: float = 0.45

    def __post_init__(self) -> None:
        corners = self._grid(
            np.array([-60.0, self.width + 60.0, -60.0, self.width + 60.0]),
            np.array([-60.0, -60.0, self.height + 60.0, self.height + 60.0]),
        )
        self._first = tuple(int(np.floor(axis.min() / pitch)) - 1 for axis, pitch in corners)
        last = tuple(int(np.floor(axis.max() / pitch)) + 1 for axis, pitch in corners)
        columns, rows = (b - a + 1 for a, b in zip(self._first, last, strict=True))
        i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
        self._kind = self._block_kinds(i + self._first[0], j + self._first[1])
        self._lots = self._build(i, j)
        self.trees = self._plant()

    # places ------------------------------------------------------------------------------

    def _grid(self, u: Floats, v: Floats) -> tuple[tuple[Floats, float], tuple[Floats, float]]:
        """Return the streets' coordinates (s along the hill, t across) and their pitch."""
        s = u * np.cos(TURN) + v * np.sin(TURN)
        t = -u * np.sin(TURN) + v * np.cos(TURN) + 3.5 * np.sin(s / 90.0)
        return (s + 12.0, PITCH_S), (t + 8.0, PITCH_T)

    def _ungrid(self, s: Floats, t: Floats) -> tuple[Floats, Floats]:
        """Undo `_grid`."""
        s = s - 12.0
        t = t - 8.0 - 3.5 * np.sin(s / 90.0)
        return s * np.cos(TURN) - t * np.sin(TURN), s * np.sin(TURN) + t * np.cos(TURN)

    def _locate(self, u: Floats, v: Floats) -> tuple[NDArray[np.int64], ...]:
        """Return block column and row (into the tables) and the place a, b in the block."""
        (s, pitch_s), (t, pitch_t) = self._grid(u, v)
        i, j = np.floor(s / pitch_s), np.floor(t / pitch_t)
        a, b = s - i * pitch_s, t - j * pitch_t
        column = np.clip(i.astype(np.int64) - self._first[0], 0, self._kind.shape[0] - 1)
        row = np.clip(j.astype(np.int64) - self._first[1], 0, self._kind.shape[1] - 1)
        return column, row, a, b

    def terrain(self, u: Floats, v: Floats) -> Floats:
        """Return the bare earth's height: a hillside that falls to the south-east."""
        slope = np.cos(2 * np.pi * (0.62 * u - 0.78 * v + 150.0) / 960.0)
        cross = np.cos(2 * np.pi * (0.78 * u + 0.62 * v - 190.0) / 610.0)
        rough = 2.2 * smooth(31, u, v, 105.0) + 0.35 * smooth(32, u, v, 27.0)
        return 304.0 + 31.0 * slope - 6.0 * cross + rough

    # buildings ---------------------------------------------------------------------------

    def _block_kinds(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
        """Say what each block is used for."""
        middle = self.terrain(*self._ungrid((i + 0.5) * PITCH_S, (j + 0.5) * PITCH_T))
        lot = uniform(self.seed + 40, i, j)
        kind = np.select([lot < 0.74, lot < 0.84, lot < 0.9], [HOUSES, FLATS, HALL], PARK)
        kind = np.where((i % 4 == 2) & (j % 4 == 1), CHURCH, kind)
        kind = np.where(middle < LAKE + 3.5, PARK, kind)
        return np.where(middle > WOOD, FOREST, kind)

    def _build(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> _Lots:
        """Put the buildings of every block into tables."""
        i, j, kind = i[..., None], j[..., None], self._kind[..., None]
        column, row = i + self._first[0], j + self._first[1]
        slot = np.arange(12)[None, None, :]

        def draw(seed: int, low: float, high: float) -> Floats:
            return low + (high - low) * uniform(self.seed + seed, column, row, slot)

        side, place, is_shed = slot // 4 % 2, slot % 4, slot >= 8
        # houses: two rows of four lots; slots 8 to 11 are garages beside some of them
        a = STREET + WALK + LOT * (place + 0.5) + draw(41, -1.2, 1.2)
        inner = np.where(side == 0, 10.5, PITCH_T - 10.5) + draw(42, -1.0, 1.0)
        half_a, half_b = draw(43, 4.2, 5.6), draw(44, 4.4, 5.8)
        eaves, rise = draw(45, 3.2, 6.2), draw(46, 2.0, 3.6)
        shape = np.select([draw(47, 0, 1) < 0.6, draw(47, 0, 1) < 0.85], [GABLE, HIP], FLAT)
        rise = np.where(shape == FLAT, 0.0, rise)
        stands = np.where(is_shed, draw(48, 0, 1) < 0.45, draw(48, 0, 1) < 0.9)
        shed = (a + LOT / 2 - 2.2, np.where(place % 2 == 0, 8.0, PITCH_T - 8.0))
        parts = {
            "a": np.where(is_shed, shed[0], a),
            "b": np.where(is_shed, shed[1], inner),
            "half_a": np.where(is_shed, 1.6, half_a),
            "half_b": np.where(is_shed, 3.0, half_b),
            "eaves": np.where(is_shed, 2.6, eaves),
            "rise": np.where(is_shed, 0.0, rise),
            "shape": np.where(is_shed, FLAT, shape),
            "stands": stands,
        }
        middle_a, middle_b = PITCH_S / 2, PITCH_T / 2
        special = {
            FLATS: [
                (middle_a, 12.5, 26.0, 5.6, 14.5, 0.0, FLAT),
                (middle_a, PITCH_T - 12.5, 26.0, 5.6, 11.6, 0.0, FLAT),
                (STREET + WALK + 10.0, 12.5, 2.2, 2.2, 17.3, 0.0, FLAT),
                (PITCH_S - 15.0, PITCH_T - 12.5, 2.2, 2.2, 14.4, 0.0, FLAT),
            ],
            HALL: [
                (middle_a - 6, middle_b, 20.0, 15.0, 6.8, 1.6, GABLE),
                (middle_a + 22, middle_b - 6, 6.0, 7.0, 4.2, 0.0, FLAT),
            ],
            CHURCH: [
                (middle_a + 4, middle_b, 15.0, 6.5, 9.0, 7.0, GABLE),
                (middle_a - 14.0, middle_b, 3.4, 3.4, 19.0, 13.0, SPIRE),
                (middle_a + 7, middle_b, 3.4, 10.5, 7.5, 5.2, GABLE),
            ],
        }
        names = ("a", "b", "half_a", "half_b", "eaves", "rise", "shape")
        for use, buildings in special.items():
            of_use = kind[..., 0] == use
            parts["stands"][of_use] = False
            for number, building in enumerate(buildings):
                parts["stands"][of_use, number] = True
                for name, value in zip(names, building, strict=True):
                    parts[name][of_use, number] = value
        parts["stands"] = parts["stands"] & ~np.isin(kind, (PARK, FOREST))
        base = self.terrain(
            *self._ungrid(column * PITCH_S + parts["a"], row * PITCH_T + parts["b"])
        )
        stands = parts.pop("stands") & (base > LAKE + 2.0)
        parts["half_a"] = np.where(stands, parts["half_a"], -1.0)
        colour = (bits(self.seed + 49, column, row, slot) % 6).astype(np.int64)
        colour = np.where(kind == CHURCH, 3, np.where(kind == HALL, 6, colour))
        return _Lots(base=base, colour=colour, **parts)

    def _building(self, u: Floats, v: Floats) -> tuple[Floats, Floats, NDArray[np.int64], Floats]:
        """Return the roofs' height (-inf: none), side to the sun, colour, chimney or not."""
        column, row, a, b = self._locate(u, v)
        height, light = np.full(len(u), -np.inf), np.zeros(len(u))
        colour, ridge = np.zeros(len(u), np.int64), np.zeros(len(u))
        lots = self._lots
        for slot in range(12):
            half_a = lots.half_a[column, row, slot]
            da = a - lots.a[column, row, slot]
            db = b - lots.b[column, row, slot]
            inside = np.flatnonzero(
                (np.abs(da) < half_a) & (np.abs(db) < lots.half_b[column, row, slot])
            )
            if not len(inside):
                continue
            where = (column[inside], row[inside], slot)
            da, db, half_a, half_b = da[inside], db[inside], half_a[inside], lots.half_b[where]
            along_a = half_a >= half_b
            shape, rise = lots.shape[where], lots.rise[where]
            across = np.where(along_a, np.abs(db) / half_b, np.abs(da) / half_a)
            end = np.where(
                along_a,
                1 - (half_a - np.abs(da)) / half_b,
                1 - (half_b - np.abs(db)) / half_a,
            )
            pyramid = np.maximum(np.abs(da) / half_a, np.abs(db) / half_b)
            fall = np.select(
                [shape == GABLE, shape == HIP, shape == SPIRE],
                [across, np.maximum(across, end), pyramid],
                0.0,
            )
            top = lots.base[where] + lots.eaves[where] + rise * (1 - fall)
            chimney = (np.abs(da - 1.5) < 0.5) & (np.abs(db - 0.8) < 0.5) & (shape < FLAT)
            top = np.where(chimney & (half_a < 6), top + 1.1, top)
            # the sun stands in the south-west: roofs that fall that way are brighter
            facing = np.where(along_a, -np.sign(db), -np.sign(da)) * (rise > 0)
            higher = top > height[inside]
            chosen = inside[higher]
            height[chosen], light[chosen] = top[higher], facing[higher]
            colour[chosen] = np.where(shape == FLAT, 6, lots.colour[where])[higher]
            ridge[chosen] = (chimney & (half_a < 6))[higher]
        return height, light, colour, ridge

    def roof(self, u: Floats, v: Floats) -> Floats:
        """Return the height of the building at each place, -inf where there is none."""
        return self._building(u, v)[0]

    # what the pulse meets ----------------------------------------------------------------

    def _street(
        self, column: NDArray[np.int64], row: NDArray[np.int64], a: Floats, b: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the distance from the middle of the nearest street, and whether it is paved."""
        across = np.minimum(np.minimum(a, PITCH_S - a), np.minimum(b, PITCH_T - b))
        return across, self._kind[column, row] != FOREST

    def surface(self, u: Floats, v: Floats, is_roof: NDArray[np.bool_]) -> Surface:
        """Return what lies at each place: the roof where `is_roof`, else the ground."""
        ground = self.terrain(u, v)
        column, row, a, b = self._locate(u, v)
        kind = self._kind[column, row]
        middle, paved = self._street(column, row, a, b)
        is_water = ground < LAKE
        road = (middle < STREET) & paved & ~is_water & ~is_roof
        walk = (middle < STREET + WALK) & (middle >= STREET) & paved & ~is_water & ~is_roof

        grain = smooth(self.seed + 60, u, v, 9.0) + 0.6 * smooth(self.seed + 61, u, v, 2.3)
        colour = np.array([104.0, 132.0, 74.0]) + grain[:, None] * np.array([13.0, 9.0, 8.0])
        yard = (kind == HALL) | (kind == CHURCH)
        gravel = np.array([152.0, 146.0, 134.0]) + 4 * grain[:, None]
        colour = np.where(yard[:, None], gravel, colour)
        wood = np.array([92.0, 88.0, 62.0]) + 7 * grain[:, None]
        colour = np.where((kind == FOREST)[:, None], wood, colour)
        shore = (ground < LAKE + 0.9)[:, None]
        colour = np.where(shore, np.array([182.0, 170.0, 138.0]), colour)
        colour = np.where(walk[:, None], np.array([158.0, 156.0, 152.0]), colour)
        line = road & (middle < 0.12) & (np.floor((a + b) / 3.0) % 2 == 0)
        colour = np.where(road[:, None], np.array([92.0, 93.0, 98.0]) + 2 * grain[:, None], colour)
        colour = np.where(line[:, None], 214.0, colour)
        colour = np.where(is_water[:, None], np.array([58.0, 92.0, 112.0]), colour)
        reflectance = np.select([is_water, line, road, walk], [0.15, 0.6, 0.12, 0.3], 0.5)
        reflectance = reflectance + 0.05 * np.clip(grain, -1, 1)
        detection = np.select([is_water, road, walk], [0.0, 0.72, 0.9], 0.95)
        height = np.where(is_water, LAKE, ground + 0.03 * grain * ~road)
        code = np.where(is_water, np.uint8(9), np.uint8(2))

        # cars at the kerb, hedges between lots, and what stands on roofs stay unclassified
        stand = np.floor((a + b) / 6.2).astype(np.int64)
        in_stand = np.abs((a + b) / 6.2 - stand - 0.5)
        car = road & (middle > 1.3) & (middle < 3.0) & (in_stand < 0.35)
        car &= uniform(self.seed + 62, column, row, stand, (a < b)) < 0.3
        lift = np.where(in_stand < 0.2, 1.45, 0.95)
        height = np.where(car, height + lift, height)
        paint = 60.0 + 150.0 * uniform(self.seed + 63, column, row, stand)
        colour = np.where(car[:, None], paint[:, None] * np.array([1.0, 0.97, 0.96]), colour)
        lot = (a - STREET - WALK) / LOT
        hedge = (kind == HOUSES) & (np.abs(lot - np.round(lot)) * LOT < 0.45) & (middle > 6.5)
        hedge &= ~is_roof & ~is_water & (uniform(self.seed + 64, column, row, np.round(lot)) < 0.6)
        height = np.where(hedge, height + 1.3 + 0.2 * grain, height)
        colour = np.where(hedge[:, None], np.array([66.0, 96.0, 50.0]), colour)
        code = np.where(car, np.uint8(1), np.where(hedge, np.uint8(3), code))

        top, light, tile, chimney = self._building(u, v)
        roofed = is_roof & np.isfinite(top)
        palette = np.vstack([ROOFS, [[150.0, 150.0, 148.0]]])
        shine = (1.0 + 0.16 * light + 0.03 * grain)[:, None]
        colour = np.where(roofed[:, None], palette[tile] * shine, colour)
        return Surface(
            height=np.where(roofed, top, height),
            code=np.where(roofed, np.where(chimney > 0, 1, 6), code).astype(np.uint8),
            colour=colour,
            reflectance=np.where(roofed, 0.36 + 0.1 * (tile == 6), reflectance),
            detection=np.where(roofed, 0.99, detection),
        )

    def _plant(self) -> Trees:
        """Plant the trees: gardens, parks, street trees and the wood on the hill."""
        pitch = 6.4
        columns, rows = int(self.width / pitch) + 4, int(self.height / pitch) + 4
        j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        u = (i - 1 + 0.15 + 0.7 * uniform(self.seed + 70, i, j)) * pitch
        v = (j - 1 + 0.15 + 0.7 * uniform(self.seed + 71, i, j)) * pitch
        flat_u, flat_v = u.ravel(), v.ravel()
        column, row, a, b = self._locate(flat_u, flat_v)
        kind, foot = self._kind[column, row], self.terrain(flat_u, flat_v)
        middle, paved = self._street(column, row, a, b)
        chance = np.array([0.3, 0.3, 0.45, 0.4, 0.12, 0.95])[kind]
        chance = np.where(foot < LAKE + 5, np.maximum(chance, 0.3), chance)
        avenue = paved & (middle > STREET + 0.4) & (middle < STREET + 2.8)
        chance = np.where(avenue, 0.55, chance)
        chance = np.where(paved & (middle < STREET + 0.4), 0.0, chance)
        open_sky = ~np.isfinite(self.roof(flat_u, flat_v)) & (foot > LAKE + 0.6)
        grows = open_sky & (uniform(self.seed + 72, i, j).ravel() < chance)
        size = uniform(self.seed + 73, i, j).ravel()
        in_wood = kind == FOREST
        tall = np.where(in_wood, 13 + 9 * size, np.where(avenue, 7 + 3 * size, 4 + 11 * size**1.5))
        radius = np.where(in_wood, 2.6 + 1.8 * size, 1.1 + 0.24 * tall)
        cone = uniform(self.seed + 74, i, j).ravel() < np.where(in_wood, 0.35, 0.12)
        radius = np.where(cone, 0.75 * radius, radius)
        tone = uniform(self.seed + 75, i, j).ravel()[:, None]
        leaf = np.array([62.0, 92.0, 44.0]) + tone * np.array([42.0, 34.0, 16.0])
        leaf = np.where(cone[:, None], np.array([40.0, 70.0, 46.0]) + 14 * tone, leaf)
        shape = u.shape
        return Trees(
            pitch=pitch,
            u=u,
            v=v,
            foot=foot.reshape(shape),
            tall=tall.reshape(shape),
            radius=np.where(grows, np.minimum(radius, 0.95 * pitch), 0.0).reshape(shape),
            is_cone=cone.reshape(shape),
            colour=leaf.reshape(*shape, 3),
        )
