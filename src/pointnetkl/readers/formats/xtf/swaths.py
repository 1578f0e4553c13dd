"""The pings of an XTF file, placed by its positions, motion and offsets, as the tables of a recording."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.readers.formats.recording import IMPOSSIBLE, PING_COLUMNS, SOUNDING_COLUMNS
from pointnetkl.readers.formats.xtf import raytrace
from pointnetkl.readers.formats.xtf.packets import FileHeader, Place
from pointnetkl.readers.formats.xtf.raytrace import Arms, Fan
from pointnetkl.readers.formats.xtf.streams import Streams

_STEEPEST = np.deg2rad(89.0)  # a beam farther to the side meets no seabed
_FARTHEST_M = 12_000.0
_UNAPPLIED = "this is not applied, because the format does not say"
_UPRIGHT = 1e-4  # radians, of a mount that is as good as not tilted


@dataclass(frozen=True)
class Ping:
    """A ping, before it has a place."""

    time_s: float
    fan: Fan
    speed: float  # of sound, m/s
    depth_m: float  # of the sonar's vehicle as its own sensor has it, 0 where it has none
    channel: int


@dataclass
class _Doubts:
    """Counts of pings that stand on less than their file should say."""

    held: int = 0  # at the first or the last position
    strange: int = 0  # of sonars that the header lacks
    mounted: int = 0  # with a receiver whose mount is tilted
    mount: float = 0.0  # radians, the largest

    def take(self, pings: list[Ping], held: np.ndarray, sonars: int) -> None:
        mounts = np.abs([ping.fan.mount for ping in pings])
        self.held += int(held.sum())
        self.strange += sum(ping.channel >= sonars for ping in pings)
        self.mounted += int((mounts > _UPRIGHT).sum())
        self.mount = max(self.mount, float(mounts.max()))


class Swaths:
    """Pings and soundings that have a place, until they are handed over."""

    def __init__(self, header: FileHeader, streams: Streams) -> None:
        """Place pings by a file's header and what was recorded between them."""
        self._header, self._streams = header, streams
        self._pings: list[np.ndarray] = []
        self._soundings: list[np.ndarray] = []
        self._quality: list[np.ndarray] = []
        self._numbered = 0
        self._doubts = _Doubts()
        self.count = 0

    def add(self, batch: list[Ping]) -> int:
        """Place pings that have as many beams; return how many have no time or attitude and are left out."""
        pings = [ping for ping in batch if np.isfinite(ping.time_s)]
        if not pings:
            return len(batch)
        time = np.array([ping.time_s for ping in pings])
        sent = self._streams.motion(time)
        known = np.isfinite(sent.roll + sent.pitch + sent.heading + sent.heave)
        if known.any():
            self._place([ping for ping, level in zip(pings, known, strict=True) if level])
        return len(batch) - int(known.sum())

    def tables(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return the pings and soundings that have not been handed over yet, as a recording has them."""
        pings = np.concatenate([*self._pings, np.empty((0, len(PING_COLUMNS)))])
        columns = np.concatenate([*self._soundings, np.empty((5, 0))], 1)
        table: dict[str, np.ndarray] = dict(zip(SOUNDING_COLUMNS, columns, strict=False))
        table["ping"], table["beam"] = table["ping"].astype(np.int64), table["beam"].astype(np.int64)
        table["quality"] = np.concatenate([*self._quality, np.empty(0, np.int8)])
        self._pings, self._soundings, self._quality, self._numbered, self.count = [], [], [], 0, 0
        return pd.DataFrame(pings, columns=list(PING_COLUMNS)), pd.DataFrame(table)

    def told(self) -> list[str]:
        """Return sentences on what was missing for the pings so far, and what stands for it."""
        doubts, told = self._doubts, list[str]()
        if doubts.held:
            told.append(f"has {doubts.held} pings before its first position or after its last, which are put there")
        if doubts.strange:
            told.append(_strange(doubts.strange, len(self._header.sonars)))
        if doubts.mounted:
            told.append(
                f"has {doubts.mounted} pings whose sonar says that its receiver is mounted with a tilt of up to"
                f" {np.rad2deg(doubts.mount):.1f} degrees; only the offsets of the file's header are applied"
            )
        return told

    def _place(self, pings: list[Ping]) -> None:
        time, speed, tilt = np.array([(p.time_s, p.speed, p.fan.tilt) for p in pings]).T
        travel, angle = np.stack([p.fan.travel_s for p in pings]), np.stack([p.fan.angle for p in pings])
        quality = np.stack([p.fan.quality for p in pings])
        with np.errstate(invalid="ignore", over="ignore"):
            possible = (np.abs(angle) < _STEEPEST) & (travel >= 0.0) & (travel * speed[:, None] < 2.0 * _FARTHEST_M)
        travel, angle = np.where(possible, travel, 0.0), np.where(possible, angle, 0.0)
        sent, heard = self._streams.motion(time), self._streams.motion(time[:, None] + travel)
        arms = _arms(self._header, [p.channel for p in pings], np.array([p.depth_m for p in pings]))
        places = raytrace.soundings(travel, angle, tilt, speed, sent, heard, arms)
        possible &= np.isfinite(places[0] + places[1] + places[2])
        east, north = self._streams.place(time)
        self._doubts.take(pings, self._streams.held(time), len(self._header.sonars))
        depth = np.array([p.depth_m for p in pings])
        self._pings.append(np.stack([time, east, north, depth, sent.roll, sent.pitch, sent.heading], 1))
        self._append([np.where(possible, place, 0.0) for place in places], np.where(possible, quality, IMPOSSIBLE))

    def _append(self, places: list[np.ndarray], quality: np.ndarray) -> None:
        count, beams = quality.shape
        ping = np.repeat(np.arange(self._numbered, self._numbered + count), beams)
        beam = np.tile(np.arange(beams), count)
        self._soundings.append(np.stack([ping, beam, *(place.ravel() for place in places)]))
        self._quality.append(quality.ravel().astype(np.int8))
        self._numbered, self.count = self._numbered + count, self.count + quality.size


def vertical(header: FileHeader) -> str:
    """Return what depths are below, and which corrections they have."""
    level = "the water line" if header.reference_m else "the vessel's reference point, taken as at the water line"
    heave = "" if header.motion.stated else ", heave taken as that of the sonar because the motion sensor has no offset"
    return f"below {level}{heave}; the sound speed at the sonar along straight rays, no profile; tide not applied"


def unapplied(header: FileHeader) -> list[str]:
    """Return sentences on angles of the header that are not applied."""
    motion, off, told = header.motion, header.navigation.yaw, list[str]()
    if any((motion.roll, motion.pitch, motion.yaw)):
        angles = f"roll {motion.roll:.3g}, pitch {motion.pitch:.3g}, yaw {motion.yaw:.3g} degrees"
        told.append(f"says that its motion sensor is turned by {angles}; {_UNAPPLIED} whether the motion is corrected")
    if off:
        told.append(f"says that its headings are off by {off:.3g} degrees; {_UNAPPLIED} whether they are corrected")
    return told


def _strange(pings: int, sonars: int) -> str:
    if sonars:
        return f"has {pings} pings of sonars that its header lacks, which take the place and angles of the first"
    return "has no sonar in its header, which is taken to be level and at the vessel's reference point"


def _arms(header: FileHeader, channels: list[int], depth_m: np.ndarray) -> Arms:
    """Return the lever arms of the n sonars that sent; below a vehicle with a depth of its own only their turn."""
    sonars = [_sonar(header, channel) for channel in channels]
    place = np.array([(s.forward, s.starboard, s.down) for s in sonars])
    turn = np.deg2rad([(s.roll, s.pitch, s.yaw) for s in sonars]).T
    one, none = np.ones(len(sonars)), np.zeros(len(sonars))
    ahead, across = (np.stack(raytrace.turned(axis, *turn), 1) for axis in ((one, none, none), (none, one, none)))
    navigation, motion = header.navigation, header.motion
    to_sonar = place - (navigation.forward, navigation.starboard, navigation.down)
    if motion.stated:
        from_heave, depth = place - (motion.forward, motion.starboard, motion.down), motion.down
    else:
        # offsets of zero more often are not known than zero: on real data an arm from there makes heave out of roll
        from_heave, depth = place * (0.0, 0.0, 1.0), 0.0
    own = depth_m > 0.0
    from_heave = np.where(own[:, None], 0.0, from_heave)
    return Arms(to_sonar, from_heave, np.where(own, 0.0, depth - header.reference_m), ahead, across)


def _sonar(header: FileHeader, channel: int) -> Place:
    """Return the place of the sonar that a ping is from; of the first where the header does not have so many."""
    if not header.sonars:
        return Place()
    return header.sonars[channel if channel < len(header.sonars) else 0]
