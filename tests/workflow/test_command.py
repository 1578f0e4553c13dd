"""A command ends well, or with exit status 1 and one sentence."""

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

from pointnetkl.workflow import command
from pointnetkl.workflow.errors import PointNetKLError
from pointnetkl.workflow.parameters import SettingsError


def run(monkeypatch: pytest.MonkeyPatch, error: Exception | None, *arguments: str) -> list[argparse.Namespace]:
    seen = []

    def main(arguments: argparse.Namespace) -> None:
        seen.append(arguments)
        if error:
            raise error

    monkeypatch.setattr(sys, "argv", ["stage", *arguments])
    command.run(main, command.parser("Do it."))
    return seen


def test_a_command_runs_with_its_parameter_file(monkeypatch: pytest.MonkeyPatch):
    assert run(monkeypatch, None)[0].params == Path("params.yaml")
    assert run(monkeypatch, None, "--params", "other.yaml")[0].params == Path("other.yaml")


@pytest.mark.parametrize("error", [PointNetKLError("it is wrong"), SettingsError("it is wrong")])
def test_an_error_of_ours_is_one_sentence(monkeypatch: pytest.MonkeyPatch, error: Exception):
    with pytest.raises(SystemExit) as caught:
        run(monkeypatch, error)
    assert caught.value.code == "error: it is wrong"  # which Python prints to stderr, exiting with 1


def test_an_error_of_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(KeyError):
        run(monkeypatch, KeyError("slip"))


@pytest.mark.parametrize("script", ["segment", "voxelise"])
def test_a_stage_without_its_input_ends_with_status_one_and_one_sentence(script: str, tmp_path: Path):
    options = {"segment": ["--survey", "--submaps", "--poses"], "voxelise": ["--submaps", "--clouds"]}[script]
    arguments = [word for option in options for word in (option, "gone")]
    path = Path(__file__).parents[2] / "pipeline" / f"{script}.py"
    done = subprocess.run(
        [sys.executable, path, "small", *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert (
        done.stderr
        == "error: params.yaml: cannot be read (No such file or directory); name your parameters with --params\n"
    )
