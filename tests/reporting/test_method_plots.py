"""Charts of methods: every method has one line in all panels, the best on top, and none is lost beyond an axis."""

import itertools

import numpy as np
import pandas as pd

from pointnetkl.registration.covariance.catalogue import Family
from pointnetkl.reporting.covariances import method_plots, pareto_plots
from pointnetkl.reporting.drawing import families, plots

METHODS = (
    *("monte_carlo", "constant", "naive_gicp", "naive_meancov", "hessian", "censi", "unscented"),
    *("mc_5", "mc_13", "mc_65", "mc_300", "constant_train", "hessian_calibrated", "censi_calibrated"),
    *("structure_tensor", "cello", "pointnetkl", "pointnetkl_unscaled", "network"),
)


def table(methods: tuple[str, ...] = METHODS) -> pd.DataFrame:
    """Return made-up results of the methods on three surveys, the later ones better; some at the same place."""
    rank = np.tile(np.arange(len(methods), 0.0, -1), 3)
    mean = 0.01 * 1.5 ** (rank // 2)
    return pd.DataFrame(
        {
            "survey": np.repeat(["borno_8", "thwaites_11", "mine"], len(methods)),
            "method": methods * 3,
            "mean": mean,
            "ci_low": mean / 1.2,
            "ci_high": mean * 1.3,
            "paper": None,
            "nees": 1 + rank,
            "coverage_95": 1 / (1 + 0.01 * rank),
        }
    )


def names(figure: plots.Figure) -> list[str]:
    """Return the names at the side of a figure's first panel."""
    return [label.get_text() for label in figure.axes[0].get_yticklabels()]


def test_each_survey_has_a_panel_and_the_best_method_is_on_top():
    kl = table()[lambda rows: rows["method"] != "monte_carlo"]
    figure = method_plots.divergence(kl)
    assert [axes.get_title() for axes in figure.axes] == ["Bornö 8", "Thwaites 11", "mine"]
    assert names(figure)[0] == "network"
    assert names(figure)[-1] in ("constant", "naive_gicp")
    assert figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1]  # the first line on top


def test_the_gold_standard_is_above_all_methods():
    assert names(method_plots.calibration(table()))[0] == "monte_carlo"


def test_a_method_without_a_row_in_one_survey_shifts_no_other():
    kl = table(("constant", "censi", "network")).assign(mean=[3.0, 2.0, 1.0] * 3)
    fewer = kl[(kl["survey"] != "thwaites_11") | (kl["method"] != "censi")]
    whole, part = method_plots.divergence(kl), method_plots.divergence(fewer)
    assert names(whole) == names(part) == ["network", "censi", "constant"]
    heights = [line.get_ydata()[0] for line in part.axes[1].lines if len(line.get_ydata())]
    assert sorted(heights) == [0, 2]


def test_a_figure_grows_with_the_number_of_methods():
    few, many = (method_plots.divergence(table(methods)).get_size_inches()[1] for methods in (METHODS[:5], METHODS))
    assert many - few > 0.15 * (len(METHODS) - 5)


def test_a_nees_beyond_the_axis_is_written_at_its_border():
    axes = method_plots.calibration(table(("constant", "network")).assign(nees=[227426486.0, 1.0] * 3)).axes[0]
    assert [text.get_text() for text in axes.texts] == ["2e8 →"]
    assert all(axes.get_xlim()[0] < line.get_xdata()[0] < axes.get_xlim()[1] for line in axes.lines)


def test_what_no_covariance_made_does_not_stretch_the_slam_axis():
    errors = {"corrupted": 200.0, "constant": 5.2, "network": 5.0}
    slam = pd.DataFrame({"survey": "mine", "method": list(errors), "rmse_xyz_m": list(errors.values())})
    axes = method_plots.slam_error(slam.assign(ci_low=4.9, ci_high=5.3, truth_rmse_xyz_m=None)).axes[0]
    assert axes.get_xlim()[1] < 6
    assert "corrupted: 200 m" in axes.get_title()


def test_titles_and_labels_of_many_surveys_do_not_run_into_each_other():
    rows = [
        {"survey": f"survey_{i}", "method": method, "rmse_xyz_m": 5.68, "truth_rmse_xyz_m": 13.6, "nees": 1.0}
        for i in range(6)
        for method in ("corrupted", "constant")
    ]
    table = pd.DataFrame(rows).assign(ci_low=4.9, ci_high=5.3, coverage_95=0.9)
    for figure in (method_plots.slam_error(table), method_plots.calibration(table)):
        figure.draw_without_rendering()
        words = [[axes.title, axes.xaxis.label] for axes in figure.axes]
        for row in filter(None, (words[:6], words[6:])):
            for side_by_side in zip(*row, strict=True):
                boxes = [text.get_window_extent() for text in side_by_side if text.get_text()]
                assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


def test_a_table_without_rows_makes_an_empty_figure():
    empty = table().iloc[:0]
    assert plots.png(method_plots.divergence(empty))
    assert plots.png(pareto_plots.accuracy_time(empty, {}))


def test_without_held_out_errors_a_figure_says_so():
    figure = method_plots.calibration(table().iloc[:0])
    assert [text.get_text() for text in figure.texts] == ["no held-out errors: label.held_out_runs is 0"]
    assert plots.png(figure)


def test_every_family_has_a_colour_and_a_marker_of_its_own():
    assert list(families.STYLES) == list(Family)
    assert len({(each.colour, each.marker) for each in families.STYLES.values()}) == len(Family)
    assert families.style("constant_train") == families.STYLES[Family.LEARNED] != families.style("constant")


def test_no_name_covers_another_or_a_point_of_the_pareto_figure():
    seconds = {method: 0.01 * 1.15 ** (i // 3) for i, method in enumerate(METHODS)}
    figure = pareto_plots.accuracy_time(table(), seconds)
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent().padded(-0.5) for text in axes.texts]
        assert len(boxes) == len(METHODS)
        assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
        drawn = [line.get_xydata() for line in axes.lines if line.get_marker() != "None"]
        points = axes.transData.transform(np.concatenate(drawn))
        assert not any(box.contains(*point) for box in boxes for point in points)


def test_the_pareto_front_falls_to_the_gold_standard():
    axes = pareto_plots.accuracy_time(
        table(), {method: 0.001 * i + 1e-5 for i, method in enumerate(reversed(METHODS))}
    ).axes[0]
    (front,) = [line for line in axes.lines if line.get_label() == "Pareto front"]
    assert (np.diff(front.get_ydata()) <= 0).all()
    assert (np.diff(front.get_xdata()) >= 0).all()
    assert front.get_ydata()[-1] == axes.get_ylim()[0]
