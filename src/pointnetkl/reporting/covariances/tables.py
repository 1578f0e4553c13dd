"""Tables of covariances: Tables II and III, calibration, and measures by terrain class, size of label and copy."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

from pointnetkl.registration.covariance import catalogue, gaussian
from pointnetkl.reporting import paper
from pointnetkl.reporting.results import GOLD
from pointnetkl.reporting.text_table import Block, Numbers, block, by_method, heading, interval

UNSEEN = "not in training"
COVERAGES = tuple(f"coverage_{round(100 * share)}" for share in gaussian.COVERAGES)
_CLASS = ("survey", "simulated", "class", "training", "submaps")


def every(
    numbers: Numbers, datasets: Numbers, training: Numbers, runtime: Numbers, methods: Collection[str]
) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files; `methods` have a row in Table III, timed or not."""
    kl = divergences(numbers["kl"], datasets)
    return {
        "table_2": [*table_2(numbers["kl"], datasets, training), kl],
        "table_3": table_3(runtime, methods),
        "kl": [kl],
        "calibration": [calibrations(numbers["calibration"], datasets)],
        **split(numbers, datasets),
    }


def split(numbers: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables that split the measures: long ones to compute with, and `terrain`, keys is to be read."""
    long = {
        "by_class": by_class(numbers["by_class"], datasets),
        "by_size": by_size(numbers["by_size"], datasets),
        "by_copy": by_copy(numbers["by_copy"], datasets),
    }
    wide = [block for blocks in long.values() for block in blocks[1:]]
    return {
        "terrain": [terrains(numbers["terrain"], datasets), *wide],
        **{name: blocks[:1] for name, blocks in long.items()},
    }


def table_2(kl: Numbers, datasets: Numbers, training: Numbers) -> list[Block]:
    """Return Table II: mean KL divergence (nats) of every method in training, validation and on each test survey.

    `training` has the divergences of methods that learn, {method: {"training": ..., "validation": ...}}, nats.
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
    printed = {heading(n, datasets) if n in datasets else n: Decimal(str(value)) for n, value in paper.KL.items()}
    rows.append({"method": "pointnetkl, the paper", **printed})
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
    """Return Table III: seconds per submap of `methods` and of all others that were timed, the paper's beside."""
    times = {name: time for name, time in runtime.items() if isinstance(time, Mapping) and "mean_s" in time}
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


def machine(runtime: Numbers) -> str:
    """Return in words where the times were measured, on how many submaps and points, and with how many label runs."""
    named = dict(runtime.get("machine", {}))
    timed = named.pop("params", {})
    kept = {key: timed[key] for key in ("submaps", "points", "runs") if key in timed}
    return ", ".join(f"{key} {value}" for key, value in (named | kept).items())


def terrains(by_survey: Numbers, datasets: Numbers) -> Block:
    """Return the terrain classes of every survey's submaps (terrain.counts)."""
    rows = [
        {**_class(survey, name, numbers, datasets), **numbers}
        for survey, classes in by_survey.items()
        for name, numbers in classes.items()
    ]
    caption = "Terrain classes: submaps, mean of their rms slopes, medians of their labels' eigenvalues."
    return block(caption, rows, [*_CLASS, "slope", "label_smaller_m2", "label_larger_m2"])


def by_class(by_survey: Numbers, datasets: Numbers) -> list[Block]:
    """Return every measure by survey, class and method (numbers.by_class); then the main ones, a column a method."""
    rows = list(_rows(by_survey, datasets))
    measures = ["mean", "ci_low", "ci_high", "median", "mean_floor0", "axis_error_deg", "network_better"]
    columns = [*_CLASS, "method", *measures, "nees", *COVERAGES, "mc_coverage_95"]
    wide = {
        "mean": "Mean KL(label || Q) by terrain class, nats.",
        "nees": "Normalised NEES by terrain class: 1 is right.",
        "coverage_95": "Share of errors inside the 95 % ellipse by terrain class; monte_carlo's own beside.",
    }
    every = block("All measures by terrain class and method.", rows, columns)
    return [every, *(_wide(caption, rows, _CLASS, measure) for measure, caption in wide.items())]


def by_size(by_survey: Numbers, datasets: Numbers) -> list[Block]:
    """Return mean KL by the size of the label (numbers.by_size), with the floor and without; then a column a method."""
    return _split(by_survey, datasets, "label_m2", "by the larger eigenvalue of the label (m²)")


def by_copy(by_survey: Numbers, datasets: Numbers) -> list[Block]:
    """Return mean KL to labels of both copies (numbers.by_copy), on the same few submaps; then a column a method."""
    return _split(by_survey, datasets, "copy", "by copy, on the submaps that have labels of both")


def _class(survey: str, name: str, numbers: Numbers, datasets: Numbers) -> dict[str, Any]:
    cells = {"survey": survey, "simulated": datasets[survey]["simulated"], "class": name}
    return {**cells, "training": "seen" if numbers["in_training"] else UNSEEN, "submaps": numbers["submaps"]}


def _rows(by_survey: Numbers, datasets: Numbers) -> Iterator[dict[str, Any]]:
    for survey, classes in by_survey.items():
        for name, numbers in classes.items():
            kl, calibration = numbers["kl"], numbers["calibration"]
            for method in dict.fromkeys([*calibration, *kl]):
                judged = {**kl.get(method, {}), **calibration.get(method, {})}
                yield {
                    **_class(survey, name, numbers, datasets),
                    "method": method,
                    **judged,
                    **interval(judged.get("ci95")),
                    "mc_coverage_95": calibration.get(GOLD, {}).get("coverage_95"),
                }


def _split(by_survey: Numbers, datasets: Numbers, by: str, words: str) -> list[Block]:
    keys = ("survey", "simulated", by, "submaps")
    rows = [
        {
            **dict(zip(keys, (survey, datasets[survey]["simulated"], name, part["submaps"]), strict=True)),
            "method": method,
        }
        | means
        for survey, parts in by_survey.items()
        for name, part in parts.items()
        for method, means in part["kl"].items()
    ]
    return [
        block(f"Mean KL {words}, nats.", rows, [*keys, "method", "mean", "mean_floor0"]),
        _wide(f"Mean KL {words}, nats.", rows, keys, "mean"),
        _wide(f"Mean KL without the floor, {words}, nats.", rows, keys, "mean_floor0"),
    ]


def _wide(caption: str, rows: Sequence[Mapping[str, Any]], keys: Sequence[str], measure: str) -> Block:
    kept = [row for row in rows if measure in row]
    lines: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in kept:
        line = lines.setdefault(tuple(row[name] for name in keys), {name: row[name] for name in keys})
        line[row["method"]] = row[measure]
    methods = dict.fromkeys(row["method"] for row in kept)
    return block(caption, list(lines.values()), [*keys, *methods])


def _paper_kl(row: Numbers) -> float | None:
    return paper.KL.get(row["survey"]) if row["method"] == catalogue.POINTNETKL else None
