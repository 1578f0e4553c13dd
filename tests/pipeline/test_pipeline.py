"""The whole pipeline at smoke scale, end to end, and what happens when something changes."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from pointnetkl.registration.covariance import table
from pointnetkl.workflow import artifacts
from workspace import ROOT, Workspace

DROPPED = ("shetland", "borno_1", "thwaites_11")
CHANGES = (Path(__file__).parents[2] / "scales/smoke").read_text().replace("-S ", "").split()
SCALE = [f"-S{change}" for change in CHANGES if not any(f"surveys.{name}." in change for name in DROPPED)]

CHEAP = (
    *("models.pointnetkl.train.steps=2", "vary.submaps=1", "vary.runs=45", "time.submaps=1"),
    *("slam.repetitions=1", "slam.draw_repetitions=1"),
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """The smoke scale, run once: two training surveys and a test survey."""
    workspace = Workspace(tmp_path_factory.mktemp("study"))
    workspace.drop_surveys(*DROPPED)
    workspace.commit("three surveys")
    workspace.run("dvc", "exp", "run", *SCALE, POINTNETKL_WORKERS="1")
    workspace.commit("smoke")
    return workspace


def hashes(workspace: Workspace) -> dict[str, str]:
    """Return the hash of every artifact in dvc.lock, but of what holds timings."""
    lock = yaml.safe_load((workspace.folder / "dvc.lock").read_text())
    timed = tuple(
        f"reports/{name}"
        for name in (
            "runtime.json",
            "tables/table_3",
            "figures/accuracy_time.png",
            "figures/cost_accuracy.png",
            "index.html",
        )
    )
    return {
        out["path"]: out["md5"]
        for stage in lock["stages"].values()
        for out in stage.get("outs", [])
        if not out["path"].startswith(timed)
    }


def test_the_paper_s_tables_come_out(study: Workspace):
    for number in range(1, 5):
        text = (study.folder / f"reports/tables/table_{number}.md").read_text()
        assert "borno_8" in text or number == 3
    metrics = json.loads((study.folder / "reports/metrics.json").read_text())
    assert metrics["slam"]["borno_8"]["corrupted"]["rmse_xyz_m"] > 0
    assert metrics["kl"]["borno_8"]["pointnetkl"]["mean"] > 0


def test_a_second_run_has_nothing_to_do_and_says_so(study: Workspace):
    output = study.run("dvc", "repro").stdout
    assert study.ran(output) == []
    assert "up to date" in output


def test_changing_slam_reruns_slam_stress_and_the_report_only(study: Workspace):
    study.edit("params.yaml", "yaw_sigma_rad: 1.0e-2", "yaw_sigma_rad: 2.0e-2")
    assert sorted(study.ran(study.run("dvc", "repro").stdout)) == ["report", "slam@borno_8", "stress@borno_8"]
    difference = study.run("dvc", "metrics", "diff").stdout
    assert "slam.borno_8.corrupted.rmse_xyz_m" in difference
    assert "slam.yaw_sigma_rad" in study.run("dvc", "params", "diff").stdout
    study.edit("params.yaml", "yaw_sigma_rad: 2.0e-2", "yaw_sigma_rad: 1.0e-2")
    study.run("dvc", "repro")


def test_another_clean_run_with_other_workers_gives_the_same_bytes(study: Workspace, tmp_path: Path):
    again = Workspace(tmp_path)
    for name in ("params.yaml",):
        (again.folder / name).write_text((study.folder / name).read_text())
    again.run("dvc", "repro", POINTNETKL_WORKERS="3")
    assert hashes(again) == hashes(study)


def test_a_survey_of_the_user_s_runs_only_its_own_stages_and_what_gathers_them(study: Workspace):
    # raw pings under another name stand for a user's file; nothing is known of its truth
    study.run("cp", "-r", "data/raw/borno_8", "data/raw/mine")
    line = (
        "mine: {group: test, raw: data/raw/mine, truth: data/none,"
        " submap_length_m: 100, point_spacing_m: 3.2, label_runs: 20}"
    )
    study.edit("params.yaml", "  test: &test\n", f"  test: &test\n    {line}\n")
    ran = study.run("dvc", "repro").stdout
    own = (
        *("ingest", "segment", "voxelise", "label", "vary", "estimate", "predict", "graph"),
        *("slam", "calibrate", "stress"),
    )
    assert sorted(study.ran(ran)) == sorted([*(f"{stage}@mine" for stage in own), "report"])
    metrics = json.loads((study.folder / "reports/metrics.json").read_text())
    assert metrics["datasets"]["mine"]["simulated"] is False
    assert metrics["slam"]["mine"]["pointnetkl"]["rmse_xyz_m"] >= 0
    assert "mine" in (study.folder / "reports/tables/table_1.md").read_text()


def read_covariances(path: Path) -> tuple[pd.DataFrame, np.ndarray]:
    """Return a table's rows and their covariances, each in units of its own sigmas: a correlation."""
    rows = pd.read_parquet(path)
    q = table.to_matrices(rows)
    sigma = np.sqrt(np.diagonal(q, axis1=1, axis2=2))
    return rows, q / (sigma[:, :, None] * sigma[:, None])


def test_with_yaw_every_stage_gives_covariances_of_x_y_and_yaw(tmp_path: Path):
    workspace = Workspace(tmp_path)
    surveys = yaml.safe_load((ROOT / "params.yaml").read_text())["study"]["surveys"]
    others = [name for name in surveys if name not in ("baltic", "borno_8")]
    workspace.drop_surveys(*others)
    workspace.commit("two surveys, x, y and yaw")
    asked = [
        *(c for c in CHANGES if not any(f"surveys.{name}." in c for name in others)),
        "registration.dof=xyyaw",
        *CHEAP,
    ]
    # asked for by its name, the report needs no survey simulated that is not in the study
    workspace.run("dvc", "exp", "run", *(f"-S{change}" for change in asked), "report")

    data = workspace.folder / "data"
    for path in ("labels/baltic", "labels/borno_8", "covariances/borno_8_estimated", "covariances/borno_8_predicted"):
        rows, correlation = read_covariances(data / f"{path}.parquet")
        assert correlation.shape == (len(rows), 3, 3)
        assert np.linalg.eigvalsh(correlation).min() > 0
        assert (rows["q_ww_rad2"] < 0.1).all()
    held_out = artifacts.read_arrays(data / "labels/borno_8_errors.npz")[0]["held_out"]
    found = artifacts.read_arrays(data / "graphs/borno_8.npz")[0]["registration_error_truth_m"]
    assert held_out.shape[2] == found.shape[1] == 3
    assert 0 < np.abs(found[:, 2]).max() < 0.1
    metrics = json.loads((workspace.folder / "reports/metrics.json").read_text())
    for method in {*rows["method"], *pd.read_parquet(data / "covariances/borno_8_estimated.parquet")["method"]}:
        assert metrics["slam"]["borno_8"][method]["rmse_xyz_m"] > 0
        assert metrics["calibration"]["borno_8"][method]["nees"] > 0
