"""The page's words on labels: their size, how sure they are, what they depend on, and how networks learn them."""

import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Blocks, cell


def eigenvalues(shown: Blocks) -> Section:
    """Return the section of the labels' eigenvalues and of how sure they are."""
    return Section(
        "Labels",
        (
            "A label is the second moment of the registration's errors from starts drawn about the truth (variance:"
            " the prior, 9 m² in the paper). A variance near the prior means that the seabed held no information, one"
            " near 0 that it fixed the position. The smaller eigenvalue is of the direction that the terrain holds"
            " best. Whiskers of the figure span 5 to 95 %, boxes the quartiles.",
            "relative_error is the largest standard error of the label's variance in any direction, as a share of it,"
            " from the errors' fourth moments: the median over submaps, and what 95 % of them stay below. bias is the"
            " mean error (m), part of the label, and bias_share its square's share of it. main_basin_share is the share"
            " of runs within three robust sigmas of the most common outcome: 0.99 where there is one basin.",
        ),
        [*shown["labels"], *shown["label_quality"]],
        {"labels": "Eigenvalues of the labels. Crosses: quantiles of what the authors' network predicts there."},
        (
            "label.copy same registers a submap to a noisy copy of its very points, as the paper does. That"
            " flatters, because an independent pass over the same ground has other points. Where points lie farther"
            " apart than the starts spread (self_matching, a share of the survey's submaps), the copy registers to"
            " itself.",
            "The values of the authors' network are its predictions on its own surveys, not labels: a rough guide"
            " only.",
        ),
    )


def dependence(shown: Blocks) -> Section:
    """Return the section of what a label depends on."""
    accuracy, noise = (shown[name][0].frame for name in ("label_accuracy", "label_noise"))
    return Section(
        "What a label depends on",
        (
            "Labels of a few submaps of each test survey, from flat to rugged, under other settings than the label"
            " stage's. All labels of one submap start from the same draws. Under another sigma they have the same"
            " noise, scaled; with other points they have other noise.",
            "Runs: a label is an estimate. Many registrations of one submap were divided into parts of L. The table and"
            " the first figure show how far a part's label is from the label of all runs: the error of the variance"
            " along the label's axes (root mean square, as a share), and KL(label || label of L)."
            f"{_accuracy(accuracy)}",
            "Spacing: the same submaps, thinned to coarser cells. Right of the dotted line points lie farther apart"
            " than the starts spread. There the copy of `same` can register to itself; on flat ground its label then"
            " falls by orders of magnitude and says nothing about the seabed. The clouds of `split` share no point.",
            "Noise: sigma of the noise on each coordinate of the copy, which the paper does not give. The"
            " power with which an eigenvalue grows is taken between the smallest sigma above 0 and the largest. About 2"
            " means that the noise alone makes the eigenvalue, so that the label only returns what was put in; about 0,"
            f" that any noise would do; between, that noise takes over at some sigma in between.{_noise(noise)}",
        ),
        [*shown["label_accuracy"], *shown["label_noise"]],
        {
            "cost_accuracy": "Error against cost, a line for each submap; dashed: what Gaussian errors would give."
            " Lines above it have a second basin that few of the L runs reached. The seconds above are of one thread,"
            " at the size of Table III's submaps.",
            "spacing": "Both eigenvalues of each submap's label against point spacing, under the label stage's noise.",
            "noise": "Both eigenvalues of each submap's label by the noise of the copy, at the survey's own spacing."
            " Without noise the copy of `same` is the cloud itself: its registration recovers the motion exactly, and"
            " the line runs off the bottom.",
        },
        (
            "The two halves of `split` are drawn once, so all runs of a label share the offset between them. On rugged"
            " ground, where noise is small, that one mean error is most of the label, and other soundings of the same"
            " ground would give it another direction (mean_x_m, mean_y_m of label_conditions.csv; bias_share above).",
            "Few submaps, and few parts at the largest L: its points are rough.",
        ),
    )


def training() -> Section:
    """Return the section of how networks learn the labels."""
    return Section(
        "Training",
        (
            "KL divergence to the labels as the network learns. Validation submaps are blocks along the track:"
            " few of them overlap a neighbour that is trained on, though adjacent lines still share some ground. The"
            " ring marks the weights that were kept. The floor (floor_m2 of a model's train) is added to both the label"
            " and the network's covariance before they are compared, and to neither when Q is used.",
        ),
        figures={"training": "KL divergence (nats) by optimiser step, a panel for each model (the paper's Fig. 4)."},
    )


def _accuracy(table: pd.DataFrame) -> str:
    # the largest number of runs with ten parts or more
    many = table[table["parts"] >= 10]
    if many.empty:
        return ""
    runs = many["runs"].max()
    errors = [
        f"{row.survey} {cell(100 * row.relative_error, 2)} % (at worst {cell(100 * row.relative_error_max, 2)} %)"
        for row in many[many["runs"] == runs].itertuples()
    ]
    theory = cell(100 * many.loc[many["runs"] == runs, "gaussian_error"].iloc[0], 2)
    return f" At L = {runs}: {', '.join(errors)}; Gaussian errors: {theory} %."


def _noise(table: pd.DataFrame) -> str:
    powers = table.dropna(subset=["power"])
    ranges = [
        f"{cell(float(labels['power'].min()), 2)} to {cell(float(labels['power'].max()), 2)} ({copy})"
        for copy, labels in powers.groupby("copy")
    ]
    return f" Here the powers are {' and '.join(ranges)}." if ranges else ""
