"""`pointnetkl correct`: a folder and a sentence, or one sentence and nothing."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raw_survey
from pointnetkl import __main__ as program
from pointnetkl import correction
from pointnetkl.commands import correct as command
from pointnetkl.correction import Corrected, Inputs, Settings
from pointnetkl.correction.result import CLOSURES, TRACK, Verdict
from pointnetkl.slam.closing import drift
from pointnetkl.surveys.survey import SWATHS
from raw_survey import Plan, Raw

PLAN = Plan(lines=3, drift_m=1.5)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Raw:
    return raw_survey.write(tmp_path_factory.mktemp("command") / "raw", PLAN)


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Correct nothing, and return what would have been."""
    calls: list[tuple[Any, ...]] = []

    def nothing(*arguments: Any) -> Corrected:
        calls.append(arguments)
        return left_as_it_was()

    monkeypatch.setattr(correction, "correct", nothing)
    return calls


def left_as_it_was() -> Corrected:
    verdict = Verdict(False, "Left as it was: no overlap.", 0, 0, *[np.nan] * 6, "")
    track, none = (schema.empty_table().to_pandas() for schema in (TRACK, CLOSURES))
    return Corrected("a", SWATHS, "local", (0.0, 0.0), [], track, None, none, verdict)


def run(*words: object) -> int:
    return program.main(["correct", *map(str, words)])


def error(capsys: pytest.CaptureFixture, *words: object) -> str:
    """Return the sentence that a command ends with."""
    assert run(*words) == 1
    printed = capsys.readouterr().err.splitlines()
    sentences = [line for line in printed if line.startswith("error: ")]
    assert len(sentences) == 1
    assert "Traceback" not in "".join(printed)
    return sentences[0]


def test_a_survey_is_corrected_and_the_verdict_is_said(raw: Raw, tmp_path: Path, capsys: pytest.CaptureFixture):
    out = tmp_path / "new" / "corrected"
    assert run(raw.folder, "--out", out, "--cell", 4) == 0
    printed = capsys.readouterr().out
    assert "Corrected: loop closures that are left out fit to" in printed
    assert re.search(r"the track moved by [\d.]+ m \(rms\)", printed)
    assert "drift of navigation: " in printed
    assert f"report: {out / 'report.html'}" in printed
    assert (out / "report.html").is_file()
    assert [path.name for path in out.parent.iterdir()] == ["corrected"]


def test_a_survey_that_is_left_as_it_was_does_not_speak_of_moves(given: list, tmp_path: Path, capsys):
    assert run(tmp_path, "--out", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "Left as it was: no overlap." in printed
    assert "moved" not in printed
    assert "drift" not in printed


def test_options_are_settings_and_inputs(given: list, tmp_path: Path):
    words = "--navigation usbl --drift scale_error=0.01 --length 90 --spacing 3 --cell 2 --zone EPSG:32633 --replace"
    named = ["--fixes", "a.csv", "--reference", "b.tif", "--ties", "c.txt", "--held", "x/1.all", "2.all"]
    assert run("one", "two", "--out", tmp_path / "out", *words.split(), *named) == 0
    ((source, out, settings, replace),) = given
    expected = Inputs(
        [Path("one"), Path("two")],
        held=["1.all", "2.all"],
        fixes=Path("a.csv"),
        reference=Path("b.tif"),
        ties=Path("c.txt"),
    )
    assert source == expected
    assert (out, replace) == (tmp_path / "out", True)
    assert settings == Settings(
        navigation="usbl",
        drift="scale_error=0.01",
        submap_length_m=90.0,
        point_spacing_m=3.0,
        cell_m=2.0,
        utm_zone="EPSG:32633",
    )


def test_without_options_settings_are_those_of_the_library(given: list, tmp_path: Path):
    assert run("one", "--out", tmp_path / "out") == 0
    ((source, _, settings, replace),) = given
    assert (settings, replace, source) == (Settings(), False, Inputs([Path("one")], held=[]))


def test_parameters_are_read_and_options_come_before_them(given: list, tmp_path: Path):
    rates = "{scale_error: 0.1, heading_bias_rad: 0.0, heading_walk_rad: 0.0, heading_correlation_s: 1.0, "
    rates += "velocity_walk_mps: 0.0, velocity_correlation_s: 1.0}"
    (tmp_path / "p.yaml").write_text(f"correct: {{overlap_points: 99, cell_m: 7.0}}\nnavigation: {{mine: {rates}}}\n")
    assert run("one", "--out", tmp_path / "out", "--params", tmp_path / "p.yaml", "--cell", 2) == 0
    ((source, _, settings, _),) = given
    assert (settings.overlap_points, settings.cell_m) == (99, 2.0)
    assert source.rates == {"mine": drift.Settings(0.1, 0, 0, 1, 0, 1)}


def test_parameters_need_no_section_of_navigation(given: list, tmp_path: Path):
    (tmp_path / "p.yaml").write_text("correct: {overlap_points: 99}\n")
    assert run("one", "--out", tmp_path / "out", "--params", tmp_path / "p.yaml") == 0
    assert given[0][2].overlap_points == 99


def test_a_path_that_is_missing_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture):
    assert "gone: is missing" in error(capsys, tmp_path / "gone", "--out", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "empty").mkdir()
    assert "has no raw files" in error(capsys, tmp_path / "empty", "--out", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_an_out_that_is_there_is_one_sentence(raw: Raw, tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "mine").write_text("thesis")
    assert "--replace" in error(capsys, raw.folder, "--out", tmp_path)
    assert (tmp_path / "mine").read_text() == "thesis"


def test_raw_files_are_not_replaced(raw: Raw, capsys: pytest.CaptureFixture):
    for out in (raw.folder, raw.folder.parent, raw.folder / "out"):
        error(capsys, raw.folder, "--out", out, "--replace")
    assert all(file.is_file() for file in raw.files)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--drift", "hugin"], "drift is 'hugin', must be one of"),
        (["--drift", "scale=1"], "'scale=1' is no rate"),
        (["--drift", "scale_error=7"], "scale_error is 7.0, must be from 0 to 1"),
        (["--held", "other.all"], "other.all: is to be held, and is no file of this survey"),
        (["--zone", "EPSG:4326"], "EPSG:4326"),
        (["--zone", "33N"], "utm_zone"),
        (["--length", "-1"], "submap_length_m is -1.0"),
        (["--spacing", "nan"], "point_spacing_m is nan"),
        (["--cell", "inf"], "cell_m is inf"),
        (["--params", "/nowhere/params.yaml"], "/nowhere/params.yaml: cannot be read"),
    ],
)
def test_an_option_that_makes_no_sense_is_one_sentence(
    raw: Raw, tmp_path: Path, words: list[str], sentence: str, capsys: pytest.CaptureFixture
):
    geographic = (
        raw_survey.write(tmp_path / "raw", Plan(lines=2, beams=24, on_earth=True)) if "--zone" in words else raw
    )
    assert sentence in error(capsys, geographic.folder, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", ["time_s,sigma_m\n1,2\n", "", "time_s,sigma_m,x_m,y_m\n1,2,3,4\n"])
def test_bad_fixes_are_one_sentence(raw: Raw, tmp_path: Path, content: str, capsys: pytest.CaptureFixture):
    (tmp_path / "fixes.csv").write_text(content)
    sentence = error(capsys, raw.folder, "--out", tmp_path / "out", "--fixes", tmp_path / "fixes.csv")
    assert str(tmp_path / "fixes.csv") in sentence
    assert not (tmp_path / "out").exists()


def test_bad_ties_are_one_sentence(raw: Raw, tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "ties.txt").write_text("TIE\n")
    sentence = error(capsys, raw.folder, "--out", tmp_path / "out", "--ties", tmp_path / "ties.txt")
    assert "ties.txt: line 1" in sentence


def test_a_reference_of_another_crs_is_one_sentence(raw: Raw, tmp_path: Path, capsys: pytest.CaptureFixture):
    grid = raw_survey.grid(tmp_path / "grid.tif", PLAN, crs="EPSG:32634")
    sentence = error(capsys, raw.folder, "--out", tmp_path / "out", "--reference", grid)
    assert sentence == f"error: {grid}: is in EPSG:32634 and the survey in EPSG:32633; bring it to the survey's"


@pytest.mark.parametrize("words", [[], ["survey"], ["--out", "out"], ["survey", "--out", "out", "--navigation", "gps"]])
def test_words_that_lack_something_are_refused_by_the_parser(words: list[str], capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        run(*words)
    assert ended.value.code == 2
    assert "usage: " in capsys.readouterr().err


def test_help_names_every_option_and_every_rate(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        run("--help")
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    for name in ("--out", "--replace", "--navigation", "--drift", "--length", "--spacing", "--cell", "--held"):
        assert name in printed
    for name in ("--fixes", "--reference", "--ties", "--zone", "--params", "report.html", "partial"):
        assert name in printed
    for name in (*drift.PRESETS, "scale_error", "heading_bias_deg", "position_walk_m", "position_correlation_s"):
        assert name in printed


def test_help_takes_no_slow_imports():
    words = "import sys; from pointnetkl.__main__ import main\n"
    words += "try:\n main(['correct', '--help'])\nexcept SystemExit:\n pass\n"
    slow = "print(sorted({'rasterio', 'matplotlib', 'numba', 'pyproj', 'torch'} & set(sys.modules)), file=sys.stderr)"
    ended = subprocess.run([sys.executable, "-c", words + slow], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "[]"


def test_the_summary_has_the_verdict_and_the_report():
    assert command.summary(left_as_it_was(), Path("out")).splitlines() == [
        "",
        "Left as it was: no overlap.",
        f"report: {Path('out') / 'report.html'}",
    ]
