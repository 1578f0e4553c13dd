"""Kongsberg .all: the sonar's own numbers, placed by the active system; damage costs only the damaged records."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import all_files
from all_files import ACROSS, BEGIN, attitude, datagram, depths, position, starts, xyz88
from pointnetkl.readers import projection
from pointnetkl.readers.formats import kongsberg_all
from pointnetkl.readers.formats.kongsberg_all import KongsbergError
from pointnetkl.readers.formats.recording import IMPOSSIBLE, PART, REJECTED, Recording
from realdata import REALDATA

ALL = REALDATA / "all"
real = pytest.mark.skipif(not ALL.exists(), reason="no real data here")
SEABED = 45.0 - ACROSS / 8
COUNTS = {  # pings, soundings, valid
    "em2040c_warrnambool": (183, 73_200, 67_964),
    "em2040_belgica": (9, 2304, 2304),
    "em2040_north_sea": (11, 4400, 3670),
    "em710_barents_sea": (9, 3600, 3600),
    "em710_svalbard": (10, 1280, 1267),
}


def read(path: Path, *content: bytes) -> Recording:
    """Return the one part of a small file; written first, if its content is given."""
    if content:
        path.write_bytes(b"".join(content))
    (part,) = kongsberg_all.read(path)
    return part


def good(recording: Recording) -> pd.DataFrame:
    return recording.soundings[recording.soundings["quality"] == 0]


def depth(recording: Recording) -> np.ndarray:
    """Return the depths of the good soundings below the water line, metres."""
    soundings = good(recording)
    return np.asarray(soundings["down_m"] + recording.pings["depth_m"].to_numpy()[soundings["ping"]])


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_written_ping_is_read_where_it_was_in_either_byte_order(tmp_path: Path, order: str):
    recording = read(tmp_path / "small.all", all_files.survey(12, order))
    assert kongsberg_all.begins(all_files.survey(1, order))
    pings, soundings = recording.pings, recording.soundings
    assert (len(pings), len(good(recording))) == (12, 12 * 21)
    np.testing.assert_allclose(pings["time_s"], BEGIN + np.arange(12))
    np.testing.assert_allclose(pings["east"], 5.0 + 1e-5 * np.arange(12), atol=1e-7)
    np.testing.assert_allclose(pings[["north", "depth_m", "heading_rad"]], [[10.0, 1.5, np.pi / 2]] * 12)
    np.testing.assert_allclose(pings[["roll_rad", "pitch_rad"]], np.deg2rad([[1.0, -1.0]] * 12))
    first = soundings[soundings["ping"] == 0]
    np.testing.assert_allclose(first["across_m"], ACROSS)
    np.testing.assert_allclose(first["down_m"], SEABED)
    assert first["along_m"].eq(2.0).all()
    assert list(first["beam"]) == list(range(21))
    assert (recording.skipped, recording.problems) == ({}, [])
    assert recording.sensor == "Kongsberg EM2040, serial 7"
    assert recording.crs == projection.GEOGRAPHIC


def test_depth_is_that_below_the_transducer_and_the_transducers_own_at_the_ping(tmp_path: Path):
    pings = [xyz88(BEGIN, SEABED, transducer=3.0), xyz88(BEGIN + 1, SEABED + 1, transducer=2.0)]
    recording = read(tmp_path / "heave.all", position(BEGIN, 5, 10), position(BEGIN + 1, 5, 10), *pings)
    np.testing.assert_allclose(depth(recording), np.tile(SEABED + 3.0, 2), rtol=1e-6)
    assert recording.vertical.startswith("below the water line")


def test_beams_without_detection_are_impossible_and_those_flagged_by_the_sonar_rejected(tmp_path: Path):
    down = np.array([40.0, 40, 40, 40, np.nan, 13_000])
    ping = xyz88(BEGIN, down, np.zeros(6), detection=[0, 0x81, 0x84, 2, 0, 0], cleaning=[0, 0, 0, -128, 0, 0])
    quality = read(tmp_path / "flags.all", position(BEGIN, 5, 10), ping).soundings["quality"]
    assert list(quality) == [0, REJECTED, IMPOSSIBLE, REJECTED, IMPOSSIBLE, IMPOSSIBLE]


def test_the_place_of_a_ping_is_between_the_positions_of_the_active_system(tmp_path: Path):
    active = [position(BEGIN + t, 5 + 1e-4 * t, 10, 0xC1) for t in (0.0, 1.0, 2.0)]
    other = [position(BEGIN + t, 5.01, 10.01, 0x02) for t in (0.2, 0.4, 0.6, 1.2)]
    recording = read(tmp_path / "two.all", *other, *active, xyz88(BEGIN + 0.5, SEABED), xyz88(BEGIN + 1.75, SEABED))
    np.testing.assert_allclose(recording.pings["east"], [5 + 5e-5, 5 + 1.75e-4], atol=1e-8)
    assert recording.pings["north"].eq(10).all()


def test_where_no_system_is_marked_active_one_alone_makes_the_track(tmp_path: Path):
    first = [position(BEGIN + t, 5, 10, 0x01) for t in (0, 1, 2)]
    second = [position(BEGIN + t, 6, 11, 0x02) for t in (0, 1)]
    recording = read(tmp_path / "none.all", *first, *second, xyz88(BEGIN + 0.5, SEABED))
    assert recording.pings[["east", "north"]].to_numpy().tolist() == [[5, 10]]


def test_a_position_off_the_earth_places_no_ping(tmp_path: Path):
    bad = struct.pack("<iiHHHHBB", 0x7FFFFFFF, 0x7FFFFFFF, 0, 0, 0, 0, 0x81, 0)
    nowhere = datagram("P", bad, BEGIN)
    recording = read(tmp_path / "bad.all", nowhere, position(BEGIN + 1, 5, 10), xyz88(BEGIN + 0.1, SEABED))
    assert recording.pings["east"].eq(5).all()
    assert "1 pings before the first position or after the last, by up to 0.9 s" in recording.problems[0]
    assert read(tmp_path / "bad.all", nowhere, xyz88(BEGIN, SEABED)).pings["east"].isna().all()


def test_a_track_over_the_date_line_does_not_go_round_the_world(tmp_path: Path):
    track = [position(BEGIN, 179.9999, 10), position(BEGIN + 1, -179.9999, 10)]
    recording = read(tmp_path / "line.all", *track, xyz88(BEGIN + 0.75, SEABED))
    assert recording.pings["east"].item() == pytest.approx(-179.99995, abs=1e-7)


def test_time_goes_on_across_midnight(tmp_path: Path):
    midnight = BEGIN + 14 * 3600
    content = all_files.survey(4, begin=midnight - 2)
    assert {int(day) for day in struct.unpack("<II", content[8:12] + content[-40:-36])} >= {20200517}
    recording = read(tmp_path / "midnight.all", content)
    np.testing.assert_allclose(recording.pings["time_s"], midnight - 2 + np.arange(4))
    assert recording.pings["roll_rad"].notna().all()


def test_roll_and_pitch_are_those_of_the_sensor_in_use(tmp_path: Path):
    used = attitude(BEGIN, [0, 1, 2, 3], [4, 3, 2, 1], descriptor=0x01)
    unused = attitude(BEGIN, [30, 30, 30, 30], [30, 30, 30, 30], descriptor=0x1E)
    recording = read(tmp_path / "roll.all", position(BEGIN, 5, 10), unused, used, xyz88(BEGIN + 0.15, SEABED))
    np.testing.assert_allclose(recording.pings[["roll_rad", "pitch_rad"]], np.deg2rad([[1.5, 2.5]]), rtol=1e-5)


def test_heads_of_a_dual_sonar_are_pings_of_one_time(tmp_path: Path):
    heads = [xyz88(BEGIN, SEABED, serial=serial, model=2045) for serial in (101, 102)]
    recording = read(tmp_path / "dual.all", position(BEGIN, 5, 10), *heads)
    assert recording.pings["time_s"].tolist() == [BEGIN, BEGIN]
    assert recording.sensor == "Kongsberg EM2040C, serials 101 and 102"


@pytest.mark.parametrize("order", ["<", ">"])
def test_older_depth_datagrams_have_steps_and_an_offset_of_the_transducer(tmp_path: Path, order: str):
    where = position(BEGIN, 5, 10, order=order)
    shallow = read(tmp_path / "em3000.all", where, depths(BEGIN, SEABED, order=order))
    np.testing.assert_allclose(depth(shallow), SEABED + 1.5, atol=0.006)
    np.testing.assert_allclose(shallow.soundings["across_m"], ACROSS, atol=0.011)
    np.testing.assert_allclose(shallow.soundings["along_m"], 2.0, atol=0.011)
    submersible = read(tmp_path / "hugin.all", where, depths(BEGIN, SEABED, turns=1, order=order))
    np.testing.assert_allclose(depth(submersible), SEABED + 1.5 + 655.36, atol=0.006)
    lifted = read(tmp_path / "waves.all", where, depths(BEGIN, SEABED, transducer_cm=65526, turns=-1, order=order))
    np.testing.assert_allclose(depth(lifted), SEABED - 0.1, atol=0.006)


def test_depths_without_a_sign_reach_twice_as_deep(tmp_path: Path):
    deep = np.full(21, 4000.0)
    settings = {"steps_cm": (10, 10), "across": np.zeros(21)}
    for model, sign in ((120, 1), (300, 1), (1002, -1)):
        ping = depths(BEGIN, deep, model=model, **settings)
        down = read(tmp_path / "deep.all", position(BEGIN, 5, 10), ping).soundings["down_m"]
        np.testing.assert_allclose(down, 4000.0 if sign > 0 else 4000.0 - 6553.6)


def test_a_ping_that_is_logged_both_ways_counts_once(tmp_path: Path):
    recording = read(tmp_path / "both.all", position(BEGIN, 5, 10), depths(BEGIN, SEABED), xyz88(BEGIN, SEABED + 1))
    assert len(recording.pings) == 1
    np.testing.assert_allclose(recording.soundings["down_m"], SEABED + 1)


def test_unknown_datagrams_and_longer_revisions_are_passed_over_by_their_length(tmp_path: Path):
    unknown = datagram("~", b"\x02X" * 500, BEGIN)
    extra = datagram("l", bytes(300), BEGIN)
    plain = xyz88(BEGIN, SEABED)
    longer = datagram("X", plain[20:-3] + b"new in revision Z", BEGIN)
    recording = read(tmp_path / "new.all", unknown, position(BEGIN, 5, 10), extra, longer, unknown, plain)
    assert (len(recording.pings), recording.problems) == (2, [])
    np.testing.assert_allclose(recording.soundings["down_m"], np.tile(SEABED, 2))


def test_a_wrong_checksum_costs_its_ping_alone(tmp_path: Path):
    content = bytearray(all_files.survey())
    place = starts(content, "X")[5]
    content[place + 60] ^= 0x10
    recording = read(tmp_path / "small.all", bytes(content))
    assert list(recording.pings["time_s"] - BEGIN) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert recording.skipped == {"pings with a wrong checksum": 1}
    assert recording.problems == [f"small.all: 464 bytes from byte {place} on are damaged or cut off"]


@pytest.mark.parametrize("length", [0, 3, 0x7FFFFFFF, 900])
def test_a_damaged_length_costs_its_datagram_alone(tmp_path: Path, length: int):
    content = bytearray(all_files.survey())
    place = starts(content, "X")[5]
    content[place : place + 4] = struct.pack("<I", length)
    recording = read(tmp_path / "small.all", bytes(content))
    assert list(recording.pings["time_s"] - BEGIN) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert recording.problems == [f"small.all: 464 bytes from byte {place} on are damaged or cut off"]


def test_a_length_that_spans_other_datagrams_does_not_hide_them(tmp_path: Path):
    content = bytearray(all_files.survey())
    first, *_, last = starts(content, "X")[3:8]
    content[first : first + 4] = struct.pack("<I", last - first - 4)
    assert len(read(tmp_path / "small.all", bytes(content)).pings) == 11


def test_a_file_that_was_cut_off_gives_what_is_before_and_says_where(tmp_path: Path):
    content = all_files.survey()
    cut = starts(content, "X")[7]
    recording = read(tmp_path / "small.all", content[: cut + 30])
    assert len(recording.pings) == 7
    assert recording.problems == [f"small.all: 30 bytes from byte {cut} on are damaged or cut off"]


def test_garbage_before_between_and_behind_does_not_hang_and_costs_nothing_else(tmp_path: Path):
    noise = np.random.default_rng(1).integers(0, 256, 1 << 20, dtype=np.uint8).tobytes()
    header = xyz88(BEGIN, SEABED)[:20]
    for order in "<>":
        for filling in (noise, bytes(1 << 20), b"\x02" * (1 << 20), header * (1 << 15)):
            recording = read(tmp_path / "small.all", filling, all_files.survey(3, order), filling, b"end")
            assert len(recording.pings) == 3
            assert len(recording.problems) == 2


def test_a_ping_that_says_what_it_cannot_hold_is_counted(tmp_path: Path):
    plain = bytearray(xyz88(BEGIN, SEABED)[20:-3])
    more, no_depth = bytes(plain[:8]) + b"\xff\xff" + bytes(plain[10:]), b"\0\0\0\0\xff\xff\xff\xff" + bytes(plain[8:])
    zero = depths(BEGIN, SEABED)[20:-3]
    pings = [datagram("X", content, BEGIN) for content in (more, no_depth, b"", bytes(plain))]
    coarse = datagram("D", zero[:8] + b"\0" + zero[9:], BEGIN)
    recording = read(tmp_path / "odd.all", position(BEGIN, 5, 10), *pings, coarse)
    assert recording.skipped == {
        "pings too short for what they hold": 2,
        "pings with an impossible transducer depth or resolution": 2,
    }
    assert (len(recording.pings), len(recording.problems)) == (1, 4)


def test_the_first_places_of_damage_are_reported_and_the_others_counted(tmp_path: Path):
    content = bytearray(all_files.survey(60))
    for place in starts(content, "X"):
        content[place + 60] ^= 0x10
    recording = read(tmp_path / "small.all", bytes(content))
    assert recording.skipped == {"pings with a wrong checksum": 60}
    assert (len(recording.problems), recording.problems_omitted) == (20, 40)


def test_a_file_without_pings_says_what_it_holds(tmp_path: Path):
    water = [datagram("k", bytes(50), BEGIN)] * 3
    recording = read(tmp_path / "line.wcd", position(BEGIN, 5, 10), *water)
    assert len(recording.pings) == len(recording.soundings) == 0
    assert "holds 1 positions and no ping, but 3 datagrams of water column" in recording.problems[0]
    assert read(tmp_path / "x.all", xyz88(BEGIN, SEABED)).problems == ["x.all: holds pings and no position"]


def test_what_is_no_all_file_is_refused_in_a_sentence(tmp_path: Path):
    for content in (b"", b"\x02", bytes(5000), b"GSF-v03.07" * 500):
        (tmp_path / "other.all").write_bytes(content)
        assert not kongsberg_all.begins(content[:4096])
        with pytest.raises(KongsbergError, match=f"none of its {len(content)} bytes from byte 0 on"):
            list(kongsberg_all.read(tmp_path / "other.all"))
    with pytest.raises(KongsbergError, match="cannot be read"):
        list(kongsberg_all.read(tmp_path / "missing.all"))


def test_parts_together_hold_what_the_file_holds(tmp_path: Path):
    across = np.linspace(-40, 40, 20_000)
    pings = [xyz88(BEGIN + number, np.full(20_000, 40.0 + number), across) for number in range(30)]
    path = tmp_path / "long.all"
    path.write_bytes(b"".join([position(BEGIN, 5, 10), position(BEGIN + 29, 5.001, 10), pings[0][:99], *pings]))
    parts = list(kongsberg_all.read(path))
    assert len(parts) == 3
    assert all(len(part.soundings) < PART + 20_000 for part in parts)
    assert sum(len(part.problems) for part in parts) == 1
    np.testing.assert_allclose(np.concatenate([part.pings["time_s"] for part in parts]), BEGIN + np.arange(30))
    seabed = [part.soundings.groupby("ping")["down_m"].first() for part in parts]
    np.testing.assert_allclose(np.concatenate(seabed), 40.0 + np.arange(30))
    assert all(part.soundings["ping"].max() == len(part.pings) - 1 for part in parts)


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes with some flipped, overwritten, taken out, put in or cut off."""
    changed = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        offset, count = int(rng.integers(len(changed))), int(rng.integers(1, 60))
        match rng.integers(5):
            case 0:
                changed[offset] ^= 1 << int(rng.integers(8))
            case 1:
                changed[offset : offset + count] = rng.integers(0, 256, count, dtype=np.uint8).tobytes()
            case 2:
                del changed[offset : offset + count]
            case 3:
                changed[offset:offset] = bytes(count)
            case _:
                del changed[max(offset, 1) :]
    return bytes(changed)


def test_mutated_files_end_in_a_sentence_or_say_what_was_lost(tmp_path: Path):
    rng, size = np.random.default_rng(0), len(all_files.survey(6))
    lost = 0
    for number in range(400):
        content = mutated(all_files.survey(6, "<>"[number % 2]), rng)
        try:
            recording = read(tmp_path / "mutated.all", content)
        except KongsbergError:
            continue
        assert np.isfinite(good(recording)[["along_m", "across_m", "down_m"]].to_numpy()).all()
        np.testing.assert_allclose(depth(recording), np.tile(SEABED + 1.5, len(recording.pings)))
        if len(recording.pings) < 6:
            lost += 1
            assert recording.problems or len(content) < size
    assert lost > 50


@real
@pytest.mark.parametrize("name", COUNTS)
def test_the_real_surveys_have_the_counts_that_are_known(name: str):
    recording = read(ALL / f"{name}.all")
    assert (len(recording.pings), len(recording.soundings), len(good(recording))) == COUNTS[name]
    assert recording.skipped == {}
    assert recording.pings.notna().all(axis=None)


@real
def test_the_real_track_and_depths_are_those_that_are_known():
    recording = read(ALL / "em2040c_warrnambool.all")
    x, y = projection.roughly(recording.pings["east"].to_numpy(), recording.pings["north"].to_numpy())
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(21.1, abs=0.05)
    # below the transducer, which hangs 0.5 to 0.9 m below the water line
    np.testing.assert_allclose(good(recording)["down_m"].quantile([0.01, 0.99]), [9.2, 10.7], atol=0.06)
    np.testing.assert_allclose(np.quantile(depth(recording), [0.01, 0.99]), [9.98, 11.19], atol=0.01)


@real
def test_a_real_file_of_positions_alone_says_so():
    recording = read(ALL / "em122_positions_only.all")
    assert len(recording.pings) == 0
    assert recording.problems == ["em122_positions_only.all: holds 60 positions and no ping"]
    assert recording.sensor == "Kongsberg EM122, serial 117"


def disagreement(recording: Recording, cell_m: float, side: int) -> float:
    """Return the median difference in depth of soundings of different pings in one cell, metres."""
    pings, soundings = recording.pings, good(recording)
    x, y = projection.roughly(pings["east"].to_numpy(), pings["north"].to_numpy())
    ping = soundings["ping"].to_numpy()
    heading, across, along = pings["heading_rad"].to_numpy()[ping], side * soundings["across_m"], soundings["along_m"]
    east = x[ping] + across * np.cos(heading) + along * np.sin(heading)
    north = y[ping] - across * np.sin(heading) + along * np.cos(heading)
    table = pd.DataFrame({"x": east // cell_m, "y": north // cell_m, "ping": ping, "z": depth(recording)})
    medians = table.groupby(["x", "y", "ping"])["z"].median()
    return float(medians.groupby(level=["x", "y"]).std().median())


@real
@pytest.mark.parametrize(("name", "cell_m"), [("em2040c_warrnambool", 2.0), ("em2040_belgica", 1.0)])
def test_neighbouring_pings_agree_on_the_seabed_and_would_not_if_port_were_starboard(name: str, cell_m: float):
    recording = read(ALL / f"{name}.all")
    assert disagreement(recording, cell_m, 1) < 0.9 * disagreement(recording, cell_m, -1)


@real
@pytest.mark.parametrize("name", COUNTS)
def test_an_independent_reader_has_the_same_soundings(name: str):
    kongsbergall = pytest.importorskip("themachinethatgoesping.echosounders.kongsbergall")
    theirs = kongsbergall.KongsbergAllFileHandler([str(ALL / f"{name}.all")], show_progress=False).get_pings()
    recording = read(ALL / f"{name}.all")
    ours = [table for _, table in recording.soundings.groupby("ping")]
    apart = []
    for other in theirs:
        if not other.has_bottom() or not other.bottom.has_xyz():
            continue
        place, time = other.bottom.get_xyz(), other.get_timestamp()
        at_once = np.flatnonzero(np.abs(recording.pings["time_s"] - time) < 1e-3)
        same = [n for n in at_once if np.array_equal(np.float32(ours[n]["across_m"]), np.float32(place.y))]
        assert len(same) == 1
        np.testing.assert_array_equal(np.float32(ours[same[0]]["down_m"]), np.float32(place.z))
        np.testing.assert_array_equal(np.float32(ours[same[0]]["along_m"]), np.float32(place.x))
        apart.append(recording.pings["depth_m"][same[0]] - other.get_geolocation().z)
    assert len(apart) == len(recording.pings)
    assert np.min(np.abs(apart)) < 0.2  # theirs is from lever arms and heave, which they extrapolate for some pings


def test_the_race_of_readers_is_over_a_file_repeated_in_whole(tmp_path: Path):
    content = all_files.survey(6)
    (tmp_path / "small.all").write_bytes(content)
    words = ["--source", str(tmp_path / "small.all"), "--megabytes", str(2.5e-6 * len(content)), "--repetitions", "1"]
    script = Path(__file__).parents[2] / "benchmarks/readers_all.py"
    result = subprocess.run([sys.executable, script, *words], capture_output=True, text=True, check=True)
    report = json.loads(result.stdout.splitlines()[-1])
    assert report["bytes"] == 3 * len(content)
    assert report["ours"]["soundings"] == 3 * 6 * len(ACROSS)
    assert report["ours"]["depth"] == pytest.approx(3 * 6 * SEABED.sum())
