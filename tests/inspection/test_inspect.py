"""`python -m pointnetkl inspect`: the facts of any raw file."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from generic_files import geographic, parquet, rows
from pointnetkl import __main__ as command
from pointnetkl import readers
from pointnetkl.inspection import cells, choice, tally
from pointnetkl.readers import FORMATS
from pointnetkl.readers.formats import xyz
from pointnetkl.readers.formats.recording import PING_COLUMNS, SOUNDING_COLUMNS, Recording
from pointnetkl.readers.projection import GEOGRAPHIC
from pointnetkl.surveys.survey import SOUNDINGS
from realdata import REALDATA

LEAST = {"file", "format", "pings", "soundings", "valid", "track_m", "depth_min_m", "depth_max_m", "skipped"}


def printed(capsys: pytest.CaptureFixture, *words: object) -> tuple[int, str, str]:
    """Return the exit status of `inspect` and what it printed."""
    capsys.readouterr()
    status = command.main(["inspect", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out, err


def objects(capsys: pytest.CaptureFixture, *words: object) -> list[dict[str, Any]]:
    """Return the JSON of `inspect`, which must have no NaN."""
    _, out, _ = printed(capsys, *words, "--json")
    return json.loads(out, parse_constant=pytest.fail)


def flagged() -> pd.DataFrame:
    """Return four pings of five beams in UTM zone 33, one of which has no place, and three bad soundings."""
    table = rows()
    table.loc[[1, 2], "quality"] = 1
    table.loc[3, "down_m"] = 5e6
    table.loc[15:, "x_m"] = np.nan
    return table


def test_json_has_the_numbers_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = parquet(tmp_path / "line.parquet", flagged())
    (facts,) = objects(capsys, path)
    assert facts.keys() >= LEAST
    assert (facts["file"], facts["format"], facts["kind"]) == (str(path), "generic pings", "pings")
    assert (facts["pings"], facts["pings_used"], facts["soundings"], facts["valid"]) == (4, 3, 20, 12)
    assert facts["beams"] == {"min": 5, "median": 5, "max": 5}
    assert facts["flagged"] == {"rejected": 2, "impossible": 1}
    assert facts["skipped"] == {"pings without a position on the earth": 1, "soundings of skipped pings": 5}
    assert facts["track_m"] == pytest.approx(20)
    assert (facts["depth_min_m"], facts["depth_max_m"]) == (50, 54)
    assert facts["swath_m"] == 40
    assert (facts["start"], facts["end"]) == ("2017-07-14T02:40:00.000Z", "2017-07-14T02:40:10.000Z")
    assert facts["crs"] == "EPSG:32633"
    assert facts["extent_m"] == [499_980, 6_000_000.5, 500_020, 6_000_020.5]
    assert (facts["longitude_deg"], facts["latitude_deg"]) == (15, pytest.approx(54.1481, abs=1e-4))
    assert "error" not in facts


def test_what_a_file_does_not_know_is_null(tmp_path: Path, capsys: pytest.CaptureFixture):
    (facts,) = objects(capsys, parquet(tmp_path / "line.parquet", rows(pings=1, beams=1).assign(quality=3), crs=None))
    unknown = (
        "depth_min_m",
        "depth_max_m",
        "depth_extremes_m",
        "swath_m",
        "extent_m",
        "longitude_deg",
        "sensor",
        "vertical",
    )
    assert [facts[name] for name in unknown] == [None] * len(unknown)
    assert (facts["crs"], facts["valid"], facts["track_m"]) == ("local", 0, 0)


def test_the_text_says_what_the_json_does(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = parquet(tmp_path / "line.parquet", flagged())
    status, out, err = printed(capsys, path)
    assert (status, err) == (0, "")
    name, *lines = out.rstrip("\n").splitlines()
    assert name == str(path)
    words = {line[2:12].strip(): line[12:] for line in lines}
    assert words["format"] == "generic pings"
    assert words["time"] == "2017-07-14 02:40:00.000 to 02:40:10.000 UTC, 10 s"
    assert words["pings"] == "4, 1 of them not used, 5 beams each"
    assert words["soundings"] == "20, 12 (60.0 %) valid; 2 rejected, 1 impossible"
    assert words["track"] == "20.0 m"
    assert words["depth"] == "50.00 to 54.00 m (98 % of the valid ones; all: 50.00 to 54.00 m)"
    assert words["CRS"].startswith("EPSG:32633 (WGS 84 / UTM zone 33N), from 54.14")
    assert words["skipped"] == "1 pings without a position on the earth, 5 soundings of skipped pings"


def test_a_damaged_file_among_good_ones_is_named_and_the_others_are_reported(tmp_path: Path):
    good, other = parquet(tmp_path / "a.parquet", rows()), parquet(tmp_path / "c.parquet", rows(pings=7))
    (tmp_path / "b.parquet").write_bytes(good.read_bytes()[:700])
    (tmp_path / "d.gsf").touch()
    files = [good, tmp_path / "b.parquet", other, tmp_path / "d.gsf", tmp_path / "gone.all"]
    words = [sys.executable, "-m", "pointnetkl", "inspect", *files, "--json"]
    result = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert result.returncode == 1
    assert [line.split(": ")[1] for line in result.stderr.splitlines()] == [str(files[k]) for k in (1, 3, 4)]
    assert all(line.startswith("error: ") for line in result.stderr.splitlines())
    facts = json.loads(result.stdout)
    assert [facts["file"] for facts in facts] == list(map(str, files))
    assert [facts["pings"] for facts in facts] == [4, None, 7, None, None]
    assert [facts.get("error") is None for facts in facts] == [True, False, True, False, False]
    assert "damaged Parquet file" in facts[1]["error"]
    assert facts[1]["format"] == "generic pings"
    assert all(facts.keys() >= LEAST for facts in facts)


def test_pings_that_have_no_place_are_counted_and_an_error(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = parquet(tmp_path / "lost.parquet", rows().assign(x_m=np.nan))
    status, out, err = printed(capsys, path)
    assert (status, "4 pings without a position" in err) == (1, True)
    assert "4, 4 of them not used" in out
    assert "20, 0 (0.0 %) valid" in out


def test_a_file_without_pings_is_no_error(tmp_path: Path, capsys: pytest.CaptureFixture):
    status, out, err = printed(capsys, parquet(tmp_path / "none.parquet", rows().head(0)), "--json", "--plot", tmp_path)
    (facts,) = json.loads(out)
    assert (status, err, facts["pings"], facts["soundings"], facts["track_m"]) == (0, "", 0, 0, None)
    assert list(tmp_path.glob("*.png")) == []


@pytest.mark.parametrize(("skipped", "status"), [({}, 0), ({"unreadable pings": 3}, 1)])
def test_pings_that_are_all_lost_are_an_error_and_none_at_all_is_not(
    skipped: dict[str, int], status: int, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    empty = [pd.DataFrame(columns=list(columns), dtype=float) for columns in (PING_COLUMNS, SOUNDING_COLUMNS)]
    told_by_reader = {
        "problems": ["a.lost: holds 60 positions"],
        "sensor": "Sonar 1",
        "vertical": "below the water line",
    }
    part = Recording("a.lost", GEOGRAPHIC, *empty, skipped, **told_by_reader)
    module = SimpleNamespace(SUFFIXES=(".lost",), begins=lambda head: head == b"lost", read=lambda path: iter([part]))
    monkeypatch.setitem(FORMATS, "Lost", module)
    (tmp_path / "a.lost").write_bytes(b"lost")
    exit_status, out, _ = printed(capsys, tmp_path / "a.lost", "--json")
    (facts,) = json.loads(out)
    assert (exit_status, facts["pings"], facts["skipped"]) == (status, 0, skipped)
    assert ("error" in facts) == (status == 1)
    assert (facts["format"], facts["sensor"], facts["vertical"]) == ("Lost", "Sonar 1", "below the water line")
    assert facts["problems"] == ["a.lost: holds 60 positions"]


def test_of_a_folder_every_raw_file_is_reported_in_natural_order_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    for name in ("line_10.parquet", "line_2.parquet", "deeper.parquet"):
        parquet(tmp_path / name, rows())
    (tmp_path / "sub").mkdir()
    (tmp_path / "deeper.parquet").rename(tmp_path / "sub/deeper.parquet")
    (tmp_path / "notes.md").write_text("about these lines\n")
    (tmp_path / "remarks.txt").write_text("waves 2 m\n")
    (tmp_path / "prices.csv").write_text("item,price\ncoffee,3\n")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    (tmp_path / ".hidden.parquet").write_bytes(b"PAR1")
    (tmp_path / "cut.gsf").touch()
    facts = objects(capsys, tmp_path)
    assert [facts["file"] for facts in facts] == [
        str(tmp_path / name) for name in ("cut.gsf", "line_2.parquet", "line_10.parquet", "sub/deeper.parquet")
    ]
    status, out, err = printed(capsys, tmp_path)
    assert (status, err.count("\n"), "cut.gsf: is empty" in err) == (1, 1, True)
    assert out.endswith("4 files, 12 pings, 60 soundings, 60 valid; 1 of the files cannot be used\n")


def test_inspect_and_ingest_choose_the_same_files_of_a_folder(tmp_path: Path):
    parquet(tmp_path / "line.parquet", rows())
    (tmp_path / "log.out").write_text("started\n")
    (tmp_path / "remarks.pts").write_text("waves 2 m\n")
    (tmp_path / "cut.gsf").touch()
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    np.savetxt(tmp_path / "surface.dat", np.random.default_rng(0).uniform(0, 9, (50, 3)), "%.2f")
    files_of_folder = choice.files([tmp_path])
    assert files_of_folder == readers.files(tmp_path)[0]
    assert [file.name for file in files_of_folder] == ["cut.gsf", "line.parquet", "surface.dat"]
    (tmp_path / "map.tif").write_bytes(b"II*\0")
    assert [file.name for file in choice.files([tmp_path])][2] == "map.tif"  # which is no survey


def test_a_folder_without_raw_files_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "empty").mkdir()
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts/a.md").write_text("a\n")
    path = parquet(tmp_path / "line.parquet", rows())
    status, out, err = printed(capsys, tmp_path / "empty", tmp_path / "texts", path)
    assert (status, err.count("has no raw files")) == (1, 2)
    assert str(path) in out


def test_a_zone_that_is_given_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = parquet(tmp_path / "line.parquet", geographic(5.99, 55.0))
    assert [objects(capsys, path, *zone)[0]["crs"] for zone in ([], ["--zone", "EPSG:32632"])] == [
        "EPSG:32631",
        "EPSG:32632",
    ]
    status, _, err = printed(capsys, path, "--zone", "32")
    assert (status, err) == (1, "error: --zone: utm_zone is '32', must be auto or a code such as EPSG:32633\n")


def test_plots_are_a_map_and_a_view_of_the_swaths(tmp_path: Path, capsys: pytest.CaptureFixture):
    path, out = parquet(tmp_path / "line.parquet", rows(pings=40, beams=30)), tmp_path / "drawn"
    (facts,) = objects(capsys, path, "--plot", out)
    assert facts["plots"] == [str(out / "line_map.png"), str(out / "line_swath.png")]
    for name in facts["plots"]:
        pixels = np.asarray(Image.open(name).convert("RGB"), float)
        assert pixels.shape[1] > 400
        assert pixels.std() > 5
    before = [Path(name).read_bytes() for name in facts["plots"]]
    printed(capsys, path, "--plot", out)
    assert [Path(name).read_bytes() for name in facts["plots"]] == before


def test_files_of_one_name_have_plots_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture):
    parquet(tmp_path / "line.parquet", rows())
    (tmp_path / "b").mkdir()
    shutil.copy(tmp_path / "line.parquet", tmp_path / "b/line.parquet")
    facts = objects(capsys, tmp_path / "line.parquet", tmp_path / "b/line.parquet", "--plot", tmp_path / "drawn")
    assert len({plot for facts in facts for plot in facts["plots"]}) == 4


def test_plot_before_a_file_does_not_take_it_for_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    parquet(Path("line.parquet"), rows())
    assert command.main(["inspect", "--plot", "line.parquet"]) == 0
    assert sorted(file.name for file in Path().glob("*.png")) == ["line_map.png", "line_swath.png"]
    assert command.main(["inspect", "--plot"]) == 1
    assert "no file is given" in capsys.readouterr().err


@pytest.mark.parametrize("beams", [1, 2, 7])
@pytest.mark.parametrize("pings", [1, 2])
def test_the_smallest_surveys_can_be_drawn(tmp_path: Path, pings: int, beams: int, capsys: pytest.CaptureFixture):
    path = parquet(tmp_path / "line.parquet", rows(pings=pings, beams=beams))
    assert printed(capsys, path, "--plot", tmp_path)[0] == 0
    assert (tmp_path / "line_map.png").stat().st_size > 3000
    assert (tmp_path / "line_swath.png").stat().st_size > 3000


def test_beams_whose_numbers_are_names_are_drawn_in_their_order(tmp_path: Path, capsys: pytest.CaptureFixture):
    table = rows()
    table["beam"] = table["beam"] * 400_000_000
    assert printed(capsys, parquet(tmp_path / "line.parquet", table), "--plot", tmp_path)[0] == 0
    assert (tmp_path / "line_swath.png").is_file()


def test_what_other_commands_take_is_named(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "network.pt").write_bytes(b"PK\x03\x04")
    status, _, err = printed(capsys, tmp_path / "network.pt")
    assert (status, err) == (
        1,
        f"error: {tmp_path / 'network.pt'}: is no raw data but a trained model, which `predict` takes\n",
    )


def test_points_without_pings_have_an_area_and_no_track(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(FORMATS, "XYZ", xyz)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(60.0), np.arange(40.0)))
    path = tmp_path / "surface.xyz"
    np.savetxt(path, np.column_stack([5e5 + x, 6e6 + y, -30 - x / 10]), "%.2f")
    (facts,) = objects(capsys, path, "--plot", tmp_path)
    assert (facts["format"], facts["kind"]) == ("XYZ", "points")
    assert (facts["pings"], facts["soundings"], facts["valid"], facts["track_m"], facts["beams"]) == (
        0,
        2400,
        2400,
        None,
        None,
    )
    assert facts["area_m2"] == pytest.approx(2400, rel=0.1)
    assert (facts["depth_min_m"], facts["depth_max_m"]) == (30, 35.9)
    assert facts["plots"] == [str(tmp_path / "surface_map.png")]
    out = printed(capsys, path)[1]
    assert "submaps are cut in tiles" in out
    assert "  pings" not in out


def test_navigation_has_a_track_and_no_soundings(tmp_path: Path, capsys: pytest.CaptureFixture):
    path, seconds = tmp_path / "mission.out", np.arange(0.0, 100.0, 0.5)
    records = np.zeros((len(seconds), 17))
    records[:, 0] = 3 * 86_400 + 3600 + seconds  # Wednesday, one in the morning
    records[:, 1], records[:, 2] = np.deg2rad(55.0), np.deg2rad(15.0 + 1e-5 * seconds)
    path.write_bytes(records.astype("<f8").tobytes())
    (facts,) = objects(capsys, path, "--plot", tmp_path)
    assert (facts["format"], facts["kind"], facts["records"], facts["pings"], facts["soundings"]) == (
        "SBET",
        "navigation",
        200,
        0,
        0,
    )
    assert facts["track_m"] == pytest.approx(99.5 * 1e-5 * 63_994, rel=1e-3)  # metres in a degree of longitude there
    assert (facts["week_s"], facts["duration_s"], facts["start"]) == ([262_800, 262_899.5], 99.5, None)
    assert facts["plots"] == [str(tmp_path / "mission_map.png")]
    out = printed(capsys, path)[1]
    assert "Wednesday 01:00:00 to 01:01:39 of a week that the file does not name, 1 min 40 s" in out
    assert "it may take the place of a survey's own" in out


def test_help_names_every_format(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        command.main(["inspect", "--help"])
    out = capsys.readouterr().out
    assert ended.value.code == 0
    assert [
        name for name in (*FORMATS, "GeoTIFF", "BAG", "SBET", "--plot", "--zone", "TMPDIR") if name not in out
    ] == []


def test_inspect_imports_none_of_the_slow_libraries(tmp_path: Path):
    path = parquet(tmp_path / "line.parquet", rows())
    program = (
        "import sys; from pointnetkl import __main__ as c; c.main(['inspect', sys.argv[1]]);"
        "print([name for name in ('torch', 'open3d', 'numba', 'gtsam', 'matplotlib', 'dask') if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def parts(pings: int, beams: int) -> list[pd.DataFrame]:
    """Return soundings one ping a part, beams 1 m apart on a slope down to the east."""
    across = np.arange(beams, dtype=float)
    table = pd.DataFrame({"beam": np.arange(beams), "x_m": across, "z_m": -10 - across / beams, "quality": 0})
    return [table.assign(ping=ping, y_m=float(ping))[SOUNDINGS.names] for ping in range(pings)]


def test_what_is_kept_of_a_large_survey_is_bounded_and_even(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tally, "MOST_POINTS", 1000)
    monkeypatch.setattr(tally, "MOST_PINGS", 16)
    counted = tally.Tally()
    for part in parts(pings=300, beams=20):
        counted.take(part)
    assert 400 < len(counted.points) <= 1000
    np.testing.assert_allclose(counted.points.mean(axis=0)[:2], [9.5, 149.5], rtol=0.1)
    kept = counted.swaths["ping"].unique()
    assert list(kept) == list(range(0, 300, 32))
    assert len(counted.swaths) == 20 * len(kept)
    assert counted.beams(301) == {"min": 0, "median": 20, "max": 20}
    assert counted.swath_m() == pytest.approx(19)


def test_a_map_has_no_holes_where_there_are_soundings():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0, 400, 20_000), rng.uniform(0, 100, 20_000), np.full(20_000, -30.0)])
    covered = cells.from_points(points)
    assert covered is not None
    assert np.isfinite(covered.depth_m).mean() > 0.95
    assert covered.area_m2 == pytest.approx(40_000, rel=0.06)
    np.testing.assert_allclose(covered.depth_m[np.isfinite(covered.depth_m)], 30)
    corridor = np.column_stack([points[:, 0], points[:, 0] + points[:, 1] / 50, points[:, 2]])
    covered = cells.from_points(corridor)
    assert covered is not None
    assert covered.area_m2 == pytest.approx(800, rel=0.5)  # of 160,000 that its box has


@pytest.mark.skipif(not REALDATA.is_dir(), reason="no real data beside the project")
@pytest.mark.parametrize(
    ("name", "pings", "soundings", "valid"),
    [
        ("gsf/em302_st_croix.gsf", 50, 21_600, 20_959),
        ("gsf/em302_deep.gsf", 8, 3456, None),
        ("gsf/stub_3_09.gsf", 3, 21, 0),
        ("all/em2040c_warrnambool.all", 183, 73_200, 67_964),
        ("all/em122_positions_only.all", 0, 0, 0),
        ("kmall/em2040_tampa.kmall", 25, 15_184, None),
        ("xtf/r2sonic_pier.xtf", 923, 236_288, None),
        ("laz/kimberley_corridor_1m.laz", 0, 890_647, 890_647),
    ],
)
def test_real_files_have_their_known_counts(
    name: str, pings: int, soundings: int, valid: int | None, capsys: pytest.CaptureFixture
):
    status, out, _ = printed(capsys, REALDATA / name, "--json")
    (facts,) = json.loads(out)
    assert (status, facts["pings"], facts["soundings"]) == (0, pings, soundings)
    assert valid is None or facts["valid"] == valid


@pytest.mark.skipif(not REALDATA.is_dir(), reason="no real data beside the project")
@pytest.mark.parametrize(
    ("name", "cells_in_all", "cell_m", "depths"),
    [
        ("grid/scituate_5m.tif", 661 * 1125, 5.0, (6.4, 29.9)),
        ("grid/bering_strait_2m.bag", 2_522_946, 2.0, (51.0, 53.0)),
    ],
)
def test_real_grids_are_named_with_what_they_are_for(
    name: str,
    cells_in_all: int,
    cell_m: float,
    depths: tuple[float, float],
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
):
    status, out, _ = printed(capsys, REALDATA / name, "--json", "--plot", tmp_path)
    (facts,) = json.loads(out)
    assert (status, facts["kind"], facts["pings"], facts["soundings"], facts["track_m"]) == (
        0,
        "grid",
        0,
        cells_in_all,
        None,
    )
    assert facts["cell_m"] == pytest.approx(cell_m, rel=1e-3)
    assert (facts["depth_min_m"], facts["depth_max_m"]) == pytest.approx(depths, abs=0.1)
    assert "height" in facts["vertical"]
    assert Path(facts["plots"][0]).is_file()
    assert "a seabed to simulate surveys over" in printed(capsys, REALDATA / name)[1]
