"""The pings of an XTF file, placed by its positions, motion and offsets, become the tables of a recording."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pointnetkl.readers.formats.recording import IMPOSSIBLE, PING_COLUMNS, SOUNDING_COLUMNS
from pointnetkl.readers.formats.xtf import raytrace
from pointnetkl.readers.formats.xtf.packets import FileHeader, Mounting
from pointnetkl.readers.formats.xtf.raytrace import Arms, Fan
from pointnetkl.readers.formats.xtf.streams import Streams

_STEEPEST = np.deg2rad(89.0)  # a beam farther to the side meets no seabed
_FARTHEST_M = 12_000.0
_UNAPPLIED = "this is not applied, because the format does not say"
_UPRIGHT = 1e-4  # radians, the tilt of a mount that counts as none


@dataclass(frozen=True)
class RangePing:
    """A ping's ranges and angles, before it has a place."""

    time_s: float
    fan: Fan
    speed: float  # of sound, m/s
    depth_m: float  # of the sonar's vehicle by its own sensor, 0 without one
    channel: int


@dataclass
class _Doubts:
    """Counts of pings for which the file lacks something."""

    extrapolated: int = 0  # placed at the first or the last position
    undeclared: int = 0  # of sonars that the header lacks
    mounted: int = 0  # with a receiver whose mount is tilted
    mount: float = 0.0  # radians, the largest

    def count_pings(self, pings: list[RangePing], extrapolated: np.ndarray, sonars: int) -> None:
        mounts = np.abs([ping.fan.mount for ping in pings])
        self.extrapolated += int(extrapolated.sum())
        self.undeclared += sum(ping.channel >= sonars for ping in pings)
        self.mounted += int((mounts > _UPRIGHT).sum())
        self.mount = max(self.mount, float(mounts.max()))


class Swaths:
    """Pings and soundings with a place, for the next part of a file."""

    def __init__(self, header: FileHeader, streams: Streams) -> None:
        """Place pings by a file's header, positions and motion."""
        self._header, self._streams = header, streams
        self._pings: list[np.ndarray] = []
        self._soundings: list[np.ndarray] = []
        self._quality: list[np.ndarray] = []
        self._numbered = 0
        self._doubts = _Doubts()
        self.count = 0

    def add(self, batch: list[RangePing]) -> int:
        """Place pings with equal numbers of beams; return how many are left out for lack of time or attitude."""
        pings = [ping for ping in batch if np.isfinite(ping.time_s)]
        if not pings:
            return len(batch)
        time = np.array([ping.time_s for ping in pings])
        sent = self._streams.motion(time)
        placeable = np.isfinite(sent.roll + sent.pitch + sent.heading + sent.heave)
        if placeable.any():
            self._place([ping for ping, level in zip(pings, placeable, strict=True) if level])
        return len(batch) - int(placeable.sum())

    def tables(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return the pings and soundings since the last call, in the columns of a recording."""
        pings = np.concatenate([*self._pings, np.empty((0, len(PING_COLUMNS)))])
        columns = np.concatenate([*self._soundings, np.empty((5, 0))], 1)
        table: dict[str, np.ndarray] = dict(zip(SOUNDING_COLUMNS, columns, strict=False))
        table["ping"], table["beam"] = table["ping"].astype(np.int64), table["beam"].astype(np.int64)
        table["quality"] = np.concatenate([*self._quality, np.empty(0, np.int8)])
        self._pings, self._soundings, self._quality, self._numbered, self.count = [], [], [], 0, 0
        return pd.DataFrame(pings, columns=list(PING_COLUMNS)), pd.DataFrame(table)

    def notes(self) -> list[str]:
        """Return sentences on what the file lacks for the pings so far, and on what replaces it."""
        doubts, sentences = self._doubts, list[str]()
        if doubts.extrapolated:
            sentences.append(
                f"has {doubts.extrapolated} pings before its first position or after its last, which are put there"
            )
        if doubts.undeclared:
            sentences.append(_undeclared(doubts.undeclared, len(self._header.sonars)))
        if doubts.mounted:
            sentences.append(
                f"has {doubts.mounted} pings whose sonar says that its receiver is mounted with a tilt of up to"
                f" {np.rad2deg(doubts.mount):.1f} degrees; only the offsets of the file's header are applied"
            )
        return sentences

    def _place(self, pings: list[RangePing]) -> None:
        time, speed, tilt = np.array([(ping.time_s, ping.speed, ping.fan.tilt) for ping in pings]).T
        travel, angle = np.stack([ping.fan.travel_s for ping in pings]), np.stack([ping.fan.angle for ping in pings])
        quality = np.stack([ping.fan.quality for ping in pings])
        with np.errstate(invalid="ignore", over="ignore"):
            possible = (np.abs(angle) < _STEEPEST) & (travel >= 0.0) & (travel * speed[:, None] < 2.0 * _FARTHEST_M)
        travel, angle = np.where(possible, travel, 0.0), np.where(possible, angle, 0.0)
        sent, heard = self._streams.motion(time), self._streams.motion(time[:, None] + travel)
        arms = _arms(self._header, [ping.channel for ping in pings], np.array([ping.depth_m for ping in pings]))
        places = raytrace.soundings(travel, angle, tilt, speed, sent, heard, arms)
        possible &= np.isfinite(places[0] + places[1] + places[2])
        east, north = self._streams.place(time)
        self._doubts.count_pings(pings, self._streams.is_extrapolated(time), len(self._header.sonars))
        depth = np.array([ping.depth_m for ping in pings])
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
    """Return the level that depths are below, and the corrections that they have."""
    level = "the water line" if header.reference_m else "the vessel's reference point, taken as at the water line"
    heave = "" if header.motion.stated else ", heave taken as that of the sonar because the motion sensor has no offset"
    return f"below {level}{heave}; the sound speed at the sonar along straight rays, no profile; tide not applied"


def unapplied(header: FileHeader) -> list[str]:
    """Return sentences on angles of the header that are not applied."""
    motion, yaw, sentences = header.motion, header.navigation.yaw, list[str]()
    if any((motion.roll, motion.pitch, motion.yaw)):
        angles = f"roll {motion.roll:.3g}, pitch {motion.pitch:.3g}, yaw {motion.yaw:.3g} degrees"
        sentences.append(
            f"says that its motion sensor is turned by {angles}; {_UNAPPLIED} whether the motion is corrected"
        )
    if yaw:
        sentences.append(
            f"says that its headings are off by {yaw:.3g} degrees; {_UNAPPLIED} whether they are corrected"
        )
    return sentences


def _undeclared(pings: int, sonars: int) -> str:
    if sonars:
        return f"has {pings} pings of sonars that its header lacks, which take the place and angles of the first"
    return "has no sonar in its header, which is taken to be level and at the vessel's reference point"


def _arms(header: FileHeader, channels: list[int], depth_m: np.ndarray) -> Arms:
    """Return the lever arms of n pings' sonars; of a vehicle with a depth of its own only the sonar's rotation."""
    sonars = [_sonar(header, channel) for channel in channels]
    place = np.array([(sonar.forward, sonar.starboard, sonar.down) for sonar in sonars])
    turn = np.deg2rad([(sonar.roll, sonar.pitch, sonar.yaw) for sonar in sonars]).T
    ones, zeros = np.ones(len(sonars)), np.zeros(len(sonars))
    ahead, across = (
        np.stack(raytrace.levelled(axis, *turn), 1) for axis in ((ones, zeros, zeros), (zeros, ones, zeros))
    )
    navigation, motion = header.navigation, header.motion
    to_sonar = place - (navigation.forward, navigation.starboard, navigation.down)
    if motion.stated:
        from_heave, depth = place - (motion.forward, motion.starboard, motion.down), motion.down
    else:
        # offsets of zero are unknown more often than true: on real data an arm from there turns roll into heave
        from_heave, depth = place * (0.0, 0.0, 1.0), 0.0
    submerged = depth_m > 0.0
    from_heave = np.where(submerged[:, None], 0.0, from_heave)
    return Arms(to_sonar, from_heave, np.where(submerged, 0.0, depth - header.reference_m), ahead, across)


def _sonar(header: FileHeader, channel: int) -> Mounting:
    """Return the mounting of a ping's sonar; that of the first sonar where the header does not have so many."""
    if not header.sonars:
        return Mounting()
    return header.sonars[channel if channel < len(header.sonars) else 0]
