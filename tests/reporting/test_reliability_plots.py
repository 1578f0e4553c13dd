"""Reliability: the truth lies on the diagonal, a covariance too small under it."""

import numpy as np
import pytest

from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting.covariances import reliability_plots
from pointnetkl.reporting.drawing import plots

Q = np.array([[[4.0, 1.5, 0.01], [1.5, 1.0, 0.0], [0.01, 0.0, 0.001]]]).repeat(5, axis=0)
ERRORS = np.random.default_rng(0).multivariate_normal(np.zeros(3), Q[0], (5, 4000))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_true_covariance_holds_as_many_errors_as_it_says(dimensions: int):
    errors, q = ERRORS[..., :dimensions], Q[:, :dimensions, :dimensions]
    table = reliability_plots.coverage("mine", errors, {"monte_carlo": q}, ["monte_carlo"])
    np.testing.assert_allclose(table["observed"], table["nominal"], atol=0.01)


def test_a_covariance_too_small_is_under_the_diagonal_and_one_too_large_above():
    methods = {"network": 0.5 * Q, "constant": 2 * Q}
    table = reliability_plots.coverage("mine", ERRORS, methods, ["network", "constant", "cello"])
    share = table.assign(excess=table["observed"] - table["nominal"]).groupby("method")["excess"]
    assert set(share.groups) == {"network", "constant"}
    assert share.max()["network"] < 0 < share.min()["constant"]


def test_coverage_is_that_of_the_metrics():
    table = reliability_plots.coverage("mine", ERRORS, {"constant": 1.3 * Q}, ["constant"])
    at_95 = table.loc[np.isclose(table["nominal"], 0.95), "observed"].item()
    assert at_95 == pytest.approx(gaussian.calibration(ERRORS, 1.3 * Q)["coverage_95"])


def test_methods_of_one_family_differ_in_their_lines():
    methods = {"pointnetkl": Q, "network": 2 * Q, "constant": 3 * Q}
    axes = reliability_plots.reliability(reliability_plots.coverage("mine", ERRORS, methods, list(methods))).axes[0]
    looks = [(line.get_color(), line.get_linestyle()) for line in axes.lines]
    assert len(set(looks)) == 4  # and the diagonal


def test_without_held_out_errors_the_figure_says_so():
    figure = reliability_plots.reliability(reliability_plots.EMPTY)
    assert [text.get_text() for text in figure.texts] == ["no held-out errors: label.held_out_runs is 0"]
    assert plots.png(figure)
