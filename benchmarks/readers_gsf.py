"""How fast a GSF file is read, against the format's own C library (gsfpy) and a reader in Python (gsfu).

A real file is repeated, with later times, until it has the size asked for. Every reader is a process of its own, reads
the file once to have it in the page cache, and then some more times, in seconds of the processor; depth, across and
along track and flags of all beams are taken out, and their sums compared.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from reader_race import Beams, Race

SOURCE = Path(__file__).parents[2] / "shared/realdata/gsf/em302_st_croix.gsf"
PING, ATTITUDE = 2, 12


def generate(source: Path, target: Path, size: float) -> None:
    """Write the records of a file, those with times again and again until there are so many bytes."""
    content, timed, at = source.read_bytes(), [], 0
    with target.open("wb") as file:
        while at < len(content):
            length, word = struct.unpack_from(">II", content, at)
            end = at + 8 + length + 4 * (word >> 31)
            if word in (PING, ATTITUDE):  # without a checksum, which a later time would break
                timed.append((struct.unpack_from(">I", content, at + 8)[0], at, end))
            else:
                file.write(content[at:end])
            at = end
        span, later = max(timed)[0] - min(timed)[0] + 1, 0
        while file.tell() < size:
            for seconds, at, end in timed:
                file.write(content[at : at + 8] + struct.pack(">I", seconds + later) + content[at + 12 : end])
            later += span


def ours(path: Path) -> Iterator[Beams]:
    """Yield the beams of each part that our reader gives."""
    from pointnetkl.readers.formats import gsf, recording

    for part in gsf.read(path):
        table = part.soundings
        depth = table["down_m"].to_numpy() + part.pings["depth_m"].to_numpy()[table["ping"].to_numpy()]
        refused = table["quality"].to_numpy() == recording.REJECTED
        yield depth, table["across_m"].to_numpy(), table["along_m"].to_numpy(), refused


def gsfpy(path: Path) -> Iterator[Beams]:
    """Yield the beams of each ping that the C library gives; it ends in an exception."""
    import gsfpy3_09 as library

    with library.open_gsf(path) as file:
        while True:
            try:
                ping = file.read(library.enums.RecordType.GSF_RECORD_SWATH_BATHYMETRY_PING)[1].mb_ping
            except library.GsfException:
                return
            arrays = (ping.depth, ping.across_track, ping.along_track, ping.beam_flags)
            depth, across, along, flags = (
                np.ctypeslib.as_array(array, (ping.number_beams,)).copy() for array in arrays
            )
            yield depth, across, along, (flags & 1) != 0


def gsfu(path: Path) -> Iterator[Beams]:
    """Yield the beams of each ping that gsfu gives."""
    import GSFU

    file = GSFU.gsf(str(path))
    for _, _, ping in file.iter_records(PING):
        beams = ping["Beams"]
        yield beams["Depth_m"], beams["AcrossTrack_m"], beams["AlongTrack_m"], (beams["BeamFlags"] & 1) != 0
    file.closeFile()


RACE = Race(
    __file__,
    __doc__ or "",
    SOURCE,
    generate,
    {"ours": ours, "gsfpy": gsfpy, "gsfu": gsfu},
    ("depth", "across", "along", "refused"),
    ("depth", "refused"),
)

if __name__ == "__main__":
    RACE.main()
