"""`make repro` runs DVC, says what it runs and for how long, and edits nothing."""

import importlib.util
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def repro() -> ModuleType:
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("repro", ROOT / "tools/repro.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_scale_and_the_number_of_surveys_are_announced(
    repro: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "params.yaml").write_text("study: {scale: demo, train: {a: {}, b: {}}, test: {c: {}}}\n")
    monkeypatch.setattr(repro, "ROOT", tmp_path)
    repro.announce()
    assert capsys.readouterr().out == "scale: demo, 2 training and 1 test surveys\n"


def test_stages_are_timed_from_what_dvc_prints_and_its_status_is_returned(
    repro: ModuleType, capsys: pytest.CaptureFixture[str]
):
    lines = ("Running stage 'segment@a':", "> python pipeline/segment.py a", "Stage 'label@a' didn't change, skipping")
    lines += ("Running stage 'segment@b':", "Running stage 'report':")
    printing = "; ".join(f"print({line!r})" for line in lines)
    status, seconds = repro.follow([sys.executable, "-c", f"{printing}; raise SystemExit(3)"], {})
    assert status == 3
    assert list(seconds) == ["segment@a", "segment@b", "report"]
    assert capsys.readouterr().out.splitlines() == list(lines)


def test_the_seconds_of_a_stage_are_added_up_over_its_surveys(repro: ModuleType, capsys: pytest.CaptureFixture[str]):
    repro.summarise({"segment@a": 1.0, "segment@b": 2.5, "report": 4.0}, 8.0)
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line]
    assert rows == [["stage", "runs", "seconds"], ["segment", "2", "3.5"], ["report", "1", "4.0"], ["all", "3", "8.0"]]


def test_a_run_edits_no_file_of_the_project(repro: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shutil.copy(ROOT / "params.yaml", tmp_path / "params.yaml")
    (tmp_path / ".git").mkdir()
    monkeypatch.setattr(repro, "ROOT", tmp_path)
    monkeypatch.setattr(repro, "follow", lambda command, environment: (0, {}))
    monkeypatch.chdir(tmp_path)
    assert repro.main() == 0
    assert (tmp_path / "params.yaml").read_bytes() == (ROOT / "params.yaml").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".git", "params.yaml"]
