"""A stage that cannot do its work says why in one sentence, exits with 1, and leaves what was there as it was."""

import contextlib
import io
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
import pytest
import yaml

from pointnetkl.registration.covariance import table
from pointnetkl.slam.graph import survey_graph
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts
from toy_survey import graph

ROOT = Path(__file__).parents[2]


def stage(name: str, *arguments: str | Path) -> str:
    """Run a stage that must fail, in this process; return the sentence that it ends with."""
    command, printed = [f"{name}.py", *map(str, arguments)], io.StringIO()
    with (
        contextlib.chdir(ROOT),
        contextlib.redirect_stderr(printed),
        mock.patch.object(sys, "argv", command),
        pytest.raises(SystemExit) as ended,
    ):
        runpy.run_path(str(ROOT / "pipeline" / f"{name}.py"), run_name="__main__")
    assert printed.getvalue() == ""
    sentence = ended.value.code  # Python prints a text and ends with status 1
    assert isinstance(sentence, str)
    assert len(sentence.splitlines()) == 1
    return sentence


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    """A copy of params.yaml to spoil."""
    return Path(shutil.copy(ROOT / "params.yaml", tmp_path / "params.yaml"))


@pytest.fixture
def short_survey(tmp_path: Path) -> Path:
    """Twenty metres of track over flat ground."""
    pings = pd.DataFrame({name: np.zeros(20) for name in survey.PINGS.names}).assign(
        ping=range(20), time_s=np.arange(20.0), x_m=np.arange(20.0), file="line"
    )
    soundings = pd.DataFrame({"ping": np.repeat(range(20), 9), "beam": np.tile(range(9), 20)}).assign(
        x_m=lambda t: t["ping"].astype(float), y_m=lambda t: 3.0 * t["beam"], z_m=-30.0, quality=0
    )
    for name, rows, schema in (("pings", pings, survey.PINGS), ("soundings", soundings, survey.SOUNDINGS)):
        artifacts.write_table(tmp_path / f"survey/{name}.parquet", rows, schema, {})
    return tmp_path / "survey"


def test_a_missing_raw_file_in_a_process_of_its_own(tmp_path: Path):
    script = [sys.executable, ROOT / "pipeline/ingest.py", "x", "--raw", tmp_path / "gone.gsf", "--truth", "data/none"]
    result = subprocess.run([*script, "--out", tmp_path / "out"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr.startswith(f"error: {tmp_path / 'gone.gsf'}: is missing")
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_survey_that_the_study_does_not_have(short_survey: Path, tmp_path: Path):
    outs = ("--submaps", tmp_path / "s.parquet", "--poses", tmp_path / "p.parquet")
    said = stage("segment", "atlantis", "--survey", short_survey, *outs)
    assert "atlantis" in said
    assert "baltic" in said


def test_a_parameter_of_the_wrong_type(short_survey: Path, parameters: Path, tmp_path: Path):
    parameters.write_text(parameters.read_text().replace("max_gap_m: 30.0", "max_gap_m: 3e1"))
    outs = ("--submaps", tmp_path / "s.parquet", "--poses", tmp_path / "p.parquet")
    said = stage("segment", "baltic", "--survey", short_survey, *outs, "--params", parameters)
    assert "segment.max_gap_m is '3e1', must be a finite number" in said
    assert "with a point" in said


def test_a_corrupt_table_leaves_the_old_result(short_survey: Path, tmp_path: Path):
    whole = (short_survey / "pings.parquet").read_bytes()
    (short_survey / "pings.parquet").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "s.parquet").write_text("computed before")
    outs = ("--submaps", tmp_path / "s.parquet", "--poses", tmp_path / "p.parquet")
    said = stage("segment", "baltic", "--survey", short_survey, *outs)
    assert "pings.parquet: cannot be read" in said
    assert (tmp_path / "s.parquet").read_text() == "computed before"


def test_a_survey_too_short_for_one_submap(short_survey: Path, tmp_path: Path):
    outs = ("--submaps", tmp_path / "s.parquet", "--poses", tmp_path / "p.parquet")
    said = stage("segment", "baltic", "--survey", short_survey, *outs)
    assert "baltic" in said
    assert "submap_length_m" in said


def test_a_kind_of_model_that_there_is_not(parameters: Path, tmp_path: Path):
    parameters.write_text(parameters.read_text().replace("kind: mean_field", "kind: foo"))
    outs = [word for out in ("weights", "onnx", "loss", "summary") for word in (f"--{out}", tmp_path / out)]
    folders = ("--training", tmp_path, "--checkpoints", tmp_path)
    said = stage("train", "network", *folders, *outs, "--params", parameters)
    assert f"{parameters}: models.network.kind is 'foo', must be pointnetkl or mean_field" in said


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the graph, submaps and covariances of survey toy, and those of a survey of as many submaps."""
    folder, (submaps, toy_graph) = tmp_path_factory.mktemp("toy"), graph()
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    made_with = {"graph": params["graph"] | {"draws": len(toy_graph.draws)}, "registration": params["registration"]}
    artifacts.write_arrays(folder / "toy.npz", survey_graph.to_arrays(toy_graph), made_with)
    artifacts.write_arrays(folder / "bare.npz", survey_graph.to_arrays(toy_graph), {})
    for name in ("toy", "other"):
        sampling = {"survey": name, "kind": "pings", "spacing_m": 0.8}
        artifacts.write_table(folder / f"{name}.parquet", submap.to_table(submaps), submap.POINTS, sampling)
        rows = table.from_matrices(name, "network", toy_graph.number, np.tile(np.eye(2), (len(toy_graph.number), 1, 1)))
        artifacts.write_table(folder / f"{name}_q.parquet", rows, table.SCHEMA, {"survey": name})
    return folder


ELSEWHERE = "is of survey other, not of toy; give the files of one survey"
Q_ELSEWHERE = "has covariances of survey other, not of toy; give the files of one survey"


@pytest.mark.parametrize(
    ("name", "survey_name", "spoilt", "says"),
    [
        ("slam", "toy", {"predicted": "other_q.parquet"}, f"other_q.parquet: {Q_ELSEWHERE}"),
        ("slam", "toy", {"submaps": "other.parquet"}, f"other.parquet: {ELSEWHERE}"),
        ("slam", "other", {}, "toy.npz: is of survey toy, not of other; give the files of one survey"),
        ("calibrate", "toy", {"submaps": "other.parquet"}, f"other.parquet: {ELSEWHERE}"),
        ("close", "toy", {"poses": "other.parquet"}, f"other.parquet: {ELSEWHERE}"),
        ("close", "other", {}, "toy.parquet: is of survey toy, not of other; give the files of one survey"),
        ("stress", "toy", {"estimated": "other_q.parquet"}, f"other_q.parquet: {Q_ELSEWHERE}"),
        (
            "stress",
            "toy",
            {"graph": "bare.npz"},
            "bare.npz: does not say its graph.cell_factor; run dvc repro graph@toy",
        ),
        ("graph", "toy", {"labels": "other_q.parquet"}, f"other_q.parquet: {ELSEWHERE}"),
    ],
)
def test_files_that_do_not_belong_together(
    toy: Path, tmp_path: Path, name: str, survey_name: str, spoilt: dict, says: str
):
    assert stage(name, survey_name, *arguments(name, toy, tmp_path, **spoilt)) == f"error: {toy}/{says}"
    assert not list(tmp_path.iterdir())


def arguments(name: str, toy: Path, out: Path, **spoilt: str) -> list[str]:
    """Return a stage's arguments: what it reads from a folder, some of it spoilt, and what it writes to another."""
    q, points = "toy_q.parquet", "toy.parquet"
    read, written = {
        "graph": ({"poses": points, "labels": q, "pings": points, "truth": points}, ["graph"]),
        "calibrate": ({"graph": "toy.npz", "model": "none"}, ["closures", "covariances", "ends"]),
        "slam": (
            {"graph": "toy.npz", "estimated": q, "predicted": q, "measured": q, "pings": points},
            ["rows", "trajectories", "consistency", "map-thinning"],
        ),
        "close": (
            {"graph": "toy.npz", "poses": points, "estimated": q, "predicted": q, "measured": q, "pings": points},
            ["rows", "closed", "closures"],
        ),
        "stress": ({"graph": "toy.npz", "estimated": q, "predicted": q}, ["rows", "gate"]),
    }[name]
    files = [(key, toy / file) for key, file in ({"submaps": points} | read | spoilt).items()]
    return [word for key, path in [*files, *((key, out / key) for key in written)] for word in (f"--{key}", str(path))]
