"""The report of a correction says first what was done, stands alone, and can be read by anyone in any browser."""

import dataclasses
import html
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import rasterio

import corrected_survey
from pointnetkl.correction import page
from pointnetkl.correction.page import charts, numbers, rasters, theme, words
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.slam.closing.schemas import State
from pointnetkl.surveys.survey import POINTS, SUBMAPS

CHROMIUM = shutil.which("chromium")
FACTS = {
    "formats": "ALL",
    "rounds": 3,
    "soundings": None,
    page.PROBLEMS: ["first.all: 2 datagrams are damaged; they are skipped."],
    page.LEFT_OUT: ["no graph.g2o: the noise of dead reckoning is not known"],
    page.PARAMETERS: "correct:\n  drift: dead-reckoning\n",
    "disagreement_before_m": np.linspace(-1, 1, 500),
    "disagreement_after_m": np.linspace(-0.3, 0.3, 400),
}
MEASURE = """<script>
const box = e => { const r = e.getBoundingClientRect(); return [r.top, r.right, r.bottom].map(Math.round).join(","); };
document.title = [innerWidth, document.documentElement.scrollWidth, box(document.querySelector(".sentence")),
  ...[...document.querySelectorAll("#maps img")].map(box)].join(" ");
</script>"""
NARROW = """<body style="margin:0"><iframe style="width:400px;height:900px;border:0" srcdoc="PAGE"></iframe><script>
onload = () => { const page = document.querySelector("iframe").contentDocument.documentElement;
  document.title = page.clientWidth + " " + page.scrollWidth; };
</script>"""


class Parsed(HTMLParser):
    """The elements of a page with their attributes, and its text by element."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))

    def handle_data(self, data: str) -> None:
        if data.strip() and self.elements[-1][0] != "style":
            self.texts.append(" ".join(data.split()))

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def grid(path: Path, values: np.ndarray, bands: tuple[str, ...], corrected: Corrected) -> None:
    crs = 'LOCAL_CS["local",UNIT["metre",1],AXIS["east",EAST],AXIS["north",NORTH]]'
    west, north = corrected.origin[0] - 60.0, corrected.origin[1] + 180.0
    shape = {"height": values.shape[0], "width": values.shape[1], "count": len(bands), "dtype": "float32"}
    cell = 420.0 / values.shape[1]
    place = {
        "transform": rasterio.Affine(cell, 0.0, west, 0.0, -cell, north),
        "crs": rasterio.CRS.from_string(crs if corrected.crs == "local" else corrected.crs),
    }
    with rasterio.open(path, "w", driver="GTiff", nodata=np.nan, **place, **shape) as file:
        for band, name in enumerate(bands, 1):
            file.write(values.astype(np.float32), band)
            file.set_band_description(band, name)


def folder_of(path: Path, corrected: Corrected, depth: np.ndarray | None = None) -> Path:
    """Return a folder with the maps of a survey, 420 m wide."""
    if depth is None:
        north, east = np.mgrid[0:120, 0:210]
        depth = 20 + np.sin(east / 9) * np.cos(north / 7)
        depth[:20, :30] = np.nan
    path.mkdir(exist_ok=True)
    for name, moved in (("before", 0.0), ("after", 0.1)):
        grid(path / f"map_{name}.tif", depth + moved, ("Depth", "Density", "Uncertainty"), corrected)
    grid(path / "difference.tif", 0.1 + 0 * depth, ("Difference",), corrected)
    for name in ("track.csv", "closures.csv", "navigation.sbet", "na0/line #1.all.na0"):
        (path / name).parent.mkdir(exist_ok=True)
        (path / name).write_bytes(b"")
    return path


def written(path: Path, corrected: Corrected, facts: dict[str, Any] | None = None, **maps: np.ndarray) -> str:
    page.write(folder_of(path, corrected, **maps), corrected, FACTS if facts is None else facts)
    return (path / page.REPORT).read_text(encoding="utf-8")


def without_track() -> Corrected:
    survey = corrected_survey.corrected(applied=False)
    nan = float("nan")
    verdict = dataclasses.replace(
        survey.verdict, closures=0, accepted=0, left_out_before_m=nan, left_out_after_m=nan, left_out_p=nan,
        disagreement_before_m=nan, disagreement_after_m=nan, variance_factor=nan, drift="",
    )  # fmt: skip
    nothing = {"track": survey.track.iloc[:0], "submaps": None, "closures": survey.closures.iloc[:0]}
    return dataclasses.replace(survey, kind=POINTS, verdict=verdict, **nothing)


def of_submaps() -> Corrected:
    survey = corrected_survey.corrected("local")
    rows = survey.track.iloc[::50].reset_index(drop=True)
    rows = rows.assign(ping=rows.index.astype(np.int32), time_s=rows.index.astype(float))
    return dataclasses.replace(survey, kind=SUBMAPS, track=rows, vertical=[])


SURVEYS = {
    "corrected": corrected_survey.corrected,
    "left": lambda: corrected_survey.corrected(applied=False),
    "points": without_track,
    "submaps": of_submaps,
}


@pytest.fixture(scope="module", params=SURVEYS)
def report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with the page of each kind of survey, and its text."""
    folder = tmp_path_factory.mktemp(request.param)
    facts = {} if request.param == "points" else FACTS
    return folder, written(folder, SURVEYS[request.param](), facts)


def test_the_page_says_first_the_name_what_was_done_and_why(tmp_path: Path) -> None:
    for applied, state in ((True, "Corrected"), (False, "Left as it was")):
        survey = corrected_survey.corrected(applied=applied)
        texts = Parsed(written(tmp_path, survey)).texts
        assert texts[1:3] == ["small", state]  # after the title
        assert survey.verdict.sentence in texts[:6]


def test_the_first_screen_has_five_numbers_with_their_units(tmp_path: Path) -> None:
    headline = numbers.headline(corrected_survey.corrected())
    assert [f"{n.value} {n.unit}".strip() for n in headline] == [
        "1.51 m", "0.50 → 0.20 m", "4 of 6", "2.40 → 0.20 m", "1.23 → 0.18 m",
    ]  # fmt: skip
    texts = Parsed(written(tmp_path, corrected_survey.corrected())).texts
    assert all(n.label in texts for n in headline)


def test_a_corrected_survey_has_two_maps_and_one_that_is_left_has_one(tmp_path: Path) -> None:
    maps = re.compile(r'alt="Hillshaded map of the seabed (as \w+)')
    assert maps.findall(written(tmp_path, corrected_survey.corrected())) == ["as navigated", "as corrected"]
    assert maps.findall(written(tmp_path, corrected_survey.corrected(applied=False))) == ["as navigated"]


def test_points_without_a_track_get_a_sentence_and_no_time_series(tmp_path: Path) -> None:
    text = written(tmp_path, without_track(), {})
    assert "There is no track" in text
    assert "Correction along the track" not in text
    assert "nan" not in " ".join(Parsed(text).texts).lower()


def test_submaps_that_only_count_have_no_utc(tmp_path: Path) -> None:
    text = written(tmp_path, of_submaps())
    assert "UTC" not in " ".join(Parsed(text).texts)
    assert charts.shift(of_submaps(), theme.DAY).axes[-1].get_xlabel() == "submap"


def test_the_page_needs_nothing_from_elsewhere(report: tuple[Path, str]) -> None:
    folder, text = report
    parsed = Parsed(text)
    assert not parsed.all("script")
    assert "url(" not in text
    assert "@import" not in text
    assert all(image["src"].startswith("data:image/png;base64,") for image in parsed.all("img"))
    links = [link["href"] for link in parsed.all("a")]
    assert all(
        f'id="{link[1:]}"' in text if link.startswith("#") else (folder / unquote(link)).exists() for link in links
    )
    assert {"track.csv", "na0/line #1.all.na0"} <= set(map(unquote, links))
    assert len(text.encode()) < 2_000_000


def test_headings_are_in_order_and_tables_and_figures_are_told_in_words(report: tuple[Path, str]) -> None:
    parsed = Parsed(report[1])
    levels = [int(tag[1]) for tag, _ in parsed.elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == len(parsed.all("main")) == 1
    assert max(np.diff(levels)) <= 1
    assert all(re.search(r"\d", image["alt"]) and "nan" not in image["alt"] for image in parsed.all("img"))
    assert all(cell.get("scope") in ("row", "col") for cell in parsed.all("th"))
    assert parsed.all("html")[0]["lang"] == "en"


def luminance(colour: str) -> float:
    digits = colour * 2 if len(colour) == 3 else colour
    parts = np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return float(np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])


def contrast(one: str, other: str) -> float:
    low, high = sorted(map(luminance, (one, other)))
    return (high + 0.05) / (low + 0.05)


def test_text_stands_out_from_its_ground_by_day_by_night_and_on_paper(report: tuple[Path, str]) -> None:
    palettes = [
        dict(re.findall(r"--(\w+): #(\w+)", block)) for block in re.findall(r":root \{(.*?)\}", report[1], re.S)
    ]
    assert len(palettes) == 3
    for palette in palettes:
        for text in ("ink", "soft", "link"):
            assert all(contrast(palette[text], palette[ground]) >= 4.5 for ground in ("paper", "panel", "note"))
        assert all(contrast("fff", palette.get(state, palettes[0][state])) >= 4.5 for state in ("good", "warn"))
    for each in (theme.DAY, theme.NIGHT):
        assert contrast(each.ink[1:], each.paper[1:]) >= 4.5


def test_each_state_of_a_closure_has_words_and_a_mark_of_its_own() -> None:
    assert set(words.STATES) == set(theme.STATES) == set(State)
    assert len({theme.mark(state) for state in State}) == len(set(theme.STATES.values())) == len(State)


def test_the_same_survey_gives_the_same_bytes(tmp_path: Path) -> None:
    once, again = (written(tmp_path / name, corrected_survey.corrected()) for name in "ab")
    assert once == again


def test_a_page_of_the_noisiest_maps_is_below_two_megabytes(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(30, 5, (1400, 1500))
    text = written(tmp_path, corrected_survey.corrected(), depth=noise)
    assert len(text.encode()) < 2_000_000


def test_names_of_surveys_and_files_are_text_and_not_markup(tmp_path: Path) -> None:
    survey = dataclasses.replace(corrected_survey.corrected(), name="<b>A & B</b>")
    text = written(tmp_path, survey, {"problems": ["<script>alert(1)</script>"]})
    assert "<b>" not in text
    assert "<script>" not in text
    assert "<b>A & B</b>" in Parsed(text).texts


def test_a_heading_turned_clockwise_is_positive_and_lines_are_not_joined() -> None:
    survey = corrected_survey.corrected()
    _, _, heading = charts.shift(survey, theme.DAY).axes
    (line,) = [line for line in heading.lines if line.get_label() == "correction"]
    drawn = np.asarray(line.get_ydata(), float)
    np.testing.assert_allclose(drawn[np.isfinite(drawn)], -np.degrees(survey.track["moved_yaw_rad"]))
    assert np.isnan(drawn).sum() == 2  # between three lines


def test_a_large_map_is_drawn_from_averages_of_what_is_known(tmp_path: Path) -> None:
    survey = corrected_survey.corrected()
    values = np.full((2 * rasters.CELLS, 4 * rasters.CELLS), np.nan)
    values[0, :8] = np.arange(8)  # the northernmost row
    grid(tmp_path / "a.tif", values, ("Depth",), survey)
    raster = rasters.read(tmp_path / "a.tif", "Depth")
    assert raster is not None
    assert raster.values.shape == (rasters.CELLS // 2, rasters.CELLS)
    np.testing.assert_allclose(raster.values[-1, :3], [1.5, 5.5, np.nan])  # rows run to the north
    west, north = survey.origin[0] - 60, survey.origin[1] + 180
    cell = 420 / rasters.CELLS
    np.testing.assert_allclose(raster.corners, [[west, north - cell], [west + 2 * cell, north]])


def test_a_damaged_map_or_one_without_depths_is_named_in_the_error(tmp_path: Path) -> None:
    (tmp_path / "map_before.tif").write_bytes(b"no GeoTIFF")
    with pytest.raises(CorrectionError, match=r"map_before.tif: cannot be read .* run the correction again"):
        rasters.read(tmp_path / "map_before.tif", "Depth")
    grid(tmp_path / "other.tif", np.ones((4, 4)), ("Height",), corrected_survey.corrected())
    with pytest.raises(CorrectionError, match=r"other.tif: has no band Depth"):
        rasters.read(tmp_path / "other.tif", "Depth")


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [(6.42, 0.313, "6.42 → 0.31"), (0.5, 0.034, "0.500 → 0.034"), (250.0, 12.0, "250.0 → 12.0"), (np.nan, np.nan, "—")],
)
def test_a_pair_of_lengths_has_as_many_decimals_as_the_smaller_needs(before: float, after: float, text: str) -> None:
    assert numbers.pair(before, after) == text


def browse(url: Path, profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert CHROMIUM
    common = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--hide-scrollbars"]
    command = [CHROMIUM, *common, f"--user-data-dir={profile}", *options, "--dump-dom", url.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def title(dom: str) -> str:
    return re.findall("<title>(.*?)</title>", dom)[0]


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_in_a_browser_the_verdict_and_all_maps_are_on_the_first_screen(
    report: tuple[Path, str], tmp_path: Path
) -> None:
    (tmp_path / "page.html").write_text(report[1].replace("</main>", f"</main>{MEASURE}"), encoding="utf-8")
    options = ("--window-size=1440,900", "--enable-logging=stderr", "--v=0")
    seen = browse(tmp_path / "page.html", tmp_path / "profile", *options)
    assert "CONSOLE" not in seen.stderr
    width, needed, sentence, *maps = title(seen.stdout).split()
    assert int(needed) <= int(width) == 1440
    assert int(sentence.split(",")[2]) < 250
    assert len(maps) in (1, 2)
    assert all(int(right) <= 1440 and int(bottom) <= 900 for _, right, bottom in (box.split(",") for box in maps))
    assert len({box.split(",")[0] for box in maps}) == 1  # side by side


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_in_a_browser_400_pixels_are_wide_enough(report: tuple[Path, str], tmp_path: Path) -> None:
    # in a frame, because no window of Chromium is so narrow
    (tmp_path / "narrow.html").write_text(NARROW.replace("PAGE", html.escape(report[1])), encoding="utf-8")
    seen = browse(tmp_path / "narrow.html", tmp_path / "profile")
    width, needed = map(int, title(seen.stdout).split())
    assert needed <= width == 400
