"""A random seabed: depth anywhere in the plane, from a seed and a few lengths and slopes.

The terrain is patchy, as real seabeds are. One ruggedness, from sediment basins to bare rock, sets the steepness of
every field at a place, on a logarithmic scale. So ground that is rough at the scale of metres is also rough at the
scale of a submap.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pointnetkl.simulation import noise
from pointnetkl.workflow import parameters


class Seabed(Protocol):
    """Depth at any point, and a place for a survey."""

    @property
    def crs(self) -> str:
        """The CRS of its coordinates."""
        ...

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return z (n,) metres, up, negative below the surface, at x, y (n,) metres."""
        ...

    def place(self, length_m: float, width_m: float, azimuth_rad: float) -> tuple[float, float]:
        """Return the centre of a survey of this size, drawn along an azimuth counter-clockwise from east."""
        ...


@dataclass(frozen=True)
class Field:
    """A random field whose steepness follows the ruggedness of the place."""

    slope: list[float]  # rms slope across the grain where the ground is least and most rugged
    length_m: float  # from a hill to the next hollow, coarsest octave
    octaves: int = 2  # each half as long as the one before, and as steep
    stretch: float = 1.0  # how much longer along the grain
    azimuth_deg: float = 0.0  # of the grain, counter-clockwise from east

    def __post_init__(self) -> None:
        """Refuse slopes that are no range.

        Raises:
            ValueError: the slopes are not two positive numbers in rising order, or a length is not positive.
        """
        parameters.require_positive(self, "length_m", "octaves", "stretch")
        if len(self.slope) != 2 or not 0 < self.slope[0] <= self.slope[1]:
            raise ValueError(f"slope is {self.slope}, must be [flattest, steepest], both above zero")


@dataclass(frozen=True)
class Relief:
    """Basins and plateaus with slopes between them, because little of a seabed has most of its height."""

    height_m: float  # of the plateaus above the basins
    length_m: float  # from a basin to the next plateau
    flat: float  # share of the ground that is basin or plateau
    stretch: float  # how much longer along the grain
    azimuth_deg: float  # of the grain, counter-clockwise from east

    def __post_init__(self) -> None:
        """Refuse a share outside 0 to 1.

        Raises:
            ValueError: the flat share is not between 0 and 1, or a length is not positive.
        """
        parameters.require_positive(self, "length_m", "stretch")
        if not 0 < self.flat < 1:
            raise ValueError(f"flat is {self.flat}, must be between 0 and 1")


@dataclass(frozen=True)
class Ripples:
    """Sand waves: crests in fields that cover a share of the ground."""

    height_m: float  # crest to trough
    wavelength_m: float
    azimuth_deg: float  # of the crests
    cover: float
    patch_m: float = 200.0


@dataclass(frozen=True)
class Outcrops:
    """Groups of rocks that stand out of the sediment."""

    height_m: float
    size_m: float
    cover: float
    patch_m: float = 250.0


@dataclass(frozen=True)
class Ploughmarks:
    """Furrows of icebergs' keels: long, curved, with berms, in two crossing families."""

    depth_m: float
    width_m: float
    spacing_m: float
    azimuth_deg: float
    cover: float


@dataclass(frozen=True)
class Wall:
    """A fjord wall along a winding line through the survey."""

    height_m: float
    width_m: float  # from its foot to its top
    azimuth_deg: float
    offset_m: float  # of the line from the survey's centre, to the left of the azimuth


@dataclass(frozen=True)
class Settings:
    """The terrain of one place; features that are None do not occur there."""

    depth_m: float
    patch_m: float  # from rugged ground to smooth
    relief: Relief
    hills: Field  # hundreds of metres
    texture: Field  # tens of metres and less, which registration depends on
    ridges: Field | None = None
    ripples: Ripples | None = None
    outcrops: Outcrops | None = None
    ploughmarks: Ploughmarks | None = None
    wall: Wall | None = None


@dataclass(frozen=True)
class Random:
    """A seabed drawn from a seed, without an edge."""

    settings: Settings
    seed: int
    crs: str
    centre: tuple[float, float]  # of every survey of it, in its CRS

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return z (n,) metres at projected coordinates x, y (n,)."""
        return heights(self.settings, self.seed, x - self.centre[0], y - self.centre[1])

    def place(self, length_m: float, width_m: float, azimuth_rad: float) -> tuple[float, float]:
        """Return the centre, because a seabed without an edge has room for a survey of any size."""
        return self.centre


def heights(terrain: Settings, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return z (n,) metres of a random terrain at x, y (n,) metres from its centre."""
    z = np.full(len(x), -terrain.depth_m)
    for _, part in features(terrain, seed, x, y):
        z += part
    return z


def features(terrain: Settings, seed: int, x: np.ndarray, y: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each feature's contribution to z, (n,) metres, with its name in the settings."""
    # a seed for each feature, so that a new feature leaves the others as they are
    yield "relief", _relief(terrain.relief, seed * 64 + 12, x, y)
    rugged = _ruggedness(terrain.patch_m, seed * 64 + 40, x, y)
    for number, name in enumerate(("hills", "texture", "ridges")):
        if (field := getattr(terrain, name)) is not None:
            yield name, _field(field, rugged, seed * 64 + 4 * number, x, y)
    if terrain.ripples is not None:
        yield "ripples", _ripples(terrain.ripples, seed * 64 + 20, x, y)
    if terrain.outcrops is not None:
        yield "outcrops", _outcrops(terrain.outcrops, seed * 64 + 24, x, y)
    if terrain.ploughmarks is not None:
        yield "ploughmarks", _ploughmarks(terrain.ploughmarks, seed * 64 + 28, x, y)
    if terrain.wall is not None:
        yield "wall", _wall(terrain.wall, seed * 64 + 36, x, y)


def _relief(relief: Relief, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    u, v = noise.stretched(x, y, relief.stretch, np.deg2rad(relief.azimuth_deg))
    # the value that a unit field exceeds on half of the flat share, by the same logistic as in noise.share
    edge = np.log(2.0 / relief.flat - 1.0) / 1.702
    return relief.height_m * (_smooth(0.5 + noise.field(u, v, seed, relief.length_m) / (2 * edge)) - 0.5)


def _ruggedness(patch_m: float, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # smoothed twice, because most ground is either sediment or rock, and little is in between
    return _smooth(_smooth(noise.share(noise.field(x, y, seed, patch_m, 2))))


def _field(field: Field, rugged: np.ndarray, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    flattest, steepest = field.slope
    u, v = noise.stretched(x, y, field.stretch, np.deg2rad(field.azimuth_deg))
    steepness = flattest * (steepest / flattest) ** rugged
    unit = noise.field(u, v, seed, field.length_m, field.octaves)
    return np.asarray(steepness / noise.slope(field.length_m, field.octaves) * unit)


def _ripples(ripples: Ripples, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    length = ripples.wavelength_m
    _, across = noise.stretched(x, y, 1.0, np.deg2rad(ripples.azimuth_deg))
    across = across + 0.5 * length * noise.field(x, y, seed, 8 * length)  # crests bend and fork
    presence = _within(noise.field(x, y, seed + 1, ripples.patch_m, 2), ripples.cover)
    return np.asarray(0.5 * ripples.height_m * presence * np.sin(2 * np.pi / length * across))


def _outcrops(outcrops: Outcrops, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    group = noise.field(x, y, seed, outcrops.patch_m)
    rock = noise.field(x, y, seed + 1, outcrops.size_m, 3)
    # the sum of two unit fields, brought back to unit variance
    rank = noise.share((group + rock) / np.sqrt(2.0))
    return outcrops.height_m * np.maximum(rank - (1 - outcrops.cover), 0.0) / outcrops.cover


def _ploughmarks(marks: Ploughmarks, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    z = np.zeros(len(x))
    for family, turn in enumerate((0.0, 0.9)):
        u, v = noise.stretched(x, y, 6.0, np.deg2rad(marks.azimuth_deg) + turn)
        # a furrow runs where a drawn-out field is zero: a long curve that never ends abruptly
        distance = noise.field(u, v, seed + 2 * family, marks.spacing_m) / noise.slope(marks.spacing_m)
        presence = _within(noise.field(x, y, seed + 2 * family + 1, 2 * marks.spacing_m), marks.cover)
        t = (2.0 * distance / marks.width_m) ** 2
        z -= marks.depth_m * presence * (1.0 - t) * np.exp(-t / 2)
    return z


def _wall(wall: Wall, seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    _, across = noise.stretched(x, y, 1.0, np.deg2rad(wall.azimuth_deg))
    wander = 0.4 * wall.width_m * noise.field(x, y, seed, 2 * wall.width_m, 2)
    return 0.5 * wall.height_m * np.tanh(2 * (across - wall.offset_m + wander) / wall.width_m)


def _within(field: np.ndarray, cover: float) -> np.ndarray:
    """Return 1 inside patches that cover this share of the plane, 0 outside, with soft edges."""
    return _smooth((noise.share(field) - (1.0 - cover)) / 0.1 + 0.5)


def _smooth(step: np.ndarray) -> np.ndarray:
    """Return 0 below 0, 1 above 1, and a smooth step between."""
    t = np.clip(step, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))
