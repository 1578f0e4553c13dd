"""`make repro` leaves out what cannot run here, and says so."""

from pathlib import Path

import pytest
import yaml

from workspace import ROOT, repro


def test_a_survey_without_its_grid_becomes_comments_and_nothing_else_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    before = yaml.safe_load((ROOT / "params.yaml").read_text())
    assert before["simulate"]["scituate"]["grid"] == "data/grids/scituate_5m.tif"
    path = tmp_path / "params.yaml"
    path.write_text((ROOT / "params.yaml").read_text())
    (tmp_path / "data").mkdir()
    (tmp_path / "data/none").touch()
    (tmp_path / "data/grids").mkdir()
    (tmp_path / "data/grids/scituate_5m.tif.dvc").touch()
    monkeypatch.chdir(tmp_path)
    repro.leave_out_gridless(path)
    after = yaml.safe_load(path.read_text())
    for group in (before["simulate"], before["study"]["test"], before["study"]["surveys"]):
        del group["scituate"]
    assert after == before
    assert "data/grids/scituate_5m.tif is not here" in capsys.readouterr().out


def test_a_line_that_dvc_has_folded_is_left_out_whole():
    folded = """\
study:
  test: &test
    scituate: {raw: data/raw/scituate, truth: data/truth,
      label_runs: 50}
    borno_8: {raw: data/raw/borno_8,
      label_runs: 50}
simulate:
  scituate:
    seed: 1
    layout: {lines: 5,
      line_length_m: 7.0}
  other: {seed: 2}
"""
    left = yaml.safe_load(repro.without(folded, "scituate"))
    assert left == {
        "study": {"test": {"borno_8": {"raw": "data/raw/borno_8", "label_runs": 50}}},
        "simulate": {"other": {"seed": 2}},
    }


def test_a_survey_with_its_grid_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "params.yaml"
    path.write_text((ROOT / "params.yaml").read_text())
    for grid in ("data/none", "data/grids/scituate_5m.tif"):
        (tmp_path / grid).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / grid).touch()
    monkeypatch.chdir(tmp_path)
    repro.leave_out_gridless(path)
    assert path.read_text() == (ROOT / "params.yaml").read_text()
