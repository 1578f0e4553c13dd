"""The paper's four tables and ours beside them, from the numbers of `summary`; None where nothing is known."""

from collections.abc import Collection, Iterator, Mapping
from decimal import Decimal
from typing import Any

import numpy as np

from pointnetkl.registration.covariance import gaussian
from pointnetkl.reporting import paper
from pointnetkl.reporting.results import GOLD
from pointnetkl.reporting.text_table import Block, Numbers, block, by_method, heading, interval

_SIZES = ("area_km2", "submaps", "sigma_z")
COVERAGES = tuple(f"coverage_{round(100 * share)}" for share in gaussian.COVERAGES)


def table_1(datasets: Numbers) -> list[Block]:
    """Return Table I: each survey's vehicle, area, submaps and sigma_z, the paper's beside; then their density."""
    rows = [{"survey": name, **numbers, **_paper_sizes(name, numbers)} for name, numbers in datasets.items()]
    sizes = [column for size in _SIZES for column in (size, f"paper_{size}", f"ratio_{size}")]
    density = ("track_km", "points_mean", "points_std", "spacing_m", "label_runs", "self_matching")
    return [
        block(
            "Table I. Surveys: size, and spread of the normalised points.",
            rows,
            ["survey", "simulated", "vehicle", *sizes],
        ),
        block("Points per registration cloud, and registrations per label.", rows, ["survey", "simulated", *density]),
    ]


def table_2(kl: Numbers, datasets: Numbers, training: Numbers) -> list[Block]:
    """Return Table II: mean KL divergence (nats) of every method in training, validation and on each test survey.

    `training` has what is known of methods that learn, {method: {"training": ..., "validation": ...}}, nats.
    """
    surveys = [name for name in kl if name in datasets]
    methods = dict.fromkeys(method for name in surveys for method in kl[name])
    rows = [
        {
            "method": method,
            **training.get(method, {}),
            **{heading(name, datasets): kl[name].get(method, {}).get("mean") for name in surveys},
        }
        for method in methods
    ]
    # decimals are written as they are: the paper's numbers as it prints them
    known = {heading(n, datasets) if n in datasets else n: Decimal(str(value)) for n, value in paper.KL.items()}
    rows.append({"method": "pointnetkl, the paper", **known})
    caption = "Table II. Mean KL divergence by method, nats; training: cello's by left-out blocks, others in sample."
    columns = ["method", "training", "validation", *(heading(name, datasets) for name in surveys)]
    return [block(caption, rows, columns)]


def divergences(kl: Numbers, datasets: Numbers) -> Block:
    """Return KL(label || Q) in nats and the axis error of every method on every test survey."""
    rows = [{**row, **interval(row.get("ci95")), "paper": _paper_kl(row)} for row in by_method(kl, datasets)]
    columns = ["survey", "simulated", "method", "mean", "ci_low", "ci_high", "median", "mean_floor0", "axis_error_deg"]
    columns += ["network_better", "paper"]
    return block("KL(label || Q) by method, nats; the interval is of the mean.", rows, columns)


def calibrations(calibration: Numbers, datasets: Numbers) -> Block:
    """Return NEES and coverage of every method on held-out registration errors."""
    columns = ["survey", "simulated", "method", "nees", *COVERAGES, "mc_coverage_95"]
    gold = {name: methods.get(GOLD, {}).get("coverage_95") for name, methods in calibration.items()}
    rows = [{**row, "mc_coverage_95": gold[row["survey"]]} for row in by_method(calibration, datasets)]
    return block("Calibration on registration errors that no label has seen.", rows, columns)


def table_3(runtime: Numbers, methods: Collection[str] = ()) -> list[Block]:
    """Return Table III: seconds per submap of `methods` and whatever else was timed, the paper's beside."""
    times = {name: of for name, of in runtime.items() if isinstance(of, Mapping) and "mean_s" in of}
    gold = times.get(GOLD, {}).get("mean_s")
    rows = [
        {
            "method": name,
            **times.get(name, {}),
            "times_faster": gold / times[name]["mean_s"] if gold and name in times and times[name]["mean_s"] else None,
            **dict(zip(("paper_mean_s", "paper_std_s"), paper.RUNTIME.get(name, (None, None)), strict=True)),
        }
        for name in dict.fromkeys([*methods, *times])
    ]
    columns = ("method", "mean_s", "std_s", "times_faster", "paper_mean_s", "paper_std_s")
    caption = f"Table III. Seconds per submap. Ours: {machine(runtime)}. The paper: {paper.RUNTIME_MACHINE}."
    return [block(caption, rows, columns)]


def label_quantiles(eigenvalues: Mapping[str, np.ndarray], datasets: Numbers) -> Block:
    """Return quantiles of the labels' eigenvalues, {survey: (k, 2) m^2}, and of the authors' network's."""
    names = [f"q{round(100 * q):02d}_m2" for q in paper.QUANTILES]
    rows = [
        {
            "survey": survey,
            "simulated": simulated,
            "eigenvalue": side,
            "of": of,
            **dict(zip(names, values, strict=True)),
        }
        for survey, found in eigenvalues.items()
        for i, side in enumerate(("smaller", "larger"))
        for of, simulated, values in _quantiles(survey, side, found[:, i], datasets)
    ]
    return block(
        "Quantiles of the eigenvalues of the labels, m².", rows, ["survey", "simulated", "eigenvalue", "of", *names]
    )


def machine(runtime: Numbers) -> str:
    """Return the machine that the times are of, and how many submaps, points and label runs, in words."""
    named = dict(runtime.get("machine", {}))
    timed = named.pop("params", {})  # what was timed
    kept = {key: timed[key] for key in ("submaps", "points", "runs") if key in timed}
    return ", ".join(f"{key} {value}" for key, value in (named | kept).items())


def _paper_sizes(name: str, ours: Numbers) -> dict[str, Any]:
    if name not in paper.DATASETS:
        return {}
    theirs = {size: getattr(paper.DATASETS[name], size) for size in _SIZES}
    ratios = {f"ratio_{size}": ours[size] / theirs[size] for size in _SIZES}
    return {**{f"paper_{size}": value for size, value in theirs.items()}, **ratios}


def _paper_kl(row: Numbers) -> float | None:
    return paper.KL.get(row["survey"]) if row["method"] == "pointnetkl" else None


def _quantiles(
    survey: str, side: str, values: np.ndarray, datasets: Numbers
) -> Iterator[tuple[str, bool, list[float]]]:
    yield "labels", datasets[survey]["simulated"], [float(q) for q in np.quantile(values, paper.QUANTILES)]
    if survey in paper.EIGENVALUES:
        yield "authors' network", False, list(paper.EIGENVALUES[survey][side])
