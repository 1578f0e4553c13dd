"""The figures of covariances, and which of the results each one shows."""

from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from pointnetkl.registration.covariance import catalogue
from pointnetkl.reporting import results
from pointnetkl.reporting.covariances import cases, ellipse_plots, method_plots, pareto_plots, reliability_plots

# Ellipses beside the label's: of each group the first method that has covariances
_COMPARED = (
    (catalogue.NETWORK, catalogue.POINTNETKL),
    (catalogue.STRUCTURE_TENSOR,),
    (catalogue.CENSI_CALIBRATED, catalogue.NAIVE_GICP),
)
_SUBMAPS_ACROSS, _WORST = 4, 10
_RELIABLE = (
    *(results.GOLD, catalogue.NETWORK, catalogue.POINTNETKL, catalogue.STRUCTURE_TENSOR, catalogue.CELLO),
    *(catalogue.CENSI_CALIBRATED, catalogue.UNSCENTED, catalogue.CONSTANT, catalogue.NAIVE_GICP),
)


def every(
    surveys: Sequence[cases.Survey], kl: pd.DataFrame, calibration: pd.DataFrame, runtime: Mapping[str, Any]
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures by name; `kl` and `calibration` are tables of the test surveys (tables.divergences)."""
    seconds = {name: times["mean_s"] for name, times in runtime.items() if "mean_s" in times}
    yield "submaps", submaps(surveys)
    yield from ((f"worst/{name}", figure) for name, figure in worst(surveys))
    yield "reliability", reliability(surveys)
    yield "kl", method_plots.divergence(kl)
    yield "calibration", method_plots.calibration(calibration)
    yield "accuracy_time", pareto_plots.accuracy_time(kl, seconds)


def submaps(surveys: Sequence[cases.Survey]) -> Figure:
    """Draw some submaps of each test survey, the largest label first, with its ellipse and those of a few methods."""
    present = set().union(*(survey.test.covariances for survey in surveys))
    methods = _first_present(_COMPARED, present)
    return ellipse_plots.gallery(
        {survey.name: cases.large_to_small(survey, methods, _SUBMAPS_ACROSS) for survey in surveys}
    )


def worst(surveys: Sequence[cases.Survey]) -> Iterator[tuple[str, Figure]]:
    """Yield each method's page of the submaps that it is most wrong about, by the method's name."""
    methods = dict.fromkeys(method for survey in surveys for method in survey.test.covariances)
    for method in methods:
        if method != results.GOLD:  # the labels themselves
            yield method, ellipse_plots.worst(method, cases.worst(surveys, method, _WORST))


def reliability(surveys: Sequence[cases.Survey]) -> Figure:
    """Draw the coverage of the main methods' ellipses on errors that no label has seen, at every level."""
    tables = [
        reliability_plots.coverage(
            each.name, each.test.held_out, {results.GOLD: each.labels.q, **each.test.covariances}, _RELIABLE
        )
        for each in surveys
        if each.test.held_out.size
    ]
    return reliability_plots.reliability(pd.concat([reliability_plots.EMPTY, *tables]))


def _first_present(groups: Sequence[Sequence[str]], present: Container[str]) -> list[str]:
    firsts = (next((method for method in group if method in present), None) for group in groups)
    return [method for method in firsts if method]
