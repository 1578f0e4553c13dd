"""LAS and LAZ: points equal an independent reader's, with their CRS; damage costs only the damaged points."""

import io
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
from pyproj import CRS

from damage import corrupted
from las_files import write
from pointnetkl.readers import projection
from pointnetkl.readers.formats import las, recording
from pointnetkl.readers.formats.las.header import LasError
from pointnetkl.readers.formats.recording import IMPOSSIBLE, POINT_COLUMNS, REJECTED, Recording
from pointnetkl.surveys.survey import POINTS
from realdata import REALDATA

CORRIDOR = REALDATA / "laz/kimberley_corridor_1m.laz"
RNG = np.random.default_rng(0)
both = pytest.mark.parametrize("name", ["a.las", "a.laz"])


def read(path: Path) -> Recording:
    """Read a small file, which is one part."""
    (part,) = las.read(path)
    assert list(part.soundings) == list(POINT_COLUMNS)
    assert (part.kind, len(part.pings)) == (POINTS, 0)
    return part


def changed(path: Path, *patches: tuple[int, str, float]) -> Path:
    """Put numbers into a file, each at its byte."""
    content = bytearray(path.read_bytes())
    for offset, form, value in patches:
        struct.pack_into(form, content, offset, value)
    path.write_bytes(content)
    return path


@both
@pytest.mark.parametrize("kind", range(11))
def test_the_points_are_those_that_were_written(tmp_path: Path, kind: int, name: str):
    path = write(tmp_path / name, kind=kind)
    expected = laspy.read(path)
    part = read(path)
    np.testing.assert_allclose(part.soundings[["east", "north", "up_m"]], expected.xyz, rtol=0, atol=1e-9)
    assert part.crs == "EPSG:32633"
    assert not part.skipped
    assert not part.problems


@pytest.mark.skipif(not CORRIDOR.exists(), reason="no real data here")
def test_the_real_corridor_has_its_points_and_its_crs():
    parts = list(las.read(CORRIDOR))
    points = np.concatenate([part.soundings[["east", "north", "up_m"]] for part in parts])
    assert len(points) == 890_647
    np.testing.assert_allclose(points, laspy.read(CORRIDOR).xyz, rtol=0, atol=1e-6)
    assert {part.crs for part in parts} == {"EPSG:32751"}
    assert (points[:, 2].min(), points[:, 2].max()) == (-48.97, -31.17)
    assert max(len(part.soundings) for part in parts) < 2 * recording.PART
    assert not any(part.problems or part.skipped for part in parts)


@both
@pytest.mark.parametrize("kind", [0, 6])
def test_noise_withheld_points_and_the_water_surface_are_no_seabed(tmp_path: Path, kind: int, name: str):
    classes = [0, 2, 7, 18, 9, 1] + ([40, 41, 42, 45] if kind else [])
    withheld = np.arange(len(classes)) == 5
    path = write(tmp_path / name, len(classes), kind, classification=classes, withheld=withheld)
    expected = [0, 0, REJECTED, REJECTED, 0, REJECTED] + ([0, REJECTED, REJECTED, IMPOSSIBLE] if kind else [])
    assert list(read(path).soundings["quality"]) == expected


def test_heights_above_zero_are_depths_unless_a_vertical_crs_says_otherwise(tmp_path: Path):
    part = read(write(tmp_path / "a.las", z=50.0))
    assert part.soundings["up_m"].max() < -40
    assert "taken as depth" in part.vertical
    named = read(write(tmp_path / "b.las", z=50.0, crs="EPSG:32633+5703"))
    assert named.soundings["up_m"].min() > 40
    assert (named.crs, named.vertical) == ("EPSG:32633", "NAVD88 height")
    deep = read(write(tmp_path / "c.las", z=50.0, crs="EPSG:32633+5831"))
    assert deep.soundings["up_m"].max() < -40
    assert "depth" in deep.vertical


@pytest.mark.parametrize(
    ("keys", "up_m", "cause"),
    [
        ({4096: 5703}, 5.0, "NAVD88 height"),
        ({4096: 5715}, -5.0, "MSL depth"),
        ({4096: 6360}, 5 * 1200 / 3937, "NAVD88 height (ftUS)"),
        ({4096: 5703, 4099: 9002}, 5 * 0.3048, "NAVD88 height"),
        ({4096: 5103}, 5.0, "NAVD88 height"),  # as GeoTIFF 1.0 numbers it
        ({4096: 5030}, 5.0, "height above an ellipsoid"),
        ({4096: 32767}, -5.0, "z taken as depth"),
        ({}, -5.0, "z taken as depth"),
    ],
)
@pytest.mark.parametrize("level", [3072, None])
def test_the_vertical_key_says_which_way_heights_count_and_in_which_unit(
    tmp_path: Path, level: int | None, keys: dict[int, int], up_m: float, cause: str
):
    path = tmp_path / "a.las"
    entries = ({3072: 26916} if level else {}) | keys
    header = laspy.LasHeader(point_format=1)
    words = [1, 1, 0, len(entries), *(word for key, value in entries.items() for word in (key, 0, 1, value))]
    header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", struct.pack(f"<{len(words)}H", *words)))
    points = laspy.LasData(header)
    points.x, points.y, points.z = [1.0, 2.0], [3.0, 4.0], [5.0, 5.0]
    points.write(str(path))
    part = read(path)
    assert part.crs == ("EPSG:26916" if level else projection.LOCAL)
    assert part.soundings["up_m"].to_list() == pytest.approx([up_m, up_m], abs=1e-9)
    assert part.vertical.startswith(cause)


def test_heights_of_a_crs_of_three_axes_are_up(tmp_path: Path):
    path = write(tmp_path / "a.las", crs=CRS.from_epsg(32633).to_3d(), z=50.0)
    part = read(path)
    assert (part.crs, part.soundings["up_m"].min() > 40) == ("EPSG:32633", True)
    assert part.vertical == "height above the ellipsoid of WGS 84 / UTM zone 33N"


@pytest.mark.parametrize(
    ("raised", "passes"),
    [
        (lazrs.LazrsError, False),
        (type("PanicException", (BaseException,), {"__module__": "pyo3_runtime"}), False),
        (MemoryError, True),
        (type("HangError", (BaseException,), {}), True),
    ],
)
def test_of_what_stops_a_chunk_only_damage_is_taken_for_damage(
    tmp_path: Path, raised: type[BaseException], passes: bool, monkeypatch: pytest.MonkeyPatch
):
    def fail(*arguments: object) -> None:
        raise raised

    path = write(tmp_path / "a.laz")
    monkeypatch.setattr(lazrs, "LasZipDecompressor", fail)
    with pytest.raises(raised if passes else LasError):
        read(path)


def test_heights_in_feet_are_brought_to_metres_and_maps_in_feet_are_refused(tmp_path: Path):
    part = read(write(tmp_path / "a.las", crs="EPSG:32633+8228"))  # NAVD88 height (ft)
    assert part.soundings["up_m"].median() == pytest.approx(-50 * 0.3048, abs=0.2)
    with pytest.raises(LasError, match="is in US survey foot, must be in metres"):
        read(write(tmp_path / "b.las", crs=2227))


def test_a_file_may_be_in_degrees_or_say_nothing_of_its_place(tmp_path: Path):
    header = laspy.LasHeader(point_format=6)
    header.scales = [1e-7, 1e-7, 0.01]
    header.add_crs(CRS.from_epsg(4326))
    points = laspy.LasData(header)
    points.x, points.y, points.z = [10.5, 200.25, 3.0], [60.5, 60.25, 91.0], [-3.0, -4.0, -5.0]
    points.write(str(tmp_path / "a.las"))
    part = read(tmp_path / "a.las")
    assert part.crs == projection.GEOGRAPHIC
    np.testing.assert_allclose(part.soundings["east"], [10.5, -159.75], atol=1e-6)
    assert part.skipped == {"soundings without a position on the earth": 1}
    assert read(write(tmp_path / "b.las", crs=None)).crs == projection.LOCAL


@pytest.mark.parametrize("kind", [1, 7])
def test_a_damaged_chunk_costs_no_other(tmp_path: Path, kind: int):
    path = write(tmp_path / "a.laz", 120_000, kind)
    content = bytearray(path.read_bytes())
    offset = struct.unpack_from("<I", content, 96)[0] + 8 + 100 + (len(content) // 2 if kind == 1 else 0)
    content[offset : offset + 40] = bytes(40)
    path.write_bytes(content)
    parts = list(las.read(path))
    assert sum(len(part.soundings) for part in parts) == 70_000
    assert parts[-1].skipped == {"points of damaged chunks": 50_000}
    assert "are a damaged chunk of 50000 points" in parts[-1].problems[0]


@pytest.mark.parametrize("kind", [1, 7])
def test_a_compressed_file_that_is_cut_gives_its_whole_chunks(tmp_path: Path, kind: int):
    path = write(tmp_path / "a.laz", 120_000, kind)
    path.write_bytes(path.read_bytes()[: -path.stat().st_size // 8])
    parts = list(las.read(path))
    assert sum(len(part.soundings) for part in parts) == 100_000
    assert any("damaged or cut off" in problem for problem in parts[-1].problems)
    expected = laspy.read(write(tmp_path / "b.laz", 120_000, kind)).xyz[:100_000]
    np.testing.assert_allclose(np.concatenate([p.soundings[["east", "north", "up_m"]] for p in parts]), expected)


def variable_chunks(path: Path, kind: int, sizes: list[int]) -> Path:
    """Compress the points of a file again, in chunks of these sizes, as cloud-optimised files are."""
    plain = laspy.read(path)
    content = path.read_bytes()
    with laspy.open(path) as opened:
        record = opened.header.vlrs.get("LasZipVlr")[0].record_data
    vlr = lazrs.LazVlr.new_for_compression(kind, 0, True)
    head = content[: struct.unpack_from("<I", content, 96)[0]].replace(record, vlr.record_data())
    target = io.BytesIO()
    target.write(head)
    rows = np.frombuffer(plain.points.array.tobytes(), np.uint8).reshape(len(plain.points), -1)
    cuts = np.split(rows, np.cumsum(sizes)[:-1])
    compressor = lazrs.LasZipCompressor(target, vlr)
    compressor.compress_chunks([cut.reshape(-1) for cut in cuts])
    compressor.done()
    path.write_bytes(target.getvalue())
    return path


@pytest.mark.parametrize("kind", [1, 7])
def test_chunks_may_be_of_any_size(tmp_path: Path, kind: int):
    expected = laspy.read(write(tmp_path / "a.laz", 600, kind)).xyz
    path = variable_chunks(tmp_path / "a.laz", kind, [100, 299, 1, 200])
    part = read(path)
    np.testing.assert_allclose(part.soundings[["east", "north", "up_m"]], expected, rtol=0, atol=1e-9)
    assert not part.problems
    content = bytearray(path.read_bytes())
    offset = struct.unpack_from("<I", content, 96)[0] + 8 + 40
    content[offset : offset + 60] = bytes(60)
    path.write_bytes(content)
    damaged = read(path)
    np.testing.assert_allclose(damaged.soundings[["east", "north", "up_m"]], expected[100:], rtol=0, atol=1e-9)
    assert damaged.skipped == {"points of damaged chunks": 100}


def test_a_file_that_is_cut_gives_the_points_that_it_has(tmp_path: Path):
    path = write(tmp_path / "a.las", 1000, 1)
    path.write_bytes(path.read_bytes()[: -28 * 100 - 5])
    part = read(path)
    assert len(part.soundings) == 899
    assert part.skipped == {"points cut off": 101}


def test_a_count_that_is_not_true_is_reported(tmp_path: Path):
    part = read(changed(write(tmp_path / "a.las", 100, 1), (107, "<I", 60)))
    assert len(part.soundings) == 60
    assert "its header says 60 points, and it has room for 100; 60 are read" in part.problems[0]
    part = read(changed(write(tmp_path / "a.las", 100, 1), (107, "<I", 4_000_000_000)))
    assert (len(part.soundings), part.skipped) == (100, {"points cut off": 3_999_999_900})
    part = read(changed(write(tmp_path / "a.las", 100, 1), (107, "<I", 0)))
    assert len(part.soundings) == 100
    assert "its header says 0 points, and it has room for 100; 100 are read" in part.problems[0]


def test_points_beyond_the_stated_bounds_are_impossible_unless_most_are(tmp_path: Path):
    path = write(tmp_path / "a.las", 100, 1)
    first = struct.unpack_from("<I", path.read_bytes(), 96)[0]
    part = read(changed(path, (first, "<i", 2_000_000_000)))
    assert list(part.soundings["quality"]) == [IMPOSSIBLE] + 99 * [0]
    assert "1 of 100 points lie beyond the bounds" in part.problems[0]
    part = read(changed(write(path, 100, 1), (131, "<d", 10.0)))
    assert (part.soundings["quality"] == 0).all()
    assert "bounds, scales or offsets of its header are wrong" in part.problems[0]


@pytest.mark.parametrize(
    ("patch", "cause"),
    [
        ((0, "<I", 0), "must begin with LASF"),
        ((24, "<B", 7), "version 7"),
        ((96, "<I", 2**32 - 1), "points from byte 4294967295 on"),
        ((104, "<B", 60), "points of format 60"),
        ((105, "<H", 3), "in 3 bytes do not exist"),
        ((131, "<d", float("nan")), "give no coordinates"),
    ],
)
def test_a_head_that_contradicts_itself_is_refused_in_a_sentence(tmp_path: Path, patch: tuple, cause: str):
    with pytest.raises(LasError, match=cause) as caught:
        read(changed(write(tmp_path / "a.las"), patch))
    assert str(tmp_path / "a.las") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_counts_of_records_and_chunks_are_not_trusted(tmp_path: Path):
    path = write(tmp_path / "a.laz", kind=1)
    content = path.read_bytes()
    first = struct.unpack_from("<I", content, 96)[0]
    table = struct.unpack_from("<q", content, first)[0]
    assert len(read(changed(path, (100, "<I", 2**32 - 1))).soundings) == 300
    part = read(changed(path, (table + 4, "<I", 2**32 - 1)))
    assert len(part.soundings) == 300
    assert "its table of chunks is missing or damaged" in part.problems[0]
    with pytest.raises(LasError, match="LASzip record"):
        read(changed(path, (content.index(b"laszip encoded"), "<B", 0)))


@both
def test_a_file_that_ends_within_its_head_is_refused(tmp_path: Path, name: str):
    content = write(tmp_path / name).read_bytes()
    for size in (1, 4, 100, 210, 226, 227, 300, 375, 400):
        (tmp_path / name).write_bytes(content[:size])
        with pytest.raises(LasError, match=r"byte (0|24)"):
            read(tmp_path / name)


@both
def test_mutated_files_end_in_a_sentence_or_in_declared_points(tmp_path: Path, name: str):
    content = write(tmp_path / name, 100, 7 if name == "a.laz" else 1).read_bytes()
    rng = np.random.default_rng(8)
    for _ in range(300):
        (tmp_path / name).write_bytes(corrupted(content, rng))
        try:
            parts = list(las.read(tmp_path / name))
        except LasError as error:
            sentence = str(error)
            assert "\n" not in sentence
        else:
            assert all(np.isfinite(part.soundings.to_numpy(float)).all() for part in parts)


def test_a_file_is_recognised_by_its_first_bytes():
    assert las.begins(b"LASF\0\0")
    assert not las.begins(io.BytesIO(b"PAR1").read())
