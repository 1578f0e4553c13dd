"""The front end's gate: how much submaps cover of each other, and what it joined of what it should have."""

import dataclasses

import numpy as np
import pandas as pd

from pointnetkl.slam.graph import footprint, survey_graph
from pointnetkl.slam.robust import loop_gate
from pointnetkl.slam.robust import schemas as robust_schemas
from pointnetkl.surveys import pose
from toy_survey import SETTINGS, SPACING, graph

SUBMAPS, GRAPH = graph(3, 4)
CLOUDS = [s.points for s in SUBMAPS]
CELL = SETTINGS.cell_factor * SPACING


def test_coverages_are_those_of_the_footprints_pair_by_pair():
    coverages = loop_gate.coverages(CLOUDS, GRAPH.truth, CELL)
    cells = [footprint.cells(pose.transform(T, p), CELL) for T, p in zip(GRAPH.truth, CLOUDS, strict=True)]
    assert np.diag(coverages).tolist() == [1.0] * len(cells)
    for i, k in ((7, 0), (0, 7), (8, 1), (11, 0), (3, 2)):
        assert coverages[i, k] == footprint.coverage(cells[i], cells[k])


def table(survey_graph_: survey_graph.SurveyGraph = GRAPH, corrupted: list[np.ndarray] | None = None) -> pd.DataFrame:
    return loop_gate.table(survey_graph_, CLOUDS, corrupted or [], CELL, SETTINGS.coverage)


def test_algorithm_1_joins_the_pairs_that_cover_but_for_those_at_the_edge():
    # a draw moves submaps a little once it has registered them
    rows = table(dataclasses.replace(GRAPH, truth=GRAPH.gt)).query("at == 'graph'")
    assert rows["draw"].tolist() == [0, 1]
    assert (rows["both"] >= 0.9 * rows["joined"]).all()
    assert (rows["both"] >= 0.9 * rows["covering"]).all()


def test_at_the_true_poses_the_gate_makes_no_mistake_and_at_others_it_does():
    far = GRAPH.truth.copy()
    far[4:8, 1, 3] += 15.0
    rows = table(corrupted=[GRAPH.truth, far]).query("at == 'corrupted'").reset_index()
    assert rows.loc[0, "joined"] == rows.loc[0, "both"] == rows.loc[0, "covering"] > 0
    assert rows.loc[1, "both"] < rows.loc[1, "covering"]


def test_a_gate_that_joined_half_is_told_so():
    edges = GRAPH.closures.edges
    some = dataclasses.replace(
        edges, target=edges.target[::2], source=edges.source[::2], T_target_source=edges.T_target_source[::2]
    )
    half = dataclasses.replace(GRAPH, draws=(dataclasses.replace(GRAPH.closures, edges=some),))
    all_joined, half_joined = table().iloc[0], table(half).iloc[0]
    assert half_joined["joined"] == len(some.source)
    assert half_joined["covering"] == all_joined["covering"]
    assert 0.4 < half_joined["both"] / all_joined["both"] < 0.7


def test_neighbours_on_the_track_are_no_loops():
    n = len(CLOUDS)
    together = np.tile(GRAPH.truth[0], (n, 1, 1))
    assert table(corrupted=[together]).iloc[-1]["joined"] == (n - 1) * (n - 2) / 2


def test_without_truth_only_what_was_joined_is_known():
    rows = table(dataclasses.replace(GRAPH, truth=np.full_like(GRAPH.truth, np.nan)))
    assert (rows["joined"] > 0).all()
    assert rows[["covering", "both"]].isna().all(axis=None)
    assert list(rows.columns) == robust_schemas.GATE.names
