"""The report's words on how sure a label is, and on what it depends on that the paper leaves open."""

from collections.abc import Mapping, Sequence

import pandas as pd

from pointnetkl.reporting.page import Section
from pointnetkl.reporting.text_table import Block, cell


def section(shown: Mapping[str, Sequence[Block]]) -> Section:
    """Return the section around the tables of label_tables, by the stems of their files."""
    accuracy, noise = (shown[name][0].frame for name in ("label_accuracy", "label_noise"))
    return Section(
        "What a label depends on",
        (
            "Labels of a few submaps of each test survey, from flat to rugged, under other choices than the label"
            " stage's. All of one submap start from the same draws, and under another sigma have the same noise,"
            " scaled; other points have other noise.",
            "Runs: a label is an estimate. Many registrations of one submap were taken apart into parts of L; the"
            " table and the first figure tell how far a part's label is from that of all: the error of the variance"
            " along the label's axes (root mean square, as a share), and KL(label || label of L)."
            f"{_accuracy(accuracy)}",
            "Spacing: the same submaps, thinned to coarser cells. Right of the dotted line points lie farther apart"
            " than the starts spread: there the copy of `same` can register to itself, and on flat ground its label"
            " then falls by orders of magnitude and tells nothing of the seabed. The clouds of `split` share no point.",
            "Noise: sigma of the noise on each coordinate of the copy, which the paper does not give. The"
            " power with which an eigenvalue grows is taken between the smallest sigma above 0 and the largest: about 2"
            " says that the noise alone makes it, and the label tells what was put in; about 0, that any noise would"
            f" do; between, that noise takes over somewhere on the way.{_noise(noise)}",
        ),
        [*shown["label_accuracy"], *shown["label_noise"]],
        {
            "cost_accuracy": "Error against cost, a line for each submap; dashed: what Gaussian errors would give."
            " Lines above it have a second basin that few of the L runs met. Seconds, above: on one thread, at the size"
            " of Table III's submaps.",
            "spacing": "Both eigenvalues of each submap's label against point spacing, under the label stage's noise.",
            "noise": "Both eigenvalues of each submap's label by the noise of the copy, at the survey's own spacing."
            " Without noise the copy of `same` is the very cloud, found exactly: lines leave through the bottom.",
        },
        (
            "The two halves of `split` are drawn once: all runs of a label share the offset between them. On rugged"
            " ground, where noise is small, that one mean error is most of the label, in a direction that other"
            " soundings of the same ground would turn (mean_x_m, mean_y_m of label_conditions.csv; bias_share above).",
            "Few submaps, and few parts at the largest L: its points are rough.",
        ),
    )


def _accuracy(found: pd.DataFrame) -> str:
    # the most runs that so many parts speak for
    many = found[found["parts"] >= 10]
    if many.empty:
        return ""
    runs = many["runs"].max()
    each = [
        f"{row.survey} {cell(100 * row.relative_error, 2)} % (at worst {cell(100 * row.relative_error_max, 2)} %)"
        for row in many[many["runs"] == runs].itertuples()
    ]
    theory = cell(100 * many.loc[many["runs"] == runs, "gaussian_error"].iloc[0], 2)
    return f" At L = {runs}: {', '.join(each)}; Gaussian errors: {theory} %."


def _noise(found: pd.DataFrame) -> str:
    powers = found.dropna(subset=["power"])
    each = [
        f"{cell(float(of['power'].min()), 2)} to {cell(float(of['power'].max()), 2)} ({copy})"
        for copy, of in powers.groupby("copy")
    ]
    return f" Here the powers are {' and '.join(each)}." if each else ""
