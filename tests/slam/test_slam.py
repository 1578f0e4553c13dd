"""What the benchmark's graphs are corrupted by, and whose covariances are on their edges."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from pointnetkl.registration.covariance import gaussian, table
from pointnetkl.slam.benchmark import protocol
from pointnetkl.slam.graph import pose_graph, survey_graph
from pointnetkl.slam.graph.pose_graph import Edges
from toy_survey import graph

SETTINGS = protocol.Settings(3, 4, 2, 0.05, "all", 0.0, 2, 15.0, 2)
SUBMAPS, GRAPH = graph(4, 4, apart=6.0)


def test_noise_is_new_in_each_draw_and_repetition_and_the_same_in_each_run():
    noisy = protocol.corrupt(GRAPH, 0, 1, SETTINGS)
    assert (noisy == protocol.corrupt(GRAPH, 0, 1, SETTINGS)).all()
    others = [protocol.corrupt(GRAPH, draw, repetition, SETTINGS) for draw, repetition in ((0, 0), (1, 0), (1, 1))]
    others.append(protocol.corrupt(dataclasses.replace(GRAPH, survey="other"), 0, 1, SETTINGS))
    every = np.array([noisy, *others])
    assert len(np.unique(every[:, 0, 0, 1])) == len(every)


def test_only_the_yaw_of_dead_reckoning_is_corrupted():
    exact, noisy = pose_graph.between(GRAPH.gt), protocol.corrupt(GRAPH, 0, 0, SETTINGS)
    assert noisy[:, :3, 3] == pytest.approx(exact[:, :3, 3])
    turn = np.linalg.inv(exact) @ noisy
    assert turn[:, 2, :3] == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(turn), 1)), abs=1e-9)
    assert 0.5 < np.arctan2(turn[:, 1, 0], turn[:, 0, 0]).std() / SETTINGS.yaw_sigma_rad < 2


def test_a_registration_shared_by_its_edges_counts_once():
    closures, q = GRAPH.closures, {s.number: 0.04 * np.eye(2) for s in SUBMAPS}

    def x_variances(edges: str, closures_: survey_graph.Closures = closures) -> np.ndarray:
        return survey_graph.full_covariances(GRAPH.number, q, closures_, GRAPH.closure_noise, "toy", edges)[:, 3, 3]

    assert (x_variances("all") == 0.04).all()
    # the information of its edges then adds up to that of one Q
    assert np.bincount(closures.registration, 1 / x_variances("shared")) == pytest.approx(1 / 0.04)
    assert np.bincount(closures.registration).max() > 1
    none = Edges(*(part[:0] for part in (closures.edges.target, closures.edges.source, closures.edges.T_target_source)))
    bare = dataclasses.replace(closures, edges=none, registration=closures.registration[:0])
    assert x_variances("shared", bare).shape == (0,)


@pytest.mark.parametrize("bad", [[[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]])
def test_what_is_not_a_covariance_never_reaches_the_optimiser(bad: list[list[float]]):
    rows = table.from_matrices("toy", "m", [0, 1], np.array([np.eye(2), np.eye(2)]))
    rows.loc[1, ["q_xx_m2", "q_xy_m2", "q_yy_m2"]] = [bad[0][0], bad[0][1], bad[1][1]]
    with pytest.raises(gaussian.CovarianceError, match="submap 1, m"):
        protocol.by_method(rows)


def test_two_covariances_of_one_name_for_one_submap_are_refused():
    rows = table.from_matrices("toy", "m", [0], np.eye(2)[None])
    with pytest.raises(protocol.SlamError, match="two covariances for submap 0"):
        protocol.by_method(pd.concat([rows, rows]))


def test_clouds_follow_the_nodes_and_a_missing_one_is_named():
    clouds = {s.number: s.points for s in SUBMAPS}
    assert protocol.node_clouds(GRAPH, clouds)[5] is SUBMAPS[5].points
    del clouds[5]
    with pytest.raises(protocol.SlamError, match="submap 5"):
        protocol.node_clouds(GRAPH, clouds)


def test_a_floor_stands_below_every_variance():
    rows = table.from_matrices("toy", "sure", [0, 1], np.array([1e-13 * np.eye(2), np.eye(2)]))
    q = protocol.by_method(rows, 1e-6)["sure"]
    assert np.linalg.eigvalsh(q[0]) == pytest.approx([1e-6, 1e-6])
    assert q[1] == pytest.approx(np.eye(2), abs=1e-5)


def test_the_variants_are_of_a_few_methods_and_the_table_of_all():
    by_name = {variant.name: variant for variant in protocol.variants(["odd", "constant", "network"], SETTINGS)}
    assert by_name["table"].methods == ["odd", "constant", "network"]
    assert by_name["shared"].methods == by_name["authors"].methods == ["constant", "network"]
    assert (by_name["table"].edges, by_name["shared"].edges, by_name["authors"].edges) == ("all", "shared", "all")
    shared = dataclasses.replace(SETTINGS, edges="shared")
    assert [variant.name for variant in protocol.variants(["network"], shared)] == ["table", "all", "authors"]


def test_only_the_first_draw_has_the_paper_s_many_noises():
    for variant in protocol.variants(["network"], SETTINGS):
        assert variant.repetitions(1, SETTINGS) == 2
        assert variant.repetitions(0, SETTINGS) == (2 if variant.name == "shared" else 4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("edges", "some"), ("repetitions", 0), ("draw_repetitions", 0), ("draw_repetitions", 5), ("seed", -1)),
        *(("yaw_sigma_rad", -0.1), ("floor_m2", -1.0), ("map_cell_m", 0.0), ("map_thinning", 0)),
        *(("map_cell_m", 1e9), ("map_cell_m", 1e-300), ("floor_m2", 1e300)),
    ],
)
def test_settings_without_sense_are_refused(name: str, value: object):
    with pytest.raises(ValueError, match=f"^{name} is"):
        dataclasses.replace(SETTINGS, **{name: value})
