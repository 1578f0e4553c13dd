"""graph.g2o, read and optimised by GTSAM."""

import dataclasses
from pathlib import Path

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares

import corrected_survey
from pointnetkl.correction.products import graph
from pointnetkl.correction.products.accepted import measurements
from pointnetkl.correction.result import Corrected, CorrectionError
from pointnetkl.exchange import g2o
from pointnetkl.slam.closing.estimate import Tie, from_matrices
from pointnetkl.slam.graph.pose_graph import DeadReckoningNoise
from pointnetkl.surveys.se2 import SE2

NOISE = [DeadReckoningNoise(1e-3, 1e-3, 0.02, 0.5 + 0.1 * k, 0.3, 0.01) for k in range(8)]


def written(path: Path, survey: Corrected) -> list[str]:
    assert survey.submaps is not None
    return graph.write(path / "graph.g2o", survey, survey.submaps, NOISE)


def factors_of(path: Path) -> tuple[dict[tuple[int, int], gtsam.BetweenFactorPose3], gtsam.Values]:
    read, values = gtsam.readG2o(str(path / "graph.g2o"), True)
    factors = [read.at(k) for k in range(read.size())]
    return {tuple(factor.keys()): factor for factor in factors}, values


def test_vertices_are_the_corrected_submaps_and_edges_dead_reckoning_and_closures(tmp_path: Path):
    survey = corrected_survey.corrected()
    sentences = written(tmp_path, survey)
    factors, values = factors_of(tmp_path)
    assert survey.submaps is not None
    for node, T in enumerate(survey.submaps.after):
        np.testing.assert_allclose(values.atPose3(node).matrix(), T, atol=1e-12)
    assert set(factors) == {(k, k + 1) for k in range(8)} | {(1, 4), (4, 7)}
    for k in range(8):
        relative = np.linalg.inv(survey.submaps.before[k]) @ survey.submaps.before[k + 1]
        np.testing.assert_allclose(factors[k, k + 1].measured().matrix(), relative, atol=1e-9)
    assert sentences == [
        "graph.g2o lacks 1 accepted closure that ground holds in less than two directions and 1 accepted closure on a"
        " reference"
    ]


def test_the_first_submap_is_held(tmp_path: Path):
    written(tmp_path, corrected_survey.corrected())
    assert "FIX 0\n" in (tmp_path / "graph.g2o").read_text()
    assert g2o.read(tmp_path / "graph.g2o").graph.fixed.tolist() == [0]


def test_a_closure_of_one_target_lies_off_the_corrected_poses_by_its_residual():
    survey = corrected_survey.corrected()
    assert survey.submaps is not None
    (first, *_), less = measurements(survey, survey.submaps)
    assert (first.target, first.source, less) == (1, 4, 1)
    np.testing.assert_allclose(first.lever, [3.0, 20.0], atol=1e-9)
    np.testing.assert_allclose(first.residual, corrected_survey.RESIDUAL, atol=1e-12)


def test_a_closure_informs_on_the_middle_of_its_overlap_with_the_covariance_of_its_shift(tmp_path: Path):
    survey = corrected_survey.corrected()
    written(tmp_path, survey)
    content = g2o.read(tmp_path / "graph.g2o")
    assert content.dialect == "g2o"
    covariance = np.linalg.inv(content.graph.information[8])
    lever = np.array([3.0, 20.0])
    J = np.zeros((2, 6))
    J[:, 3:5], J[:, 2] = np.eye(2), (-lever[1], lever[0])
    assert survey.submaps is not None
    R = survey.submaps.after[4][:2, :2]
    np.testing.assert_allclose(R @ J @ covariance @ J.T @ R.T, corrected_survey.V, rtol=1e-5)


def test_gtsam_finds_what_an_adjustment_of_the_closure_itself_finds(tmp_path: Path):
    survey = corrected_survey.corrected()
    survey = dataclasses.replace(survey, closures=survey.closures.iloc[:1])  # one target: nothing is approximate
    submaps = survey.submaps
    assert submaps is not None
    # GTSAM takes half angles of dialect g2o for angles, so that the weights would not be ours
    content = graph.graph(submaps, measurements(survey, submaps)[0], NOISE)
    g2o.write(tmp_path / "graph.g2o", content, "gtsam")
    read, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    read.add(gtsam.NonlinearEqualityPose3(0, values.atPose3(0)))
    solution = gtsam.LevenbergMarquardtOptimizer(read, values).optimize()
    solved = from_matrices(np.array([solution.atPose3(node).matrix() for node in range(9)]))
    expected = _adjusted(from_matrices(submaps.before), from_matrices(submaps.after), survey)
    np.testing.assert_allclose(solved[:, :2], expected[:, :2], atol=5e-3)
    np.testing.assert_allclose(np.cos(solved[:, 2] - expected[:, 2]), 1.0, atol=1e-6)
    assert np.abs(expected[:, :2] - from_matrices(submaps.before)[:, :2]).max() > 0.3


def _adjusted(before: np.ndarray, start: np.ndarray, survey: Corrected) -> np.ndarray:
    """Return poses (9, 3) that are most likely by dead reckoning and the tie's offset, with the first one held."""
    assert survey.submaps is not None
    (closure,) = measurements(survey, survey.submaps)[0]
    tie = Tie.at(start, closure.source, [closure.target], None, closure.lever)
    whiten = np.linalg.inv(np.linalg.cholesky(closure.V))
    moves = SE2.from_vector(before[:-1]).inverse() @ SE2.from_vector(before[1:])
    sigmas = np.array([[noise.x_m, noise.y_m, noise.yaw_rad] for noise in NOISE])

    def residuals(free: np.ndarray) -> np.ndarray:
        poses = np.vstack([start[:1], free.reshape(8, 3)])
        made = SE2.from_vector(poses[:-1]).inverse() @ SE2.from_vector(poses[1:])
        errors = (moves.inverse() @ made).to_vector()
        errors[:, 2] = np.mod(errors[:, 2] + np.pi, 2 * np.pi) - np.pi
        return np.concatenate(
            [(errors / sigmas).ravel(), whiten @ (tie.offset(poses) - tie.offset(before) - closure.shift)]
        )

    found = least_squares(residuals, start[1:].ravel(), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-12)
    return np.vstack([start[:1], found.x.reshape(8, 3)])


def test_several_targets_count_as_the_one_with_most_of_the_overlap():
    survey = corrected_survey.corrected()
    assert survey.submaps is not None
    last = measurements(survey, survey.submaps)[0][1]
    assert (last.target, last.source) == (4, 7)
    np.testing.assert_allclose(last.residual, corrected_survey.RESIDUAL, atol=1e-12)


def test_noises_must_be_one_between_each_two_submaps(tmp_path: Path):
    survey = corrected_survey.corrected()
    assert survey.submaps is not None
    with pytest.raises(CorrectionError, match="there are 7 noises of dead reckoning for 9 submaps"):
        graph.write(tmp_path / "graph.g2o", survey, survey.submaps, NOISE[1:])


def test_a_closure_of_another_survey_is_refused(tmp_path: Path):
    survey = corrected_survey.corrected()
    other = dataclasses.replace(survey, closures=survey.closures.assign(source=99))
    with pytest.raises(CorrectionError, match="names submap 99, which is not of the survey"):
        written(tmp_path, other)


def test_a_survey_without_closures_is_a_chain(tmp_path: Path):
    assert written(tmp_path, corrected_survey.without_closures()) == []
    assert len(factors_of(tmp_path)[0]) == 8
