"""Stages ingest and segment, and command `correct`, on gigabytes: seconds, and the largest process's memory.

The survey is generated: Kongsberg .all files of a lawnmower over rolling ground, 400 beams a ping, half of each file
datagrams that are passed over, as in real ones. Its positions wander by up to four metres from the truth.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
BEGIN_S = 1_600_000_000
BEAMS, PING_S, SPEED_M_S, SPACING_M, LINE_M = 400, 0.2, 4.0, 60.0, 6000.0
WANDER_M = 4.0
_METRES_PER_DEGREE = 111_320.0

_HEAD = [("length", "<u4"), ("stx", "u1"), ("kind", "S1"), ("model", "<u2"), ("date", "<u4"), ("ms", "<u4")]
_HEAD += [("count", "<u2"), ("serial", "<u2")]
_TAIL = [("etx", "u1"), ("checksum", "<u2")]
_BEAM = [("down", "<f4"), ("across", "<f4"), ("along", "<f4"), ("window", "<u2"), ("quality", "u1"), ("angle", "i1")]
_BEAM += [("detection", "u1"), ("cleaning", "i1"), ("strength", "<i2")]
_PLACE = [("latitude", "<i4"), ("longitude", "<i4"), ("quality", "<u2"), ("speed", "<u2"), ("course", "<u2")]
_PLACE += [("heading", "<u2"), ("descriptor", "u1"), ("size", "u1")]
POSITION = np.dtype([*_HEAD, *_PLACE, *_TAIL])
_XYZ = [("heading", "<u2"), ("sound_speed", "<u2"), ("transducer", "<f4"), ("beams", "<u2"), ("valid", "<u2")]
_XYZ += [("rate", "<f4"), ("scanning", "u1"), ("spare", "u1", 3)]
SWATH = np.dtype([*_HEAD, *_XYZ, ("beam", _BEAM, BEAMS), ("end", "u1"), *_TAIL])
PASSED = np.dtype([*_HEAD, ("content", "u1", SWATH.itemsize), *_TAIL])
PING = np.dtype([("position", POSITION), ("swath", SWATH), ("passed", PASSED)])


def write(path: Path, first: int, pings: int) -> None:
    """Write one file: `pings` of the survey from its `first` on."""
    with path.open("wb") as file:
        for begin in range(first, first + pings, 500):
            _pings(np.arange(begin, min(begin + 500, first + pings))).tofile(file)


def _pings(number: np.ndarray) -> np.ndarray:
    table = np.zeros(len(number), PING)
    along, line = (SPEED_M_S * PING_S * number) % LINE_M, (SPEED_M_S * PING_S * number) // LINE_M
    back = line % 2 == 1
    x, y = np.where(back, LINE_M - along, along), SPACING_M * line
    heading = np.where(back, 27_000, 9_000)
    across = np.linspace(-60, 60, BEAMS)
    seabed = y[:, None] + np.where(back, 1, -1)[:, None] * across
    down = 40 + 2 * np.sin(x[:, None] / 31) * np.cos(seabed / 23) + 0.7 * np.sin((x[:, None] + 2 * seabed) / 9.7)
    down += np.random.default_rng(int(number[0])).normal(0, 0.03, down.shape)
    beam = table["swath"]["beam"]
    beam["down"], beam["across"], beam["quality"] = down, across, 9
    for name, value in (("heading", heading), ("transducer", 2.0), ("beams", BEAMS), ("valid", BEAMS)):
        table["swath"][name] = value
    east, north = (x + WANDER_M * np.sin(number / 9_000), y + WANDER_M * (np.cos(number / 7_000) - 1) / 2)
    table["position"]["latitude"] = np.rint((50 + north / _METRES_PER_DEGREE) * 2e7)
    table["position"]["longitude"] = np.rint(east / (_METRES_PER_DEGREE * np.cos(np.deg2rad(50))) * 1e7)
    table["position"]["heading"], table["position"]["descriptor"] = heading, 0x81
    for name, kind in (("position", b"P"), ("swath", b"X"), ("passed", b"N")):
        _frame(table[name], kind, number)
    return table


def _frame(table: np.ndarray, kind: bytes, number: np.ndarray) -> None:
    """Fill in the head and the tail of datagrams, with their checksums."""
    time_s = BEGIN_S + PING_S * number
    day = (time_s // 86_400).astype("datetime64[D]")
    year, month = day.astype("datetime64[Y]").astype(int) + 1970, day.astype("datetime64[M]").astype(int) % 12 + 1
    table["length"], table["stx"], table["kind"] = table.dtype.itemsize - 4, 2, kind
    table["model"], table["serial"], table["etx"] = 2040, 7, 3
    table["date"] = year * 10_000 + month * 100 + (day - day.astype("datetime64[M]")).astype(int) + 1
    table["ms"] = np.rint(time_s % 86_400 * 1000)
    table["count"] = number % 65_536
    inner = np.ascontiguousarray(table).view(np.uint8).reshape(len(table), -1)[:, 5:-3]
    table["checksum"] = inner.sum(axis=1, dtype=np.uint32) & 0xFFFF


def run(*words: object) -> tuple[float, int]:
    """Run Python with a command line; return seconds, and the bytes of the largest process so far."""
    began = time.monotonic()
    subprocess.run([sys.executable, *map(str, words)], check=True, cwd=ROOT)
    return time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024


def main() -> None:
    """Generate the survey, run the two stages and the command, print what they took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=2.0, help="of raw data in all")
    parser.add_argument("--files", type=int, default=4)
    parser.add_argument("--length", type=float, help="of submaps for `correct`, metres; by default chosen by it")
    parser.add_argument("--folder", type=Path, help="where to work; it takes three times the raw data")
    arguments = parser.parse_args()
    pings = int(arguments.gigabytes * 1e9 / PING.itemsize / arguments.files)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        (folder / "raw").mkdir()
        for number in range(arguments.files):
            write(folder / f"raw/line_{number}.all", number * pings, pings)
        size = sum(file.stat().st_size for file in (folder / "raw").iterdir())
        params = folder / "params.yaml"
        line = (
            "    big: {group: test, raw: raw, truth: data/none,"
            " submap_length_m: 120, point_spacing_m: 1.5, label_runs: 200}\n"
        )
        text = (ROOT / "params.yaml").read_text()
        params.write_text(text.replace("  test: &test\n", f"  test: &test\n{line}"))
        (folder / "none").write_text("none\n")
        given = ("--params", params)
        ingest = run(
            "pipeline/ingest.py", "big", *given, "--raw", folder / "raw", "--truth", folder / "none", "--out", folder
        )
        words = ("--survey", folder, "--submaps", folder / "submaps.parquet", "--poses", folder / "poses.parquet")
        segment = run("pipeline/segment.py", "big", *given, *words)
        for table in ("pings", "soundings", "submaps", "poses"):
            (folder / f"{table}.parquet").unlink()
        length = ("--length", arguments.length) if arguments.length else ()
        correct = run("-m", "pointnetkl", "correct", folder / "raw", "--out", folder / "corrected", *length)
        verdict = yaml.safe_load((folder / "corrected/parameters.yaml").read_text())["verdict"]
    told = {"bytes": size, "soundings": pings * arguments.files * BEAMS} | _told(size, ingest, segment, correct)
    print(json.dumps(told | {"verdict": verdict["sentence"]}))


def _told(
    size: int, ingest: tuple[float, int], segment: tuple[float, int], correct: tuple[float, int]
) -> dict[str, float]:
    return {
        "ingest_s": round(ingest[0], 1),
        "ingest_mb_s": round(size / ingest[0] / 1e6, 1),
        "ingest_peak_mib": ingest[1] >> 20,
        "segment_s": round(segment[0], 1),
        "segment_peak_mib": segment[1] >> 20,  # of both stages
        "correct_s": round(correct[0], 1),
        "peak_mib": correct[1] >> 20,  # of all
    }


if __name__ == "__main__":
    main()
