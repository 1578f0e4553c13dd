"""How fast a Kongsberg .all file is read, against themachinethatgoesping (C++, on PyPI).

A real file is repeated, with later times and the checksums that these make, until it has the size asked for. Every
reader is a process of its own, reads the file once to have it in the page cache, and then some more times; depth below
the transducer, across and along track of all beams are taken out, and their sums compared. Ours also checks every
checksum and places the pings, theirs also makes an index of the file.
"""

import datetime
import itertools
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from reader_race import Beams, Race

SOURCE = Path(__file__).parents[2] / "shared/realdata/all/em2040c_warrnambool.all"
DAY_MS, PAUSE_MS = 86_400_000, 50


def generate(source: Path, target: Path, size: float) -> None:
    """Write the datagrams of a file again and again, later and counted on, until there are so many bytes."""
    content, places, at = bytearray(source.read_bytes()), [], 0
    while at < len(content):
        length, date, clock, count = struct.unpack_from("<I4xIIH", content, at)
        end = at + 4 + length
        day = datetime.date(date // 10_000, date // 100 % 100, date % 100).toordinal()
        rest = sum(content[at + 5 : end - 3]) - sum(content[at + 8 : at + 18])
        places.append((at, end, day * DAY_MS + clock, count, rest))
        at = end
    times, counts = zip(*[(time_ms, count) for _, _, time_ms, count, _ in places], strict=True)
    span_ms, span = max(times) - min(times) + PAUSE_MS, max(counts) + 1
    with target.open("wb") as file:
        for copy in itertools.count():
            for begin, end, time_ms, count, rest in places:
                days, clock = divmod(time_ms + copy * span_ms, DAY_MS)
                day = datetime.date.fromordinal(days)
                date = day.year * 10_000 + day.month * 100 + day.day
                stamp = struct.pack("<IIH", date, clock, (count + copy * span) % (1 << 16))
                content[begin + 8 : begin + 18] = stamp
                struct.pack_into("<H", content, end - 2, (rest + sum(stamp)) & 0xFFFF)
            file.write(content)
            if file.tell() >= size:
                return


def ours(path: Path) -> Iterator[Beams]:
    """Yield the beams of each part that our reader gives."""
    from pointnetkl.readers.formats import kongsberg_all

    for part in kongsberg_all.read(path):
        down, across, along = (part.soundings[name].to_numpy() for name in ("down_m", "across_m", "along_m"))
        yield down, across, along


def themachinethatgoesping(path: Path) -> Iterator[Beams]:
    """Yield the beams of each ping that themachinethatgoesping gives; those of a ping without any are left out."""
    from themachinethatgoesping.echosounders import kongsbergall

    for ping in kongsbergall.KongsbergAllFileHandler([str(path)], show_progress=False).get_pings():
        if ping.has_bottom() and ping.bottom.has_xyz():
            place = ping.bottom.get_xyz()
            yield tuple(np.asarray(axis, np.float64) for axis in (place.z, place.y, place.x))


RACE = Race(
    __file__,
    __doc__ or "",
    SOURCE,
    generate,
    {"ours": ours, "themachinethatgoesping": themachinethatgoesping},
    ("depth", "across", "along"),
    ("depth",),
)

if __name__ == "__main__":
    RACE.main()
