"""Kongsberg .kmall: the sonar's own places and depths, in every revision; damage costs only the damaged records."""

import itertools
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import Geod

from kmall_files import ACROSS, TIME_S, attitude, body, datagram, installation, packets, ping, soundings
from pointnetkl.readers.formats import kmall
from pointnetkl.readers.formats.recording import IMPOSSIBLE, PING_COLUMNS, REJECTED, SOUNDING_COLUMNS, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.surveys.survey import SurveyError
from realdata import REALDATA

FILES = sorted((REALDATA / "kmall").glob("*.kmall"))
real = pytest.mark.skipif(not FILES, reason="no real data here")
each_real = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)


def parts(path: Path, *content: bytes) -> list[Recording]:
    """Write a file and read it."""
    path = path / "line.kmall"
    path.write_bytes(b"".join(content))
    return list(kmall.read(path))


def read(path: Path, *content: bytes) -> Recording:
    """Write a small file and read it, in one part."""
    (recording,) = parts(path, *content)
    return recording


def pings(count: int = 5, **fields: Any) -> list[bytes]:
    """Return pings a second apart."""
    return [ping(TIME_S + number, **fields) for number in range(count)]


def test_a_written_ping_is_read_where_it_was(tmp_path: Path):
    recording = read(tmp_path, installation(), ping(), attitude())
    assert tuple(recording.pings) == PING_COLUMNS
    assert tuple(recording.soundings) == SOUNDING_COLUMNS
    time, east, north, depth, roll, pitch, heading = recording.pings.iloc[0]
    assert (time, east, north, depth, heading) == (TIME_S, 5.0, 10.0, 30.0, pytest.approx(np.pi / 2))
    assert (roll, pitch) == (pytest.approx(np.deg2rad(1.0)), pytest.approx(np.deg2rad(-2.0)))
    np.testing.assert_allclose(recording.soundings["along_m"], 2.0)
    np.testing.assert_allclose(recording.soundings["across_m"], ACROSS, rtol=1e-6)
    np.testing.assert_allclose(recording.soundings["down_m"], 45.0 - ACROSS / 8, rtol=1e-6)
    assert recording.soundings["quality"].eq(0).all()
    assert (recording.sensor, recording.crs) == ("Kongsberg EM304, serial 123, 45", "EPSG:4326")
    assert (recording.skipped, recording.problems) == ({}, [])


def test_a_sensor_is_called_as_far_as_the_file_names_it(tmp_path: Path):
    unnumbered = installation("OSCV:Empty,EMXV:EM124,SN=10055,TRAI_TX1:N=0;X=4.2")
    assert read(tmp_path, unnumbered, ping()).sensor == "Kongsberg EM124, serial 10055"
    assert read(tmp_path, installation("nothing"), ping()).sensor == "Kongsberg EM304"


def test_a_reference_point_above_the_water_has_a_negative_depth(tmp_path: Path):
    assert read(tmp_path, ping(water_m=0.31)).pings["depth_m"][0] == pytest.approx(-0.31)


@pytest.mark.parametrize("block", range(6), ids=["common", "info", "sector", "receiver", "class", "sounding"])
def test_what_a_newer_revision_adds_to_a_block_is_passed_over(tmp_path: Path, block: int):
    longer = [0] * 6
    longer[block] = 8
    fields: dict[str, Any] = {"extra": 4, "classes": 2, "sectors": 2}
    expected = read(tmp_path, ping(**fields))
    newer = read(tmp_path, ping(version=9, longer=longer, **fields))
    pd.testing.assert_frame_equal(newer.soundings, expected.soundings)
    pd.testing.assert_frame_equal(newer.pings, expected.pings)


def test_the_first_revision_has_a_shorter_block_for_the_ping(tmp_path: Path):
    recording = read(tmp_path, ping(version=0, info=144))
    assert recording.pings["north"][0] == 10.0
    assert recording.soundings["quality"].eq(0).all()


def test_extra_detections_are_soundings_but_not_of_the_seabed(tmp_path: Path):
    types = [0] * 17 + [1, 1, 2, 0]
    quality = read(tmp_path, ping(type=types, extra=4, classes=1)).soundings["quality"]
    assert quality.tolist() == [0] * 17 + [REJECTED] * 4


def test_the_sonar_s_own_flags_decide_what_is_a_detection(tmp_path: Path):
    types, methods = np.zeros(21), np.ones(21)
    types[3], types[4], methods[5], methods[6] = 2, 9, 0, 2
    quality = read(tmp_path, ping(type=types, method=methods)).soundings["quality"]
    assert {row: value for row, value in enumerate(quality) if value} == {3: REJECTED, 4: REJECTED, 5: IMPOSSIBLE}


def test_heads_of_one_ping_stay_pings_of_their_own(tmp_path: Path):
    recording = read(tmp_path, ping(fan=(2, 0), count=11), ping(fan=(2, 1), count=7))
    assert recording.pings["time_s"].tolist() == [TIME_S] * 2
    assert recording.soundings.groupby("ping")["beam"].max().tolist() == [10, 6]


@pytest.mark.parametrize("version", [2, 3])
def test_a_ping_logged_in_packets_is_put_together(tmp_path: Path, version: int):
    sent = packets(body(soundings()), 3, version)
    recording = read(tmp_path, sent[0], attitude(), *sent[1:], ping(TIME_S + 1))
    assert len(recording.pings) == 2
    assert recording.soundings["quality"].eq(0).all()
    expected = read(tmp_path, ping())
    pd.testing.assert_frame_equal(recording.soundings[:21], expected.soundings)


def test_a_search_after_damage_does_not_read_on_from_every_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    looked: list[int] = []
    window_read = Window.read
    monkeypatch.setattr(
        Window, "read", lambda self, offset, count: looked.append(count) or window_read(self, offset, count)
    )
    marks = b"\0\0\1\0#MRZ" * 50_000  # each would be a ping of 64 kB
    recording = read(tmp_path, marks, ping())
    assert recording.skipped == {"pings in damaged bytes": 50_000}
    assert sum(looked) < 8 * len(marks)


@pytest.mark.parametrize("lost", range(3))
def test_a_ping_of_which_a_packet_is_missing_is_counted_once(tmp_path: Path, lost: int):
    sent = packets(body(soundings()), 3, 3)
    del sent[lost]
    other = packets(body(soundings()), 3, 3, TIME_S + 1)
    for content in ([*sent, *other], [*other, *sent]):
        recording = read(tmp_path, *content)
        assert recording.pings["time_s"].tolist() == [TIME_S + 1]
        assert recording.skipped == {"pings of which a part is missing": 1}


def test_packets_of_two_pings_are_not_mixed(tmp_path: Path):
    first, second = (packets(body(soundings()), 3, 3, TIME_S + number) for number in range(2))
    recording = read(tmp_path, first[0], *second[1:])
    assert len(recording.pings) == 0
    assert recording.skipped == {"pings of which a part is missing": 2}


def test_packets_beyond_what_a_sonar_sends_are_not_kept(tmp_path: Path):
    recording = read(tmp_path, *packets(body(soundings(600)), 2, 3), *packets(body(soundings()), 300, 3), ping())
    assert len(recording.pings) == 2
    assert recording.skipped == {"pings of which a part is missing": 1}
    assert read(tmp_path, *packets(body(soundings(2000)), 2, 3)).skipped == {"pings of which a part is missing": 1}


def test_datagrams_of_unknown_kind_are_passed_over_by_their_length(tmp_path: Path):
    unknown = datagram(b"#ZZ9", b"#MRZ" * 50)
    recording = read(tmp_path, unknown, ping(), unknown, ping(TIME_S + 1), unknown)
    assert len(recording.pings) == 2
    assert recording.problems == []


def test_a_file_of_the_water_column_says_that_it_has_no_soundings(tmp_path: Path):
    recording = read(tmp_path, installation(), *[datagram(b"#MWC", bytes(500))] * 3)
    assert len(recording.pings) == len(recording.soundings) == 0
    (problem,) = recording.problems
    assert problem.startswith("line.kmall: has no #MRZ datagram, hence no soundings, but 3 #MWC, 1 #IIP; give the")


def test_a_sensor_that_is_not_used_or_doubts_itself_gives_no_attitude(tmp_path: Path):
    for other in (attitude(status=0), attitude(doubts=2), attitude(TIME_S + 9)):
        assert read(tmp_path, ping(), other).pings["roll_rad"].isna().all()


def test_damage_between_datagrams_costs_only_what_it_hit(tmp_path: Path):
    content = pings()
    hit = bytearray(content[1])
    hit[0] ^= 0x40
    recording = read(tmp_path, content[0], bytes(hit), b"#" * 999, *content[2:], content[0][:-30])
    assert recording.pings["time_s"].tolist() == [TIME_S + number for number in (0, 2, 3, 4)]
    assert recording.skipped == {"pings in damaged bytes": 2}
    size = len(content[0])
    assert recording.problems == [
        f"line.kmall: {size + 999} bytes from byte {size} on are damaged or cut off",
        f"line.kmall: {size - 30} bytes from byte {5 * size + 999} on are damaged or cut off",
    ]


def test_a_mark_on_the_edge_of_a_stretch_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("pointnetkl.readers.formats.window._SEARCHED", 64)
    for lead in range(1, 140):
        recording = read(tmp_path, b"\xff" * lead, ping(), b"\xff" * lead)
        assert len(recording.pings) == 1
        assert recording.skipped == {}
        assert len(recording.problems) == 2


WRONG = {
    "soundings": ping(TIME_S + 1, main=65535),
    "bytes of a sounding": ping(TIME_S + 1, each=65535),
    "sounding too short": ping(TIME_S + 1, each=8),
    "sectors": ping(TIME_S + 1).replace(struct.pack("<2H", 3, 48), struct.pack("<2H", 65535, 65535)),
    "common block": ping(TIME_S + 1).replace(struct.pack("<2H", 12, 7), struct.pack("<2H", 65535, 7)),
    "ping block": ping(TIME_S + 1)
    .replace(struct.pack("<H", 152), struct.pack("<H", 8))
    .replace(b"\3\0\x30", b"\3\0\x60"),
    "receiver block": ping(TIME_S + 1, classes=8).replace(struct.pack("<2H", 32, 21), struct.pack("<2H", 0, 21)),
    "nothing": datagram(b"#MRZ", b"", TIME_S + 1),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_length_that_the_datagram_does_not_have_is_not_believed(tmp_path: Path, wrong: bytes):
    recording = read(tmp_path, ping(), wrong, ping(TIME_S + 2))
    assert recording.pings["time_s"].tolist() == [TIME_S, TIME_S + 2]
    assert recording.skipped == {"pings with impossible lengths": 1}
    assert f"the ping at byte {len(ping())} cannot be used: it" in recording.problems[0]


def test_a_ping_without_soundings_is_a_ping(tmp_path: Path):
    recording = read(tmp_path, ping(count=0), ping(TIME_S + 1, count=0, each=0), ping(TIME_S + 2))
    assert recording.soundings["ping"].unique().tolist() == [2]
    assert len(recording.pings) == 3


def test_a_sounding_that_its_own_latitude_places_elsewhere_is_impossible(tmp_path: Path):
    starboard, latitude = ACROSS.copy(), soundings()["latitude"]
    starboard[4] += 10.0
    damaged = datagram(b"#MRZ", b"\1\0\1\0" + body(soundings(starboard=starboard, latitude=latitude)))
    recording = read(tmp_path, *pings(), damaged)
    assert np.flatnonzero(recording.soundings["quality"]).tolist() == [5 * 21 + 4]


def test_a_damaged_heading_makes_a_ping_s_soundings_impossible(tmp_path: Path):
    turned = datagram(b"#MRZ", b"\1\0\1\0" + body(soundings(heading_deg=90.0), heading_deg=110.0))
    recording = read(tmp_path, *pings(), turned)
    quality = recording.soundings["quality"].to_numpy().reshape(6, 21)
    assert quality.tolist() == [[0] * 21] * 5 + [[IMPOSSIBLE] * 21]


def test_a_heading_that_is_none_is_not_a_number(tmp_path: Path):
    recording = read(tmp_path, *pings(), ping(heading_deg=361.0), ping(heading_deg=-4.0))
    assert recording.pings["heading_rad"].isna().tolist() == [False] * 5 + [True] * 2


def test_latitudes_that_a_sonar_never_fills_in_are_no_evidence(tmp_path: Path):
    rows = soundings()
    rows["latitude"] = rows["longitude"] = 0.0
    empty = [datagram(b"#MRZ", b"\1\0\1\0" + body(rows), TIME_S + number) for number in range(4)]
    assert read(tmp_path, *empty).soundings["quality"].eq(0).all()


def test_a_time_that_is_none_is_not_a_number(tmp_path: Path):
    content = [*pings(), ping(TIME_S + 5, nanoseconds=4_000_000_000), ping(TIME_S + 2**30), ping(TIME_S + 6)]
    assert np.flatnonzero(read(tmp_path, *content).pings["time_s"].isna()).tolist() == [5, 6]


def test_two_days_in_one_file_are_both_kept(tmp_path: Path):
    days = [ping(TIME_S + number + 864_000 * (number > 1)) for number in range(5)]
    assert read(tmp_path, *days).pings["time_s"].notna().all()


def test_a_file_is_handed_over_in_parts_that_are_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    lines = [(ping(TIME_S + number), attitude(TIME_S + number, rate=5.0)) for number in range(40)]
    again = [ping(TIME_S + 50 + step) for step in np.linspace(-0.4, 0.4, 9)]
    content = [installation(), *itertools.chain(*lines), attitude(TIME_S + 50, rate=5.0), *again]
    expected = read(tmp_path, *content)
    monkeypatch.setattr(kmall, "PART", 400)
    several = parts(tmp_path, *content)
    assert len(several) > 5
    assert max(len(part.soundings) for part in several) <= 121
    pd.testing.assert_frame_equal(pd.concat([part.pings for part in several], ignore_index=True), expected.pings)
    columns = [part.soundings.drop(columns="ping") for part in several]
    pd.testing.assert_frame_equal(pd.concat(columns, ignore_index=True), expected.soundings.drop(columns="ping"))
    assert {part.sensor for part in several} == {expected.sensor}


def test_pings_without_soundings_do_not_pile_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(kmall, "PART", 400)
    assert max(len(part.pings) for part in parts(tmp_path, *[ping(count=0)] * 50)) < 10


def test_no_more_than_twenty_damages_are_reported(tmp_path: Path):
    recording = read(tmp_path, *itertools.chain(*[(ping(TIME_S + number), b"\0" * 30) for number in range(30)]))
    assert (len(recording.problems), recording.problems_omitted) == (20, 10)
    assert len(recording.pings) == 30


def test_what_is_no_kmall_file_is_refused_in_a_sentence(tmp_path: Path):
    for content in (b"\x89PNG" * 500, b"", ping()[:-1], b"\0\0\0\0#MRZ" * 300):
        with pytest.raises(SurveyError, match=r"line\.kmall: none of its"):
            parts(tmp_path, content)
    with pytest.raises(SurveyError, match="cannot be read"):
        list(kmall.read(tmp_path / "missing.kmall"))


def test_a_file_is_recognised_by_its_first_datagram():
    assert kmall.begins(installation())
    assert kmall.begins(ping(count=100)[:4096])
    assert not kmall.begins(installation()[:-4] + b"\0\0\0\0")
    assert not kmall.begins(b"\x89PNG" * 9)
    assert not kmall.begins(ping()[:19])


@real
def test_the_real_files_have_the_known_counts():
    counts = {}
    for path in FILES:
        (recording,) = kmall.read(path)
        valid = int(recording.soundings["quality"].eq(0).sum())
        counts[path.stem] = (recording.sensor, len(recording.pings), len(recording.soundings), valid)
        assert (recording.skipped, recording.problems) == ({}, [])
        assert recording.pings.notna().all(axis=None)
    assert counts == {
        "em2040_tampa": ("Kongsberg EM2040P, serial 2032", 25, 15_184, 11_473),
        "em2042_ostend_1": ("Kongsberg EM2042, serial 5001, 5003", 6, 2_960, 2_294),
        "em2042_ostend_2": ("Kongsberg EM2042, serial 5001, 5003", 6, 2_960, 2_812),
    }


def independent(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Return the #MRZ datagrams and the installation's text by pykmall."""
    peer = pytest.importorskip("KMALL")
    file = peer.kmall(str(path))
    file.index_file()
    read = {kind: list(rows["ByteOffset"]) for kind, rows in file.Index.groupby("MessageType", observed=True)}
    datagrams = []
    for offset in read["b'#MRZ'"]:
        file.FID.seek(int(offset))
        datagrams.append(file.read_EMdgmMRZ())
    file.FID.seek(int(read["b'#IIP'"][0]))
    text = file.read_EMdgmIIP()["install_txt"]
    file.closeFile()
    return datagrams, text


@each_real
def test_an_independent_reader_agrees(path: Path):
    (recording,) = kmall.read(path)
    theirs, _ = independent(path)
    for number, datagram_ in enumerate(theirs):
        info, sounding = datagram_["pingInfo"], datagram_["sounding"]
        vehicle, ours = recording.pings.iloc[number], recording.soundings[recording.soundings["ping"] == number]
        assert vehicle["time_s"] == pytest.approx(datagram_["header"]["dgtime"], abs=1e-6)
        assert (vehicle["north"], vehicle["east"]) == (info["latitude_deg"], info["longitude_deg"])
        assert ours["quality"].eq(0).sum() == datagram_["rxInfo"]["numSoundingsValidMain"]
        np.testing.assert_array_equal(ours["along_m"], sounding["x_reRefPoint_m"])
        np.testing.assert_array_equal(ours["across_m"], sounding["y_reRefPoint_m"])
        depth = np.array(sounding["z_reRefPoint_m"]) - info["z_waterLevelReRefPoint_m"]
        np.testing.assert_allclose(vehicle["depth_m"] + ours["down_m"], depth, atol=1e-6)


@each_real
def test_soundings_lie_where_the_sonar_itself_places_them_and_not_mirrored(path: Path):
    (recording,) = kmall.read(path)
    theirs, _ = independent(path)
    own = pd.concat([pd.DataFrame(d["sounding"])[["deltaLongitude_deg", "deltaLatitude_deg"]] for d in theirs])
    vehicle = recording.pings.iloc[recording.soundings["ping"]]
    along, across = (recording.soundings[name].to_numpy() for name in ("along_m", "across_m"))
    apart = []
    for side in (1.0, -1.0):
        azimuth = np.rad2deg(vehicle["heading_rad"].to_numpy() + np.arctan2(side * across, along))
        geod, start = Geod(ellps="WGS84"), (vehicle["east"].to_numpy(), vehicle["north"].to_numpy())
        place = geod.fwd(*start, azimuth, np.hypot(along, across))[:2]
        apart.append(geod.inv(*place, *(start + own.to_numpy().T))[2])
    assert apart[0].max() < 0.01
    assert np.median(apart[1]) > 1.0


@each_real
def test_the_water_line_is_where_it_puts_the_transducer_at_its_own_depth(path: Path):
    (recording,) = kmall.read(path)
    theirs, text = independent(path)
    below = float(re.search(r"TRAI_(?:HD|TX)1:.*?Z=([\d.]+)", text)[1])
    own = [d["pingInfo"]["txTransducerDepth_m"] for d in theirs]
    # levers turn with roll and pitch, and an array's centre is a few centimetres off the head's
    np.testing.assert_allclose(recording.pings["depth_m"] + below, own, atol=0.05)


@each_real
@pytest.mark.filterwarnings("error")
def test_a_damaged_file_gives_finite_soundings_or_a_sentence(path: Path, tmp_path: Path):
    content = path.read_bytes()[:60_000]
    marks = [offset for offset in range(len(content)) if content[offset : offset + 4] in (b"#MRZ", b"#SKM", b"#IIP")]
    rng = np.random.default_rng(3)
    for _ in range(150):
        damaged = bytearray(content[: int(rng.integers(10_000, len(content)))])
        for offset in [*rng.integers(0, len(damaged), 8), *(rng.choice(marks, 4) + rng.integers(-4, 280, 4))]:
            damaged[min(int(offset), len(damaged) - 1)] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)])
        try:
            read_parts = parts(tmp_path, bytes(damaged))
        except kmall.KmallError:
            continue
        for part in read_parts:
            good = part.soundings[part.soundings["quality"] == 0]
            assert np.isfinite(good.to_numpy(float)).all()
            assert good["ping"].isin(part.pings.index).all()
        assert any(len(part.pings) or part.problems for part in read_parts)
