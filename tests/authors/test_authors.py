"""One command makes tables beside the paper's from arrays in the authors' format."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import authors_arrays
from pointnetkl.authors import consolidated
from pointnetkl.authors import tables as authors_tables
from pointnetkl.models import model_file
from pointnetkl.models import pointnetkl as network
from pointnetkl.training import loop
from pointnetkl.workflow import parameters

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
QUICK = {
    "steps": 3,
    "batch": 4,
    "points": 16,
    "validate_every": 1,
    "threads": 1,
    "device": "cpu",
    "statistics_batch": 8,
}


def prepare(folder: Path) -> None:
    """Write small arrays under the authors' names, and parameters for a short training of a small network."""
    params = yaml.safe_load((ROOT / "authors.yaml").read_text())
    params["models"]["pointnetkl"]["train"] |= QUICK
    params["models"]["pointnetkl"]["network"] |= {"hidden_layers": 1, "hidden_width": 16}
    (folder / "authors.yaml").write_text(yaml.safe_dump(params))
    for seed, name in enumerate(("baltic", "antarctica", "borno_val")):
        authors_arrays.write(folder / f"{name}.npy", authors_arrays.rows(12, seed))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("authors")
    prepare(folder)
    words = "--train baltic.npy antarctica.npy --test borno_val.npy --out out"
    command = [sys.executable, ROOT / "pipeline/authors.py", *words.split()]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stdout
    return folder


def test_table_1_has_the_authors_sigma_z_beside_the_paper_s(finished: Path):
    table = pd.read_csv(finished / "out/table_1.csv").set_index("file")
    assert table.loc["baltic", ["survey", "submaps", "paper_submaps"]].tolist() == ["Baltic", 12, 7543]
    pooled = np.concatenate([row[0] for row in authors_arrays.rows(12, 0)])[:, 2].std()
    assert table.loc["baltic", "sigma_z"] == pytest.approx(pooled, rel=1e-3)
    assert table["paper_sigma_z"].dropna().tolist() == [0.067827, 0.246802]
    assert "9" in (finished / "out/table_1.md").read_text()


def test_table_2_has_training_validation_and_every_test_file(finished: Path):
    table = pd.read_csv(finished / "out/table_2.csv").set_index("set")
    assert table.index.tolist() == ["training", "validation", "borno_val"]
    assert table["submaps"].tolist() == [20, 4, 12]
    assert table["paper"].tolist() == [0.0184, 0.0394, 1.0578]
    assert table.loc["borno_val", "survey"] == "Bornö 8"
    own = table[["mean", "ci_low", "ci_high", "median", "mean_floor0", "constant_train", "constant"]]
    assert np.isfinite(own.to_numpy()).all()
    assert (table["constant"] <= table["constant_train"] * (1 + 1e-9)).all()


def test_the_model_and_its_parameters_are_kept_and_no_checkpoint(finished: Path):
    names = {path.name for path in (finished / "out").iterdir() if path.is_file()}
    assert names == {f"table_{n}.{kind}" for n in "12" for kind in ("csv", "md")} | {
        "loss.csv", "parameters.json", "pointnetkl.pt"
    }  # fmt: skip
    assert not list((finished / "out").glob("checkpoints/*"))
    made_by = json.loads((finished / "out/parameters.json").read_text())
    assert (made_by["surveys"], made_by["tests"]) == (["baltic", "antarctica"], ["borno_val"])
    assert made_by["models"]["pointnetkl"]["train"]["steps"] == 3
    stored = model_file.read(finished / "out/pointnetkl.pt")
    assert (stored.metadata, stored.voxel) == (made_by, consolidated.VOXEL)
    samples = consolidated.samples({"borno_val": consolidated.read(finished / "borno_val.npy")})
    assert loop.predict(stored.model, samples).shape == (12, 2, 2)


@pytest.mark.parametrize(
    ("test", "cause"),
    [
        ("copy", "copy, row 0: is row 0 of antarctica, which is trained on; test on other submaps"),
        ("baltic", "baltic.npy: there is a baltic before it; give each file once"),
        ("cut", "cut.npy: byte 130: FRAME of"),
        ("absent", "absent.npy: cannot be read (No such file or directory)"),
    ],
)
def test_what_cannot_be_tested_ends_in_one_sentence(
    finished: Path, monkeypatch: pytest.MonkeyPatch, test: str, cause: str
):
    authors_arrays.write(finished / "copy.npy", authors_arrays.rows(12, 1))
    (finished / "cut.npy").write_bytes((finished / "borno_val.npy").read_bytes()[:500])
    words = f"authors.py --params authors.yaml --train baltic.npy antarctica.npy --test {test}.npy --out none"
    monkeypatch.setattr(sys, "argv", words.split())
    monkeypatch.chdir(finished)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "pipeline/authors.py"), run_name="__main__")
    assert str(ended.value.code).startswith(f"error: {cause}")
    assert not (finished / "none").exists()


def test_the_network_of_the_authors_data_is_that_of_the_pipeline():
    section = "models.pointnetkl"
    own, pipeline = (ROOT / name for name in ("authors.yaml", "params.yaml"))
    assert parameters.read(own, f"{section}.network", network.Settings) == parameters.read(
        pipeline, f"{section}.network", network.Settings
    )
    assert parameters.read(own, f"{section}.train", loop.CloudSettings).batch == 500


def test_a_perfect_answer_has_no_divergence_and_the_best_constant_is_the_mean():
    label = np.array([row[2] for row in authors_arrays.rows(8)])
    predictions = authors_tables.Predictions(label, label, label.mean(axis=0))
    frame = authors_tables.table_2({"baltic": predictions, "borno_slam": predictions}, 0.01, 2, 0)[0].frame
    assert frame["mean"].tolist() == pytest.approx([0, 0], abs=1e-9)
    assert frame["constant"].tolist() == frame["constant_train"].tolist()
    assert frame["constant"][0] > 0.01
    assert frame["paper"].tolist() == [None, 1.0578]
