"""Figures are functions of tables: the same in, the same bytes out, and what they must show is there."""

import io
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from PIL import Image

from pointnetkl.reporting import paper
from pointnetkl.reporting.covariances import method_plots, pareto_plots
from pointnetkl.reporting.drawing import maps, plots
from pointnetkl.reporting.labels import figures as label_figures
from pointnetkl.reporting.surveys import figures as survey_figures

KL = pd.DataFrame(
    {
        "survey": ["borno_8"] * 2 + ["mine"] * 2,
        "method": ["constant", "pointnetkl"] * 2,
        "mean": [2.0, 1.0, 3.0, 0.5],
        "ci_low": [1.5, 0.8, 2.5, 0.4],
        "ci_high": [2.5, 1.2, 3.5, 0.6],
        "nees": [0.9, 1.8, 1.1, 40.0],
        "coverage_95": [0.9, 0.8, 0.95, 0.4],
        "paper": pd.Series([None, 1.0578, None, None], dtype=object),
    }
)
SLAM = KL.assign(
    rmse_xyz_m=KL["mean"],
    truth_rmse_xyz_m=pd.Series([9.0, 8.0, None, None], dtype=object),
)
SECONDS = {"pointnetkl": 0.01, "constant": 1e-4, "monte_carlo": 1.0}
LOSS = pd.DataFrame({"step": [1, 2, 3, 4], "training": [4.0, 3.0, 2.0, 1.0], "validation": [np.nan, 2.5, 2.0, 2.2]})


ACCURACY = pd.DataFrame(
    {
        "survey": "borno_8",
        "submap": [0] * 3 + [1] * 3,
        "runs": [13, 100, 1000] * 2,
        "relative_error": [0.4, 0.2, 0.1] * 2,
    }
).assign(kl_mean=lambda rows: rows["relative_error"] ** 2)
VARIED = pd.DataFrame(
    [
        (survey, number, copy, sigma, 0.9 * sigma, 3.0 + sigma, 1e-4 + sigma**2, 2e-4 + 9 * sigma**2)
        for survey in ("borno_8", "mine")
        for number in (3, 5)
        for copy in ("same", "split")
        for sigma in (0.0, 0.02, 0.1, 0.5)
    ],
    columns=["survey", "submap", "copy", "noise_sigma_m", "cell_m", "spacing_m", "smaller_m2", "larger_m2"],
)


POINTS = np.random.default_rng(0).uniform(-1, 1, (500, 3))
EIGENVALUES = {"borno_8": np.sort(9.0 * np.abs(POINTS[:30, :2]))}
EVERY: dict[str, Callable[[], Figure]] = {
    "training": lambda: label_figures.training({"pointnetkl": LOSS, "network": LOSS}),
    "kl": lambda: method_plots.divergence(KL),
    "calibration": lambda: method_plots.calibration(KL),
    "slam": lambda: method_plots.slam_error(SLAM),
    "labels": lambda: label_figures.eigenvalues(EIGENVALUES, 9.0, 0.01),
    "accuracy_time": lambda: pareto_plots.accuracy_time(KL, SECONDS),
    "cost_accuracy": lambda: label_figures.cost_accuracy(ACCURACY, 0.001),
    "spacing": lambda: label_figures.spacing(VARIED, 9.0),
    "noise": lambda: label_figures.noise(VARIED),
    "swath": lambda: survey_figures.draw_swath(100 * POINTS - [0, 0, 200], "baltic"),
    "canonical": lambda: survey_figures.draw_canonical({"baltic": POINTS, "borno_1": POINTS}),
}


def test_the_whisker_of_a_small_label_is_not_cut_off():
    labels = {"small": np.geomspace([1e-5, 1e-3], [1e-3, 1e-2], 20), "large": np.full((20, 2), 9.0)}
    axes = label_figures.eigenvalues(labels, 9.0, 0.01).axes[0]
    assert axes.get_xlim()[0] < np.quantile(labels["small"], 0.05)


@pytest.mark.parametrize("name", EVERY)
def test_a_figure_is_small_the_same_bytes_twice_and_has_no_date(name: str):
    first, second = plots.png(EVERY[name]()), plots.png(EVERY[name]())
    assert first == second
    assert len(first) < 300_000
    image = Image.open(io.BytesIO(first))
    assert not image.text  # matplotlib would write its version
    assert image.width == round(plots.WIDTH_IN * plots.DPI)


@pytest.mark.parametrize("name", ["training", "swath", "labels", "accuracy_time"])
def test_every_axis_names_its_unit(name: str):
    axes = EVERY[name]().axes[-1 if name == "accuracy_time" else 0]
    assert "(" in axes.get_xlabel() or axes.get_xlabel() == "optimiser step"
    assert "(" in axes.get_ylabel() or name == "labels"


@pytest.mark.parametrize("name", ["spacing", "noise"])
def test_both_copies_of_every_survey_are_drawn_on_shared_axes(name: str):
    axes = EVERY[name]().axes
    assert [each.get_title() for each in axes] == [
        f"{survey}, copy: {copy}" for survey in ("Bornö 8", "mine") for copy in ("same", "split")
    ]
    assert len({(each.get_xlim(), each.get_ylim()) for each in axes}) == 1


def test_labels_of_nothing_leave_the_axis_and_do_not_stretch_it():
    found = label_figures.noise(
        VARIED.assign(smaller_m2=VARIED["smaller_m2"].where(VARIED["noise_sigma_m"] > 0, 1e-16))
    )
    assert found.axes[0].get_ylim()[0] == pytest.approx(1e-7)


def test_without_a_time_per_registration_there_is_no_axis_of_seconds():
    assert label_figures.cost_accuracy(ACCURACY, None).axes[0].child_axes == []
    assert len(label_figures.cost_accuracy(ACCURACY, 0.001).axes[0].child_axes) == 1


def test_without_variations_the_figures_are_empty_and_no_error():
    assert plots.png(label_figures.cost_accuracy(ACCURACY.iloc[:0], None))
    assert plots.png(label_figures.noise(VARIED.iloc[:0]))


def test_the_training_curve_names_the_step_with_the_least_validation_divergence():
    first, second = label_figures.training({"pointnetkl": LOSS, "network": LOSS.iloc[:2]}).axes
    assert first.get_title() == "pointnetkl, kept: step 3, 2 nats"
    assert second.get_title() == "network, kept: step 2, 2.5 nats"


def test_a_training_curve_without_a_validation_is_still_drawn():
    assert plots.png(label_figures.training({"pointnetkl": LOSS.assign(validation=np.nan)}))


def test_a_validation_before_the_first_step_is_drawn():
    before = pd.DataFrame({"step": [0], "training": [np.nan], "validation": [7.0]})
    axes = label_figures.training({"network": pd.concat([before, LOSS])}).axes[0]
    trained, judged = axes.lines[:2]
    assert judged.get_xdata()[0] == 0
    assert trained.get_xdata()[0] == 1


def test_a_depth_map_holds_the_mean_depth_of_each_cell():
    points = np.array([[0.0, 0.0, -10.0], [0.5, 0.5, -20.0], [10.0, 0.0, -30.0]])
    depth, (left, right, _, _) = maps.raster(points, 1.0, np.array([[0.0, 0.0], [10.0, 0.5]]))
    assert depth[0, 0] == 15.0
    assert np.isnan(depth[0, 1])
    assert depth[0, -1] == 30.0
    assert left <= 0.0
    assert right >= 10.0


def test_a_straight_stretch_is_found_beyond_a_turn():
    corner = np.concatenate(
        [np.stack([np.arange(0, 300, 2.0), np.zeros(150)], -1), [[300.0, y] for y in range(0, 900, 2)]]
    )
    first, last = survey_figures.straight_stretch(corner, 500.0)
    assert corner[first, 0] == corner[last, 0] == 300.0
    assert corner[last, 1] - corner[first, 1] == pytest.approx(500, abs=4)


def test_a_short_survey_gives_a_shorter_stretch():
    line = np.stack([np.linspace(0, 80, 41), np.zeros(41)], -1)
    assert survey_figures.straight_stretch(line, 500.0) == (0, 40)


def test_surveys_and_methods_are_called_as_a_reader_calls_them():
    assert [paper.title(name) for name in ("borno_8", "thwaites_11", "monte_carlo", "scituate", "my_survey")] == [
        "Bornö 8", "Thwaites 11", "Monte Carlo", "Scituate", "my_survey"
    ]  # fmt: skip
