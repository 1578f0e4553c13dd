"""Errors of loop closures, measured: what Q_ij is, what GT adds, and that the number of workers does not count."""

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from pointnetkl.models import model_file
from pointnetkl.models import pointnetkl as network
from pointnetkl.registration import gicp, monte_carlo, pair
from pointnetkl.registration.covariance import table
from pointnetkl.slam.closures import errors as closure_errors
from pointnetkl.slam.closures import loop_closure, placed, terrain
from pointnetkl.slam.closures import schemas as closure_schemas
from pointnetkl.slam.graph import survey_graph
from pointnetkl.slam.graph.survey_graph import SurveyGraph
from pointnetkl.surveys import pose, submap
from pointnetkl.surveys.se2 import SE2
from pointnetkl.workflow import artifacts, parameters
from toy_survey import REGISTRATION, SETTINGS, SPACING, graph

ROOT = Path(__file__).parents[2]
LABEL = monte_carlo.Settings(2, "same", 1.0, 0.02, 0)
CHOSEN = closure_errors.Settings(5, 60)


def measure(
    survey: tuple[list[submap.Submap], SurveyGraph], registration: gicp.Settings = REGISTRATION, runs: int = 60
) -> closure_errors.Measured:
    """Return the tables of a toy survey."""
    setup = closure_errors.Setup(SPACING, SETTINGS, LABEL, registration, pair.covariance.Settings())
    return closure_errors.measure(survey[1], survey[0], dataclasses.replace(CHOSEN, runs=runs), setup)


@pytest.fixture(scope="module")
def toy() -> tuple[list[submap.Submap], SurveyGraph]:
    """A survey over rugged ground, whose navigation drifts."""
    return graph()


@pytest.fixture(scope="module")
def measured(toy: tuple[list[submap.Submap], SurveyGraph]) -> closure_errors.Measured:
    """Its tables."""
    return measure(toy)


def by_submap(covariances: pd.DataFrame, method: str) -> dict[int, np.ndarray]:
    """Return the covariances of a method by submap."""
    rows = covariances[covariances["method"] == method]
    return dict(zip(rows["submap"].tolist(), table.to_matrices(rows), strict=True))


def size(q: np.ndarray) -> float:
    """Return the geometric mean of a covariance's variances."""
    return float(np.sqrt(np.linalg.det(q)))


@pytest.mark.slow
def test_another_pass_is_found_worse_than_the_very_points_and_better_than_half_of_them(
    toy: tuple[list[submap.Submap], SurveyGraph], measured: closure_errors.Measured
):
    pair, split = by_submap(measured[1], "measured_pair"), by_submap(measured[1], "split")
    for number, q in pair.items():
        rng = np.random.default_rng(1)
        same = monte_carlo.covariance(monte_carlo.errors(toy[0][number], 60, rng, LABEL, REGISTRATION).errors)
        assert 10 * size(same) < size(q) < size(split[number])


def test_there_is_a_row_for_each_registration_of_each_draw(
    toy: tuple[list[submap.Submap], SurveyGraph], measured: closure_errors.Measured
):
    rows, graph_ = measured[0], toy[1]
    assert list(rows.columns) == closure_schemas.CLOSURES.names
    for draw, closures in enumerate(graph_.draws):
        of_draw = rows[rows["draw"] == draw]
        assert of_draw["submap"].tolist() == graph_.number[closures.node].tolist()
        expected = survey_graph.registration_errors(closures, graph_.truth)
        assert of_draw[["error_x_m", "error_y_m"]].to_numpy() == pytest.approx(expected)
    assert rows["overlap"].between(SETTINGS.coverage, 1).all()
    assert set(by_submap(measured[1], "measured_pair")) == set(rows["submap"])


def test_a_placed_registration_errs_as_the_graph_s_does_where_gt_is_the_truth():
    submaps, graph_ = graph()
    true = dataclasses.replace(graph_, gt=graph_.truth)
    starts = [loop_closure.starts("toy", submaps, SETTINGS, 2, draw) for draw in range(2)]
    draws = tuple(loop_closure.close(submaps, graph_.truth, start, SPACING, SETTINGS, REGISTRATION) for start in starts)
    rows, _, _ = measure((submaps, dataclasses.replace(true, draws=draws)), runs=4)
    first = rows[rows["submap"] == rows["submap"].min()]  # its targets have not been registered themselves
    for axis in "xy":
        assert first[f"error_{axis}_m"].to_numpy() == pytest.approx(
            first[f"placed_error_{axis}_m"].to_numpy(), abs=1e-4
        )
    assert rows[["given_m", "heading_m"]].to_numpy() == pytest.approx(0, abs=1e-9)


def test_a_wrong_heading_errs_by_its_lever_to_the_common_ground(toy: tuple[list[submap.Submap], SurveyGraph]):
    submaps, graph_ = toy
    gt = graph_.truth.copy()
    gt[-1] = gt[-1] @ pose.matrix(np.zeros(3), 0.01)
    rows, _, _ = measure((submaps, dataclasses.replace(graph_, gt=gt)), runs=4)
    by_submap = rows.groupby("submap")["heading_m"].first()
    # the line before is 10 m away: the middle of what both have is 5 m to the side, but for cells of 4 m
    assert by_submap.iloc[-1] == pytest.approx(0.01 * 5, rel=0.15)
    assert by_submap.iloc[:-1].to_numpy() == pytest.approx(0, abs=1e-9)
    assert rows["given_m"].iloc[-1] == pytest.approx(0, abs=1e-9)


def test_without_a_truth_only_gt_tells_errors(toy: tuple[list[submap.Submap], SurveyGraph]):
    submaps, graph_ = toy
    rows, _, _ = measure((submaps, dataclasses.replace(graph_, truth=np.full_like(graph_.truth, np.nan))), runs=4)
    assert rows[["error_x_m", "given_m", "heading_m"]].isna().all(axis=None)
    assert rows[["gt_error_x_m", "placed_error_x_m"]].notna().all(axis=None)


def test_with_yaw_there_is_its_error_too():
    with_yaw = dataclasses.replace(REGISTRATION, dof="xyyaw")
    rows, covariances, ends = measure(graph(registration=with_yaw), with_yaw)
    assert list(rows.columns) == closure_schemas.schema(3).names
    assert 0 < rows["placed_error_w_rad"].abs().max() < 0.05
    for q in by_submap(covariances, "measured_pair").values():
        assert q.shape == (3, 3)
        assert np.sqrt(q[2, 2]) < 0.02
    assert set(ends["method"]) == {"pair", "drpm", "map"}  # the misfit's region has no yaw
    assert list(ends.columns) == closure_schemas.ends_schema(3).names
    # nothing is said of the error that a registration without yaw would have
    assert rows["heading_m"].isna().all()


def test_the_number_of_workers_does_not_count(
    toy: tuple[list[submap.Submap], SurveyGraph], measured: closure_errors.Measured, monkeypatch: pytest.MonkeyPatch
):
    for workers in ("1", "3"):
        monkeypatch.setenv("POINTNETKL_WORKERS", workers)
        for actual, expected in zip(measure(toy), measured, strict=True):
            pd.testing.assert_frame_equal(actual, expected, check_exact=True)


def test_a_survey_that_closes_no_loop_has_empty_tables():
    rows, covariances, ends = measure(graph(lines=1), runs=4)
    assert len(rows) == len(covariances) == len(ends) == 0
    assert list(ends.columns) == closure_schemas.ENDS.names
    assert list(rows.columns) == closure_schemas.CLOSURES.names
    assert list(covariances.columns) == table.SCHEMA.names


def test_points_off_the_target_are_left_out_at_each_start_as_the_graph_leaves_them_out(
    toy: tuple[list[submap.Submap], SurveyGraph],
):
    submaps, graph_ = toy
    ground = loop_closure.Ground(
        pose.transform(graph_.truth[0], submaps[0].points), graph_.truth[0][:3, 3], 2.0, REGISTRATION
    )
    cloud = pose.transform(graph_.truth[7], submaps[7].points)
    starts = [SE2(translation, 0.0) for translation in np.random.default_rng(1).normal(0, 1, (5, 2))]
    for start, outcome in zip(starts, ground.register_many(cloud, starts), strict=True):
        expected = ground.register(cloud, start)
        assert outcome is not None
        assert expected is not None
        assert outcome[0].to_vector() == pytest.approx(expected[0].to_vector(), abs=1e-6)


def test_slopes_in_one_block_are_as_patchy_as_can_be():
    points = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), -1).reshape(-1, 2)
    assert terrain.patchiness(points, np.ones(1600)) == pytest.approx(0, abs=0.1)
    corner = (points < 5).all(axis=1)
    assert terrain.patchiness(points, corner.astype(float)) == pytest.approx(np.sqrt(15))
    assert terrain.patchiness(points, np.zeros(1600)) == 0


def test_where_no_placed_registration_matches_q_ij_is_the_label_by_halves(
    toy: tuple[list[submap.Submap], SurveyGraph], monkeypatch: pytest.MonkeyPatch
):
    alone = toy[1].number[toy[1].closures.node[0]]
    there = toy[1].truth[toy[1].closures.node[0]]
    register = placed.Placed.register

    def lost(self: placed.Placed, starts: np.ndarray) -> list[placed.End | None]:
        return [None for _ in starts] if np.array_equal(self.T_map_source, there) else register(self, starts)

    monkeypatch.setattr(placed.Placed, "register", lost)
    _, covariances, ends = measure(toy, runs=4)
    assert alone not in set(ends["submap"])
    pair, split = by_submap(covariances, "measured_pair"), by_submap(covariances, "split")
    assert set(pair) == set(split)
    assert (pair[alone] == split[alone]).all()
    assert sum((pair[number] == split[number]).all() for number in pair) == 1
    survey_graph.edge_covariances(toy[1].number, pair, toy[1].closures, "toy, pair")  # every edge has one


def test_fewer_than_four_runs_are_refused():
    with pytest.raises(ValueError, match="runs is 3, must be 4 or above"):
        closure_errors.Settings(1, 3)


def write(folder: Path, survey: tuple[list[submap.Submap], SurveyGraph], submaps: int) -> list[str]:
    """Write what the stage reads; return its command."""
    sampling = {"kind": "pings", "spacing_m": SPACING}
    artifacts.write_table(folder / "submaps.parquet", submap.to_table(survey[0][:submaps]), submap.POINTS, sampling)
    made_with = {"graph": SETTINGS, "registration": REGISTRATION}
    metadata = {name: parameters.as_metadata(values) for name, values in made_with.items()}
    artifacts.write_arrays(folder / "graph.npz", survey_graph.to_arrays(survey[1]), metadata)
    sections = {"calibrate": closure_errors.Settings(5, 4), "label": LABEL}
    params: dict[str, Any] = {name: parameters.as_metadata(values) for name, values in sections.items()}
    params["close"] = {"closing": {"search": {"numbers": parameters.as_metadata(pair.covariance.Settings())}}}
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    command = [sys.executable, str(ROOT / "pipeline/calibrate.py"), "toy", "--params", "params.yaml"]
    settings = network.Settings(scale_input=True, hidden_layers=1, hidden_width=8, dropout=0.0)
    (folder / "mine.pt").write_bytes(model_file.to_bytes("pointnetkl", network.PointNetKL(settings), 0.01, {}))
    command += ["--graph", "graph.npz", "--submaps", "submaps.parquet", "--model", "mine.pt"]
    return [
        *command,
        "--closures",
        "out/toy.parquet",
        "--covariances",
        "out/toy_covariances.parquet",
        "--ends",
        "out/toy_ends.parquet",
    ]


@pytest.mark.slow
def test_the_stage_writes_both_tables(toy: tuple[list[submap.Submap], SurveyGraph], tmp_path: Path):
    subprocess.run(write(tmp_path, toy, len(toy[0])), cwd=tmp_path, check=True, capture_output=True)
    rows = artifacts.read_table(tmp_path / "out/toy.parquet", closure_schemas.CLOSURES)
    covariances = artifacts.read_table(tmp_path / "out/toy_covariances.parquet", table.SCHEMA)
    assert len(rows) == sum(len(closures.node) for closures in toy[1].draws)
    assert set(covariances["method"]) == {"split", "measured_pair", "mine_overlap"}


def test_submaps_of_another_graph_are_refused_in_one_sentence(
    toy: tuple[list[submap.Submap], SurveyGraph], tmp_path: Path
):
    done = subprocess.run(write(tmp_path, toy, 5), cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.strip() == ("error: toy: the graph has 12 submaps, not the 5 given; run dvc repro graph@toy")
    assert not (tmp_path / "out").exists()
