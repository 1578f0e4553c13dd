"""Covariances from the ground in common: of which points, and about which middle."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from pointnetkl.registration.covariance import table
from pointnetkl.slam.closures import overlap
from pointnetkl.surveys import pose
from pointnetkl.surveys.se2 import SE2
from pointnetkl.surveys.submap import Submap
from toy_survey import REGISTRATION, SPACING, SWATH, graph

REACH = 2 * SPACING


@dataclass(frozen=True)
class Asked:
    """A method that remembers what it was asked about."""

    name: str = "asked"
    dimensions: int = 2
    seen: dict[int, Submap] = field(default_factory=dict)

    def covariance(self, submap: Submap) -> np.ndarray:
        self.seen[submap.number] = submap
        return np.diag([1.0, 2.0, 1e-4][: self.dimensions])


def test_a_method_sees_the_points_over_the_targets_and_no_others():
    submaps, survey_graph = graph(2, 3, apart=12.0)
    method = Asked()
    covariances = overlap.tabulate([method], survey_graph, submaps, REACH)
    assert covariances["submap"].tolist() == survey_graph.closures.node.tolist()
    assert set(covariances["method"]) == {"asked_overlap"}
    # the second line lies 12 m beside the first, one way round, and its swath is as wide
    for number, part in method.seen.items():
        north = pose.transform(survey_graph.gt[number], part.points)[:, 1]
        assert 0.6 * len(submaps[number].points) < len(part.points) < 0.9 * len(submaps[number].points)
        assert north.max() < SWATH / 2 + REACH + 1.0
        assert pose.transform(survey_graph.gt[number], submaps[number].points)[:, 1].max() > SWATH / 2 + 10.0


def test_where_all_of_a_submap_was_registered_all_of_it_is_seen():
    submaps, survey_graph = graph(2, 3, apart=12.0)
    method = Asked()
    overlap.tabulate([method], survey_graph, submaps, None)
    assert all(part is submaps[number] for number, part in method.seen.items())


def test_ground_that_hardly_has_points_leaves_the_whole_submap():
    submaps, survey_graph = graph(2, 3)
    method = Asked()
    overlap.tabulate([method], survey_graph, submaps, 1e-6)
    assert [len(part.points) for part in method.seen.values()] == [len(submaps[n].points) for n in method.seen]


def test_with_yaw_a_covariance_is_moved_to_the_middle_of_the_whole_submap():
    submaps, survey_graph = graph(2, 3, apart=12.0, registration=replace(REGISTRATION, dof="xyyaw"))
    method = Asked(dimensions=3)
    covariances = overlap.tabulate([method], survey_graph, submaps, REACH)
    rng = np.random.default_rng(3)
    for number, q in zip(covariances["submap"], table.to_matrices(covariances), strict=True):
        away = submaps[number].points[:, :2].mean(axis=0) - method.seen[number].points[:, :2].mean(axis=0)
        errors = rng.normal(0.0, np.sqrt([1.0, 2.0, 1e-4]), (200_000, 3))
        moved = SE2.from_vector(errors).act(away) - away
        expected = np.cov(np.column_stack([moved, errors[:, 2]]), rowvar=False)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert q / scale == pytest.approx(expected / scale, abs=0.01)
        assert np.hypot(*away) > 3.0


def test_a_survey_that_closes_no_loop_has_an_empty_table():
    submaps, survey_graph = graph(1, 4)
    covariances = overlap.tabulate([Asked()], survey_graph, submaps, REACH)
    assert covariances.empty
    assert covariances.columns.tolist() == table.SCHEMA.names
