"""XTF: ranges and angles become soundings on the seabed; unread and damaged packets are reported."""

import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import damage
import xtf_files
from pointnetkl.readers import projection
from pointnetkl.readers.formats import xtf
from pointnetkl.readers.formats.recording import IMPOSSIBLE, PING_COLUMNS, REJECTED, SOUNDING_COLUMNS, Recording
from pointnetkl.readers.formats.window import Window
from pointnetkl.readers.formats.xtf import packets as xtf_packets
from pointnetkl.readers.formats.xtf import r2sonic, raytrace
from pointnetkl.readers.formats.xtf import streams as xtf_streams
from pointnetkl.readers.formats.xtf import swaths as xtf_swaths
from pointnetkl.readers.formats.xtf.packets import FileHeader
from realdata import REALDATA
from xtf_files import ACROSS, BEGIN, DEGREE_M, EAST, SONAR, SPEED, Ship

PIER = REALDATA / "xtf/r2sonic_pier.xtf"
real = pytest.mark.skipif(not PIER.exists(), reason="no real data here")
FLAT = dict.fromkeys(SONAR, 0.0)


def recorded(path: Path, content: bytes) -> Recording:
    """Return the one part of a file with this content."""
    path.write_bytes(content)
    (part,) = xtf.read(path)
    assert tuple(part.pings) == PING_COLUMNS
    assert tuple(part.soundings) == SOUNDING_COLUMNS
    return part


def still(path: Path, *pings: bytes, **head: Any) -> Recording:
    """Return what is read of pings within ten seconds of BEGIN, from a ship that lies still, heading north."""
    motion = [xtf_files.attitude(BEGIN + t, 0, 0, 0, 360.0) for t in np.arange(0, 10.5, 0.5)]
    places = [xtf_files.position(BEGIN + t, EAST, 0.0) for t in (0, 5, 10)]
    head = {"sonars": (FLAT,), "motion": {}, "reference_m": 0.0} | head
    return recorded(path, xtf_files.header(**head) + b"".join([*motion, *places, *pings]))


def fan(time_s: float = BEGIN + 1, **fields: Any) -> bytes:
    """Return a ping of three beams that meets a seabed 30 m below, 30 m to port, below and 30 m to starboard."""
    angle = np.deg2rad([-45.0, 0.0, 45.0])
    return xtf_files.ping(65, time_s, xtf_files.bth0(time_s, 60 / np.cos(angle) / SPEED, angle, **fields))


def distances(ship: Ship, part: Recording) -> np.ndarray:
    """Return how far each sounding (pings, beams, 3) is from where the seabed was: metres north, east, down."""
    away = []
    for row, ping in enumerate(part.pings.itertuples()):
        places = ship.echoes(round(2 * (ping.time_s - BEGIN)) / 2 + BEGIN)[2]
        soundings = part.soundings[part.soundings["ping"] == row]
        along, across = soundings["along_m"].to_numpy(), soundings["across_m"].to_numpy()
        cos, sin = np.cos(ping.heading_rad), np.sin(ping.heading_rad)
        north = ping.north * 110_574.3 + along * cos - across * sin
        east = (ping.east - EAST) * DEGREE_M + along * sin + across * cos
        away.append(np.stack([north, east, ping.depth_m + soundings["down_m"].to_numpy()], 1) - places)
    return np.array(away)


def beams_28(_: float, travel_s: np.ndarray, angle: np.ndarray) -> bytes:
    """Return the content of a packet 28, which has no time."""
    return xtf_files.beams_28(travel_s, angle)


CONTENTS = [
    (65, xtf_files.bth0),
    (68, xtf_files.bth0),
    (61, xtf_files.record_7027),
    (61, xtf_files.records_7006_7004),
    (28, beams_28),
]


@pytest.mark.parametrize(("kind", "content"), CONTENTS)
def test_soundings_lie_where_the_seabed_was_under_a_ship_that_rolls_pitches_heaves_and_yaws(
    tmp_path: Path, kind: int, content: xtf_files.Content
):
    ship = Ship()
    part = recorded(tmp_path / "line.xtf", xtf_files.survey(ship, kind, content))
    assert (len(part.pings), len(part.soundings)) == (12, 12 * len(ACROSS))
    assert (part.soundings["quality"] == 0).all()
    assert part.skipped == {}
    away = distances(ship, part)
    # the way of the sonar itself between sending and hearing is left out, but for its depth: 2 cm at the side
    assert np.abs(away).max() < 0.03
    assert np.abs(away).mean() < 0.006
    assert part.vertical.startswith("below the water line;")


@pytest.mark.parametrize("wrong", ["roll", "pitch", "yaw", "forward", "starboard", "down"])
def test_each_offset_of_the_sonar_counts(tmp_path: Path, wrong: str):
    ship = Ship()
    other = {**SONAR, wrong: -SONAR[wrong]}
    part = recorded(tmp_path / "line.xtf", xtf_files.survey(ship, pings=4, sonars=(other,)))
    assert np.abs(distances(ship, part)).max() > 0.5


def test_heave_is_the_sonar_s_where_the_motion_sensor_has_no_place(tmp_path: Path):
    ship = Ship(motion=None)
    part = recorded(tmp_path / "line.xtf", xtf_files.survey(ship))
    assert np.abs(distances(ship, part)).max() < 0.03
    assert "heave taken as that of the sonar" in part.vertical


def test_a_position_of_the_antenna_is_brought_to_the_sonar_by_both_offsets(tmp_path: Path):
    sonar, antenna = FLAT | {"forward": 3.0, "starboard": 1.0}, {"forward": -2.0, "starboard": 4.0, "down": -9.0}
    part = still(tmp_path / "a.xtf", fan(), sonars=(sonar,), navigation=antenna)
    np.testing.assert_allclose(part.soundings["along_m"], 5.0, atol=1e-6)
    np.testing.assert_allclose(part.soundings["across_m"], [-33, -3, 27], atol=0.01)


def test_a_flat_seabed_is_flat_and_its_first_beam_to_port(tmp_path: Path):
    for even in (False, True):
        part = still(tmp_path / "a.xtf", fan(even=even))
        np.testing.assert_allclose(part.soundings["across_m"], [-30, 0, 30], atol=0.01)
        np.testing.assert_allclose(part.soundings["along_m"], 0, atol=1e-9)
        np.testing.assert_allclose(part.soundings["down_m"], 30, atol=0.01)
    np.testing.assert_allclose(part.pings["east"], EAST)
    assert part.sensor == "R2Sonic 2024, serial 100017"
    assert part.crs == projection.GEOGRAPHIC


def test_depths_are_below_the_water_line_by_the_height_of_the_reference_point(tmp_path: Path):
    part = still(tmp_path / "a.xtf", fan(), sonars=(FLAT | {"down": 3.0},), reference_m=1.0)
    np.testing.assert_allclose(part.soundings["down_m"], 32, atol=0.01)


def test_a_vehicle_s_own_depth_counts_instead_of_offsets(tmp_path: Path):
    ping = bytearray(fan())
    struct.pack_into("<f", ping, 192, 500.0)
    part = still(tmp_path / "a.xtf", bytes(ping), sonars=(FLAT | {"down": 3.0},))
    np.testing.assert_allclose(part.pings["depth_m"], 500)
    np.testing.assert_allclose(part.soundings["down_m"], 30, atol=0.01)


def test_heads_of_a_dual_sonar_have_their_own_offsets(tmp_path: Path):
    content = xtf_files.bth0(BEGIN + 1, np.array([60 / SPEED]), np.array([0.0]))
    pings = [xtf_files.ping(65, BEGIN + 1, content, channel) for channel in (0, 1, 0)]
    sonars = tuple(FLAT | {"roll": roll, "starboard": side} for roll, side in ((30.0, -1.0), (-30.0, 1.0)))
    part = still(tmp_path / "a.xtf", *pings, sonars=sonars)
    # a head whose starboard side is down looks to port
    np.testing.assert_allclose(part.soundings["across_m"], [-16, 16, -16], atol=0.01)
    assert len(part.pings) == 3


def test_what_the_sonar_did_not_find_is_impossible_and_what_failed_its_tests_is_rejected(tmp_path: Path):
    part = still(tmp_path / "a.xtf", fan(flags=np.array([0b1011, 0b0111, 0b1010])))
    assert list(part.soundings["quality"]) == [0, 0, REJECTED]
    part = still(tmp_path / "b.xtf", fan(flags=np.array([0b1000, 0b0100, 0])))
    assert list(part.soundings["quality"]) == [0, 0, IMPOSSIBLE]
    none = xtf_files.bth0(BEGIN + 1, np.array([0.0, 0.04, 0.04]), np.array([-0.5, 0.0, 1.6]))
    part = still(tmp_path / "c.xtf", xtf_files.ping(65, BEGIN + 1, none))
    assert list(part.soundings["quality"]) == [IMPOSSIBLE, 0, IMPOSSIBLE]
    record = xtf_files.record_7027(BEGIN + 1, np.array([0.04]), np.array([0.0]), quality=1)
    part = still(tmp_path / "d.xtf", xtf_files.ping(61, BEGIN + 1, record, speed=SPEED))
    assert list(part.soundings["quality"]) == [REJECTED]
    for quality, expected in ((0, IMPOSSIBLE), (9, REJECTED), (7, 0)):
        record = xtf_files.records_7006_7004(BEGIN + 1, np.array([0.04]), np.array([0.0]), quality)
        part = still(tmp_path / "e.xtf", xtf_files.ping(61, BEGIN + 1, record))
        assert list(part.soundings["quality"]) == [expected]


def test_a_sound_speed_of_the_one_way_time_is_doubled_and_one_that_is_missing_one_is_reported(tmp_path: Path):
    record = xtf_files.record_7027(BEGIN + 1, np.array([0.04]), np.array([0.0]))
    part = still(tmp_path / "a.xtf", xtf_files.ping(61, BEGIN + 1, record, speed=735.0))
    assert part.soundings["down_m"][0] == pytest.approx(0.02 * 1470)
    part = still(tmp_path / "b.xtf", xtf_files.ping(61, BEGIN + 1, record))
    assert part.soundings["down_m"][0] == pytest.approx(0.02 * 1500)
    assert part.problems == ["b.xtf: has no sound speed in 1 pings, for which 1500 m/s is taken"]


def test_a_sonar_whose_clock_is_not_set_has_the_recorder_s_time(tmp_path: Path):
    content = xtf_files.bth0(1000.0, np.array([0.04]), np.array([0.0]))
    part = still(tmp_path / "a.xtf", xtf_files.ping(65, BEGIN + 1.25, content))
    assert part.pings["time_s"][0] == BEGIN + 1.25


def test_time_goes_on_over_midnight_also_where_the_date_comes_late():
    time = BEGIN + 14 * 3600 - 2 + np.arange(5.0)
    late = np.where(np.arange(5) < 2, time, time - 86_400)
    np.testing.assert_array_equal(xtf_streams.unbroken(late), np.append(time[:2], time[2:]))
    np.testing.assert_array_equal(xtf_streams.unbroken(time), time)
    gap = np.array([0.0, 86_400.0, 86_401.0])
    np.testing.assert_array_equal(xtf_streams.unbroken(gap), gap)


def test_a_line_over_midnight_is_one_line(tmp_path: Path):
    ship = Ship(begin=BEGIN + 14 * 3600 - 3)
    part = recorded(tmp_path / "a.xtf", xtf_files.survey(ship))
    assert np.ptp(part.pings["time_s"]) == pytest.approx(5.5)
    assert np.isfinite(part.pings[["east", "north", "roll_rad"]].to_numpy()).all()


def test_years_of_two_digits_and_impossible_dates():
    assert xtf_packets.clock(struct.pack("<HBBBBB", 98, 1, 2, 0, 0, 3), 0) == 883_699_203
    assert xtf_packets.clock(struct.pack("<HBBBBB", 20, 5, 17, 10, 0, 0), 0) == BEGIN
    for wrong in ((2020, 2, 30, 0, 0, 0), (2020, 1, 1, 24, 0, 0), (5, 0, 0, 0, 0, 0), (60_000, 1, 1, 0, 0, 0)):
        assert np.isnan(xtf_packets.clock(struct.pack("<HBBBBB", *wrong), 0))


def test_positions_in_metres_have_no_known_place_on_the_earth(tmp_path: Path):
    part = still(tmp_path / "a.xtf", fan(), units=0)
    assert part.crs == projection.LOCAL
    np.testing.assert_allclose(part.pings["east"], EAST)
    odd = still(tmp_path / "b.xtf", fan(), units=7)
    assert "unknown unit 7" in odd.problems[0]


def test_latency_makes_positions_earlier(tmp_path: Path):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 360.0) for t in range(4))
    places = b"".join(xtf_files.position(BEGIN + t, EAST + t, 0.0) for t in range(4))
    content = xtf_files.header(motion={}, latency_ms=500) + motion + places + fan(BEGIN + 1)
    assert recorded(tmp_path / "a.xtf", content).pings["east"][0] == pytest.approx(EAST + 1.5)


def test_positions_and_motion_stand_in_the_pings_where_nothing_else_has_them(tmp_path: Path):
    pings = []
    for time in (BEGIN, BEGIN + 1):
        ping = bytearray(fan(time))
        struct.pack_into("<2d", ping, 160, 1.0, EAST)
        struct.pack_into("<4f", ping, 204, 2.0, -3.0, 90.0, 0.1)
        pings.append(bytes(ping))
    part = recorded(tmp_path / "a.xtf", xtf_files.header(motion={}) + b"".join(pings))
    np.testing.assert_allclose(part.pings[["east", "north"]], [[EAST, 1.0]] * 2)
    np.testing.assert_allclose(np.rad2deg(part.pings[["roll_rad", "pitch_rad", "heading_rad"]]), [[-3, 2, 90]] * 2)
    assert part.problems == []


def test_a_file_without_motion_says_that_it_is_not_levelled(tmp_path: Path):
    part = recorded(tmp_path / "a.xtf", xtf_files.header() + xtf_files.position(BEGIN, EAST, 0) + fan(BEGIN))
    assert part.problems == ["a.xtf: has no roll and pitch: its soundings are not levelled"]
    assert len(part.soundings) == 3


def test_pings_without_motion_near_them_are_counted(tmp_path: Path):
    part = still(tmp_path / "a.xtf", fan(), fan(BEGIN + 300))
    assert len(part.pings) == 1
    assert part.skipped == {"pings without time or attitude": 1}


def test_a_gyro_has_the_heading_where_the_attitude_has_none(tmp_path: Path):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 0.0) + xtf_files.gyro(BEGIN + t, 123) for t in range(4))
    content = xtf_files.header(motion={}) + motion + xtf_files.position(BEGIN, EAST, 0) + fan()
    assert np.rad2deg(recorded(tmp_path / "a.xtf", content).pings["heading_rad"][0]) == pytest.approx(123)


def test_a_second_gyro_is_reported_and_does_not_turn_the_ship(tmp_path: Path):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 0.0) + xtf_files.gyro(BEGIN + t, 123) for t in range(4))
    other = xtf_files.gyro(BEGIN + 0.9, 33, 23) + xtf_files.gyro(BEGIN + 1.1, 33, 23)
    places = xtf_files.position(BEGIN, EAST, 0) + xtf_files.position(BEGIN + 4, EAST, 0)
    part = recorded(tmp_path / "a.xtf", xtf_files.header(motion={}) + motion + other + places + fan())
    assert np.rad2deg(part.pings["heading_rad"][0]) == pytest.approx(123)
    assert part.problems == ["a.xtf: has headings in packets 84 (4) and 23 (2); those of 84 are taken"]


@pytest.mark.parametrize(("kind", "other"), [(107, 42), (42, 107)])
def test_a_second_antenna_is_reported_and_does_not_move_the_ship(tmp_path: Path, kind: int, other: int):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 360.0) for t in range(4))
    places = b"".join(xtf_files.position(BEGIN + t, EAST, 0.0, kind) for t in range(4))
    away = b"".join(xtf_files.position(BEGIN + t, EAST, 20 / DEGREE_M, other) for t in (0.8, 1.2))
    part = recorded(tmp_path / "a.xtf", xtf_files.header(motion={}) + motion + places + away + fan())
    np.testing.assert_allclose(part.pings[["east", "north"]], [[EAST, 0.0]])
    assert part.problems == [f"a.xtf: has positions in packets {kind} (4) and {other} (2); those of {kind} are taken"]


def test_a_position_holds_for_five_seconds_beyond_the_last_and_that_is_reported(tmp_path: Path):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 360.0) for t in range(40))
    places = b"".join(xtf_files.position(BEGIN + t, EAST + t * 1e-5, 0.0) for t in (2.0, 5.0))
    pings = b"".join(fan(BEGIN + t) for t in (0.5, 2.0, 3.0, 5.0, 9.5, 10.5, 30.0))
    part = recorded(tmp_path / "a.xtf", xtf_files.header(motion={}) + motion + places + pings)
    east = (part.pings["east"] - EAST) * 1e5
    np.testing.assert_allclose(east, [2, 2, 3, 5, 5, np.nan, np.nan], atol=1e-6)
    sentence = "has 2 pings before its first position or after its last, which are put there"
    assert part.problems == [f"a.xtf: {sentence}"]


def test_positions_far_apart_are_joined_but_not_over_half_a_minute(tmp_path: Path):
    motion = b"".join(xtf_files.attitude(BEGIN + t, 0, 0, 0, 360.0) for t in range(70))
    places = b"".join(xtf_files.position(BEGIN + t, EAST + t * 1e-5, 0.0) for t in (0.0, 20.0, 60.0))
    part = recorded(
        tmp_path / "a.xtf", xtf_files.header(motion={}) + motion + places + fan(BEGIN + 10) + fan(BEGIN + 30)
    )
    np.testing.assert_allclose((part.pings["east"] - EAST) * 1e5, [10, np.nan], atol=1e-6)


def test_a_fan_that_was_steered_forward_lies_forward(tmp_path: Path):
    tilt = np.deg2rad(10.0)
    part = still(tmp_path / "a.xtf", fan(tilt=tilt))
    np.testing.assert_allclose(
        part.soundings["along_m"], 60 / np.cos(np.deg2rad([45, 0, 45])) / 2 * np.sin(tilt), atol=0.01
    )
    assert part.problems == []
    odd = still(tmp_path / "b.xtf", fan(tilt=float("nan")), fan(BEGIN + 2, tilt=2.0))
    assert odd.skipped == {"pings that cannot be used": 2}
    assert "is steered by" in odd.problems[0]


def test_a_tilt_of_the_receiver_s_mount_is_reported(tmp_path: Path):
    pings = (fan(mount=np.deg2rad(30)), fan(BEGIN + 2, mount=np.deg2rad(-20)), fan(BEGIN + 3))
    part = still(tmp_path / "a.xtf", *pings)
    sentence = "has 2 pings whose sonar says that its receiver is mounted with a tilt of up to 30.0 degrees"
    assert part.problems == [f"a.xtf: {sentence}; only the offsets of the file's header are applied"]


def test_angles_of_the_motion_sensor_and_the_compass_are_reported(tmp_path: Path):
    part = still(tmp_path / "a.xtf", fan(), motion={"roll": 1.5, "pitch": -2.0, "yaw": 0.5}, navigation={"yaw": 90.0})
    assert part.problems == [
        "a.xtf: says that its motion sensor is turned by roll 1.5, pitch -2, yaw 0.5 degrees; this is not applied,"
        " because the format does not say whether the motion is corrected",
        "a.xtf: says that its headings are off by 90 degrees; this is not applied,"
        " because the format does not say whether they are corrected",
    ]


def test_a_head_that_the_header_lacks_is_reported_once(tmp_path: Path):
    content = xtf_files.bth0(BEGIN + 1, np.array([60 / SPEED]), np.array([0.0]))
    pings = [xtf_files.ping(65, BEGIN + 1, content, channel) for channel in (0, 1, 2)]
    part = still(tmp_path / "a.xtf", *pings, sonars=(FLAT | {"starboard": 5.0},))
    np.testing.assert_allclose(part.soundings["across_m"], 5, atol=0.01)
    sentence = "has 2 pings of sonars that its header lacks, which take the place and angles of the first"
    assert part.problems == [f"a.xtf: {sentence}"]
    part = still(tmp_path / "b.xtf", fan(), sonars=())
    sentence = "has no sonar in its header, which is taken to be level and at the vessel's reference point"
    assert part.problems == [f"b.xtf: {sentence}"]


def test_what_is_not_read_is_counted_by_its_type(tmp_path: Path):
    scans = xtf_files.ping(0, BEGIN, bytes(640)) * 3
    part = recorded(tmp_path / "scan.xtf", xtf_files.header() + scans)
    assert part.problems == ["scan.xtf: holds 3 packets of type 0 (side-scan sonar), which are not read"]
    assert part.skipped == {"pings of a kind that is not read": 3}
    assert len(part.soundings) == 0
    both = still(tmp_path / "both.xtf", fan(), xtf_files.ping(17, BEGIN, bytes(310)))
    assert "1 packets of type 17 (processed bathymetry XYZA)" in both.problems[0]
    assert len(both.soundings) == 3


def test_a_file_of_positions_alone_says_so(tmp_path: Path):
    part = recorded(tmp_path / "a.xtf", xtf_files.header() + xtf_files.position(BEGIN, EAST, 0) * 4)
    assert part.problems == ["a.xtf: has no pings; of its packets are 4 of type 107"]


def test_an_unknown_packet_is_passed_over_by_its_length(tmp_path: Path):
    part = still(tmp_path / "a.xtf", xtf_files.packet(231, b"\xce\xfa" * 500), fan())
    assert len(part.soundings) == 3
    assert part.problems == []


def test_a_file_that_was_cut_off_gives_what_is_before(tmp_path: Path):
    content = xtf_files.survey(Ship())
    last = content.rindex(b"BTH0") - 256
    part = recorded(tmp_path / "a.xtf", content[: last + 300])
    assert len(part.pings) == 11
    assert part.skipped == {"pings in damaged bytes": 1}
    assert part.problems == [f"a.xtf: 300 bytes from byte {last} on are damaged or cut off"]


def test_a_damaged_length_or_mark_costs_its_packet_alone(tmp_path: Path):
    for offset, value in ((10, b"\xff\xff\xff\x7f"), (10, b"\x20\0\0\0"), (0, b"\0"), (11, b"\x07")):
        second = bytearray(fan(BEGIN + 2))
        second[offset : offset + len(value)] = value
        part = still(tmp_path / "a.xtf", fan(BEGIN), fan(), bytes(second), fan(BEGIN + 3))
        assert list(part.pings["time_s"] - BEGIN) == [0, 1, 3]
        assert f"{len(second)} bytes from byte" in part.problems[0]


def test_sections_of_a_ping_that_do_not_fit_cost_the_ping(tmp_path: Path):
    for offset, value in ((256 + 4, 60_000_000), (256 + 12 + 2, 0), (256 + 12 + 112, 0xFFFFFFFF)):
        broken = bytearray(fan(BEGIN + 2))
        struct.pack_into(">I", broken, offset, value)
        part = still(tmp_path / "a.xtf", fan(), bytes(broken))
        assert len(part.pings) == 1
        assert part.skipped == {"pings that cannot be used": 1}
        assert "cannot be used: it" in part.problems[0]


def test_garbage_behind_a_good_beginning_does_not_hang(tmp_path: Path):
    content = xtf_files.survey(Ship(), pings=3)
    noise = np.random.default_rng(1).integers(0, 256, 1 << 20, dtype=np.uint8).tobytes()
    head = struct.pack("<2sBBHHHI", b"\xce\xfa", 65, 0, 1, 0, 0, 1 << 17)
    for filling in (noise, bytes(1 << 20), b"\xce\xfa" * (1 << 19), head * (1 << 16)):
        assert len(recorded(tmp_path / "a.xtf", content + filling).pings) == 3


def test_what_is_no_xtf_file_is_refused_in_a_sentence(tmp_path: Path):
    path = tmp_path / "a.xtf"
    for content, word in ((b"{", "ends at byte 1"), (b"{" + bytes(5000), "no packet"), (bytes(1024), "no packet")):
        path.write_bytes(content)
        with pytest.raises(xtf.XtfError, match=word):
            list(xtf.read(path))
    with pytest.raises(xtf.XtfError, match="cannot be read"):
        list(xtf.read(tmp_path / "none.xtf"))


def test_a_file_is_recognised_by_its_first_packet_and_not_by_a_brace():
    assert xtf.begins(xtf_files.header() + fan())
    assert xtf.begins(xtf_files.header() + bytes(1024) + fan())
    assert not xtf.begins(b'{"a": 1}' + bytes(4000))


def test_a_header_of_several_blocks_is_passed(tmp_path: Path):
    content = xtf_files.survey(Ship(), pings=2)
    part = recorded(tmp_path / "a.xtf", content[:1024] + bytes(1024) + content[1024:])
    assert len(part.pings) == 2
    assert part.problems == []


def test_parts_hold_what_one_part_would(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.xtf"
    expected = recorded(path, xtf_files.survey(Ship()))
    monkeypatch.setattr(xtf, "PART", 100)
    monkeypatch.setattr(xtf, "_BATCH", 60)
    parts = list(xtf.read(path))
    assert len(parts) > 2
    pd.testing.assert_frame_equal(pd.concat([part.pings for part in parts], ignore_index=True), expected.pings)
    columns = ["beam", "along_m", "across_m", "down_m", "quality"]
    together = pd.concat([part.soundings[columns] for part in parts], ignore_index=True)
    pd.testing.assert_frame_equal(together, expected.soundings[columns])


def test_damaged_files_end_in_a_sentence_or_in_finite_soundings(tmp_path: Path):
    rng, path = random.Random(6), tmp_path / "a.xtf"
    contents = [xtf_files.survey(Ship(), kind, content, pings=3) for kind, content in CONTENTS]
    outcomes = set()
    for _ in range(150):
        path.write_bytes(damage.mutated(rng.choice(contents), rng))
        try:
            parts = list(xtf.read(path))
        except xtf.XtfError:
            outcomes.add("refused")
            continue
        for part in parts:
            places = part.soundings[["along_m", "across_m", "down_m"]].to_numpy()
            assert np.abs(places).max(initial=0.0) < 13_000
            assert part.soundings["ping"].max() < len(part.pings) or part.soundings.empty
            outcomes.add("told" if part.problems or part.skipped else "read")
    assert {"told", "read"} <= outcomes


def seabed(part: Recording) -> pd.DataFrame:
    """Return the soundings of a recording on a map: metres, and the ping of each."""
    pings = part.pings.iloc[part.soundings["ping"]].reset_index(drop=True)
    cos, sin = np.cos(pings["heading_rad"]), np.sin(pings["heading_rad"])
    along, across = part.soundings["along_m"], part.soundings["across_m"]
    scale = DEGREE_M * np.cos(np.deg2rad(pings["north"].mean()))
    east = (pings["east"] - pings["east"][0]) * scale + along * sin + across * cos
    north = (pings["north"] - pings["north"][0]) * DEGREE_M + along * cos - across * sin
    return part.soundings.assign(east=east, north=north)


def disagreement(part: Recording) -> float:
    """Return the median over cells of 1 m of the spread in depth between runs of 40 pings, metres."""
    table = seabed(part)
    cells = [table["east"] // 1, table["north"] // 1, table["ping"] // 40]
    means = table["down_m"].groupby(cells).mean()
    return float(means.groupby(level=[0, 1]).std().median())


@pytest.fixture(scope="module")
def pier() -> Recording:
    (part,) = xtf.read(PIER)
    return part


@real
def test_the_real_survey_has_the_counts_that_are_known(pier: Recording):
    assert (len(pier.pings), len(pier.soundings)) == (923, 923 * 256)
    assert (pier.soundings["quality"] == 0).all()
    assert (pier.skipped, pier.problems) == ({}, [])
    assert pier.sensor == "R2Sonic 2026, serial 100996-2026"
    np.testing.assert_allclose(pier.soundings["down_m"].quantile([0.01, 0.5, 0.99]), [13.55, 13.81, 14.18], atol=0.01)
    assert np.ptp(pier.pings["time_s"]) == pytest.approx(48.10, abs=0.01)


@real
def test_neighbouring_pings_of_the_real_survey_agree_and_would_not_with_a_wrong_sign(
    pier: Recording, monkeypatch: pytest.MonkeyPatch
):
    right = disagreement(pier)
    assert right < 0.035

    def turned(**signs: float) -> float:
        def motion(streams: xtf_streams.Streams, time: np.ndarray) -> raytrace.Motion:
            true_motion = original(streams, time)
            return replace(true_motion, **{name: sign * getattr(true_motion, name) for name, sign in signs.items()})

        original = xtf_streams.Streams.motion
        with monkeypatch.context() as changed:
            changed.setattr(xtf_streams.Streams, "motion", motion)
            (part,) = xtf.read(PIER)
        return disagreement(part)

    assert turned(roll=-1) > 4 * right
    assert turned(roll=0) > 2 * right
    assert turned(heave=-1) > 1.2 * right
    with monkeypatch.context() as changed:
        original = r2sonic.fan

        def mirrored(content: bytes) -> r2sonic.Fan | str:
            fan = original(content)
            return fan if isinstance(fan, str) else replace(fan, angle=-fan.angle)

        changed.setitem(xtf._DECODERS, 65, mirrored)
        (part,) = xtf.read(PIER)
    assert disagreement(part) > 4 * right


@real
def test_the_real_seabed_is_level_across_by_the_sonar_s_mounting_and_free_of_roll(
    pier: Recording, monkeypatch: pytest.MonkeyPatch
):
    def slopes(part: Recording) -> np.ndarray:
        down, across = (part.soundings[name].to_numpy().reshape(-1, 256) for name in ("down_m", "across_m"))
        away = across - across.mean(1, keepdims=True)
        return np.rad2deg((away * down).sum(1) / (away**2).sum(1))

    tilts, roll = slopes(pier), np.rad2deg(pier.pings["roll_rad"])
    assert abs(tilts.mean()) < 0.1
    assert abs(np.polyfit(roll, tilts, 1)[0]) < 0.01  # degrees of slope per degree of roll
    header = xtf_packets.header

    def unturned(window: Window) -> FileHeader | None:
        read = header(window)
        assert read
        return replace(read, sonars=(replace(read.sonars[0], roll=0.0),))

    monkeypatch.setattr(xtf_packets, "header", unturned)
    (part,) = xtf.read(PIER)
    assert abs(slopes(part).mean()) == pytest.approx(1.77, abs=0.1)


@real
def test_an_independent_reader_finds_the_same_positions_and_motion():
    pyxtf = pytest.importorskip("pyxtf")
    header, packets = pyxtf.xtf_read(str(PIER))
    with Window(PIER) as window, Window(PIER, 64) as probe:
        ours = xtf_packets.header(window)
        streams = xtf_streams.Streams(0.0, True)
        for packet in xtf_packets.walk(window, probe, lambda *_: None):
            streams.take(packet, window.read(packet.offset, 64))
    places = packets[pyxtf.XTFHeaderType.pos_raw_navigation]
    motion = packets[pyxtf.XTFHeaderType.attitude]
    np.testing.assert_array_equal(
        streams.positions.of_most.table[:, 1:], [(p.RawXcoordinate, p.RawYcoordinate) for p in places]
    )
    np.testing.assert_array_equal(
        streams.attitude.table[:, 1:], [(p.Roll, p.Pitch, p.Heading, p.Heave) for p in motion]
    )
    assert ours
    channel, sonar = header.ChanInfo[0], ours.sonars[0]
    assert (sonar.starboard, sonar.forward, sonar.down) == (channel.OffsetX, channel.OffsetY, channel.OffsetZ)
    assert (sonar.roll, sonar.pitch, sonar.yaw) == (channel.OffsetRoll, channel.OffsetPitch, channel.OffsetYaw)
    assert xtf_swaths.vertical(ours).startswith("below the vessel's reference point")
