"""The whole pipeline at smoke scale, end to end, and which stages run when something changes."""

import json

import pytest

from workspace import Workspace, smoke

pytestmark = pytest.mark.slow

DROPPED = ("shetland", "borno_1", "thwaites_11")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """The smoke scale, run once: two training surveys and a test survey."""
    workspace = Workspace(tmp_path_factory.mktemp("study"))
    workspace.drop_surveys(*DROPPED)
    workspace.commit("three surveys")
    workspace.run("dvc", "exp", "run", *smoke(*DROPPED), POINTNETKL_WORKERS="1")
    workspace.commit("smoke")
    return workspace


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
    headline = study.run("dvc", "metrics", "diff").stdout.splitlines()
    assert 1 < len(headline) < 62
    everything = study.run("dvc", "metrics", "diff", "--targets", "reports/metrics.json").stdout
    assert "slam.borno_8.corrupted.rmse_xyz_m" in everything
    assert "slam.yaw_sigma_rad" in study.run("dvc", "params", "diff").stdout
    study.edit("params.yaml", "yaw_sigma_rad: 2.0e-2", "yaw_sigma_rad: 1.0e-2")
    study.run("dvc", "repro")


def test_a_survey_of_the_user_s_runs_only_its_own_stages_and_the_report(study: Workspace):
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
        *("slam", "calibrate", "close", "correct", "stress"),
    )
    assert sorted(study.ran(ran)) == sorted([*(f"{stage}@mine" for stage in own), "report"])
    metrics = json.loads((study.folder / "reports/metrics.json").read_text())
    assert metrics["datasets"]["mine"]["simulated"] is False
    assert metrics["slam"]["mine"]["pointnetkl"]["rmse_xyz_m"] >= 0
    assert "mine" in (study.folder / "reports/tables/table_1.md").read_text()
