"""The whole pipeline in x, y and yaw, run twice from nothing: 3 x 3 covariances, and the same bytes again."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from pointnetkl.registration.covariance import table
from pointnetkl.workflow import artifacts
from workspace import ROOT, Workspace, smoke

pytestmark = pytest.mark.slow

SURVEYS = ("baltic", "borno_8")  # one to train on, one to test on
CHEAP = (
    *("models.pointnetkl.train.steps=2", "vary.submaps=1", "vary.runs=45", "time.submaps=1"),
    *("slam.repetitions=1", "slam.draw_repetitions=1"),
)
# seconds are never the same, and these files show them
TIMED = (
    *("reports/runtime.json", "reports/tables/table_3", "reports/index.html"),
    *("reports/figures/accuracy_time", "reports/figures/cost_accuracy"),
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Two surveys at smoke scale, run once."""
    workspace = Workspace(tmp_path_factory.mktemp("yaw"))
    surveys = yaml.safe_load((ROOT / "params.yaml").read_text())["study"]["surveys"]
    others = [name for name in surveys if name not in SURVEYS]
    workspace.drop_surveys(*others)
    workspace.commit("two surveys, x, y and yaw")
    changes = [*smoke(*others), *(f"-S{change}" for change in ("registration.dof=xyyaw", *CHEAP))]
    # asked for by its name, the report needs no survey simulated that is not in the study
    workspace.run("dvc", "exp", "run", *changes, "report", POINTNETKL_WORKERS="1")
    return workspace


def correlations(path: Path) -> tuple[pd.DataFrame, np.ndarray]:
    """Return a table's rows and their covariances, each in units of its own sigmas."""
    rows = pd.read_parquet(path)
    q = table.to_matrices(rows)
    sigma = np.sqrt(np.diagonal(q, axis1=1, axis2=2))
    return rows, q / (sigma[:, :, None] * sigma[:, None])


def test_with_yaw_every_stage_gives_covariances_of_x_y_and_yaw(study: Workspace):
    data = study.folder / "data"
    methods = set()
    for path in ("train/baltic/labels", "test/borno_8/labels", "test/borno_8/estimated", "test/borno_8/predicted"):
        rows, correlation = correlations(data / f"{path}.parquet")
        assert correlation.shape == (len(rows), 3, 3)
        assert np.linalg.eigvalsh(correlation).min() > 0
        assert (rows["q_ww_rad2"] < 0.1).all()
        methods |= set(rows.get("method", ()))
    held_out = artifacts.read_arrays(data / "test/borno_8/errors.npz")[0]["held_out"]
    errors = artifacts.read_arrays(data / "test/borno_8/graph.npz")[0]["registration_error_truth_m"]
    assert held_out.shape[2] == errors.shape[1] == 3
    assert 0 < np.abs(errors[:, 2]).max() < 0.1
    metrics = json.loads((study.folder / "reports/metrics.json").read_text())
    for method in methods:
        assert metrics["slam"]["borno_8"][method]["rmse_xyz_m"] > 0
        assert metrics["calibration"]["borno_8"][method]["nees"] > 0


def hashes(workspace: Workspace) -> dict[str, str]:
    """Return the hash of every file that a stage made, but of those with seconds in them."""
    lock = yaml.safe_load((workspace.folder / "dvc.lock").read_text())
    outs = [workspace.folder / out["path"] for stage in lock["stages"].values() for out in stage.get("outs", [])]
    files = [file for out in outs for file in ([out] if out.is_file() else out.rglob("*")) if file.is_file()]
    named = {str(file.relative_to(workspace.folder)): file for file in files}
    return {
        name: hashlib.sha256(file.read_bytes()).hexdigest()
        for name, file in named.items()
        if not name.startswith(TIMED)
    }


def test_another_clean_run_with_other_workers_gives_the_same_bytes(study: Workspace, tmp_path: Path):
    again = Workspace(tmp_path)
    shutil.copy(study.folder / "params.yaml", again.folder / "params.yaml")
    again.run("dvc", "repro", "report", POINTNETKL_WORKERS="2")
    assert len(hashes(study)) > 50
    assert hashes(again) == hashes(study)
