"""Tables of labels: their eigenvalues, how sure they are, and what they depend on that the paper leaves open."""

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd

from pointnetkl.reporting import paper
from pointnetkl.reporting.labels import numbers as label_numbers
from pointnetkl.reporting.results import Labels
from pointnetkl.reporting.text_table import Block, Numbers, block


def every(labels: Mapping[str, Labels], variations: pd.DataFrame, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files; `variations` has the schema label_table.VARIATIONS."""
    return {
        "labels": [label_quantiles({name: each.eigenvalues for name, each in labels.items()}, datasets)],
        "label_quality": [quality({name: each.rows for name, each in labels.items()}, datasets)],
        "label_accuracy": [accuracy(label_numbers.accuracy(variations), datasets)],
        "label_noise": [noise(label_numbers.by_noise(variations), datasets)],
        "label_conditions": [conditions(label_numbers.conditions(variations), datasets)],
    }


def label_quantiles(eigenvalues: Mapping[str, np.ndarray], datasets: Numbers) -> Block:
    """Return quantiles of the labels' eigenvalues, {survey: (k, 2) m^2}, and those of the authors' network."""
    names = [f"q{round(100 * q):02d}_m2" for q in paper.QUANTILES]
    rows = [
        {
            "survey": survey,
            "simulated": simulated,
            "eigenvalue": side,
            "of": source,
            **dict(zip(names, quantiles, strict=True)),
        }
        for survey, values in eigenvalues.items()
        for i, side in enumerate(("smaller", "larger"))
        for source, simulated, quantiles in _quantiles(survey, side, values[:, i], datasets)
    ]
    return block(
        "Quantiles of the eigenvalues of the labels, m².", rows, ["survey", "simulated", "eigenvalue", "of", *names]
    )


def quality(labels: Mapping[str, pd.DataFrame], datasets: Numbers) -> Block:
    """Return how sure each survey's labels are and how their registrations went."""
    surveys = [
        {"survey": name, "simulated": datasets[name]["simulated"], **label_numbers.quality(rows)}
        for name, rows in labels.items()
    ]
    caption = "How sure the labels are: runs, relative standard error, mean error, shares of the runs."
    return block(caption, surveys, ["survey", "simulated", *label_numbers.QUALITY])


def accuracy(errors: pd.DataFrame, datasets: Numbers) -> Block:
    """Return the error of labels by their number of runs (label_numbers.accuracy), over submaps, and in theory."""
    rows = [
        {
            "survey": survey,
            "simulated": datasets[survey]["simulated"],
            "runs": int(runs),
            "parts": int(submaps["parts"].sum()),
            **_spread(submaps, "relative_error", "relative_error"),
            "gaussian_error": float(label_numbers.gaussian_error(runs)),
            **_spread(submaps, "kl_mean", "kl_nats"),
            "gaussian_kl_nats": float(label_numbers.gaussian_kl(runs)),
        }
        for (survey, runs), submaps in errors.groupby(["survey", "runs"], sort=False)
    ]
    columns = [f"{name}{suffix}" for name in ("relative_error", "kl_nats") for suffix in ("", "_max")]
    return block(
        "Error of a label by its number of runs: median and largest over submaps.",
        rows,
        ["survey", "simulated", "runs", "parts", *columns[:2], "gaussian_error", *columns[2:], "gaussian_kl_nats"],
    )


def noise(labels: pd.DataFrame, datasets: Numbers) -> Block:
    """Return both eigenvalues of each submap's label (label_numbers.by_noise) by the noise of the copy, m^2.

    `power` is that of the noise with which an eigenvalue grows.
    """
    noises = sorted(set(labels["noise_sigma_m"]))
    names = [f"at_{sigma:g}_m" for sigma in noises]
    rows = []
    for (survey, number, copy), varied in labels.groupby(["survey", "submap", "copy"], sort=False):
        for side in label_numbers.SIDES:
            values = varied.set_index("noise_sigma_m")[f"{side}_m2"].reindex(noises).to_numpy()
            key = {"survey": survey, "simulated": datasets[survey]["simulated"], "submap": int(number), "copy": copy}
            power = label_numbers.growth(np.array(noises), values)
            rows.append({**key, "eigenvalue": side, **dict(zip(names, values.tolist(), strict=True)), "power": power})
    caption = "Eigenvalues of the label by the noise on each coordinate of the copy, m²."
    return block(caption, rows, ["survey", "simulated", "submap", "copy", "eigenvalue", *names, "power"])


def conditions(labels: pd.DataFrame, datasets: Numbers) -> Block:
    """Return every label under a varied spacing or noise (label_numbers.conditions)."""
    simulated = labels["survey"].map({name: each["simulated"] for name, each in datasets.items()})
    columns = ["survey", "simulated", "submap", "copy", "noise_sigma_m", "cell_m", "spacing_m", "points", "runs"]
    columns += ["q_xx_m2", "q_xy_m2", "q_yy_m2", "smaller_m2", "larger_m2", "relative_error"]
    columns += ["mean_x_m", "mean_y_m", "converged_share", "main_basin_share"]
    rows = labels.assign(simulated=simulated).to_dict("records")
    return block("Labels by spacing and noise.", rows, columns)


def _spread(submaps: pd.DataFrame, column: str, name: str) -> dict[str, float]:
    return {name: float(submaps[column].median()), f"{name}_max": float(submaps[column].max())}


def _quantiles(
    survey: str, side: str, values: np.ndarray, datasets: Numbers
) -> Iterator[tuple[str, bool, list[float]]]:
    yield "labels", datasets[survey]["simulated"], [float(q) for q in np.quantile(values, paper.QUANTILES)]
    if survey in paper.EIGENVALUES:
        yield "authors' network", False, list(paper.EIGENVALUES[survey][side])
