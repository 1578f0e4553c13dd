"""Tiles of points have no track: no graph is made of them, SLAM has nothing to say of them, and the rest goes on."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fake_artifacts
from pointnetkl.registration.covariance import label_table, table
from pointnetkl.reporting import report, results
from pointnetkl.reporting.slam import figures as slam_figures
from pointnetkl.slam.benchmark import schemas as slam_schemas
from pointnetkl.slam.closing import schemas as closing_schemas
from pointnetkl.slam.closures import graph_construction
from pointnetkl.slam.consistency import consistency_map
from pointnetkl.slam.consistency import schemas as consistency_schemas
from pointnetkl.slam.graph import graph_file, survey_graph
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.surveys import submap, survey
from pointnetkl.workflow import artifacts, parameters, study
from toy_survey import REGISTRATION, SETTINGS, SPACING, sail

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
METHODS = ("monte_carlo", "network", "structure_tensor", "constant", "naive_gicp")


@pytest.mark.parametrize("dof", ["xy", "xyyaw"])
def test_a_graph_without_a_track_has_nodes_and_no_edge_and_comes_back_from_its_file(tmp_path: Path, dof: str):
    submaps, poses = sail(2, 3)
    registration = dataclasses.replace(REGISTRATION, dof=dof)
    nodes_only = graph_construction.without_track("toy", submaps, poses, SPACING, SETTINGS, registration)
    artifacts.write_arrays(tmp_path / "toy.npz", survey_graph.to_arrays(nodes_only), {})
    again = graph_file.read(tmp_path / "toy.npz", "toy").graph
    assert not again.track
    assert np.array_equal(again.gt, poses)
    assert np.isnan(again.truth).all()
    assert [len(draw.edges.source) for draw in again.draws] == [0] * SETTINGS.draws
    summary = survey_graph.summary(again)
    assert (summary["submaps"], summary["dead_reckoning_edges"], summary["loop_closures"]) == (6, 0, 0)


def test_a_graph_of_a_track_says_nothing_of_it():
    submaps, poses = sail(2, 3)
    nodes_only = graph_construction.without_track("toy", submaps, poses, SPACING, SETTINGS, REGISTRATION)
    assert "track" in survey_graph.to_arrays(nodes_only)
    assert "track" not in survey_graph.to_arrays(dataclasses.replace(nodes_only, track=True))


def run(name: str, folder: Path, **files: str) -> None:
    """Run a stage on the files of a folder."""
    arguments = [word for option, file in files.items() for word in (f"--{option.replace('_', '-')}", folder / file)]
    script = [sys.executable, ROOT / f"pipeline/{name}.py", "toy", "--params", ROOT / "params.yaml", *arguments]
    done = subprocess.run(script, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what stages graph, slam and stress make of tiles."""
    folder, (submaps, T) = tmp_path_factory.mktemp("tiles"), sail(2, 3)
    numbers = [piece.number for piece in submaps]
    q = np.broadcast_to(0.1 * np.eye(2), (len(submaps), 2, 2))
    poses = pd.DataFrame({"submap": numbers, "x_m": T[:, 0, 3], "y_m": T[:, 1, 3], "z_m": T[:, 2, 3]})
    poses = poses.assign(time_s=np.nan, yaw_rad=0.0, track_m=30.0, pings=0, soundings=900, line=0)
    labels = pd.DataFrame(dict.fromkeys(label_table.LABELS.names, 0.0), index=numbers).assign(
        submap=numbers, runs=9, spacing_m=SPACING, self_matching=False, q_xx_m2=0.1, q_yy_m2=0.1
    )
    kind = {"kind": "points", "crs": "EPSG:32751", "origin": [5e5, 8e6]}
    for name, frame, schema, metadata in (
        ("submaps", submap.to_table(submaps), submap.POINTS, {"kind": "points", "spacing_m": SPACING}),
        ("poses", poses, submap.POSES, {}),
        ("labels", labels, label_table.LABELS, {}),
        ("pings", survey.PINGS.empty_table().to_pandas(), survey.PINGS, kind),
        ("truth", survey.TRAJECTORY.empty_table().to_pandas(), survey.TRAJECTORY, kind),
        ("estimated", pd.concat(table.from_matrices("toy", m, numbers, q) for m in METHODS), table.SCHEMA, {}),
        ("predicted", table.SCHEMA.empty_table().to_pandas(), table.SCHEMA, {}),
    ):
        artifacts.write_table(folder / f"{name}.parquet", frame, schema, metadata)
    read = {name: f"{name}.parquet" for name in ("submaps", "estimated", "predicted")}
    of_graph = {name: f"{name}.parquet" for name in ("submaps", "poses", "labels", "pings", "truth")}
    run("graph", folder, **of_graph, graph="graph.npz")
    slam = {name: f"{name}.parquet" for name in ("rows", "trajectories", "map_thinning", "pings")}
    run("slam", folder, **read, **slam, graph="graph.npz", measured="predicted.parquet", consistency="map.tif")
    run("stress", folder, **read, graph="graph.npz", rows="robust.parquet", gate="gate.parquet")
    return folder


def test_slam_and_stress_write_tables_of_no_rows(solved: Path):
    assert artifacts.read_table(solved / "rows.parquet", slam_schemas.ROWS).empty
    assert artifacts.read_table(solved / "trajectories.parquet", slam_schemas.TRAJECTORIES).empty
    assert artifacts.read_table(solved / "map_thinning.parquet", consistency_schemas.THINNING).empty
    assert artifacts.read_table(solved / "robust.parquet", robust_schemas.ROWS).empty
    assert artifacts.read_table(solved / "gate.parquet", robust_schemas.GATE).empty
    grid = consistency_map.read(solved / "map.tif", ["no track"])
    assert np.isnan(grid.errors["no track"]).all()


def test_a_graph_without_a_track_cannot_be_exported(solved: Path):
    command = [sys.executable, "-m", "pointnetkl", "export", solved / "graph.npz", "--out", solved / "toy.g2o"]
    done = subprocess.run(
        [*command, "--covariances", solved / "estimated.parquet"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr == f"error: {solved / 'graph.npz'}: its points have no track, so it has no edges to export\n"


def lose_track(root: Path, name: str) -> None:
    """Make of a test survey's artifacts those of tiles, as the stages leave them."""
    place = root / f"data/surveys/{name}/pings.parquet"
    kept = artifacts.table_metadata(place)
    artifacts.write_table(place, survey.PINGS.empty_table().to_pandas(), survey.PINGS, {**kept, "kind": "points"})
    place = root / f"data/test/{name}/graph.npz"
    arrays, _ = artifacts.read_arrays(place)
    artifacts.write_arrays(place, {**arrays, "track": np.array(False)}, {})
    for path, schema in (
        (f"slam/{name}", slam_schemas.ROWS),
        (f"slam/{name}_trajectories", slam_schemas.TRAJECTORIES),
        (f"slam/{name}_map_thinning", consistency_schemas.THINNING),
        (f"closing/{name}", closing_schemas.ROWS),
        (f"closing/{name}_closed", closing_schemas.POSES),
        (f"closing/{name}_closures", closing_schemas.CLOSURES),
        (f"robustness/{name}", robust_schemas.ROWS),
        (f"robustness/{name}_gate", robust_schemas.GATE),
    ):
        artifacts.write_table(root / f"reports/{path}.parquet", schema.empty_table().to_pandas(), schema, {})


def test_a_report_has_every_row_of_tiles_but_those_of_slam(tmp_path: Path):
    fake_artifacts.write(tmp_path)
    lose_track(tmp_path, "mine")  # of which no loop closures are known
    params = tmp_path / "params.yaml"
    folders = results.Folders(tmp_path / "data", tmp_path / "models", tmp_path / "reports", study.read(params))
    page = report.make(folders, parameters.read(params, "report", results.Settings))
    numbers = json.loads(page.files["metrics.json"])
    assert numbers["slam"]["mine"] == {"dead_reckoning_edges": 0, "loop_closures": 0}
    assert numbers["kl"]["mine"]["network"]["mean"] >= 0
    assert numbers["calibration"]["mine"]["network"]["nees"] > 0
    assert "track_km" not in numbers["datasets"]["mine"]
    rows = [line for line in page.files["tables/table_4.md"].decode().splitlines() if line.startswith("| mine")]
    assert [cell.strip() for cell in rows[0].split("|")[3:6]] == ["—", "0", "0"]
    assert "They have no track, and so no SLAM: mine." in page.files["index.html"].decode()
    assert "mine: SLAM error against GT, m: no track, no SLAM" in page.lines


def test_where_no_survey_has_a_track_every_figure_says_so():
    figures = dict(slam_figures.every([], {}, {}))
    assert len(figures) == 6
    assert {figure.texts[0].get_text() for figure in figures.values()} == {"no test survey has a track"}
