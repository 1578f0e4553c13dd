"""Small XTF files, written packet by packet as the format's definition has them, and a survey of a known seabed."""

import datetime
import struct
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

BEGIN = datetime.datetime(2020, 5, 17, 10, tzinfo=datetime.UTC).timestamp()
EAST, NORTH, DEGREE_M = 5.0, 0.0, 111_319.49  # at the equator, per degree of longitude
SPEED, HEADING = 1480.0, 70.0
SONAR = {"forward": 4.0, "starboard": -1.5, "down": 2.0, "roll": 2.0, "pitch": -3.0, "yaw": 1.0}
MOTION = {"forward": 1.0, "starboard": 0.5, "down": -0.5}
ACROSS = np.linspace(-50.0, 40.0, 31)


def header(
    sonars: tuple[dict[str, float], ...] = (SONAR,),
    motion: dict[str, float] = MOTION,
    navigation: dict[str, float] | None = None,
    units: int = 3,
    reference_m: float = 0.25,
    latency_ms: int = 0,
) -> bytes:
    """Return a file header of 1024 bytes."""
    data = bytearray(1024)
    data[0] = 0x7B
    data[2:12] = b"TESTS\0\0\0" + b"1\0"
    struct.pack_into("<HHH", data, 164, units, 0, len(sonars))
    struct.pack_into("<f", data, 178, reference_m)
    struct.pack_into("<i", data, 204, latency_ms)
    for offset, place in ((216, navigation or {}), (232, motion)):
        struct.pack_into("<3f", data, offset, *(place.get(name, 0.0) for name in ("forward", "starboard", "down")))
    struct.pack_into("<f", data, 228, (navigation or {}).get("yaw", 0.0))
    struct.pack_into("<3f", data, 244, *(motion.get(name, 0.0) for name in ("yaw", "pitch", "roll")))
    for number, place in enumerate(sonars):
        names = ("starboard", "forward", "down", "yaw", "pitch", "roll")
        struct.pack_into("<BB", data, 256 + 128 * number, 3, number)
        struct.pack_into("<6f", data, 256 + 128 * number + 48, *(place.get(name, 0.0) for name in names))
    return bytes(data)


def packet(kind: int, body: bytes, channel: int = 0) -> bytes:
    """Return a packet of a type, filled up to a multiple of 64 bytes."""
    size = -(-(14 + len(body)) // 64) * 64
    return (struct.pack("<2sBBHHHI", b"\xce\xfa", kind, channel, 1, 0, 0, size) + body).ljust(size, b"\0")


def clock(time_s: float) -> bytes:
    """Return year, month, day, hour, minute and second."""
    day = datetime.datetime.fromtimestamp(time_s // 1, datetime.UTC)
    return struct.pack("<HBBBBB", day.year, day.month, day.day, day.hour, day.minute, day.second)


def position(time_s: float, east: float, north: float, kind: int = 107) -> bytes:
    """Return a packet of a raw position (107) or of the navigation (42), in the file's units."""
    if kind == 42:
        return packet(42, clock(time_s) + struct.pack("<3I3dB", round(time_s % 1 * 1e6), 0, 0, north, east, 0.0, 0))
    return packet(107, clock(time_s) + struct.pack("<H3d4fB", round(time_s % 1 * 1e4), north, east, 0, 0, 0, 0, 0, 0))


def attitude(time_s: float, roll: float, pitch: float, heave: float, heading: float = HEADING) -> bytes:
    """Return an attitude packet (3): degrees, metres up."""
    body = struct.pack("<4I4fIf", 0, 0, 0, 0, pitch, roll, heave, 0, 0, heading)
    return packet(3, body + clock(time_s) + struct.pack("<HB", round(time_s % 1 * 1000), 0))


def gyro(time_s: float, heading: float, kind: int = 84) -> bytes:
    """Return a heading packet (23 or 84), degrees."""
    return packet(kind, clock(time_s) + struct.pack("<3If", round(time_s % 1 * 1e6), 0, 0, heading))


def ping(kind: int, time_s: float, content: bytes, channel: int = 0, speed: float = 0.0) -> bytes:
    """Return a ping: its header of 256 bytes, then what the sonar sent."""
    data = bytearray(256 - 14)
    data[:8] = clock(time_s) + bytes([int(time_s % 1 * 100)])
    struct.pack_into("<f", data, 32 - 14, speed)
    return packet(kind, bytes(data) + content, channel)


def section(name: bytes, data: bytes) -> bytes:
    """Return a section of a BTH0 packet."""
    data = data.ljust(-(-len(data) // 4) * 4, b"\0")
    return struct.pack(">2sH", name, 4 + len(data)) + data


def bth0(
    time_s: float,
    travel_s: np.ndarray,
    angle: np.ndarray,
    flags: np.ndarray | None = None,
    speed: float = SPEED,
    even: bool = False,
    tilt: float = 0.0,
    mount: float = 0.0,
) -> bytes:
    """Return an R2Sonic packet; `flags` are the four bits of Q0, by default all beams good.

    `tilt` is that of the transmitted fan, `mount` that of the receiver, radians.
    """
    count = len(angle)
    head = struct.pack(">12s12sIII", b"2024", b"100017", int(time_s), round(time_s % 1 * 1e9), 1)
    head += struct.pack(">9fHh7fIHH", 0.1, speed, 4e5, *[0.0] * 4, tilt, 0.0, 0, 0, *[0.0] * 6, mount, 0, 0, count)
    scale = max(float(travel_s.max()), 1e-6) / 65_000
    body = section(b"H0", head) + section(b"R0", struct.pack(">f", scale) + _words(travel_s / scale))
    if even:
        body += section(b"A0", struct.pack(">8f", angle[0], angle[-1], *[0.0] * 6))
    else:
        first, step = float(np.float32(angle[0])), float(np.float32(max(np.ptp(angle), 0.1) / 65_000))
        total = np.round((angle - first) / step).clip(0)
        steps = _words(np.diff(total, prepend=0))
        body += section(b"A2", struct.pack(">8f", first, step, *[0.0] * 6) + steps)
    nibbles = np.append(np.full(count, 0b1011) if flags is None else flags, [0] * (count % 2)).astype(int)
    body += section(b"Q0", bytes((nibbles[0::2] << 4 | nibbles[1::2]).tolist()))
    return struct.pack(">4sII", b"BTH0", 12 + len(body), 0) + body


def record_7027(time_s: float, travel_s: np.ndarray, angle: np.ndarray, quality: int = 3) -> bytes:
    """Return a record of RESON's raw detections, of 26 bytes each."""
    rate = 50_000.0
    head = struct.pack("<QIHIIBIff64x", 7, 1, 0, len(angle), 26, 2, 0, rate, 0.0)
    beams = b"".join(
        struct.pack("<HffIIff", number, travel * rate, turn, 1, quality, 0.0, 0.0)
        for number, (travel, turn) in enumerate(zip(travel_s, angle, strict=True))
    )
    return _frame(time_s, 7027, head + beams)


def records_7006_7004(time_s: float, travel_s: np.ndarray, angle: np.ndarray, quality: int = 11) -> bytes:
    """Return a record of RESON's older bathymetry, and the angles of its beams."""
    count = len(angle)
    head = struct.pack("<QIHIBBf", 7, 1, 0, count, 0, 0, SPEED)
    beams = travel_s.astype("<f4").tobytes() + bytes([quality] * count) + bytes(4 * count)
    angles = np.concatenate([np.zeros(count), angle, np.zeros(2 * count)]).astype("<f4").tobytes()
    return _frame(time_s, 7006, head + beams) + struct.pack("<QI", 7, count) + angles


def beams_28(travel_s: np.ndarray, angle: np.ndarray) -> bytes:
    """Return the beams of QINSy's own multibeam packet."""
    return b"".join(
        struct.pack("<idi4d4f", number, 0.0, 0, travel, 0.0, np.rad2deg(turn), 0.0, *[0.0] * 4)
        for number, (travel, turn) in enumerate(zip(travel_s, angle, strict=True))
    )


class Ship:
    """A ship that rolls, pitches, heaves and yaws on a straight line at the equator, over a seabed that slopes."""

    def __init__(
        self, sonar: dict[str, float] = SONAR, motion: dict[str, float] | None = MOTION, begin: float = BEGIN
    ) -> None:
        """Sail from `begin` on; the sonar's offsets are from the reference point, where the positions are too."""
        self.sonar, self.motion, self.begin = sonar, motion, begin
        self.offset = np.array([sonar["forward"], sonar["starboard"], sonar["down"]])

    def attitude(self, time_s: float) -> tuple[float, float, float, float]:
        """Return roll, pitch, heave and heading: degrees, metres."""
        t = time_s - self.begin
        return 6 * np.sin(2 * t), 3 * np.cos(1.7 * t), 0.4 * np.sin(1.3 * t), HEADING + 2 * np.sin(0.5 * t)

    def turn(self, time_s: float) -> Rotation:
        """Return how the vessel is turned: its axes into north, east, down."""
        roll, pitch, _, heading = self.attitude(time_s)
        return Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)

    def place(self, time_s: float) -> np.ndarray:
        """Return the reference point on the map: metres north and east."""
        ahead = np.deg2rad(HEADING)
        return 2.0 * (time_s - self.begin) * np.array([np.cos(ahead), np.sin(ahead)])

    def depth(self, time_s: float, reference_m: float = 0.25) -> float:
        """Return the depth of the sonar below the water line."""
        of_heave = np.array([self.motion[name] for name in ("forward", "starboard", "down")]) if self.motion else None
        _, _, heave, _ = self.attitude(time_s)
        if of_heave is None:
            return float(self.turn(time_s).apply([0, 0, self.offset[2]])[2] - heave - reference_m)
        return float(of_heave[2] - heave + self.turn(time_s).apply(self.offset - of_heave)[2] - reference_m)

    def echoes(self, time_s: float, across: np.ndarray = ACROSS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return travel times, angles and the seabed's places (north, east, down) of a ping's beams."""
        mounted = Rotation.from_euler("ZYX", [self.sonar[name] for name in ("yaw", "pitch", "roll")], degrees=True)
        turn = self.turn(time_s)
        ahead = (turn * mounted).apply([1.0, 0.0, 0.0])
        side = np.array([-np.sin(np.deg2rad(HEADING)), np.cos(np.deg2rad(HEADING))])
        forward = np.array([side[1], -side[0]])
        sonar_place = np.append(self.place(time_s) + turn.apply(self.offset)[:2], self.depth(time_s))
        travel, angle, places = [], [], []
        for y in across:
            x = 0.0
            for _ in range(30):  # until the seabed's place lies in the fan
                spot = self._seabed(sonar_place[:2] + y * side + x * forward)
                x -= float((spot - sonar_place) @ ahead) / float(forward @ ahead[:2])
            spot = self._seabed(sonar_place[:2] + y * side + x * forward)
            time = 2.0 * float(np.linalg.norm(spot - sonar_place)) / SPEED
            back = spot - np.append(sonar_place[:2], self.depth(time_s + time))
            travel.append(float(np.linalg.norm(spot - sonar_place) + np.linalg.norm(back)) / SPEED)
            heard = (self.turn(time_s + travel[-1]) * mounted).apply([0.0, 1.0, 0.0])
            angle.append(np.arcsin(back @ heard / np.linalg.norm(back)))
            places.append(spot)
        return np.array(travel), np.array(angle), np.array(places)

    def _seabed(self, spot: np.ndarray) -> np.ndarray:
        return np.array([*spot, 40.0 + 0.05 * spot[0] - 0.1 * spot[1]])


Content = Callable[[float, np.ndarray, np.ndarray], bytes]


def survey(
    ship: Ship, kind: int = 65, content: Content = bth0, pings: int = 12, first: float = 1.0, **head: object
) -> bytes:
    """Return a file of a ship's pings, two a second, and its motion at 50 Hz."""
    speed = 0.0 if kind == 65 else SPEED
    parts = [
        (time, attitude(time, *ship.attitude(time)))
        for time in ship.begin + np.arange(0, first + pings / 2 + 0.5, 0.02)
    ]
    for time in ship.begin + np.arange(0, first + pings / 2 + 0.5, 0.25):
        north, east = ship.place(time) / DEGREE_M
        parts.append((time, position(time, EAST + east, NORTH + north * DEGREE_M / 110_574.3)))
    for time in ship.begin + first + np.arange(pings) / 2:
        travel, angle, _ = ship.echoes(time)
        parts.append((time, ping(kind, time, content(time, travel, angle), speed=speed)))
    parts.sort(key=lambda part: part[0])
    return header(motion=ship.motion or {}, **head) + b"".join(part for _, part in parts)


def _frame(time_s: float, kind: int, data: bytes) -> bytes:
    moment = datetime.datetime.fromtimestamp(time_s // 1, datetime.UTC)
    day, seconds = moment.timetuple().tm_yday, moment.second + time_s % 1
    frame = struct.pack("<HHIIII", 5, 60, 0xFFFF, 64 + len(data) + 4, 0, 0)
    frame += struct.pack("<HHfBB", moment.year, day, seconds, moment.hour, moment.minute)
    return (frame + struct.pack("<HII", 1, kind, 7125)).ljust(64, b"\0") + data + bytes(4)


def _words(values: np.ndarray) -> bytes:
    return np.round(values).astype(">u2").tobytes()
