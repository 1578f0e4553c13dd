"""`pointnetkl demo`: a survey as raw files, whose lines disagree, and its truth."""

import argparse
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pointnetkl import readers
from pointnetkl.commands import demo
from pointnetkl.correction.result import CLOSURES, TRACK, Corrected, Verdict
from pointnetkl.surveys.survey import SWATHS, Survey
from pointnetkl.workflow.errors import PointNetKLError

SENTENCE = "The track was corrected."


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    demo.add(parser.add_subparsers())
    return parser.parse_args(["demo", *words])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a survey."""
    folder = tmp_path_factory.mktemp("demo") / "survey"
    demo.write(folder, 1)
    return folder


@pytest.fixture(scope="module")
def survey(made: Path) -> tuple[Survey, pd.DataFrame]:
    """Return the survey as ingested, and its soundings."""
    parts: list[pd.DataFrame] = []
    return readers.read(made / "raw", readers.Settings("auto"), parts.append), pd.concat(parts, ignore_index=True)


def corrected(survey: Survey, truth: pd.DataFrame, share: float) -> Corrected:
    """Return the survey with every ping moved by a share of its true error."""
    track, origin = survey.pings, survey.origin
    true = truth.iloc[np.argmin(np.abs(track["time_s"].to_numpy()[:, None] - truth["time_s"].to_numpy()), axis=1)]
    names = dict.fromkeys([name for name in TRACK.names if name not in track], 0.0)
    track = track.assign(**names).assign(
        moved_x_m=share * (true["x_m"].to_numpy() - origin[0] - track["x_m"]),
        moved_y_m=share * (true["y_m"].to_numpy() - origin[1] - track["y_m"]),
    )
    verdict = Verdict(True, SENTENCE, 0, 0, *[np.nan] * 6, "as said")
    none = CLOSURES.empty_table().to_pandas()
    return Corrected("demo", SWATHS, survey.crs, origin, [], track[TRACK.names], None, none, verdict)


def test_raw_files_hold_a_survey_of_nine_lines_and_nothing_else(made: Path, survey: tuple[Survey, pd.DataFrame]):
    files = sorted(file.name for file in (made / "raw").iterdir())
    assert len(files) == 9
    assert all(re.fullmatch(r"000\d_20200913_\d{6}_auv\.all", file) for file in files)
    assert sorted(file.name for file in made.iterdir()) == ["raw", "truth.csv"]
    ingested, soundings = survey
    assert ingested.crs == "EPSG:32632"
    assert ingested.report["problems"] == []
    assert 200_000 < len(soundings) < 600_000


def test_truth_is_near_navigation_and_differs_by_metres(made: Path, survey: tuple[Survey, pd.DataFrame]):
    ingested, _ = survey
    truth = pd.read_csv(made / "truth.csv")
    pings = ingested.pings
    x, y = (np.interp(pings["time_s"], truth["time_s"], truth[name]) for name in ("x_m", "y_m"))
    off = np.hypot(pings["x_m"] + ingested.origin[0] - x, pings["y_m"] + ingested.origin[1] - y)
    assert off[0] < 0.02
    assert 3 < np.sqrt(np.mean(off**2)) < 15


def test_lines_disagree_on_the_seabed_by_navigation_and_agree_by_the_truth(
    made: Path, survey: tuple[Survey, pd.DataFrame]
):
    ingested, soundings = survey
    moved = corrected(ingested, pd.read_csv(made / "truth.csv"), 1.0).track
    line = pd.factorize(ingested.pings["file"])[0][soundings["ping"]]
    apart = []
    for shift in (np.zeros((len(moved), 2)), moved[["moved_x_m", "moved_y_m"]].to_numpy()):
        cells = np.floor((soundings[["x_m", "y_m"]].to_numpy() + shift[soundings["ping"]]) / 4)
        table = pd.DataFrame({"x": cells[:, 0], "y": cells[:, 1], "line": line, "z": soundings["z_m"]})
        depth = table[soundings["quality"].to_numpy() == 0].groupby(["x", "y", "line"])["z"].mean()
        apart.append(float(np.sqrt(np.mean(depth.groupby(["x", "y"]).std().dropna() ** 2))))
    assert apart[0] > 2.5 * apart[1]


def test_the_same_seed_gives_the_same_files_and_another_seed_others(made: Path, tmp_path: Path):
    for seed in (1, 2):
        demo.write(tmp_path / str(seed), seed)
    again, other = ([file.read_bytes() for file in sorted((tmp_path / str(seed)).rglob("*.*"))] for seed in (1, 2))
    assert again == [file.read_bytes() for file in sorted(made.rglob("*.*"))]
    assert not set(again) & set(other)


@pytest.mark.parametrize(("share", "after"), [(1.0, 0.0), (0.5, 0.5), (0.0, 1.0)])
def test_the_printed_errors_are_those_against_the_truth(
    made: Path, survey: tuple[Survey, pd.DataFrame], share: float, after: float
):
    truth = pd.read_csv(made / "truth.csv")
    as_it_is, fitted = demo._errors(corrected(survey[0], truth, share), truth).splitlines()
    for words in (as_it_is, fitted):
        before_m, after_m = map(float, re.findall(r"([\d.]+) m (?:before|after)", words))
        assert before_m > 2
        assert after_m == pytest.approx(after * before_m, abs=0.02)


def test_the_demo_corrects_what_it_wrote_and_says_what_it_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    given: list[tuple[Path, Path]] = []

    def correct(raw: Path, out: Path) -> Corrected:
        given.append((raw, out))
        ingested = readers.read(raw, readers.Settings("auto"), lambda _: None)
        return corrected(ingested, pd.read_csv(raw.parent / "truth.csv"), 1.0)

    monkeypatch.setattr(demo, "_correct", correct)
    arguments = parsed("--out", str(tmp_path / "new" / "demo"), "--seed", "3")
    assert arguments.run(arguments) == 0
    folder = tmp_path / "new" / "demo"
    assert given == [(folder / "raw", folder / "corrected")]
    printed = capsys.readouterr().out
    for words in (str(folder / "raw"), "9 lines", str(folder / "truth.csv"), SENTENCE, "true error", "report.html"):
        assert words in printed


@pytest.mark.slow
def test_the_correction_takes_most_of_the_true_error_away_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.chdir(tmp_path)
    arguments = parsed()
    assert arguments.run(arguments) == 0
    assert (tmp_path / "pointnetkl_demo" / "corrected" / "report.html").is_file()
    for words in capsys.readouterr().out.splitlines():
        if errors := re.findall(r"([\d.]+) m (?:before|after)", words):
            assert float(errors[1]) < 0.5 * float(errors[0])


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_there_already_is_not_touched(tmp_path: Path, kind: str):
    out = tmp_path / "mine"
    (out if kind == "file" else out / "thesis.txt").parent.mkdir(exist_ok=True)
    (out if kind == "file" else out / "thesis.txt").write_text("all of it")
    arguments = parsed("--out", str(out))
    with pytest.raises(PointNetKLError, match=r"exists already.*--out"):
        arguments.run(arguments)
    assert [file.name for file in tmp_path.rglob("*") if file.is_file()] == ["mine" if kind == "file" else "thesis.txt"]


@pytest.mark.parametrize("seed", ["-1", "many", "1.5", "1000000000"])
def test_a_seed_that_is_no_whole_number_is_refused(seed: str, capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit):
        parsed("--seed", seed)
    assert "whole number" in capsys.readouterr().err


def test_help_says_what_is_made_and_where(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit) as ended:
        parsed("--help")
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    for words in ("Kongsberg .all", "truth.csv", "report.html", "--seed", "pointnetkl_demo", "EPSG:32632"):
        assert words in printed
