"""Tables that split the measures: by terrain class, by the label's size, by its copy."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pointnetkl.reporting.results import GOLD
from pointnetkl.reporting.tables import COVERAGES
from pointnetkl.reporting.text_table import Block, Numbers, block, interval

UNSEEN = "not in training"
_WHICH = ("survey", "simulated", "class", "training", "submaps")


def every(numbers: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files: long ones to compute with, and `terrain`, which is to be read."""
    split = {
        "by_class": by_class(numbers["by_class"], datasets),
        "by_size": by_size(numbers["by_size"], datasets),
        "by_copy": by_copy(numbers["by_copy"], datasets),
    }
    wide = [block for blocks in split.values() for block in blocks[1:]]
    return {
        "terrain": [terrains(numbers["terrain"], datasets), *wide],
        **{name: blocks[:1] for name, blocks in split.items()},
    }


def terrains(found: Numbers, datasets: Numbers) -> Block:
    """Return what terrain classes every survey's submaps are of (terrain.counts)."""
    rows = [
        {**_which(survey, name, of["submaps"], of["in_training"], datasets), **of}
        for survey, classes in found.items()
        for name, of in classes.items()
    ]
    caption = "Terrain classes: submaps, mean of their rms slopes, medians of their labels' eigenvalues."
    return block(caption, rows, [*_WHICH, "slope", "label_smaller_m2", "label_larger_m2"])


def by_class(found: Numbers, datasets: Numbers) -> list[Block]:
    """Return every measure by survey, class and method (summary.by_class); then the main ones, a column a method."""
    rows = list(_rows(found, datasets))
    measures = ["mean", "ci_low", "ci_high", "median", "mean_floor0", "axis_error_deg", "network_better"]
    columns = [*_WHICH, "method", *measures, "nees", *COVERAGES, "mc_coverage_95"]
    wide = {
        "mean": "Mean KL(label || Q) by terrain class, nats.",
        "nees": "Normalised NEES by terrain class: 1 is right.",
        "coverage_95": "Share of errors inside the 95 % ellipse by terrain class; monte_carlo's own beside.",
    }
    every = block("All measures by terrain class and method.", rows, columns)
    return [every, *(_wide(caption, rows, _WHICH, measure) for measure, caption in wide.items())]


def by_size(found: Numbers, datasets: Numbers) -> list[Block]:
    """Return mean KL by the size of the label (summary.by_size), with the floor and without; then a column a method."""
    return _split(found, datasets, "label_m2", "by the larger eigenvalue of the label (m²)")


def by_copy(found: Numbers, datasets: Numbers) -> list[Block]:
    """Return mean KL to labels of both copies (summary.by_copy), on the same few submaps; then a column a method."""
    return _split(found, datasets, "copy", "by copy, on the submaps that have labels of both")


def _which(survey: str, name: str, submaps: int, in_training: bool, datasets: Numbers) -> dict[str, Any]:
    place = {"survey": survey, "simulated": datasets[survey]["simulated"], "class": name}
    return {**place, "training": "seen" if in_training else UNSEEN, "submaps": submaps}


def _rows(found: Numbers, datasets: Numbers) -> Iterator[dict[str, Any]]:
    for survey, classes in found.items():
        for name, of in classes.items():
            kl, calibration = of["kl"], of["calibration"]
            for method in dict.fromkeys([*calibration, *kl]):
                judged = {**kl.get(method, {}), **calibration.get(method, {})}
                yield {
                    **_which(survey, name, of["submaps"], of["in_training"], datasets),
                    "method": method,
                    **judged,
                    **interval(judged.get("ci95")),
                    "mc_coverage_95": calibration.get(GOLD, {}).get("coverage_95"),
                }


def _split(found: Numbers, datasets: Numbers, by: str, words: str) -> list[Block]:
    which = ("survey", "simulated", by, "submaps")
    rows = [
        {
            **dict(zip(which, (survey, datasets[survey]["simulated"], part, of["submaps"]), strict=True)),
            "method": method,
        }
        | means
        for survey, parts in found.items()
        for part, of in parts.items()
        for method, means in of["kl"].items()
    ]
    return [
        block(f"Mean KL {words}, nats.", rows, [*which, "method", "mean", "mean_floor0"]),
        _wide(f"Mean KL {words}, nats.", rows, which, "mean"),
        _wide(f"Mean KL without the floor, {words}, nats.", rows, which, "mean_floor0"),
    ]


def _wide(caption: str, rows: Sequence[Mapping[str, Any]], which: Sequence[str], measure: str) -> Block:
    kept = [row for row in rows if measure in row]
    lines: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in kept:
        line = lines.setdefault(tuple(row[name] for name in which), {name: row[name] for name in which})
        line[row["method"]] = row[measure]
    methods = dict.fromkeys(row["method"] for row in kept)
    return block(caption, list(lines.values()), [*which, *methods])
