"""Texts of points: columns by name or by place, with any separator; damage costs only its line."""

from pathlib import Path

import numpy as np
import pytest

from damage import corrupted
from generic_files import rows
from pointnetkl.readers import projection
from pointnetkl.readers.formats import generic, recording, xyz
from pointnetkl.readers.formats.recording import POINT_COLUMNS, Recording
from pointnetkl.readers.formats.xyz import XyzError, number_lines
from pointnetkl.surveys.survey import POINTS

NUMBERS = "500000.25 6000001.5 -30.75\n500001 6000002 -31\n"


def read(path: Path, content: str | bytes, name: str = "a.xyz") -> Recording:
    """Write a small text and read it, in one part."""
    path = path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    (part,) = xyz.read(path)
    assert list(part.soundings) == list(POINT_COLUMNS)
    assert (part.kind, len(part.pings)) == (POINTS, 0)
    return part


def places(part: Recording) -> list[list[float]]:
    """Return x, y and height of the points."""
    return part.soundings[["east", "north", "up_m"]].to_numpy().tolist()


@pytest.mark.parametrize(
    "content",
    [
        NUMBERS,
        NUMBERS.replace(" ", "\t  ").replace("\n", "  \r\n"),
        NUMBERS.replace(" ", ", "),
        NUMBERS.replace(" ", ";").replace(".", ","),
        "500000,25 6000001,5 -30,75\n500001,0 6000002,0 -31,0\n",
        "# a survey\n\n  " + NUMBERS.replace("\n", "\n// said between\n"),
        "2\n" + NUMBERS.replace("\n", " 77 1 2 3\n"),
        "\ufeffX,Y,Z\n" + NUMBERS.replace(" ", ","),
        '"Easting (m)","Northing (m)","Elevation (m)"\n' + NUMBERS.replace(" ", ","),
        "Z;id;Footprint Y;Footprint X\n-30.75;7;6000001.5;500000.25\n-31;8;6000002;500001\n",
        "# y [m] x [m] depth [m]\n6000001.5 500000.25 30.75\n6000002 500001 31\n",
        "North_m\tEast_m\tWater depth\n6000001.5\t500000.25\t30.75\n6000002\t500001\t31\n",
        "a title of three words\nof someone\n" + NUMBERS.rstrip(),
        "date,x,y,z\n2020-01-01,500000.25,6000001.5,-30.75\n2020-01-01,500001,6000002,-31\n",
        NUMBERS.replace("\n", "\r"),
    ],
)
def test_points_are_the_same_however_they_are_written(tmp_path: Path, content: str):
    part = read(tmp_path, content)
    assert places(part) == [[500000.25, 6000001.5, -30.75], [500001.0, 6000002.0, -31.0]]
    assert not part.problems
    assert part.crs == projection.LOCAL


def test_which_way_z_counts_is_by_its_name_else_by_its_sign_and_is_said(tmp_path: Path):
    for content, up, cause in (
        ("1 2 30\n", -30, "taken as depth, because most are above zero"),
        ("1 2 -30\n", -30, "taken as height, because most are not above zero"),
        ("x,y,depth\n1,2,30\n", -30, "z is depth by the name"),
        ("x,y,depth\n1,2,-30\n", -30, "is named depth but is negative"),
        ("x,y,elevation\n1,2,30\n", 30, "z is height by the name"),
        ("x,y,depth_ft\n1,2,10\n", -3.048, "in feet, brought to metres"),
    ):
        part = read(tmp_path, content)
        assert places(part) == [[1.0, 2.0, pytest.approx(up)]]
        assert cause in part.vertical


def test_longitude_and_latitude_are_recognised_by_their_names(tmp_path: Path):
    part = read(tmp_path, "Latitude (deg),Longitude (deg),Depth (m)\n60.5,10.25,30\n95,10,30\n60,350.5,31\n")
    assert part.crs == projection.GEOGRAPHIC
    assert places(part) == [[10.25, 60.5, -30.0], [-9.5, 60.0, -31.0]]
    assert part.skipped == {"soundings without a position on the earth": 1}


def test_many_points_within_a_unit_are_degrees_unless_their_columns_have_names(tmp_path: Path):
    place = np.random.default_rng(0).uniform(0, 0.1, (200, 2))
    lines = "".join(f"{10 + x:.7f} {60 + y:.7f} 30\n" for x, y in place)
    part = read(tmp_path, lines)
    assert part.crs == projection.GEOGRAPHIC
    assert "taken as longitude and latitude" in part.problems[0]
    assert read(tmp_path, "x y z\n" + lines).crs == projection.LOCAL


def test_the_crs_may_stand_beside_the_file(tmp_path: Path):
    (tmp_path / "a.crs").write_text("EPSG:3067\n")
    assert read(tmp_path, NUMBERS).crs == "EPSG:3067"


def test_lines_that_are_not_numbers_are_counted_and_cost_no_other(tmp_path: Path):
    damaged = "500002 60#0\xff0 -32\n500003 6000004\n500003 6000004 -33 9\n5\0 6 7\n500004 6000005 nan\n"
    part = read(tmp_path, (NUMBERS + damaged + NUMBERS).encode("latin-1"))
    assert len(part.soundings) == 4
    assert part.skipped == {"lines that are not numbers": 4, "points that are not finite": 1}
    assert "4 lines are not numbers" in part.problems[0]
    part = read(tmp_path, "3\n" + NUMBERS)
    assert "its first line says 3 points, it has 2" in part.problems[0]


def test_a_large_text_is_read_in_parts_and_no_line_is_lost_between_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(number_lines, "_BLOCK", 1000)
    monkeypatch.setattr(recording, "PART", 100)
    numbers = np.random.default_rng(0).uniform(1000, 2000, (1000, 3)).round(2) * [1, 1, -1]
    for end in ("\n", "\r\n"):
        path = tmp_path / "a.xyz"
        path.write_bytes("".join(" ".join(f"{v:.2f}" for v in row) + end for row in numbers).encode() + b"spoilt")
        parts = list(xyz.read(path))
        assert len(parts) > 5
        assert max(len(part.soundings) for part in parts) < 200
        np.testing.assert_array_equal(np.concatenate([places(part) for part in parts]), numbers)
        assert [part.skipped for part in parts if part.skipped] == [{"lines that are not numbers": 1}]


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "byte 0: begins with"),
        (b"some words and no number\n" * 50, "byte 0: begins with"),
        (b"id,lat,lon\n1,2,3\n", "its columns are id, lat, lon; name those of the points x, y and z"),
        (b"x (ft),y (ft),z\n1,2,3\n", "in feet, must be in metres"),
        (b"id,a\x1b[2J\x07,lon\n1,2,3\n", r"its columns are id, a\?\[2j\?, lon; name"),
        (b"ncols 3\nnrows 2\n1 2 3\n4 5 6\n", "is a grid in text"),
    ],
)
def test_what_is_no_text_of_points_is_refused_in_a_sentence(tmp_path: Path, content: bytes, cause: str):
    with pytest.raises(XyzError, match=cause) as caught:
        read(tmp_path, content)
    assert str(caught.value).startswith(str(tmp_path / "a.xyz"))
    assert str(caught.value).isprintable()


def test_a_table_of_pings_is_no_text_of_points(tmp_path: Path):
    rows().to_csv(tmp_path / "a.csv", index=False)
    head = (tmp_path / "a.csv").read_bytes()[:4096]
    assert generic.begins(head)
    assert not xyz.begins(head)
    assert xyz.begins(NUMBERS.encode())
    assert not generic.begins(NUMBERS.encode())


@pytest.mark.parametrize("head", ["", "x,y,depth\n", "Easting;Northing;Z\n"])
def test_mutated_texts_end_in_a_sentence_or_in_finite_points(tmp_path: Path, head: str):
    separator = ";" if ";" in head else "," if head else " "
    content = (head + NUMBERS.replace(" ", separator) * 10).encode()
    rng = np.random.default_rng(8)
    for _ in range(200):
        (tmp_path / "a.xyz").write_bytes(corrupted(content, rng))
        try:
            parts = list(xyz.read(tmp_path / "a.xyz"))
        except XyzError as error:
            sentence = str(error)
            assert "\n" not in sentence
        else:
            assert all(np.isfinite(part.soundings.to_numpy(float)).all() for part in parts)


def test_numbers_that_stand_for_none_are_no_depths(tmp_path: Path):
    part = read(tmp_path, "1 2 -20\n2 3 -9999\n3 4 -21\n4 5 -32768\n")
    assert part.soundings["quality"].tolist() == [0, 2, 0, 2]
